"""The least margin of one invariant over a run, and the alarm for a violation."""

import math
from typing import Final

NEVER_NS: Final = -1


class Gauge:
    """Keeps the least margin it received; without any margin, the premise never held."""

    __slots__ = ("_alarm", "at_ns", "first_ns", "least", "name", "note")

    def __init__(self, name: str, alarm: "Alarm") -> None:
        self.name = name
        self._alarm = alarm
        self.least = math.inf
        """Least margin in the unit of the invariant; infinite while its premise never held."""
        self.at_ns = NEVER_NS
        """Instant of the least margin."""
        self.first_ns = NEVER_NS
        """Instant of the first violation."""
        self.note = ""
        """Additional remark for the result."""

    def see(self, margin: float, now_ns: int) -> None:
        # NaN counts as a violation: every comparison with it is false.
        if not margin >= self.least:
            self.least = margin
            self.at_ns = now_ns
            if not margin >= 0.0 and self.first_ns == NEVER_NS:
                self.first_ns = now_ns
                self._alarm.raised.append(self)

    def said(self, holds: bool, now_ns: int) -> None:
        """Take a result that is only true or false, as a margin of 1 or -1."""
        self.see(1.0 if holds else -1.0, now_ns)


class Alarm:
    """Gauges of violated invariants, in the order of time."""

    __slots__ = ("raised",)

    def __init__(self) -> None:
        self.raised: list[Gauge] = []
