"""Re-tunes a control law on the bench: what may change, on which runs, by which search."""

from metro_hil.tuning.parameters import DEFAULTS, PARAMETERS, Parameter, chosen_parameters
from metro_hil.tuning.tuner import Figures, Tuned, Tuner

__all__ = [
    "DEFAULTS",
    "PARAMETERS",
    "Figures",
    "Parameter",
    "Tuned",
    "Tuner",
    "chosen_parameters",
]
