"""Invariant of neutral sections (41): the controller demands no traction inside them."""

from metro_hil.monitors.context import Context
from metro_hil.monitors.description import Spoken
from metro_hil.monitors.gauge import Gauge
from plant_emulator.truth import Truth


class ZoneWatch:
    """Compares the place of the train with the zones of its line."""

    __slots__ = ("_neutral", "_traction_ns", "busy", "traction_off")

    def __init__(self, context: Context, *, traction_off: Gauge) -> None:
        self.traction_off = traction_off
        self._neutral = context.line.neutral_sections
        self._traction_ns = context.start_ns
        self.busy = bool(self._neutral)
        """Whether the line has any zone."""

    def news(self, truth: Truth, now_ns: int, spoken: Spoken) -> None:
        """Take the newest demand for traction."""
        if spoken.traction_ns == self._traction_ns:
            return
        self._traction_ns = spoken.traction_ns
        if any(each.covers(truth.rear_m, truth.front_m) for each in self._neutral):
            pulls = spoken.force_commanded_n > 0.0 and spoken.traction_permitted > 0.0
            self.traction_off.said(not pulls, now_ns)
