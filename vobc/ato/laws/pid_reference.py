"""Speed references of the PID law over the place: jerk-limited rises, and falls to a stop or limit.

A rise counts from its start, a fall backwards from its end. Both therefore begin slow, and the
speed never decreases along either.
"""

import math
from bisect import bisect_right
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from vobc.ato.motion import gradient, profile
from vobc.ato.settings.ato import AtoConfig
from vobc.ato.settings.pid import falling_decel

SOLVE_STEPS: Final = 60
SOLVED_M: Final = 1e-9
SEARCH_STEPS: Final = 30
"""Number of bisections of a range of peak speeds. The result is far finer than 1 mm/s."""


class ReferencePoint(NamedTuple):
    """Point of a curve at one place.

    Rates are in time along the curve; those of a fall are decelerations.
    """

    speed_mps: float
    accel_mps2: float
    jerk_mps3: float


class _Phase(NamedTuple):
    """Phase of constant jerk."""

    place_m: float
    speed_mps: float
    accel_mps2: float
    jerk_mps3: float
    duration_s: float


class SpeedCurve:
    """Curve built phase by phase from its slow end. At its fast end the speed is constant."""

    __slots__ = ("_accel_mps2", "_phases", "_places_m", "length_m", "top_mps")

    def __init__(self, speed_mps: float, accel_mps2: float) -> None:
        assert speed_mps >= 0.0
        assert accel_mps2 >= 0.0
        self.length_m = 0.0
        self.top_mps = speed_mps
        self._accel_mps2 = accel_mps2
        self._phases: list[_Phase] = []
        self._places_m: list[float] = []

    def ramp(self, to_mps2: float, jerk_mps3: float) -> None:
        """Change the acceleration at this rate, up or down, but not below zero."""
        change_mps2 = to_mps2 - self._accel_mps2
        self._add(math.copysign(jerk_mps3, change_mps2), abs(change_mps2) / jerk_mps3)
        self._accel_mps2 = to_mps2

    def keep_to_m(self, place_m: float) -> None:
        """Keep the acceleration up to a place, if that is ahead."""
        v, a, way_m = self.top_mps, self._accel_mps2, place_m - self.length_m
        if way_m > 0.0 and a > 0.0:
            self._add(0.0, (math.sqrt(v * v + 2.0 * a * way_m) - v) / a)

    def keep_to_mps(self, speed_mps: float) -> None:
        """Keep the acceleration up to a speed, if that is higher."""
        if speed_mps > self.top_mps and self._accel_mps2 > 0.0:
            self._add(0.0, (speed_mps - self.top_mps) / self._accel_mps2)

    def finish(self, top_mps: float, jerk_mps3: float) -> None:
        """Continue to `top_mps` and end without acceleration.

        The speed exceeds it if there is no room to ease.
        """
        a = self._accel_mps2
        self.keep_to_mps(top_mps - a * a / (2.0 * jerk_mps3))
        self.ramp(0.0, jerk_mps3)

    def _add(self, jerk_mps3: float, duration_s: float) -> None:
        if duration_s <= 0.0:
            return
        v, a, t = self.top_mps, self._accel_mps2, duration_s
        self._phases.append(_Phase(self.length_m, v, a, jerk_mps3, t))
        self._places_m.append(self.length_m)
        self.length_m += t * (v + t * (a / 2.0 + t * jerk_mps3 / 6.0))
        self.top_mps = v + t * (a + t * jerk_mps3 / 2.0)

    def at(self, place_m: float) -> ReferencePoint:
        """The point at this place. Before the curve: its beginning. Behind it: its last speed."""
        if place_m >= self.length_m:
            return ReferencePoint(self.top_mps, 0.0, 0.0)
        phase = self._phases[max(0, bisect_right(self._places_m, place_m) - 1)]
        start_m, v, a, j, t = phase
        way_m = max(0.0, place_m - start_m)
        # Distance is convex in time, so Newton's steps converge from the far side.
        for _ in range(SOLVE_STEPS):
            over_m = t * (v + t * (a / 2.0 + t * j / 6.0)) - way_m
            speed_mps = v + t * (a + t * j / 2.0)
            if over_m <= SOLVED_M or speed_mps <= 0.0:
                break
            t -= over_m / speed_mps
        t = max(0.0, t)
        return ReferencePoint(v + t * (a + t * j / 2.0), a + t * j, j)

    def place_of_m(self, speed_mps: float) -> float:
        """Place where the curve has this speed. For a higher speed: its end."""
        if speed_mps >= self.top_mps:
            return self.length_m
        for start_m, v, a, j, duration_s in reversed(self._phases):
            gain_mps = speed_mps - v
            if gain_mps < 0.0:
                continue
            root_mps2 = math.sqrt(max(0.0, a * a + 2.0 * j * gain_mps))
            t = 0.0 if gain_mps == 0.0 else min(duration_s, 2.0 * gain_mps / (a + root_mps2))
            return start_m + t * (v + t * (a / 2.0 + t * j / 6.0))
        return 0.0


