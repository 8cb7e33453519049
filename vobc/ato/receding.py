"""How far the end of authority is going to be at least, behind a train that draws away.

An end that moves is the rear of a train ahead, and that train does not stop at once. Operation may
reckon with the way that it still makes if it is braked as trains are in service; protection does
not, and goes by the end as it is.
"""

from typing import Final, NamedTuple

from vobc.ato.config import AuthorityStop

WINDOW_S: Final = 1.6
"""Over which the speed of the end is taken: some authorities, as each comes with a jump."""
LEAST_SPAN_S: Final = 0.7
"""Over less than that nothing is said of it."""
STILL_S: Final = 0.6
"""An end that has not moved for so long stands. Three authorities in a row are seldom lost."""
FASTEST_MPS: Final = 30.0
JUMP_M: Final = 5.0
"""What moves farther at once than a train in that time, and what place it finds at a tag, is no
train that draws away: a route was set, or another train is ahead now."""


class _End(NamedTuple):
    at_s: float
    end_m: float


class RecedingEnd:
    """Is told the end of authority in each cycle."""

    __slots__ = ("_ends", "_now_s", "_shape", "at_least_m")

    def __init__(self, shape: AuthorityStop) -> None:
        self._shape = shape
        self._now_s = 0.0
        self._ends: list[_End] = []
        """As it changed, oldest first."""
        self.at_least_m = 0.0
        """Where it is going to be; never behind where it is."""

    def step(self, end_m: float, *, speed_mps: float, dt_s: float) -> None:
        """`speed_mps` is that of the train itself."""
        self._now_s += dt_s
        self._note(end_m)
        leaves_mps = self._leaves_mps()
        shape = self._shape
        way_m = leaves_mps * (shape.leader_onset_s + leaves_mps / (2.0 * shape.leader_decel_mps2))
        # More would bring the train under the curve of protection, which does not reckon so.
        self.at_least_m = end_m + min(way_m, max(0.0, speed_mps) * shape.closer_s)

    def _note(self, end_m: float) -> None:
        ends, now_s = self._ends, self._now_s
        if ends:
            before = ends[-1]
            if end_m == before.end_m:
                return
            most_m = FASTEST_MPS * (now_s - before.at_s) + JUMP_M
            if not 0.0 < end_m - before.end_m <= most_m:
                ends.clear()
        ends.append(_End(now_s, end_m))
        while now_s - ends[0].at_s > WINDOW_S:
            del ends[0]

    def _leaves_mps(self) -> float:
        """How fast it moves away; 0.0 when it stands, or nobody knows yet."""
        ends = self._ends
        if not ends or self._now_s - ends[-1].at_s > STILL_S:
            return 0.0
        span_s = ends[-1].at_s - ends[0].at_s
        return (ends[-1].end_m - ends[0].end_m) / span_s if span_s >= LEAST_SPAN_S else 0.0
