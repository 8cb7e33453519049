"""Re-tunes a control law on the bench: what may change, on which runs, by which search."""

from metro_hil.tuning.parameters import DEFAULTS, PARAMETERS, TunedParameter, chosen_parameters
from metro_hil.tuning.tuner import RunFigures, Tuned, Tuner

__all__ = [
    "DEFAULTS",
    "PARAMETERS",
    "RunFigures",
    "TunedParameter",
    "Tuned",
    "Tuner",
    "chosen_parameters",
]
