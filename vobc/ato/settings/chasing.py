"""Settings of the control by chasing time."""

from dataclasses import dataclass

KMH_PER_MPS = 3.6


@dataclass(frozen=True, slots=True)
class ChasingScheme:
    """[Wu 2022] gives only the blending band. The other values are chosen here."""

    early_transition: bool = True
    """Start braking before the curve, so that the brake has built up where the curve begins."""
    small_brake: bool = True
    """Hold one small notch through electro-pneumatic blending. If off, one curve leads to the stop.
    """
    dead_time_s: float = 0.75
    """Time from the decision to the first brake effort, until an application has shown its own."""
    lag_s: float = 0.35
    """Time constant of the brake's build-up after that. The law predicts over both together."""
    air_delay_s: float = 0.0
    """Additional delay below blending, where friction alone brakes and answers later than the
    motors."""
    decel_mps2: float = 0.6
    """Deceleration of the curve to a stop, down to the small notch."""
    small_decel_mps2: float = 0.2
    """Deceleration of the small notch through blending."""
    small_decel_min_mps2: float = 0.1
    small_decel_max_mps2: float = 0.35
    """Bounds of the small notch, which depends on the remaining distance."""
    chase_decel_mps2: float = 0.15
    """Deceleration from the end of blending to the last notch."""
    last_decel_mps2: float = 0.05
    """Deceleration of the last notch on level track. It exceeds the effect of downhill gradients.
    """
    blending_begin_mps: float = 8.0 / KMH_PER_MPS
    blending_end_mps: float = 4.0 / KMH_PER_MPS
    blending_reserve_m: float = 0.0
    """Distance kept after blending to make up for late friction while the motors fade. Without the
    small notch the one curve keeps it."""
    blending_spread_ratio: float = 0.1
    """Share by which blending may begin at a higher speed."""
    last_speed_mps: float = 0.17
    """Speed from which the last notch stays applied."""
    rolling_mps2: float = 0.018
    """Running resistance at low speed, which every notch adds to its braking."""
    chase_ratio: float = 0.27
    """Share of the time to the target within which the train should reach the curve."""
    cruise_chase_s: float = 6.0
    """Time within which the train should reach a constant speed."""
    keep_band_mps: float = 0.5
    """Speed error below which a notch that closes the gap in time is kept."""
    cruise_band_mps: float = 0.25
    """Speed error within which a constant speed is kept."""
    quiet_band_mps: float = 0.15
    """Speed error below which the law keeps its notch."""
    quiet_growth_mps2: float = 0.05
    """Growth of that band before a stop, for each second that is left to close the gap."""
    guard_mps2: float = 0.01
    """Least difference between a notch and the deceleration of the curve. A closer notch never
    reaches the curve."""
    dwell_s: float = 0.4
    """Shortest time between two changes of notch."""
    early_s: float = 0.5
    """Lead of the brake state: half of the build-up at the jerk limit."""
    coast_s: float = 0.6
    """Planned coasting time before braking."""
    resume_band_mps: float = 0.8
    """Distance in speed below the curve at which a braking is abandoned."""
    stop_tolerance_m: float = 0.09
    """Predicted overrun of the stopping point above which a stronger notch replaces the last one.
    """

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
