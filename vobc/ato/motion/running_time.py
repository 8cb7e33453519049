"""Running time to a stop at a given cruising speed, and the cruising speed for a given time."""

from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.ato.motion import profile, trapezoid
from vobc.ato.motion.profile import ReferenceBrakingCurve
from vobc.ato.settings.ato import AtoConfig

SEARCH_STEPS: Final = 24
"""Number of bisections of the speed range. The result is accurate to a few mm/s."""
CHANGE_OVER_S: Final = 1.0
"""Time between acceleration and deceleration."""
CRAWL_MPS: Final = 0.5
"""Lower bound of the assumed speed."""


class LimitStretch(NamedTuple):
    """Stretch of the front's way under one limit."""

    end_m: float
    limit_mps: float


class RunningTime:
    """Speed limits as the front of the train meets them, from one place to a stop.

    [Lin], equations (3) to (7), defines the target speed as remaining distance over remaining time.
    It ignores the time to accelerate and brake. Here the running time includes both, and the speed
    for a given time is found by search.
    """

    __slots__ = ("_accel_mps2", "_curve", "_jerk_mps3", "_margin_mps", "_stop_m", "_stretches")

    def __init__(
        self,
        config: AtoConfig,
        line: LineMap,
        from_m: float,
        stop_m: float,
        curve: ReferenceBrakingCurve,
    ) -> None:
        """`curve` leads to the stop."""
        length_m = config.train_length_m
        self._accel_mps2 = config.limits.accel_mps2
        self._jerk_mps3 = config.limits.jerk_mps3
        self._margin_mps = config.speed.margin_mps
        self._curve = curve
        self._stop_m = stop_m
        ends_m = {stop_m}
        for section in line.speed_sections:
            ends_m.add(section.start_m)
            ends_m.add(section.end_m + length_m)
        stretches: list[LimitStretch] = []
        start_m = from_m
        for end_m in sorted(end_m for end_m in ends_m if from_m < end_m <= stop_m):
            middle_m = (start_m + end_m) / 2.0
            limit_mps = line.least_limit_mps(middle_m - length_m, middle_m)
            stretches.append(LimitStretch(end_m, limit_mps))
            start_m = end_m
        self._stretches = tuple(stretches)

    def time_s(self, front_m: float, speed_mps: float, cruise_mps: float) -> float:
        """Time from here to standstill at the stop, at `cruise_mps` where the limits permit it."""
        last_mps = max(CRAWL_MPS, min(cruise_mps, self._last_limit_mps() - self._margin_mps))
        parking = self._curve.at_speed(last_mps)
        total_s = parking.time_to_go_s
        brakes_m = self._stop_m - parking.distance_m
        before_mps, at_m = speed_mps, front_m
        for stretch in self._stretches:
            if stretch.end_m <= at_m:
                continue
            stretch_mps = max(CRAWL_MPS, min(cruise_mps, stretch.limit_mps - self._margin_mps))
            total_s += max(0.0, min(stretch.end_m, brakes_m) - at_m) / stretch_mps
            total_s += self._change_s(before_mps, stretch_mps, falls_before=at_m > front_m)
            before_mps, at_m = stretch_mps, stretch.end_m
            if at_m >= brakes_m:
                break
        return total_s

    def speed_for_mps(
        self, front_m: float, speed_mps: float, left_s: float, *, low_mps: float, high_mps: float
    ) -> float:
        """Cruising speed for a running time of `left_s`. If even the highest is too slow: the
        highest.

        The result is never a speed that the remaining distance is too short to reach and lose
        again.
        """
        if left_s <= 0.0:
            return high_mps
        peak_mps = profile.peak_speed_mps(
            max(0.0, speed_mps),
            self._stop_m - front_m,
            self._curve,
            accel_mps2=self._accel_mps2,
            jerk_mps3=self._jerk_mps3,
            change_over_s=CHANGE_OVER_S,
            limit_mps=high_mps,
        )
        if self.time_s(front_m, speed_mps, peak_mps) >= left_s:
            return peak_mps
        slow_mps, fast_mps = min(low_mps, peak_mps), peak_mps
        for _ in range(SEARCH_STEPS):
            middle_mps = (slow_mps + fast_mps) / 2.0
            if self.time_s(front_m, speed_mps, middle_mps) >= left_s:
                slow_mps = middle_mps
            else:
                fast_mps = middle_mps
        return slow_mps

    def _last_limit_mps(self) -> float:
        return self._stretches[-1].limit_mps if self._stretches else CRAWL_MPS

    def _change_s(self, from_mps: float, to_mps: float, *, falls_before: bool) -> float:
        """Additional time of a speed change, compared with constant speed.

        The comparison is with `to_mps`, or with `from_mps` for a reduction before a lower limit.
        """
        ramp_s = trapezoid.ramp_s(
            to_mps - from_mps, accel_mps2=self._accel_mps2, jerk_mps3=self._jerk_mps3
        )
        steady_mps = from_mps if falls_before and to_mps < from_mps else to_mps
        return ramp_s * (1.0 - (from_mps + to_mps) / (2.0 * max(CRAWL_MPS, steady_mps)))
