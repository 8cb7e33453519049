"""Speed over ground without the wheels: from radar, and from the accelerometer between readings."""

import math
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.kinematics import GRAVITY_MPS2
from vobc.odometry.config import OdometryConfig
from vobc.vocabulary import CycleInput

FIRST_CAR_M: Final = 25.0
"""Length of the first car. The accelerometer is somewhere in it and senses the gradient there."""
AHEAD_M: Final = 50.0
"""Greatest distance after which the gradients are looked up again."""
PERMILLE: Final = 0.001


def believable_mps(inputs: CycleInput, config: OdometryConfig) -> float | None:
    """Speed of the Doppler radar. None: the reading is missing, old or of low quality."""
    radar = inputs.doppler
    if (
        radar is None
        or not radar.healthy
        or radar.quality_percent < config.doppler_quality_percent
        or inputs.doppler_age_s > config.doppler_age_s
    ):
        return None
    return radar.speed_mps


class Gradients:
    """Bounds of the gradient that the accelerometer may sense, given the interval of the front.

    A line has few gradients, so the result is kept until the train leaves the stretch.
    """

    __slots__ = ("_from_m", "_line", "_to_m", "highest_mps2", "lowest_mps2")

    def __init__(self, line: LineMap) -> None:
        self._line = line
        self._from_m, self._to_m = math.inf, -math.inf
        self.lowest_mps2 = 0.0
        """Least contribution of gravity to the reading, positive uphill."""
        self.highest_mps2 = 0.0

    def look(self, low_m: float, high_m: float) -> None:
        if low_m - FIRST_CAR_M >= self._from_m and high_m <= self._to_m:
            return
        self._from_m, self._to_m = low_m - FIRST_CAR_M, high_m
        felt, level_from_m = [], self._from_m
        for piece in self._line.gradients:
            if piece.start_m <= self._to_m and piece.end_m >= self._from_m:
                felt.append(piece.gradient_permille)
                if piece.start_m > level_from_m:
                    felt.append(0.0)
                level_from_m = max(level_from_m, piece.end_m)
        if level_from_m <= self._to_m:
            felt.append(0.0)
        self.lowest_mps2 = GRAVITY_MPS2 * min(felt) * PERMILLE
        self.highest_mps2 = GRAVITY_MPS2 * max(felt) * PERMILLE
        self._reach()

    def _reach(self) -> None:
        """Extend the valid stretch to the next change of gradient, at most by AHEAD_M."""
        edges_m = [edge for g in self._line.gradients for edge in (g.start_m, g.end_m)]
        behind_m = [edge for edge in edges_m if edge <= self._from_m]
        ahead_m = [edge for edge in edges_m if edge >= self._to_m]
        self._from_m = max([self._from_m - AHEAD_M, *behind_m])
        self._to_m = min([self._to_m + AHEAD_M, *ahead_m])


