"""Zones of the line: where traction is off, where a train waits, and how it coasts through."""

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
DECIDES_S: Final = 2.0
"""Running time that a train needs, besides its braking, to wait before a zone."""
HELD_S: Final = 45.0
"""Time without a longer authority after which a train counts as held for long. It is longer than
the train ahead usually stands at a station."""
GROWS_M: Final = 1.0
"""Change of an authority that is more than a correction of the place of the train ahead."""
STANDS_MPS: Final = 0.1
"""Speed below which a train may wait where it is."""
FAR_M: Final = 1.0
"""Distance beyond the margin of operation by which an authority must pass a zone."""


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
    air_ratio = line.mean_drag_ratio(front_m - length_m, front_m)
    resistance_mps2 = gradient.resistance_mps2(ato, speed_mps, air_ratio)
    return gradient.decel_on_mps2(ato, gradient_permille) + resistance_mps2


class EvacuationHold:
    """Ends the authority of operation at an evacuation stop for a train that is held for long.

    A train is held while its authority does not reach the next stop. It is held for long when that
    authority has not grown for `HELD_S`.
    """

    __slots__ = ("_authority_m", "_decel_mps2", "_held_s", "_line", "_margin_m", "_target_m")

    def __init__(self, config: VobcConfig, line: LineMap) -> None:
        self._line = line
        self._margin_m = config.ato.authority.margin_m
        self._decel_mps2 = config.ato.braking.decel_mps2
        self._authority_m = -math.inf
        self._held_s = 0.0
        self._target_m: float | None = None

    def end_m(self, authority_end_m: float, motion: Motion, dt_s: float) -> float:
        """End of the authority that operation may use."""
        if not self._line.evacuation_stops:
            return authority_end_m
        front_m = motion.front_m.best
        free = bool(self._line.stations_between(front_m, authority_end_m))
        if free or abs(authority_end_m - self._authority_m) > GROWS_M:
            self._authority_m, self._held_s, self._target_m = authority_end_m, 0.0, None
            return authority_end_m
        self._held_s += dt_s
        if self._target_m is None and self._held_s >= HELD_S:
            self._target_m = self._next_m(authority_end_m, front_m, motion.speed_mps.best)
        return authority_end_m if self._target_m is None else min(authority_end_m, self._target_m)

    def _next_m(self, authority_end_m: float, front_m: float, speed_mps: float) -> float | None:
        """The end of authority for the next stop ahead at which the train can still stand."""
        needs_m = speed_mps * DECIDES_S + speed_mps**2 / (2.0 * self._decel_mps2)
        ends_m = (each.end_m + self._margin_m for each in self._line.evacuation_stops)
        return next((m for m in ends_m if front_m + needs_m + FAR_M <= m <= authority_end_m), None)


@dataclass(frozen=True, slots=True)
class Wait:
    """One zone or several close ones, through which the train runs without a stop."""

    hold_m: float
    """Place before which a train waits. A neutral section needs a run-up from there."""
    start_m: float
    end_m: float


class ZoneHold:
    """Ends the authority of operation before a zone until it reaches past with the whole train.

    A train that can no longer stop comfortably before a zone is not held.
    """

    __slots__ = ("_decel_mps2", "_held", "_length_m", "_line", "_margin_m", "_point_m", "_waits")

    def __init__(self, config: VobcConfig, line: LineMap) -> None:
        self._line = line
        self._length_m = config.train.length_m
        self._margin_m = config.ato.authority.margin_m + FAR_M
        self._decel_mps2 = config.ato.braking.decel_mps2
        self._waits = _waits(config, line, self._length_m + self._margin_m)
        self._held: Wait | None = None
        self._point_m = 0.0

    def end_m(self, authority_end_m: float, motion: Motion) -> float:
        """End of the authority that operation may use."""
        front_m, speed_mps = motion.front_m.best, motion.speed_mps.best
        for wait in self._waits:
            if front_m >= wait.start_m or self._passes(wait, authority_end_m):
                continue
            if wait is not self._held:
                point_m = self._point(wait, front_m, speed_mps)
                if point_m is None:
                    continue
                self._held, self._point_m = wait, point_m
            return min(authority_end_m, max(self._point_m, front_m))
        self._held = None
        return authority_end_m

    def stands_in(self, motion: Motion) -> str:
        """The zone in which a standing train is, or an empty text."""
        front_m = motion.front_m.best
        for kind, zones in (
            ("neutral section", self._line.neutral_sections),
            ("no-stop zone", self._line.no_stop_zones),
        ):
            for zone in zones:
                if zone.covers(front_m - self._length_m, front_m):
                    return f"{kind} {zone.text}"
        return ""

    def _passes(self, wait: Wait, authority_end_m: float) -> bool:
        """Whether a train that runs to the end of authority, or to a stop before it, is past."""
        clear_m = wait.end_m + self._length_m
        if authority_end_m >= clear_m + self._margin_m:
            return True
        return bool(self._line.stations_between(clear_m, authority_end_m))

    def _point(self, wait: Wait, front_m: float, speed_mps: float) -> float | None:
        if speed_mps < STANDS_MPS:
            return max(wait.hold_m, front_m)
        needs_m = speed_mps * DECIDES_S + speed_mps**2 / (2.0 * self._decel_mps2) + self._margin_m
        points_m = (wait.hold_m, wait.start_m)
        return next((at_m for at_m in points_m if front_m + needs_m <= at_m), None)


def _waits(config: VobcConfig, line: LineMap, apart_m: float) -> tuple[Wait, ...]:
    """Where trains wait. Zones without room for a train between them are one."""
    found = [Wait(zone.start_m, zone.start_m, zone.end_m) for zone in line.no_stop_zones]
    for coasting in coastings(config, line):
        zone = coasting.section
        hold_m = coasting.from_m - coasting.run_up_m
        hold_m = hold_m if math.isfinite(hold_m) else zone.start_m
        found.append(Wait(hold_m, zone.start_m, zone.end_m))
    merged: list[Wait] = []
    for wait in sorted(found, key=lambda each: each.start_m):
        # A train may wait at a station, however close the zone behind it is.
        stops_m = [each.stop_m for each in line.stations if each.stop_m <= wait.start_m]
        hold_m = max([wait.hold_m, *stops_m[-1:]])
        if merged and hold_m - apart_m < merged[-1].end_m:
            last = merged.pop()
            merged.append(Wait(last.hold_m, last.start_m, max(last.end_m, wait.end_m)))
        else:
            merged.append(Wait(hold_m, wait.start_m, wait.end_m))
    return tuple(merged)
