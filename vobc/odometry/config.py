"""Assumed properties of the position and speed sensors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from firmware_py.settings import check_ranges


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    scale_error_low_ratio: float
    """Bounds of the scale error e: counted distance = true distance * (1 + e)."""
    scale_error_high_ratio: float
    scale_sigma_ratio: float
    """Standard deviation of e before the first tags."""
    scale_margin_ratio: float
    """Relative margin added to a scale measured between two tags. It covers undetected creep."""
    scale_base_m: float
    """Least distance between two tags that measure the scale."""
    creep_sigma_m_per_sqrt_m: float
    """Random walk of the counted distance."""
    start_bound_m: float
    """Hard bound of the place of a train that is set up at a stopping point."""
    cold_movement_m: float
    """Limit for using a remembered place. Neither the place's bound nor the distance moved while
    off may exceed it."""
    tag_bound_m: float
    """Hard bound of the place of one tag."""
    tag_sigma_m: float
    tag_stamp_s: float
    """Hard bound of the instant at which the reader latches the pulses."""
    tag_reach_m: float
    """Greatest distance between the centres of tag and antenna at which the tag can be read."""
    tag_silence_s: float
    """Time after which a passed tag without a telegram counts as missed."""
    missed_tags_max: int
    localisation_limit_m: float
    """Width of the position interval beyond which the train counts as not localised."""
    tracking_rad_s: float
    """Bandwidth of the speed filter."""
    window_s: float
    """Time over which pulses are counted for the hard bounds of speed."""
    stamp_jitter_s: float
    """Bound of the variation in delay between a tacho sample and the arrival of its frame."""
    learn_s: float
    """Learning time of the tacho clock. Within this time at least one frame arrives without delay.
    Before, all frames may have been delayed, and a starting train would appear to stand. Odometry
    therefore gives no output until then."""
    max_accel_mps2: float
    """Upper bound of any train's acceleration and deceleration, gradient included."""
    max_speed_mps: float
    """Upper bound of the speed. A counter step that implies more is a jump."""
    standing_s: float
    silence_s: float
    """Age beyond which a tacho sample no longer proves standstill."""
    zero_speed_mps: float
    zero_speed_s: float
    doppler_quality_percent: float
    doppler_age_s: float
    doppler_error_mps: float
    """Hard bound of one reading, to which `doppler_error_ratio` adds a part of the speed."""
    doppler_error_ratio: float
    doppler_mean_mps: float
    """Hard bound of the mean of several readings, whose noise has averaged out.
    `doppler_mean_ratio` adds a part of the speed."""
    doppler_mean_ratio: float
    doppler_blind_mps: float
    """Speed below which the radar may detect nothing."""
    imu_age_s: float
    imu_error_mps2: float
    """Hard bound of one reading: bias and noise."""
    unseen_slip_ratio: float
    """Bound of the relative slip or slide of the wheels where neither radar nor accelerometer can
    detect it."""
    gentle_mps2: float
    """Acceleration of the wheels up to which they need next to no adhesion."""
    gentle_slip_ratio: float
    """Bound of the relative slip or slide at such low acceleration."""
    ground_slack_m: float
    """Bound of the accumulated radar error before the noise has averaged out."""
    slip_hold_s: float
    """Time of agreement with the ground speed after which the wheels are trusted again."""

    def __post_init__(self) -> None:
        if not -0.2 < self.scale_error_low_ratio <= 0.0 <= self.scale_error_high_ratio < 0.2:
            raise ValueError(
                f"scale_error_low_ratio {self.scale_error_low_ratio} and scale_error_high_ratio "
                f"{self.scale_error_high_ratio} must enclose 0 within ±0.2"
            )
        check_ranges(self, RANGES)


RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "scale_sigma_ratio": (1.0e-4, 0.1),
    "scale_margin_ratio": (0.0, 0.05),
    "scale_base_m": (1.0, 1000.0),
    "creep_sigma_m_per_sqrt_m": (0.0, 0.1),
    "start_bound_m": (0.01, 20.0),
    "cold_movement_m": (0.1, 20.0),
    "tag_bound_m": (0.001, 1.0),
    "tag_sigma_m": (0.001, 1.0),
    "tag_stamp_s": (0.0, 0.1),
    "tag_reach_m": (0.05, 3.0),
    "tag_silence_s": (0.05, 10.0),
    "missed_tags_max": (1, 10),
    "localisation_limit_m": (1.0, 500.0),
    "tracking_rad_s": (0.5, 50.0),
    "window_s": (0.02, 2.0),
    "stamp_jitter_s": (0.0, 0.1),
    "learn_s": (0.0, 10.0),
    "max_accel_mps2": (0.5, 4.0),
    "max_speed_mps": (5.0, 100.0),
    "standing_s": (0.05, 5.0),
    "silence_s": (0.02, 2.0),
    # IEEE 1474: doors and zero speed are below 3 km/h.
    "zero_speed_mps": (0.01, 3.0 / 3.6),
    "zero_speed_s": (0.1, 10.0),
    "doppler_quality_percent": (0.0, 100.0),
    "doppler_age_s": (0.02, 2.0),
    "doppler_error_mps": (0.001, 2.0),
    "doppler_error_ratio": (0.0, 0.2),
    "doppler_mean_mps": (0.0, 2.0),
    "doppler_mean_ratio": (0.0, 0.2),
    "doppler_blind_mps": (0.0, 5.0),
    "imu_age_s": (0.02, 2.0),
    "imu_error_mps2": (0.001, 2.0),
    "unseen_slip_ratio": (0.001, 1.0),
    "gentle_mps2": (0.0, 2.0),
    "gentle_slip_ratio": (0.0, 1.0),
    "ground_slack_m": (0.0, 2.0),
    "slip_hold_s": (0.01, 10.0),
}
"""Plausible range of each value. Beyond it the value is a slip of the pen or of the unit."""
