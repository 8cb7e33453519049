"""Invariants of zones (41, 42): no traction in a neutral section, and no entry that ends inside."""

from can_dbc.vobc import AtoPhase
from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from plant_emulator.truth import Truth

DRIVEN = (float(AtoPhase.RUNNING), float(AtoPhase.APPROACHING), float(AtoPhase.STOPPING))


class ZoneWatch:
    """Compares the place of the train with the zones of its line."""

    __slots__ = (
        "_front_m",
        "_length_m",
        "_neutral",
        "_traction_ns",
        "_zones",
        "entered",
        "traction_off",
    )

    def __init__(self, context: Context, *, traction_off: Gauge, entered: Gauge) -> None:
        self.traction_off, self.entered = traction_off, entered
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
        if not self._zones or spoken.ato_phase not in DRIVEN:
            return
        for zone in self._zones:
            if before_m <= zone.start_m < truth.front_m:
                self.entered.see(truth.authority_end_m - zone.end_m - self._length_m, now_ns)
