"""Zones of the line: where traction is off, and from where a train can coast through."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from firmware_py.trackdb import LineMap, LineZone
from vobc.ato.motion import gradient
from vobc.config import VobcConfig
from vobc.vocabulary import Interval, Motion

STEP_M: Final = 5.0
"""Step of the computation of coasting. Speed limits and gradients hold for longer stretches."""
LEAVES_MPS: Final = 1.0
"""Least speed that a coasting train must keep until its rear has left a neutral section."""
SET_OFF_MPS2: Final = 0.5
"""Acceleration with which a train surely sets off, before gradient and resistance."""
EASE_MARGIN_S: Final = 0.5
"""Time from the end of the demand for traction until the effort has ended, too."""


class NeutralSections:
    """Decides where traction is off, so that a train never draws power in a neutral section."""

    __slots__ = ("_ease_s", "_length_m", "_off_s", "_sections")

    def __init__(self, config: VobcConfig, line: LineMap) -> None:
        self._sections = line.neutral_sections
        self._length_m = config.train.length_m
        self._off_s = config.atp.runaway_s(config.cycle_ms / 1000.0)
        limits = config.ato.limits
        self._ease_s = self._off_s + limits.accel_mps2 / limits.jerk_mps3 + EASE_MARGIN_S

    def off(self, motion: Motion) -> bool:
        """Whether protection removes traction: the effort may otherwise act inside a section."""
        return self._reached(motion, self._off_s)

    def eases(self, motion: Motion) -> bool:
        """Whether operation demands no traction, so that it ends within its jerk limit."""
        return self._reached(motion, self._ease_s)

    def _reached(self, motion: Motion, lead_s: float) -> bool:
        if not self._sections:
            return False
        front_m: Interval = motion.front_m
        ahead_m = front_m.high + max(0.0, motion.speed_mps.high) * lead_s
        behind_m = front_m.low - self._length_m
        return any(each.covers(behind_m, ahead_m) for each in self._sections)


@dataclass(frozen=True, slots=True)
class Coasting:
    """What a train needs to coast through one neutral section."""

    section: LineZone
    entry_mps: float
    """Least speed at `from_m` with which the rear still leaves the section."""
    limit_mps: float
    """Lowest speed limit under the train there."""
    from_m: float
    """Place of the front where traction ends."""
    run_up_m: float
    """Distance in which a standing train reaches that speed. math.inf: it never does."""


def coastings(config: VobcConfig, line: LineMap) -> Iterator[Coasting]:
    """What each neutral section asks of the train, in running order."""
    limits = config.ato.limits
    lead_s = config.atp.runaway_s(config.cycle_ms / 1000.0) + EASE_MARGIN_S
    lead_s += limits.accel_mps2 / limits.jerk_mps3
    for section in line.neutral_sections:
        limit_mps = line.limit_mps(section.start_m)
        from_m = section.start_m - lead_s * limit_mps
        entry_mps = _entry_mps(config, line, from_m, section.end_m + config.train.length_m)
        under_m = max(line.start_m, from_m - config.train.length_m), max(line.start_m, from_m)
        least_mps = line.least_limit_mps(*under_m)
        yield Coasting(
            section, entry_mps, least_mps, from_m, _run_up_m(config, line, from_m, entry_mps)
        )


def _entry_mps(config: VobcConfig, line: LineMap, from_m: float, to_m: float) -> float:
    """Least speed at `from_m` with which a coasting train still has `LEAVES_MPS` at `to_m`.

    It is computed backwards as energy for each kilogram, v²/2. The train is slowest somewhere on
    the way, so the energy never falls below that of `LEAVES_MPS`.
    """
    least = LEAVES_MPS**2 / 2.0
    energy, at_m = least, to_m
    while at_m > from_m:
        step_m = min(STEP_M, at_m - from_m)
        lost_mps2 = _lost_mps2(config, line, at_m - step_m / 2.0, math.sqrt(2.0 * energy))
        energy = max(least, energy + lost_mps2 * step_m)
        at_m -= step_m
    return math.sqrt(2.0 * energy)


def _run_up_m(config: VobcConfig, line: LineMap, from_m: float, speed_mps: float) -> float:
    """Distance before `from_m` from which a train that sets off reaches the speed there."""
    energy, at_m = speed_mps**2 / 2.0, from_m
    while energy > 0.0:
        if at_m < line.start_m:
            return math.inf
        gained_mps2 = SET_OFF_MPS2 - _lost_mps2(config, line, at_m, math.sqrt(2.0 * energy))
        energy -= gained_mps2 * STEP_M
        at_m -= STEP_M
    return from_m - at_m


def _lost_mps2(config: VobcConfig, line: LineMap, front_m: float, speed_mps: float) -> float:
    ato = config.ato
    length_m = config.train.length_m
    gradient_permille = line.mean_gradient_permille(front_m - length_m, front_m)
    return gradient.decel_on_mps2(ato, gradient_permille) + gradient.resistance_mps2(ato, speed_mps)
