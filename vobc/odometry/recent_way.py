"""Distance over ground since a recent instant."""

from collections import deque
from typing import Final

KEPT: Final = 64
"""Number of stored cycles. For tag readings that arrive later, only the speed bounds the distance.
"""


class RecentWay:
    """Least and greatest distance of the latest cycles.

    Their sum is more accurate than a single speed. The noise of one radar reading averages out over
    several readings, except for a slack that counts once.
    """

    __slots__ = ("_max_accel_mps2", "_steps")

    def __init__(self, max_accel_mps2: float) -> None:
        self._max_accel_mps2 = max_accel_mps2
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=KEPT)
        """Duration in s, least and greatest distance in m of each cycle, the newest first."""

    def add(self, dt_s: float, least_m: float, most_m: float) -> None:
        """Add the distance of one cycle."""
        self._steps.appendleft((dt_s, least_m, most_m))

    def forget(self) -> None:
        """Discard the history."""
        self._steps.clear()

    def since(self, age_s: float) -> tuple[float, float] | None:
        """Least and greatest distance in m since `age_s` ago. None: no longer known.

        Within a cycle the speed may have changed. The mean speeds of its two parts differ by at
        most the greatest acceleration over half the cycle.
        """
        least_m = most_m = 0.0
        left_s = age_s
        for dt_s, step_least_m, step_most_m in self._steps:
            if left_s < dt_s:
                share = left_s / dt_s
                play_m = 0.5 * self._max_accel_mps2 * left_s * (dt_s - left_s)
                return (
                    least_m + share * step_least_m - play_m,
                    most_m + share * step_most_m + play_m,
                )
            least_m += step_least_m
            most_m += step_most_m
            left_s -= dt_s
        return None