class GroundSpeed:
    """Bounds of the speed over ground, valid while radar and accelerometer keep their declared
    errors.

    Each radar reading must agree with the previous bounds extrapolated by the accelerometer. If it
    does not, the one that agrees with the wheels counts. If all three contradict each other, the
    bounds enclose both. Without radar the bounds widen by the accelerometer's error, and without
    both by a train's greatest acceleration.
    """

    __slots__ = (
        "_accel_high_mps2",
        "_accel_low_mps2",
        "_config",
        "_felt_mps2",
        "begun",
        "high_mps",
        "low_mps",
        "moved_high_m",
        "moved_low_m",
        "refused",
        "seen",
    )

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self.begun = False
        self.low_mps = -config.max_speed_mps
        self.high_mps = config.max_speed_mps
        self.moved_low_m = 0.0
        """Least and greatest distance of the last step."""
        self.moved_high_m = 0.0
        self._felt_mps2: float | None = None
        self._accel_low_mps2 = -config.max_accel_mps2
        self._accel_high_mps2 = config.max_accel_mps2
        self.seen = False
        """The last step used a radar reading."""
        self.refused = 0
        """Number of radar readings that neither wheels nor accelerometer confirm."""

    def begin(self, low_mps: float, high_mps: float) -> None:
        self.begun = True
        self.low_mps, self.high_mps = low_mps, high_mps

    def feel(self, felt_mps2: float | None, gradients: Gradients) -> None:
        """Take a reading of the accelerometer. None: there is no credible reading.

        The reading is a delayed mean over one period. Its change since the last one widens both
        bounds.
        """
        most_mps2 = self._config.max_accel_mps2
        before, self._felt_mps2 = self._felt_mps2, felt_mps2
        if felt_mps2 is None:
            self._accel_low_mps2, self._accel_high_mps2 = -most_mps2, most_mps2
            return
        error_mps2 = self._config.imu_error_mps2
        if before is not None:
            error_mps2 += abs(felt_mps2 - before)
        low = felt_mps2 - gradients.highest_mps2 - error_mps2
        high = felt_mps2 - gradients.lowest_mps2 + error_mps2
        # A reading beyond any train's acceleration is wrong and is ignored.
        wrong = low > most_mps2 or high < -most_mps2
        self._accel_low_mps2 = -most_mps2 if wrong else max(low, -most_mps2)
        self._accel_high_mps2 = most_mps2 if wrong else min(high, most_mps2)

    def step(
        self,
        dt_s: float,
        radar_mps: float | None,
        radar_age_s: float,
        wheels_low_mps: float,
        wheels_high_mps: float,
    ) -> None:
        """Extrapolate the bounds by `dt_s` and narrow them with the radar."""
        low_accel, high_accel = self._accel_low_mps2, self._accel_high_mps2
        before_low, before_high = self.low_mps, self.high_mps
        most_mps = self._config.max_speed_mps
        low = max(before_low + low_accel * dt_s, -most_mps)
        high = min(before_high + high_accel * dt_s, most_mps)
        self.moved_low_m = 0.5 * (before_low + low) * dt_s
        self.moved_high_m = 0.5 * (before_high + high) * dt_s
        self.seen = False
        if radar_mps is not None:
            config = self._config
            error_mps = config.doppler_error_mps + config.doppler_error_ratio * abs(radar_mps)
            shown_low = radar_mps - error_mps + min(0.0, low_accel) * radar_age_s
            shown_high = radar_mps + error_mps + max(0.0, high_accel) * radar_age_s
            if shown_low <= high and low <= shown_high:
                low, high = max(low, shown_low), min(high, shown_high)
                self.seen = True
            elif shown_low <= wheels_high_mps and wheels_low_mps <= shown_high:
                low, high = shown_low, shown_high
                self.seen = True
            elif not (low <= wheels_high_mps and wheels_low_mps <= high):
                low, high = min(low, shown_low), max(high, shown_high)
                self.refused += 1
            else:
                self.refused += 1
            if self.seen:
                self._move_as_shown(radar_mps, radar_age_s, dt_s)
        self.low_mps, self.high_mps = low, high

    def _move_as_shown(self, radar_mps: float, radar_age_s: float, dt_s: float) -> None:
        """Distance of the step by the mean of several readings. It is more accurate, as noise
        averages out.
        """
        config = self._config
        accel_mps2 = 0.5 * (self._accel_low_mps2 + self._accel_high_mps2)
        mean_mps = radar_mps + accel_mps2 * (radar_age_s - 0.5 * dt_s)
        error_mps = config.doppler_mean_mps + config.doppler_mean_ratio * abs(radar_mps)
        # Error of the accelerometer over the time by which the reading is extrapolated.
        spread_mps2 = 0.5 * (self._accel_high_mps2 - self._accel_low_mps2)
        error_mps += spread_mps2 * abs(radar_age_s - 0.5 * dt_s)
        self.moved_low_m = (mean_mps - error_mps) * dt_s
        self.moved_high_m = (mean_mps + error_mps) * dt_s

    @property
    def may_rest(self) -> bool:
        """The accelerometer does not exclude a constant speed."""
        return self._accel_low_mps2 <= 0.0 <= self._accel_high_mps2

    @property
    def best_mps(self) -> float:
        return 0.5 * (self.low_mps + self.high_mps)
