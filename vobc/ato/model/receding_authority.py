"""Forecast of the end of authority behind a train that moves away.

A moving end is the rear of a train ahead, and that train does not stop at once. Operation may count
on the distance of its service braking. Protection does not, and uses the end as it is.
"""

from typing import Final, NamedTuple

from vobc.ato.settings.ato import AuthorityStop

WINDOW_S: Final = 1.6
"""Time over which the speed of the end is measured. It covers several authorities, as each one
moves the end by a jump."""
LEAST_SPAN_S: Final = 0.7
"""Shortest time for a measurement."""
STILL_S: Final = 0.6
"""Time without movement after which the end counts as fixed. Three authorities in a row are seldom
lost."""
FASTEST_MPS: Final = 30.0
JUMP_M: Final = 5.0
"""Greatest plausible movement: a fast train plus its position correction at a tag. A larger one is
a route that was set, or another train ahead."""
JOLT_M: Final = 0.4
"""Movement beyond the expected one from which the train ahead has corrected its position at a tag.
"""


class _End(NamedTuple):
    at_s: float
    end_m: float


class RecedingEnd:
    """Follows the end of authority, one step per cycle."""

    __slots__ = ("_ends", "_now_s", "_shape", "at_least_m")

    def __init__(self, shape: AuthorityStop) -> None:
        self._shape = shape
        self._now_s = 0.0
        self._ends: list[_End] = []
        """Changes of the end, oldest first."""
        self.at_least_m = 0.0
        """Forecast of the end. It is never behind the present end."""

    def step(self, end_m: float, *, speed_mps: float, dt_s: float) -> None:
        """Note the present end. `speed_mps` is the speed of this train."""
        self._now_s += dt_s
        self._note(end_m)
        # A larger value would exceed the ATP curve, which ignores the leader's motion.
        closer_m = max(0.0, speed_mps) * self._shape.closer_s
        self.at_least_m = end_m + min(self._way_m(*self._leaves()), closer_m)

    def _way_m(self, leaves_mps: float, accel_mps2: float) -> float:
        """Distance of the train ahead if it changes to service braking within its jerk limit."""
        shape = self._shape
        if leaves_mps <= 0.0:
            return 0.0
        jerk_mps3, decel_mps2 = shape.leader_jerk_mps3, shape.leader_decel_mps2
        onset_s = (accel_mps2 + decel_mps2) / jerk_mps3
        braked_mps = leaves_mps + (accel_mps2 - jerk_mps3 * onset_s / 2.0) * onset_s
        onset_m = (leaves_mps + (accel_mps2 / 2.0 - jerk_mps3 * onset_s / 6.0) * onset_s) * onset_s
        if braked_mps <= 0.0:
            return leaves_mps**2 / (2.0 * decel_mps2)
        return onset_m + braked_mps**2 / (2.0 * decel_mps2)

    def _note(self, end_m: float) -> None:
        ends, now_s = self._ends, self._now_s
        if ends:
            before = ends[-1]
            if end_m == before.end_m:
                return
            most_m = FASTEST_MPS * (now_s - before.at_s) + JUMP_M
            if not 0.0 < end_m - before.end_m <= most_m:
                ends.clear()
            else:
                self._bring_up(end_m)
        ends.append(_End(now_s, end_m))
        while now_s - ends[0].at_s > WINDOW_S:
            del ends[0]

    def _bring_up(self, end_m: float) -> None:
        """Shift the older ends with a position correction, which says nothing about the speed."""
        speed_mps, accel_mps2 = self._leaves()
        before = self._ends[-1]
        after_s = self._now_s - before.at_s
        jolt_m = end_m - before.end_m - (speed_mps + accel_mps2 * after_s / 2.0) * after_s
        if speed_mps > 0.0 and jolt_m > JOLT_M:
            self._ends[:] = [_End(each.at_s, each.end_m + jolt_m) for each in self._ends]

    def _leaves(self) -> tuple[float, float]:
        """Speed and acceleration of the end. 0.0: it is fixed, or unknown yet.

        The acceleration is the difference of the mean speeds in the two halves of the window.
        """
        ends = self._ends
        if not ends or self._now_s - ends[-1].at_s > STILL_S:
            return 0.0, 0.0
        first, last = ends[0], ends[-1]
        span_s = last.at_s - first.at_s
        if span_s < LEAST_SPAN_S:
            return 0.0, 0.0
        mean_mps = (last.end_m - first.end_m) / span_s
        middle_s = first.at_s + span_s / 2.0
        middle = min(ends, key=lambda each: abs(each.at_s - middle_s))
        before_s, after_s = middle.at_s - first.at_s, last.at_s - middle.at_s
        if min(before_s, after_s) <= 0.0:
            return mean_mps, 0.0
        before_mps = (middle.end_m - first.end_m) / before_s
        after_mps = (last.end_m - middle.end_m) / after_s
        most_mps2 = self._shape.leader_decel_mps2
        accel_mps2 = (after_mps - before_mps) / (span_s / 2.0)
        accel_mps2 = min(most_mps2, max(-most_mps2, accel_mps2))
        return max(0.0, mean_mps + accel_mps2 * span_s / 2.0), accel_mps2
