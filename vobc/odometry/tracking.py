"""Speed and acceleration from a stream of pulse counts: a low-noise estimate and hard bounds."""

import math
from collections import deque
from typing import Final

HALF_PULSE: Final = 0.5
"""Mean offset of the wheel from the shown count. A counter shows whole pulses only."""
MIN_STEP_S: Final = 1e-3
MIN_HALVES: Final = 4
MIN_HALF_S: Final = 0.035


class SpeedTrack:
    """Second-order fading-memory filter, in pulses. It has no lag at constant acceleration.

    With theta = exp(-bandwidth * dt) the three errors of the filter decay together. The gains 1 -
    theta**3, 3/2 * (1 - theta**2) * (1 - theta), (1 - theta)**3 suit any spacing of the samples.
    """

    __slots__ = (
        "_bandwidth_rad_s",
        "_counts",
        "_first_s",
        "_moved_s",
        "_window_s",
        "accel_pulses_per_s2",
        "at_pulses",
        "begun",
        "rate_pulses_per_s",
        "stamp_s",
    )

    def __init__(self, *, bandwidth_rad_s: float, window_s: float) -> None:
        self._bandwidth_rad_s = bandwidth_rad_s
        self._window_s = window_s
        self._counts: deque[tuple[float, int]] = deque()
        self._first_s = self._moved_s = -math.inf
        self.begun = False
        """At least one sample was taken."""
        self.stamp_s = -math.inf
        """Instant of the last sample."""
        self.at_pulses = HALF_PULSE
        self.rate_pulses_per_s = 0.0
        self.accel_pulses_per_s2 = 0.0

    def add(self, stamp_s: float, count: int) -> None:
        """Add one sample. Samples must be in order of time."""
        counts = self._counts
        if not self.begun:
            self.begun = True
            self._first_s = self._moved_s = stamp_s
            self.at_pulses = count + HALF_PULSE
        else:
            if count != counts[-1][1]:
                self._moved_s = stamp_s
            self._correct(max(MIN_STEP_S, stamp_s - self.stamp_s), count)
        self.stamp_s = stamp_s
        counts.append((stamp_s, count))
        while len(counts) > 2 and counts[1][0] <= stamp_s - self._window_s:
            counts.popleft()

    def _correct(self, dt_s: float, count: int) -> None:
        theta = math.exp(-self._bandwidth_rad_s * dt_s)
        short = 1.0 - theta
        accel = self.accel_pulses_per_s2
        rate = self.rate_pulses_per_s + accel * dt_s
        at = self.at_pulses + (rate - 0.5 * accel * dt_s) * dt_s
        miss = count + HALF_PULSE - at
        self.at_pulses = at + (1.0 - theta * theta * theta) * miss
        self.rate_pulses_per_s = rate + 1.5 * (1.0 - theta * theta) * short * miss / dt_s
        self.accel_pulses_per_s2 = accel + short * short * short * miss / (dt_s * dt_s)

    @property
    def still_s(self) -> float:
        """Time with samples but without a pulse. A time without samples does not count."""
        return self.stamp_s - self._moved_s

    def settle(self) -> None:
        """Reset the motion, because the wheel stands."""
        self.rate_pulses_per_s = 0.0
        self.accel_pulses_per_s2 = 0.0

    def limited_rate_pulses_per_s(self, now_s: float) -> float:
        """The present rate. A wheel without a pulse for t turns slower than one pulse per t."""
        rate = self.rate_pulses_per_s + self.accel_pulses_per_s2 * (now_s - self.stamp_s)
        still_s = self.still_s
        if still_s <= 0.0:
            return rate
        most = 1.0 / still_s
        return max(-most, min(most, rate))

    @property
    def window_full(self) -> bool:
        """The samples cover a whole window."""
        return self.stamp_s - self._counts[0][0] >= self._window_s

    @property
    def heard_s(self) -> float:
        """Time from the first sample to the last."""
        return self.stamp_s - self._first_s

    def jumped(self, most_pulses_per_s2: float, jitter_s: float) -> bool:
        """The rate changed between the two halves of the window faster than any train can."""
        counts = self._counts
        if len(counts) < MIN_HALVES:
            return False
        first_s, first = counts[0]
        mid_s, mid = counts[len(counts) // 2]
        last_s, last = counts[-1]
        early_s, late_s = mid_s - first_s, last_s - mid_s
        if early_s <= MIN_HALF_S or late_s <= MIN_HALF_S:
            return False
        early, late = (mid - first) / early_s, (last - mid) / late_s
        # Counts are whole pulses, and instants are known within the jitter.
        blur = (1.0 + abs(early) * jitter_s) / early_s + (1.0 + abs(late) * jitter_s) / late_s
        return abs(late - early) > blur + most_pulses_per_s2 * 0.5 * (last_s - first_s)

    def mean_rate(self, jitter_s: float) -> tuple[float, float, float]:
        """Lowest and highest mean rate over the window in pulses/s, and the window's length in s.

        A difference of whole pulses is wrong by less than one pulse, and its time by at most
        `jitter_s`.
        """
        first_s, first = self._counts[0]
        last_s, last = self._counts[-1]
        length_s = last_s - first_s
        if length_s <= 2.0 * jitter_s:
            return -math.inf, math.inf, length_s
        step = last - first
        short_s, long_s = length_s - jitter_s, length_s + jitter_s
        low, high = step - 1, step + 1
        return (
            low / (long_s if low > 0 else short_s),
            high / (short_s if high > 0 else long_s),
            length_s,
        )
