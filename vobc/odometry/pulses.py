"""Combines the tacho counters of two axles into one pulse count, despite wraps, jumps and dead
axles.
"""

from typing import Final

from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho

WRAP_A: Final = 65536
WRAP_B: Final = 1024
STUCK_PULSES: Final = 25
"""Pulses of the other axle after which an axle without pulses is no longer used."""
LATE_S: Final = 0.02
"""Bound of the difference in delay between two successive samples."""

PLAY_PULSES: Final = 2
"""Pulses within a sample that may contradict the reported direction. When a wheel reverses, only
its last pulse determines the direction."""
APART_PULSES: Final = 4.0
"""Difference in pulses between two axles beyond which one of them slips or slides."""
STRETCH_PULSES: Final = 16.0
"""Half the difference in pulses that couplers alone can make, 33 cm in all. Two axles on two cars
of florence4 move apart and together again by 14 cm. A wheel that slips goes on turning."""
APART_RATIO: Final = 0.01
"""Permitted difference relative to the count, because wheel diameters differ."""


def signed_difference(later: int, earlier: int, wrap: int = WRAP_A) -> int:
    """Difference of two counters modulo `wrap`, the shorter way round."""
    return (later - earlier + wrap // 2) % wrap - wrap // 2


class LeadBounds:
    """Extremes of the lead of axle B over axle A since the radar last saw the ground."""

    __slots__ = ("_high", "_low")

    def __init__(self) -> None:
        self._low = self._high = 0

    def begin(self, lead: int) -> None:
        """Restart from the present lead, because the radar sees the ground."""
        self._low = self._high = lead

    def widen(self, lead: int) -> tuple[int, int]:
        """Pulses by which the lead has left its extremes, downwards and upwards. The extremes then
        include it.
        """
        back, ahead = max(0, self._low - lead), max(0, lead - self._high)
        self._low -= back
        self._high += ahead
        return back, ahead


class AxlePlay:
    """Play between two axles, pulses. It follows their difference like a gear with backlash."""

    __slots__ = ("_apart", "_most")

    def __init__(self, most_pulses: float) -> None:
        self._apart = 0.0
        self._most = most_pulses

    def step(self, ahead: int, rolled: int) -> bool:
        """Whether axle A, which rolled this far, came further ahead or behind than the play.

        `ahead` is by how much further it rolled than axle B.
        """
        apart = self._apart + ahead
        back = APART_RATIO * abs(rolled)
        apart = max(0.0, apart - back) if apart > 0.0 else min(0.0, apart + back)
        self._apart = max(-self._most, min(self._most, apart))
        return self._apart != apart


class PulseCounter:
    """Counts by tacho A, whose count the tags latch. It uses tacho B while A is implausible."""

    __slots__ = (
        "_max_pulses_per_s",
        "_still_a",
        "_still_b",
        "_stretch",
        "_tacho",
        "_tolerance",
        "adhesion_lost",
        "axles_differ",
        "contradicted",
        "count",
        "jumps",
        "lead",
        "on_b",
        "paired",
    )

    def __init__(self, max_pulses_per_s: float) -> None:
        self._max_pulses_per_s = max_pulses_per_s
        self._tacho: Tacho | None = None
        self._still_a = 0
        self._still_b = 0
        self.count = 0
        """Pulses since the first sample, signed."""
        self.jumps = 0
        """Number of counter steps that no train can produce."""
        self.on_b = False
        self._tolerance, self._stretch = AxlePlay(APART_PULSES), AxlePlay(STRETCH_PULSES)
        self.adhesion_lost = False
        """In the last sample the axles moved further apart than couplers stretch."""
        self.axles_differ = False
        """In the last sample one axle fell behind the other: one of them slips or slides."""
        self.contradicted = False
        """The sign of the pulses contradicts the direction that tacho A reports."""
        self.paired = False
        """Both axles were plausible in the last sample."""
        self.lead = 0
        """Pulses by which axle B has moved further than axle A, over all paired samples."""

    def since_latched(self, pulses: int) -> int | None:
        """Pulses of tacho A since it showed `pulses`. None: tacho A is not trusted now."""
        if self._tacho is None or self.on_b:
            return None
        return signed_difference(self._tacho.pulses_a, pulses)

    def step(self, tacho: Tacho, dt_s: float) -> int | None:
        """Pulses since the sample before. None: neither axle is plausible."""
        before, self._tacho = self._tacho, tacho
        if before is None:
            return 0 if tacho.healthy_a or tacho.healthy_b else None
        step_a = signed_difference(tacho.pulses_a, before.pulses_a)
        step_b = signed_difference(tacho.pulses_b, before.pulses_b, WRAP_B)
        limit = self._max_pulses_per_s * (dt_s + LATE_S)
        possible_a, possible_b = abs(step_a) <= limit, abs(step_b) <= limit
        self.jumps += (not possible_a) + (not possible_b)
        self._watch_stuck(step_a, step_b)
        good_a = tacho.healthy_a and possible_a and self._still_a < STUCK_PULSES
        good_b = tacho.healthy_b and possible_b and self._still_b < STUCK_PULSES
        self.paired = good_a and good_b
        if not (good_a or good_b):
            return None
        self.on_b = not good_a
        self.contradicted = good_a and _against(step_a, tacho.direction)
        self.axles_differ = self.adhesion_lost = False
        if self.paired:
            # B wraps early. After a gap its step is known only modulo its counter.
            ahead = signed_difference(step_a, step_b, WRAP_B)
            self.axles_differ = self._tolerance.step(ahead, step_a)
            self.adhesion_lost = self._stretch.step(ahead, step_a)
            self.lead += signed_difference(step_b, step_a, WRAP_B)
        step = step_a if good_a else step_b
        self.count += step
        return step

    def _watch_stuck(self, step_a: int, step_b: int) -> None:
        """Update how far the other axle has turned while each axle gave no pulse."""
        self._still_a = self._still_a + abs(step_b) if step_a == 0 else 0
        self._still_b = self._still_b + abs(step_a) if step_b == 0 else 0


def _against(step: int, direction: Direction) -> bool:
    if step > PLAY_PULSES:
        return direction is not Direction.FORWARD
    return step < -PLAY_PULSES and direction is not Direction.REVERSE
