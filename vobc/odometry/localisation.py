"""Position of the train's front: an interval that holds the true place, and the best estimate."""

from typing import Final

from vobc.odometry.config import OdometryConfig
from vobc.odometry.recent_way import RecentWay
from vobc.odometry.references import Windows
from vobc.odometry.sampling import STEADY_S
from vobc.odometry.scale import Waypoint, WheelScale
from vobc.vocabulary import Interval, OdometryRecord, TrainBelief

REACH_PLAY_M: Final = 0.05
"""Tolerated change of the best estimate within an interval that stays the same."""


class Localisation:
    """Dead reckoning from reference to reference, by wheels and over ground.

    The interval by the wheels holds the true place while tacho A rolls without slip. The interval
    over ground holds it while radar and accelerometer keep their declared errors. If any single
    sensor fails, one of the two is right, so the union of both holds the true place. Both shrink
    only at accepted tags.

    The best estimate is a Kalman filter over (position, metres per pulse). Every tag corrects both,
    weighted by their variances.
    """

    __slots__ = (
        "_config",
        "_pulse_m",
        "_reach_m",
        "_recent",
        "_var_pp",
        "_var_ps",
        "_var_ss",
        "_width_m",
        "at_m",
        "ground_high_m",
        "ground_low_m",
        "high_m",
        "low_m",
        "m_per_pulse",
        "pulses",
        "scale",
    )

    def __init__(self, config: OdometryConfig, train: TrainBelief, start: OdometryRecord) -> None:
        self._config = config
        nominal_m = train.nominal_m_per_pulse
        self.scale = WheelScale(config, nominal_m)
        self.m_per_pulse = self.scale.nearest(start.m_per_pulse)
        self._pulse_m = self.scale.high_m
        self.at_m = start.front_m
        """Best estimate of the front at the last sample."""
        # Pulses measure any distance within one pulse, so this uncertainty is added only once.
        self.low_m = start.front_m - start.bound_m - self._pulse_m
        self.high_m = start.front_m + start.bound_m + self._pulse_m
        """Interval by the wheels, at the last sample."""
        self.ground_low_m = self.low_m - config.ground_slack_m
        self.ground_high_m = self.high_m + config.ground_slack_m
        """Interval over ground, at this instant."""
        self._recent = RecentWay(config.max_accel_mps2)
        self._width_m = 0.0
        self._reach_m = 0.0
        """Width of the last reported interval, and distance from its best estimate to the farther
        end."""
        self._var_pp = (start.bound_m / 2.0) ** 2
        self._var_ps = 0.0
        self._var_ss = (nominal_m * config.scale_sigma_ratio) ** 2
        self.pulses = 0
        """Pulses since the start, the base of all distances between tags."""
        antenna_m = start.front_m - train.antenna_offset_m
        self.scale.anchor(Waypoint(antenna_m, start.bound_m + self._pulse_m, 0, 0.0, 0.0))

    def advance(self, pulses: int) -> None:
        """Move the interval by the wheels."""
        self.pulses += pulses
        scale = self.scale
        if pulses > 0:
            self.low_m += pulses * scale.low_m
            self.high_m += pulses * scale.high_m
        else:
            self.low_m += pulses * scale.high_m
            self.high_m += pulses * scale.low_m

    def by_wheels(self, speed_mps: Interval, since_s: float) -> tuple[float, float]:
        """Present bounds by the wheels: the last sample, `since_s` ago, extrapolated with the
        speed.
        """
        jitter_s = self._config.stamp_jitter_s
        long_s = since_s + jitter_s
        short_s = max(0.0, since_s - jitter_s) if since_s <= STEADY_S else 0.0
        low_mps, high_mps = speed_mps.low, speed_mps.high
        return (
            self.low_m + low_mps * (short_s if low_mps > 0.0 else long_s),
            self.high_m + high_mps * (long_s if high_mps > 0.0 else short_s),
        )

    def begin_ground(self, speed_mps: Interval, since_s: float) -> None:
        """Start the interval over ground from the one by the wheels, whose last sample is `since_s`
        old.
        """
        low_m, high_m = self.by_wheels(speed_mps, since_s)
        self.ground_low_m = low_m - self._config.ground_slack_m
        self.ground_high_m = high_m + self._config.ground_slack_m

    def follow_wheels(self, pulses: int) -> None:
        """Move the best estimate with the wheels."""
        self._predict(pulses, pulses * self.m_per_pulse)

    def follow_ground(self, likely_m: float, spread_m: float) -> None:
        """Move the best estimate over ground, while the wheels slip or slide."""
        self._predict(0, likely_m)
        self._var_pp += spread_m * spread_m
        self.scale.forget_anchor()

    def move_over_ground(self, least_m: float, most_m: float, dt_s: float, *, steady: bool) -> None:
        """Add the distance of this cycle. After a gap, the course of the distance is unknown."""
        self.ground_low_m += least_m
        self.ground_high_m += most_m
        if steady:
            self._recent.add(dt_s, least_m, most_m)
        else:
            self._recent.forget()

    def lately_m(self, age_s: float) -> tuple[float, float] | None:
        """Least and greatest distance over ground since then, within `ground_slack_m`, if known."""
        return self._recent.since(age_s)

    def stretch(self, back_m: float, ahead_m: float) -> None:
        """Widen the interval by the wheels, which may have counted this much too much or too
        little.
        """
        self.low_m -= back_m
        self.high_m += ahead_m
        self._var_pp += (back_m + ahead_m) ** 2
        self.scale.forget_anchor()

    def widen(self, by_m: float) -> None:
        """Widen both intervals by an unknown movement."""
        self.stretch(by_m, by_m)
        self.ground_low_m -= by_m
        self.ground_high_m += by_m
        self._recent.forget()

    def trust_ground(self, low_mps: float, high_mps: float, age_s: float) -> None:
        """Replace the interval by the wheels by the one over ground, for a sample `age_s` old."""
        self.low_m = self.ground_low_m - max(0.0, high_mps) * age_s
        self.high_m = self.ground_high_m - min(0.0, low_mps) * age_s

    def reconcile(self, wheels_mps: Interval, ground_mps: Interval, since_s: float) -> None:
        """Widen both intervals to their hull at the end of slip, because either may be wrong now.

        Args:
            since_s: age of the last sample of the wheels.
        """
        low_m, high_m = self.by_wheels(wheels_mps, since_s)
        self.low_m, self.high_m = self.windows(ground_mps.low, ground_mps.high, since_s).whole_m
        self.ground_low_m = min(self.ground_low_m, low_m)
        self.ground_high_m = max(self.ground_high_m, high_m)

    def windows(self, low_mps: float, high_mps: float, age_s: float) -> Windows:
        """Where wheels and ground expect the front at the last sample, `age_s` ago.

        Args:
            low_mps: with `high_mps` the bounds of the speed over ground since then.
        """
        return Windows(
            (self.low_m, self.high_m),
            (
                self.ground_low_m - max(0.0, high_mps) * age_s,
                self.ground_high_m - min(0.0, low_mps) * age_s,
            ),
        )

    def _predict(self, pulses: int, moved_m: float) -> None:
        creep_m2 = self._config.creep_sigma_m_per_sqrt_m**2 * abs(moved_m)
        self.at_m += moved_m
        self._var_pp += pulses * (2.0 * self._var_ps + pulses * self._var_ss) + creep_m2
        self._var_ps += pulses * self._var_ss

    def forget_scale(self) -> None:
        """Discard the measured scale, because another wheel counts from now on."""
        self.scale.forget()
        self._var_ss += (self._pulse_m * self._config.scale_sigma_ratio) ** 2

    def refer(
        self,
        front_m: float,
        since_m: tuple[float, float, float],
        ground_m: tuple[float, float],
        bound_m: float,
        *,
        restarts: bool,
    ) -> None:
        """Narrow both intervals to an accepted reference, or restart them from it.

        An interval that is narrower than the reference stays, unless both are restarted, as after
        the place was lost.

        Args:
            front_m: place of the front at the tag.
            since_m: least, likely and greatest distance by the wheels from there to the last
                sample.
            ground_m: least and greatest distance over ground from there until now.
            bound_m: bound of place and instant of the reference.
        """
        low_m, high_m = front_m + since_m[0] - bound_m, front_m + since_m[2] + bound_m
        if restarts or high_m - low_m < self.high_m - self.low_m:
            self.low_m, self.high_m = low_m, high_m
        bound_m += self._config.ground_slack_m
        low_m, high_m = front_m + ground_m[0] - bound_m, front_m + ground_m[1] + bound_m
        if restarts or high_m - low_m < self.ground_high_m - self.ground_low_m:
            self.ground_low_m, self.ground_high_m = low_m, high_m
        self._width_m = self._reach_m = 0.0

    def embrace(
        self,
        front_m: float,
        since_m: tuple[float, float, float],
        ground_m: tuple[float, float],
        bound_m: float,
    ) -> None:
        """Widen both intervals by the place of a tag that contradicts them.

        Either the tag is wrong, or what the intervals are made from. The arguments are those of
        `refer`.
        """
        self.low_m = min(self.low_m, front_m + since_m[0] - bound_m)
        self.high_m = max(self.high_m, front_m + since_m[2] + bound_m)
        bound_m += self._config.ground_slack_m
        self.ground_low_m = min(self.ground_low_m, front_m + ground_m[0] - bound_m)
        self.ground_high_m = max(self.ground_high_m, front_m + ground_m[1] + bound_m)

    def never_narrower(self, low_m: float, best_m: float, high_m: float) -> Interval:
        """The reported interval. It becomes narrower only at a reference."""
        back_m, ahead_m = best_m - low_m, high_m - best_m
        short_m = self._reach_m - REACH_PLAY_M - max(back_m, ahead_m)
        if short_m > 0.0:
            low_m -= short_m if back_m >= ahead_m else 0.0
            high_m += short_m if ahead_m > back_m else 0.0
        half_m = 0.5 * (self._width_m - (high_m - low_m))
        if half_m > 0.0:
            low_m, high_m = low_m - half_m, high_m + half_m
        self._width_m = max(self._width_m, high_m - low_m)
        self._reach_m = max(max(self._reach_m, best_m - low_m), high_m - best_m)
        return Interval(low_m, best_m, high_m)

    def restart(self, front_m: float, bound_m: float) -> None:
        """Restart the best estimate from this reference alone."""
        self.at_m = front_m
        self._var_pp = bound_m**2
        self._var_ps = 0.0
        self.scale.forget_anchor()

    def correct(self, front_m: float, pulses_since: float, latch_m: float) -> None:
        """Kalman update with the measurement front_m = position - m_per_pulse * pulses_since."""
        noise = self._config.tag_sigma_m**2 + self._pulse_m**2 / 12.0 + latch_m**2 / 3.0
        gain_p = self._var_pp - pulses_since * self._var_ps
        gain_s = self._var_ps - pulses_since * self._var_ss
        spread = gain_p - pulses_since * gain_s + noise
        miss_m = front_m - (self.at_m - self.m_per_pulse * pulses_since)
        self.at_m += gain_p / spread * miss_m
        self.m_per_pulse += gain_s / spread * miss_m
        self._var_pp -= gain_p * gain_p / spread
        self._var_ps -= gain_p * gain_s / spread
        self._var_ss -= gain_s * gain_s / spread
        self.at_m = min(
            max(self.at_m, min(self.low_m, self.ground_low_m)), max(self.high_m, self.ground_high_m)
        )
        self.m_per_pulse = self.scale.nearest(self.m_per_pulse)

    def measure(self, here: Waypoint) -> None:
        """Use a tag to measure the scale of a wheel that has not slipped."""
        self.scale.measure(here)
        self.m_per_pulse = self.scale.nearest(self.m_per_pulse)
