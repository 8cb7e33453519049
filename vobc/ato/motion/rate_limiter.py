"""Speed reference over time that moves to the target with smoothed trapezoidal acceleration."""

import math
from collections import deque
from typing import Final

LANDING_PER_S: Final = 0.8
"""Rate of the exponential approach close to the target."""
LANDING_JERK_RATIO: Final = 0.7
"""Share of the jerk limit with which the acceleration decreases towards the target."""
URGENT_MPS: Final = 0.5
"""Difference below the reference at which a target takes effect without smoothing."""


class RateLimiter:
    """A raw reference approaches the target within the jerk limit. The output is its moving
    average.

    Both reach the same speed, so smoothing never overshoots.
    """

    __slots__ = (
        "_dt_s",
        "_jerk_mps3",
        "_raw_mps",
        "_raw_mps2",
        "_recent_mps2",
        "_sum_mps2",
        "accel_mps2",
        "speed_mps",
    )

    def __init__(self, jerk_mps3: float, smoothing_s: float, dt_s: float) -> None:
        self._jerk_mps3 = jerk_mps3
        self._dt_s = dt_s
        self._recent_mps2: deque[float] = deque(maxlen=max(1, round(smoothing_s / dt_s)))
        self.restart(0.0, 0.0)

    def restart(self, speed_mps: float, accel_mps2: float) -> None:
        """Restart from the train's present motion."""
        length = self._recent_mps2.maxlen or 1
        self._recent_mps2.extend([accel_mps2] * length)
        self._sum_mps2 = accel_mps2 * length
        self._raw_mps2 = accel_mps2
        self.accel_mps2 = accel_mps2
        self.speed_mps = speed_mps
        # A steadily changing reference leads its moving average by half the window.
        self._raw_mps = speed_mps + accel_mps2 * (length - 1) * self._dt_s / 2.0

    def hold_back(self, highest_mps: float) -> None:
        """Limit the reference to `highest_mps` while the train does not follow."""
        excess_mps = self.speed_mps - highest_mps
        if excess_mps > 0.0:
            self.speed_mps -= excess_mps
            self._raw_mps -= excess_mps

    def step(
        self, target_mps: float, *, rise_mps2: float, fall_mps2: float, cycles: int = 1
    ) -> None:
        """Move towards the target. Both acceleration limits are zero or more."""
        for _ in range(cycles):
            self._step_once(target_mps, rise_mps2, fall_mps2)

    def _step_once(self, target_mps: float, rise_mps2: float, fall_mps2: float) -> None:
        error_mps = target_mps - self._raw_mps
        landing_mps2 = min(
            LANDING_PER_S * abs(error_mps),
            math.sqrt(2.0 * LANDING_JERK_RATIO * self._jerk_mps3 * abs(error_mps)),
        )
        if error_mps >= 0.0:
            wanted_mps2 = min(landing_mps2, rise_mps2)
        else:
            wanted_mps2 = -min(landing_mps2, fall_mps2)
        reach_mps2 = self._jerk_mps3 * self._dt_s
        change_mps2 = min(reach_mps2, max(-reach_mps2, wanted_mps2 - self._raw_mps2))
        self._raw_mps2 += change_mps2
        self._raw_mps += self._raw_mps2 * self._dt_s
        if error_mps < -URGENT_MPS and self._raw_mps2 < self.accel_mps2:
            self.restart(self.speed_mps + self._raw_mps2 * self._dt_s, self._raw_mps2)
            return
        recent = self._recent_mps2
        self._sum_mps2 += self._raw_mps2 - recent[0]
        recent.append(self._raw_mps2)
        self.accel_mps2 = self._sum_mps2 / len(recent)
        self.speed_mps += self.accel_mps2 * self._dt_s
