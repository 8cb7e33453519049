"""Settings of control by chasing time."""

from dataclasses import dataclass

KMH_PER_MPS = 3.6


@dataclass(frozen=True, slots=True)
class ChasingScheme:
    """Wu 2022 leaves all figures but the blending band open; these are ours."""

    early_transition: bool = True
    """Brake before the curve is reached, so that the brake has built up where the curve begins."""
    small_brake: bool = True
    """Hold one small notch through electro-pneumatic blending; off, one curve leads to the stop."""
    dead_time_s: float = 0.75
    """Of the brake, from the decision to the first bite; fixed, this law identifies nothing."""
    lag_s: float = 0.35
    """Of the brake's build-up after that; both together are what is predicted over."""
    air_delay_s: float = 0.0
    """Added below blending, where friction alone brakes and answers later than the motors."""
    decel_mps2: float = 0.6
    """Of the curve to a stop, down to the small brake."""
    small_decel_mps2: float = 0.2
    """Through blending."""
    small_decel_min_mps2: float = 0.1
    small_decel_max_mps2: float = 0.35
    """The small notch lies within these, as the distance left asks for it."""
    chase_decel_mps2: float = 0.15
    """From the end of blending towards the last notch."""
    last_decel_mps2: float = 0.05
    """Of the last notch on the level; it exceeds the fall of the track."""
    blending_begin_mps: float = 8.0 / KMH_PER_MPS
    blending_end_mps: float = 4.0 / KMH_PER_MPS
    blending_reserve_m: float = 0.0
    """Kept behind blending for what friction lacks while the motors fade faster than it follows;
    without the small brake, by the one curve."""
    blending_spread_ratio: float = 0.1
    """The band may begin so much sooner."""
    last_speed_mps: float = 0.17
    """From about here the last notch stays on."""
    rolling_mps2: float = 0.018
    """Resistance at low speed; every notch brakes by that much more."""
    chase_ratio: float = 0.27
    """Share of the time to the target within which the curve is to be caught."""
    cruise_chase_s: float = 6.0
    """Time within which a constant speed is to be caught."""
    keep_band_mps: float = 0.5
    """A notch that closes the gap in time is kept as long as the gap is smaller than this."""
    cruise_band_mps: float = 0.25
    """A constant speed is kept within this."""
    quiet_band_mps: float = 0.15
    """In a gap smaller than this no other notch is looked for."""
    quiet_growth_mps2: float = 0.05
    """Before a stop that gap grows by this for each second that there is to close it."""
    guard_mps2: float = 0.01
    """A notch nearer to the curve's deceleration than this never catches it."""
    dwell_s: float = 0.4
    """A notch stays at least so long."""
    early_s: float = 0.5
    """By so much the brake state is entered early: half of the build-up at the jerk limit."""
    coast_s: float = 0.6
    """Planned without traction and brake before a braking."""
    resume_band_mps: float = 0.8
    """So much under the curve a braking is given up."""
    stop_tolerance_m: float = 0.09
    """The last notch is given up for a stronger one when it would stop farther beyond than this."""

    def __post_init__(self) -> None:
        for name in (
            "dead_time_s",
            "air_delay_s",
            "early_s",
            "coast_s",
            "quiet_growth_mps2",
            "rolling_mps2",
            "stop_tolerance_m",
        ):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is negative")
        for name in ("lag_s", "cruise_chase_s", "guard_mps2", "dwell_s", "last_speed_mps"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if self.dead_time_s + self.lag_s + self.air_delay_s > 4.0:
            raise ValueError("dead_time_s, lag_s and air_delay_s are more than 4 s together")
        if not (
            0.0
            < self.last_decel_mps2
            <= self.chase_decel_mps2
            <= self.small_decel_mps2
            <= self.decel_mps2
        ):
            raise ValueError(
                "not 0 < last_decel_mps2 <= chase_decel_mps2 <= small_decel_mps2 <= decel_mps2"
            )
        if not self.small_decel_min_mps2 <= self.small_decel_mps2 <= self.small_decel_max_mps2:
            raise ValueError("small_decel_mps2 is not within its bounds")
        if not self.last_speed_mps < self.blending_end_mps < self.blending_begin_mps:
            raise ValueError("not last_speed_mps < blending_end_mps < blending_begin_mps")
        if not 0.0 < self.chase_ratio <= 1.0:
            raise ValueError(f"chase_ratio {self.chase_ratio} is not in 0..1")
        if not 0.0 <= self.quiet_band_mps <= self.keep_band_mps <= self.resume_band_mps:
            raise ValueError("not 0 <= quiet_band_mps <= keep_band_mps <= resume_band_mps")
