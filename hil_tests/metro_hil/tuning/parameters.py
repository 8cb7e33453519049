"""The tunable parameters of each control law, with their bounds."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from firmware_py.settings import SettingsError, nearest
from vobc.ato.laws import STRATEGIES
from vobc.config import VobcConfig

DIGITS: Final = 4
"""Number of significant digits of a tried or written setting."""


@dataclass(frozen=True, slots=True)
class TunedParameter:
    """One parameter by dotted key, with bounds in its own unit."""

    key: str
    low: float
    high: float
    logarithmic: bool = False
    """Whether equal steps of the search are equal ratios of the value."""

    def value(self, share_ratio: float) -> float:
        """The value at a share of the range from `low` to `high`."""
        if self.logarithmic:
            raw = self.low * (self.high / self.low) ** share_ratio
        else:
            raw = self.low + (self.high - self.low) * share_ratio
        return float(f"{raw:.{DIGITS}g}")

    def share_ratio(self, value: float) -> float:
        """The share of the range at a value; a value out of bounds counts as the bound."""
        within = min(self.high, max(self.low, value))
        if self.logarithmic:
            return math.log(within / self.low) / math.log(self.high / self.low)
        return (within - self.low) / (self.high - self.low)


def _gains(
    prefix: str, kp: tuple[float, float], ki: tuple[float, float]
) -> tuple[TunedParameter, ...]:
    return (
        TunedParameter(f"{prefix}.kp_per_s", *kp, logarithmic=True),
        TunedParameter(f"{prefix}.ki_per_s2", *ki, logarithmic=True),
    )


STOPPING: Final = (
    TunedParameter("ato.braking.ease_jerk_mps3", 0.15, 0.55),
    TunedParameter("ato.braking.plateau_decel_mps2", 0.2, 0.5),
    TunedParameter("ato.braking.plateau_speed_mps", 1.0, 3.0),
    TunedParameter("ato.braking.final_decel_mps2", 0.04, 0.15),
    TunedParameter("ato.braking.correction_ratio", 2.0, 4.0),
    TunedParameter("ato.braking.least_decel_mps2", 0.02, 0.06),
    TunedParameter("ato.braking.decel_mps2", 0.5, 0.78),
)
"""Braking parameters of the predictive law. Laws that only choose a speed brake with it as well."""

PARAMETERS: Final[Mapping[str, tuple[TunedParameter, ...]]] = {
    "chasing": (
        TunedParameter("ato.chasing.dead_time_s", 0.3, 1.4),
        TunedParameter("ato.chasing.lag_s", 0.15, 0.7, logarithmic=True),
        TunedParameter("ato.chasing.chase_ratio", 0.1, 0.6, logarithmic=True),
        TunedParameter("ato.chasing.small_decel_mps2", 0.15, 0.35),
        TunedParameter("ato.chasing.chase_decel_mps2", 0.08, 0.15),
        TunedParameter("ato.chasing.last_decel_mps2", 0.03, 0.08),
        TunedParameter("ato.chasing.last_speed_mps", 0.08, 0.4),
        TunedParameter("ato.chasing.decel_mps2", 0.4, 0.7),
        TunedParameter("ato.chasing.dwell_s", 0.2, 1.2),
        TunedParameter("ato.chasing.early_s", 0.0, 1.2),
        TunedParameter("ato.chasing.quiet_band_mps", 0.05, 0.3),
    ),
    "green": STOPPING,
    "pid": (
        *_gains("ato.pid.rising", (0.1, 1.5), (0.001, 0.3)),
        *_gains("ato.pid.falling", (0.05, 1.2), (0.001, 0.2)),
        *_gains("ato.pid.constant", (0.05, 1.2), (0.001, 0.2)),
        *_gains("ato.pid.position", (0.02, 1.5), (0.001, 0.3)),
        TunedParameter("ato.pid.position.kd_ratio", 0.05, 2.5, logarithmic=True),
        TunedParameter("ato.pid.falling.kd_ratio", 0.0, 0.2),
        TunedParameter("ato.pid.t2_speed_mps", 0.9, 1.8),
        TunedParameter("ato.pid.t3_speed_mps", 0.55, 0.85),
        TunedParameter("ato.pid.last_decel_mps2", 0.04, 0.1),
        TunedParameter("ato.pid.decel_mps2", 0.4, 0.67),
        TunedParameter("ato.pid.ease_jerk_mps3", 0.15, 0.55),
    ),
    "pid_literal": (
        *_gains("ato.pid_literal.rising", (0.1, 8.0), (0.001, 0.3)),
        *_gains("ato.pid_literal.falling", (0.05, 1.2), (0.001, 0.3)),
        *_gains("ato.pid_literal.constant", (0.05, 1.2), (0.001, 0.3)),
        *_gains("ato.pid_literal.position", (0.02, 1.5), (0.001, 0.4)),
        TunedParameter("ato.pid_literal.position.kd_ratio", 0.05, 2.5, logarithmic=True),
    ),
    "power_limited": STOPPING,
    "predictive": STOPPING,
    "timing": STOPPING,
}
"""Tunable parameters by law; a new law adds an entry."""

DEFAULTS: Final[Mapping[str, tuple[str, ...]]] = {
    "pid": tuple(
        parameter.key
        for parameter in PARAMETERS["pid"]
        if parameter.key.split(".")[2] in ("falling", "constant", "position")
        and not parameter.key.startswith("ato.pid.falling.kd")
    ),
    "pid_literal": tuple(parameter.key for parameter in PARAMETERS["pid_literal"]),
    **{
        law: tuple(parameter.key for parameter in PARAMETERS[law][:5])
        for law in ("green", "power_limited", "predictive", "timing")
    },
    "chasing": tuple(parameter.key for parameter in PARAMETERS["chasing"][:7]),
}
"""Parameters tuned by default: gains, or the shape of the last metres."""


def chosen_parameters(law: str, keys: Sequence[str]) -> tuple[TunedParameter, ...]:
    """The named parameters, in the order of the table; without names, the law's default ones.

    Raises SettingsError for a law without a table, or a key that its table lacks.
    """
    if law not in STRATEGIES:
        raise SettingsError(f"--law {law}: {nearest(law, sorted(STRATEGIES), 'law')}")
    table = PARAMETERS.get(law)
    if table is None:
        others = ", ".join(sorted(PARAMETERS))
        raise SettingsError(f"--law {law}: it has no tunable parameters; laws with some: {others}")
    known = [parameter.key for parameter in table]
    for key in keys:
        if key not in known:
            raise SettingsError(f"--parameters {key}: {nearest(key, known, 'setting')}")
    wanted = keys or DEFAULTS.get(law, known)
    return tuple(parameter for parameter in table if parameter.key in wanted)


def value_of(config: VobcConfig, key: str) -> float:
    """The present value of a parameter."""
    found: Any = config
    for name in key.split("."):
        found = getattr(found, name)
    return float(found)
