"""Adhesion estimate: after a slip the rail counts as slippery for a while."""

from dataclasses import replace
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.ato.motion import profile
from vobc.ato.settings.ato import AtoConfig

NS_PER_S: Final = 1_000_000_000


class Manner:
    """Driving limits for one rail condition."""

    __slots__ = ("accel_mps2", "config", "limits")

    def __init__(self, config: AtoConfig, line: LineMap, accel_mps2: float) -> None:
        self.config = config
        self.limits = profile.SpeedLimits(config, line)
        self.accel_mps2 = accel_mps2


class AdhesionEstimate:
    """Remembers slips.

    A new slip does not change a braking under way. That braking was planned for a good rail and
    needs all the adhesion it can get.
    """

    __slots__ = ("_dry", "_memory_ns", "_slippery", "_slippery_until_ns", "slippery")

    def __init__(self, config: AtoConfig, line: LineMap) -> None:
        rail = config.slippery
        self._dry = Manner(config, line, config.limits.accel_mps2)
        accel_mps2 = min(rail.accel_mps2, config.limits.accel_mps2)
        self._slippery = Manner(gently(config), line, accel_mps2)
        self._memory_ns = round(rail.memory_s * NS_PER_S)
        self._slippery_until_ns = 0
        self.slippery = rail.from_start

    def observe(self, now_ns: int, *, slips: bool) -> None:
        if self.slippery and self._slippery_until_ns == 0:
            self._slippery_until_ns = now_ns + self._memory_ns
        if slips:
            self._slippery_until_ns = now_ns + self._memory_ns
        self.slippery = now_ns < self._slippery_until_ns

    @property
    def manner(self) -> Manner:
        return self._slippery if self.slippery else self._dry


def gently(config: AtoConfig) -> AtoConfig:
    """Settings for a slippery rail: no planned deceleration exceeds its adhesion."""
    shape, most_mps2 = config.braking, config.slippery.decel_mps2
    return replace(
        config,
        braking=replace(
            shape,
            decel_mps2=min(shape.decel_mps2, most_mps2),
            plateau_decel_mps2=min(shape.plateau_decel_mps2, most_mps2),
            late_plateau_decel_mps2=min(shape.late_plateau_decel_mps2, most_mps2),
            final_decel_mps2=min(shape.final_decel_mps2, most_mps2),
            late_final_decel_mps2=min(shape.late_final_decel_mps2, most_mps2),
        ),
    )
