"""How far the train has come over ground since an instant that is not long ago."""

from collections import deque
from typing import Final

KEPT: Final = 64
"""Cycles; what a reader tells later than that is bounded by speed alone."""


class RecentWay:
    """Least and most way of the last cycles, which add up better than any one speed tells.

    A single reading of the radar is known within its noise, but of the way its readings tell
    together that noise is averaged out, but for a slack that is reckoned once.
    """

    __slots__ = ("_max_accel_mps2", "_steps")

    def __init__(self, max_accel_mps2: float) -> None:
        self._max_accel_mps2 = max_accel_mps2
        self._steps: deque[tuple[float, float, float]] = deque(maxlen=KEPT)
        """How long a cycle took in s, and the least and most way in it in m; the newest first."""

    def add(self, dt_s: float, least_m: float, most_m: float) -> None:
        """The train went on for a cycle."""
        self._steps.appendleft((dt_s, least_m, most_m))

    def forget(self) -> None:
        """Of what was until now nobody knows how it went."""
        self._steps.clear()

    def since(self, age_s: float) -> tuple[float, float] | None:
        """Least and most way in m since `age_s` ago; None when that is not known any more.

        Within a cycle the speed may have changed: of two parts of it the means are apart by no more
        than the greatest acceleration over half the cycle.
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