def rise(
    from_mps: float, from_mps2: float, top_mps: float, *, accel_mps2: float, jerk_mps3: float
) -> SpeedCurve:
    """Trapezoidal acceleration up to `top_mps`, beginning with `from_mps2` or 0."""
    first_mps2 = max(0.0, from_mps2)
    curve = SpeedCurve(max(0.0, from_mps), first_mps2)
    gain_mps = max(0.0, top_mps - from_mps)
    # A ramp up to a peak p and down to 0 gains (2 p² - first²) / 2J.
    peak_mps2 = math.sqrt(jerk_mps3 * gain_mps + first_mps2 * first_mps2 / 2.0)
    curve.ramp(max(first_mps2, min(accel_mps2, peak_mps2)), jerk_mps3)
    curve.finish(top_mps, jerk_mps3)
    return curve


def stop_at_platform(config: AtoConfig, line: LineMap, at_m: float, top_mps: float) -> SpeedCurve:
    """Curve backwards from the stop through T3, T2 and T1, each with the deceleration of its
    section.

    Uphill all final decelerations are larger, because the brake needs as much room to ease as on
    the level.
    """
    scheme = config.pid
    jerk_mps3 = scheme.ease_jerk_mps3
    steady_mps2 = min(scheme.decel_mps2, profile.steady_decel_mps2(config, line, at_m))
    uphill_mps2 = max(0.0, gradient.decel_at_mps2(config, line, at_m))
    last_mps2 = min(steady_mps2, scheme.last_decel_mps2 + uphill_mps2)
    t3_mps2, stop_s = falling_decel(scheme.t3_speed_mps, scheme.t3_m, scheme.last_decel_mps2)
    curve = SpeedCurve(0.0, last_mps2)
    t3_mps2 = min(steady_mps2, t3_mps2 + uphill_mps2)
    if t3_mps2 > last_mps2:
        curve.ramp(t3_mps2, (t3_mps2 - last_mps2) / stop_s)
    curve.keep_to_m(scheme.t3_m)
    curve.ramp(min(steady_mps2, scheme.creep_decel_mps2 + uphill_mps2), jerk_mps3)
    curve.keep_to_m(scheme.t2_m)
    curve.ramp(min(steady_mps2, scheme.section_decel_mps2 + uphill_mps2), jerk_mps3)
    curve.keep_to_m(scheme.t1_m)
    curve.ramp(steady_mps2, jerk_mps3)
    curve.finish(top_mps, jerk_mps3)
    return curve


def stop_before_authority(
    config: AtoConfig, line: LineMap, at_m: float, top_mps: float
) -> SpeedCurve:
    """Curve to a standstill below protection's own curve; see `AuthorityStop`."""
    shape = config.authority
    steady_mps2 = min(shape.decel_mps2, profile.steady_decel_mps2(config, line, at_m))
    uphill_mps2 = max(0.0, gradient.decel_at_mps2(config, line, at_m))
    curve = SpeedCurve(0.0, min(shape.final_decel_mps2 + uphill_mps2, steady_mps2))
    knee_mps2 = min(max(shape.knee_decel_mps2, shape.final_decel_mps2 + uphill_mps2), steady_mps2)
    curve.ramp(knee_mps2, shape.creep_ease_mps3)
    curve.ramp(steady_mps2, shape.ease_mps3)
    curve.finish(top_mps, config.pid.ease_jerk_mps3)
    return curve


def slow_down(config: AtoConfig, *, to_mps: float, decel_mps2: float, top_mps: float) -> SpeedCurve:
    """Curve to a lower limit: trapezoidal deceleration that ends at the start of the limit."""
    jerk_mps3 = config.pid.ease_jerk_mps3
    peak_mps2 = math.sqrt(jerk_mps3 * max(0.0, top_mps - to_mps))
    curve = SpeedCurve(to_mps, 0.0)
    curve.ramp(min(decel_mps2, config.pid.decel_mps2, peak_mps2), jerk_mps3)
    curve.finish(top_mps, jerk_mps3)
    return curve


def stop_curve(
    config: AtoConfig, line: LineMap, at_m: float, top_mps: float, *, at_station: bool
) -> SpeedCurve:
    make = stop_at_platform if at_station else stop_before_authority
    return make(config, line, at_m, top_mps)


def peak_mps(
    config: AtoConfig,
    line: LineMap,
    *,
    from_mps: float,
    way_m: float,
    at_m: float,
    at_station: bool,
    limit_mps: float,
    change_over_s: float,
) -> float:
    """The highest speed up to `limit_mps` that fits within `way_m`.

    The train accelerates to it, keeps it for a while and brakes from it. If even `from_mps` is too
    high, that is the result.
    """
    if limit_mps <= from_mps:
        return limit_mps
    accel_mps2, jerk_mps3 = config.limits.accel_mps2, config.pid.rise_jerk_mps3

    def needed_m(top_mps: float) -> float:
        up = rise(from_mps, 0.0, top_mps, accel_mps2=accel_mps2, jerk_mps3=jerk_mps3)
        down = stop_curve(config, line, at_m, top_mps, at_station=at_station)
        return up.length_m + top_mps * change_over_s + down.length_m

    if needed_m(limit_mps) <= way_m:
        return limit_mps
    low_mps, high_mps = from_mps, limit_mps
    for _ in range(SEARCH_STEPS):
        middle_mps = (low_mps + high_mps) / 2.0
        if needed_m(middle_mps) <= way_m:
            low_mps = middle_mps
        else:
            high_mps = middle_mps
    return low_mps
