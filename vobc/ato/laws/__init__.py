"""Control laws by name. A new law is one module and one line in the table."""

import difflib
from collections.abc import Callable, Mapping
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.ato.laws.chasing import Chasing
from vobc.ato.laws.chasing_literal import ChasingLiteral
from vobc.ato.laws.green import GreenRun
from vobc.ato.laws.law import Strategy
from vobc.ato.laws.pid import PidPredicted
from vobc.ato.laws.pid_literal import PidLiteral
from vobc.ato.laws.power_limited import PowerLimitedRun
from vobc.ato.laws.predictive import Predictive
from vobc.ato.laws.timing import TimedRun
from vobc.ato.settings.ato import AtoConfig

STRATEGIES: Final[Mapping[str, Callable[[AtoConfig, LineMap, float], Strategy]]] = {
    "predictive": Predictive,
    "pid": PidPredicted,
    "pid_literal": PidLiteral,
    "timing": TimedRun,
    "green": GreenRun,
    "power_limited": PowerLimitedRun,
    "chasing": Chasing,
    "chasing_literal": ChasingLiteral,
}
"""Makers of the laws. Their arguments are settings, line and nominal cycle time in seconds."""


def make_strategy(config: AtoConfig, line: LineMap, dt_s: float) -> Strategy:
    """Create a law. Raises ValueError with the nearest known name for an unknown one."""
    maker = STRATEGIES.get(config.strategy)
    if maker is None:
        names = sorted(STRATEGIES)
        close = difflib.get_close_matches(config.strategy, names, n=1) or names
        raise ValueError(f"strategy {config.strategy} is unknown; did you mean {close[0]}?")
    return maker(config, line, dt_s)
