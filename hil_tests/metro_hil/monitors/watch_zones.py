"""Invariants of zones (41 to 43): traction, entry and standing."""

import math

from can_dbc.vobc import AtoPhase
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from plant_emulator.truth import Truth

HELD_NS = 47_000_000_000
"""Time without another authority from which on a train must know that it is held for long."""
NEAR_M = 5.0
AT_STOP_M = 1.0
REACT_S = 5.0
DECEL_MPS2 = 0.5
BEFORE_END_M = 6.0
"""Distance before the end of its authority in which a train need not be able to stand."""
HOLDING = float(AtoPhase.HOLDING)
DRIVEN = (float(AtoPhase.RUNNING), float(AtoPhase.APPROACHING), float(AtoPhase.STOPPING))
OPERATED = (*DRIVEN, HOLDING)


class ZoneWatch:
    """Compares the place of the train with the zones of its line."""

    __slots__ = (
        "_authority_m",
        "_front_m",
        "_held_from_m",
        "_length_m",
        "_line",
        "_neutral",
        "_since_ns",
        "_traction_ns",
        "_zones",
        "entered",
        "stands",
        "traction_off",
    )

    def __init__(
        self, context: Context, *, traction_off: Gauge, entered: Gauge, stands: Gauge
    ) -> None:
        self.traction_off, self.entered, self.stands = traction_off, entered, stands
        self._line = context.line
        self._authority_m, self._since_ns = 0.0, context.start_ns
        self._held_from_m = math.inf
        self._neutral = context.line.neutral_sections
        self._zones = (*self._neutral, *context.line.no_stop_zones)
        self._length_m = context.train.length_m
        self._traction_ns = context.start_ns
        self._front_m = float("inf")

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take the newest demand for traction."""
        if spoken.traction_ns == self._traction_ns:
            return
        self._traction_ns = spoken.traction_ns
        if any(each.covers(truth.rear_m, truth.front_m) for each in self._neutral):
            pulls = spoken.force_commanded_n > 0.0 and spoken.traction_permitted > 0.0
            self.traction_off.said(not pulls, now_ns)

    def sample(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take one step of a moving train."""
        before_m, self._front_m = self._front_m, truth.front_m
        if self._line.evacuation_stops:
            self._follow(truth, now_ns)
        if not self._zones or spoken.ato_phase not in DRIVEN:
            return
        for zone in self._zones:
            if before_m <= zone.start_m < truth.front_m:
                self.entered.see(truth.authority_end_m - zone.end_m - self._length_m, now_ns)

    def _follow(self, truth: Truth, now_ns: int) -> None:
        """Note from where the train can stop when it begins to count as held for long."""
        if truth.authority_now_m != self._authority_m:
            self._authority_m, self._since_ns = truth.authority_now_m, now_ns
            self._held_from_m = math.inf
        elif self._held_from_m == math.inf and now_ns - self._since_ns >= HELD_NS:
            speed_mps = truth.speed_mps
            needs_m = speed_mps * REACT_S + speed_mps**2 / (2.0 * DECEL_MPS2)
            self._held_from_m = truth.front_m + needs_m

    def stopped(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take a train that has come to a standstill."""
        line, front_m = self._line, truth.front_m
        if self._held_from_m == math.inf or spoken.ato_phase not in OPERATED:
            return
        if any(abs(each.stop_m - front_m) < AT_STOP_M for each in line.stations):
            return
        ends_m = [each.end_m for each in line.evacuation_stops]
        last_m = self._authority_m - BEFORE_END_M
        reachable = any(self._held_from_m <= end_m <= last_m for end_m in ends_m)
        if reachable and not line.stations_between(front_m, self._authority_m):
            distance_m = min(abs(end_m - front_m) for end_m in ends_m)
            self.stands.see(NEAR_M - distance_m, now_ns)
