"""Re-tunes a control law on the bench: its parameters, its training runs, and the search."""

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
