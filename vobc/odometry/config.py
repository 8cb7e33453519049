"""What the controller believes of its position and speed sensors."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    scale_error_low_ratio: float
    """Counted distance = true distance * (1 + e); e lies between these two ends."""
    scale_error_high_ratio: float
    scale_sigma_ratio: float
    """Standard deviation of e before the first tags."""
    scale_margin_ratio: float
    """What a scale measured between two tags is widened by, for creep that nobody sees."""
    scale_base_m: float
    """Two tags at least so far apart measure the scale."""
    creep_sigma_m_per_sqrt_m: float
    """Random walk of the counted distance."""
    start_bound_m: float
    """A train that is set up at a stopping point stands within this."""
    cold_movement_m: float
    """A place is remembered only if it was known to this, and the train was moved by no more."""
    tag_bound_m: float
    """Hard bound of the place of one tag."""
    tag_sigma_m: float
    tag_stamp_s: float
    """Hard bound of the instant at which the reader latches the pulses."""
    tag_reach_m: float
    """A tag may be read again while its centre is this near to the antenna's."""
    tag_silence_s: float
    """After this a passed tag that nobody reported counts as missed."""
    missed_tags_max: int
    localisation_limit_m: float
    """Wider intervals mean that the train does not know where it is."""
    tracking_rad_s: float
    """Bandwidth of the speed filter."""
    window_s: float
    """Pulses are counted over this time for the hard bounds of speed."""
    stamp_jitter_s: float
    """How much the delay between sampling a tacho and hearing its frame may vary."""
    learn_s: float
    """Of the tacho frames of so long a time one comes without delay. Before, the first ones may all
    have been held up, and show a train that sets off as one that stands: nothing is told yet."""
    max_accel_mps2: float
    """No train changes its speed faster, either way, gradient included."""
    max_speed_mps: float
    """Counters that would need more than this have jumped."""
    standing_s: float
    silence_s: float
    """Older than this a tacho sample proves no standstill any more."""
    zero_speed_mps: float
    zero_speed_s: float
    doppler_quality_percent: float
    doppler_age_s: float
    doppler_error_mps: float
    """Hard bound of one reading, with `doppler_error_ratio`."""
    doppler_error_ratio: float
    doppler_mean_mps: float
    """The same of the mean over some readings, when their noise has averaged out."""
    doppler_mean_ratio: float
    doppler_blind_mps: float
    """Slower than this the radar may see nothing."""
    imu_age_s: float
    imu_error_mps2: float
    """Hard bound of one reading: bias and noise."""
    unseen_slip_ratio: float
    """What wheels may slip or slide where neither radar nor accelerometer could tell."""
    gentle_mps2: float
    """Wheels that change their speed by no more need next to no adhesion."""
    gentle_slip_ratio: float
    """What they may slip or slide then, the same."""
    ground_slack_m: float
    """What radar readings may be wrong in sum before their noise has averaged out."""
    slip_hold_s: float
    """Wheels are to be trusted again once they agreed with the speed over ground for so long."""

    def __post_init__(self) -> None:
        if not -0.2 < self.scale_error_low_ratio <= 0.0 <= self.scale_error_high_ratio < 0.2:
            raise ValueError(
                f"scale_error_low_ratio {self.scale_error_low_ratio} and scale_error_high_ratio "
                f"{self.scale_error_high_ratio} must enclose 0 within ±0.2"
            )
        if self.learn_s < 0.0:
            raise ValueError(f"learn_s {self.learn_s} is negative")
        for name in _POSITIVE:
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")


_POSITIVE = (
    "scale_sigma_ratio",
    "scale_base_m",
    "start_bound_m",
    "tag_bound_m",
    "tag_sigma_m",
    "tag_reach_m",
    "missed_tags_max",
    "localisation_limit_m",
    "tracking_rad_s",
    "window_s",
    "max_accel_mps2",
    "max_speed_mps",
    "standing_s",
    "silence_s",
    "zero_speed_mps",
    "zero_speed_s",
    "doppler_error_mps",
    "imu_error_mps2",
    "unseen_slip_ratio",
    "slip_hold_s",
)
