"""Where the front of the train is: an interval that holds the truth, and the best guess in it."""

from typing import Final

from vobc.odometry.config import OdometryConfig
from vobc.odometry.recent_way import RecentWay
from vobc.odometry.sampling import STEADY_S
from vobc.odometry.scale import WheelScale
from vobc.vocabulary import Interval, OdometryRecord, TrainBelief

REACH_PLAY_M: Final = 0.05
"""By so much the best guess wanders within an interval that stays as it is."""


class Localisation:
    """Dead reckoning from reference to reference, twice.

    Two intervals are carried on: one by the wheels, which holds the truth while tacho A turns as
    the train moves, one over ground, which holds it while radar and accelerometer keep within what
    is declared of them. Whatever single sensor is wrong, one of them is right, so that both
    together hold the truth. Both shrink only at accepted tags. The best estimate is a Kalman filter
    over (position, metres per pulse): every tag corrects both, weighed by what came before.
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
        # From any instant on, pulses tell the way within one pulse, so once is enough to add it.
        self.low_m = start.front_m - start.bound_m - self._pulse_m
        self.high_m = start.front_m + start.bound_m + self._pulse_m
        """By the wheels, at the last sample."""
        self.ground_low_m = self.low_m - config.ground_slack_m
        self.ground_high_m = self.high_m + config.ground_slack_m
        """Over ground, now."""
        self._recent = RecentWay(config.max_accel_mps2)
        self._width_m = 0.0
        self._reach_m = 0.0
        """Of what was told last, from end to end and from the best guess to the further end."""
        self._var_pp = (start.bound_m / 2.0) ** 2
        self._var_ps = 0.0
        self._var_ss = (nominal_m * config.scale_sigma_ratio) ** 2
        self.pulses = 0
        """Pulses since start, the base of all distances between tags."""
        self.scale.anchor(start.front_m - train.antenna_offset_m, 0, start.bound_m + self._pulse_m)

    def advance(self, pulses: int) -> None:
        """The wheels turned."""
        self.pulses += pulses
        scale = self.scale
        if pulses > 0:
            self.low_m += pulses * scale.low_m
            self.high_m += pulses * scale.high_m
        else:
            self.low_m += pulses * scale.high_m
            self.high_m += pulses * scale.low_m

    def by_wheels(self, speed_mps: Interval, since_s: float) -> tuple[float, float]:
        """Least and most, now: the last sample, `since_s` ago, carried on by the speed since."""
        jitter_s = self._config.stamp_jitter_s
        long_s = since_s + jitter_s
        short_s = max(0.0, since_s - jitter_s) if since_s <= STEADY_S else 0.0
        low_mps, high_mps = speed_mps.low, speed_mps.high
        return (
            self.low_m + low_mps * (short_s if low_mps > 0.0 else long_s),
            self.high_m + high_mps * (long_s if high_mps > 0.0 else short_s),
        )

    def begin_ground(self, speed_mps: Interval, since_s: float) -> None:
        """Over ground the train is where it is by the wheels, the last sample `since_s` ago."""
        low_m, high_m = self.by_wheels(speed_mps, since_s)
        self.ground_low_m = low_m - self._config.ground_slack_m
        self.ground_high_m = high_m + self._config.ground_slack_m

    def follow_wheels(self, pulses: int) -> None:
        """The best estimate goes with the wheels."""
        self._predict(pulses, pulses * self.m_per_pulse)

    def follow_ground(self, likely_m: float, spread_m: float) -> None:
        """The best estimate goes over ground; the wheels turned, but not as the train moved."""
        self._predict(0, likely_m)
        self._var_pp += spread_m * spread_m
        self.scale.forget_anchor()

    def move_over_ground(self, least_m: float, most_m: float, dt_s: float, *, steady: bool) -> None:
        """So far in this cycle; of one that was not steady nobody knows when it went how far."""
        self.ground_low_m += least_m
        self.ground_high_m += most_m
        if steady:
            self._recent.add(dt_s, least_m, most_m)
        else:
            self._recent.forget()

    def lately_m(self, age_s: float) -> tuple[float, float] | None:
        """Least and most way over ground since then, within `ground_slack_m`, if it is known."""
        return self._recent.since(age_s)

    def stretch(self, back_m: float, ahead_m: float) -> None:
        """The wheels may have told too much or too little by so much."""
        self.low_m -= back_m
        self.high_m += ahead_m
        self._var_pp += (back_m + ahead_m) ** 2
        self.scale.forget_anchor()

    def widen(self, by_m: float) -> None:
        """Whatever it was, the train may have moved so much besides."""
        self.stretch(by_m, by_m)
        self.ground_low_m -= by_m
        self.ground_high_m += by_m
        self._recent.forget()

    def trust_ground(self, low_mps: float, high_mps: float, age_s: float) -> None:
        """Take the place over ground for that by the wheels, at a sample `age_s` ago."""
        self.low_m = self.ground_low_m - max(0.0, high_mps) * age_s
        self.high_m = self.ground_high_m - min(0.0, low_mps) * age_s

    def window(self, low_mps: float, high_mps: float, age_s: float) -> tuple[float, float]:
        """Where the front may have been at the last sample, `age_s` ago.

        Args:
            low_mps: with `high_mps` the bounds of the speed over ground since.
        """
        return (
            min(self.low_m, self.ground_low_m - max(0.0, high_mps) * age_s),
            max(self.high_m, self.ground_high_m - min(0.0, low_mps) * age_s),
        )

    def _predict(self, pulses: int, moved_m: float) -> None:
        creep_m2 = self._config.creep_sigma_m_per_sqrt_m**2 * abs(moved_m)
        self.at_m += moved_m
        self._var_pp += pulses * (2.0 * self._var_ps + pulses * self._var_ss) + creep_m2
        self._var_ps += pulses * self._var_ss

    def forget_scale(self) -> None:
        """Another wheel counts from now on; what was measured of the first says nothing of it."""
        self.scale.forget()
        self._var_ss += (self._pulse_m * self._config.scale_sigma_ratio) ** 2

    def refer(
        self,
        front_m: float,
        since_m: tuple[float, float, float],
        ground_m: tuple[float, float],
        bound_m: float,
        *,
        anew: bool,
    ) -> None:
        """Narrow both intervals to an accepted reference; one that misses it begins anew there.

        Args:
            front_m: of the train at the tag.
            since_m: least, likely and most way by the wheels from there to the last sample.
            ground_m: least and most way over ground from there until now.
            bound_m: of place and instant of the reference.
            anew: nothing of what was known before is to be kept.
        """
        slack_m = self._config.ground_slack_m
        low_m, high_m = front_m + since_m[0] - bound_m, front_m + since_m[2] + bound_m
        if not anew and low_m <= self.high_m and self.low_m <= high_m:
            low_m, high_m = max(low_m, self.low_m), min(high_m, self.high_m)
        self.low_m, self.high_m = low_m, high_m
        low_m = front_m + ground_m[0] - bound_m - slack_m
        high_m = front_m + ground_m[1] + bound_m + slack_m
        if not anew and low_m <= self.ground_high_m and self.ground_low_m <= high_m:
            low_m, high_m = max(low_m, self.ground_low_m), min(high_m, self.ground_high_m)
        self.ground_low_m, self.ground_high_m = low_m, high_m
        self._width_m = self._reach_m = 0.0

    def never_narrower(self, low_m: float, best_m: float, high_m: float) -> Interval:
        """What is told next: no two intervals come together again but at a reference."""
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

    def begin_anew(self, front_m: float, bound_m: float) -> None:
        """The best estimate knows nothing but this reference."""
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

    def measure(self, tag_m: float, pulses: int, bound_m: float) -> None:
        """An honest wheel was read at a tag, at so many pulses since start."""
        self.scale.measure(tag_m, pulses, bound_m)
        self.m_per_pulse = self.scale.nearest(self.m_per_pulse)
