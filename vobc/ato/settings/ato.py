"""Settings of the automatic operation: assumed properties of train and brake, driving and
stopping.
"""

from dataclasses import dataclass, field, replace
from typing import Final

from vobc.ato.settings.chasing import ChasingScheme
from vobc.ato.settings.green import Green
from vobc.ato.settings.output import OutputStage
from vobc.ato.settings.pid import PidGains, PidScheme, PrintedScheme
from vobc.ato.settings.power_limited import PowerLimited
from vobc.ato.settings.timing import Timing

MAX_DEAD_TIMES: Final = 24
"""Greatest number of brake-delay hypotheses. It bounds the computing time of a cycle."""
LEAST_GAIN_PER_S: Final = 0.1
"""Least gain of a PID that follows a falling speed at all."""
WEAK_RATIO: Final = -0.16
"""Default of `Braking.weak_ratio`: two standard deviations of the gains of usual brakes."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Comfort limits for passengers ([Allotta 2013], table 1), except in emergency braking."""

    accel_mps2: float = 0.8
    jerk_mps3: float = 0.6
    brake_demand_max_mps2: float = 1.0
    """Greatest brake demand on falling track, where the train decelerates by less than it. The
    controller also keeps it within `train.service_decel_max_mps2`."""

    def __post_init__(self) -> None:
        _positive(
            accel_mps2=self.accel_mps2,
            jerk_mps3=self.jerk_mps3,
            brake_demand_max_mps2=self.brake_demand_max_mps2,
        )

    def brake_most_mps2(self, lost_mps2: float) -> float:
        """Greatest brake demand where gravity and a weak brake take away this much of it.

        The train itself never decelerates by more than `accel_mps2`.
        """
        wanted_mps2 = self.accel_mps2 + max(0.0, lost_mps2)
        return max(self.accel_mps2, min(self.brake_demand_max_mps2, wanted_mps2))


@dataclass(frozen=True, slots=True)
class BrakeBelief:
    dead_times_s: tuple[float, ...] = (
        *(0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75),
        *(0.85, 0.95, 1.05, 1.15, 1.25, 1.35, 1.45, 1.55, 1.7, 1.85),
        *(2.1, 2.4, 2.7, 3.0),
    )
    """Hypotheses, in rising order, of the time from sending a demand to the first brake effort. The
    last ones stand for a late brake that also builds up slowly."""
    expected_dead_time_s: float = 1.1
    """Least dead time with which ATO plans a brake application before it has measured the real one.
    A value that is too long only starts the braking early. One that is too short needs more brake
    later, which a weak brake may not give."""
    first_dead_time_s: float = 1.85
    """Dead time with which ATO plans its first brake application. It plans later ones with the
    longest dead time that it has measured, and with `expected_dead_time_s` at least."""
    lag_s: float = 0.35
    """Time constant of the build-up after the dead time. An error in it is identified as dead time.
    A brake that acts sooner than this is assumed to build up as quickly."""
    speed_sigma_mps: float = 0.03
    """Standard deviation of the speed innovation under the true hypothesis, including coupler
    oscillation."""
    speed_filter_rad_s: float = 8.0
    """Bandwidth of odometry's speed filter. Its lag while the brake builds up or releases is taken
    into account."""
    fade_begin_mps: float = 8.0 / 3.6
    """Speed below which the electric brake fades."""
    fade_end_mps: float = 3.0 / 3.6
    """Speed below which the electric brake gives nothing."""
    motors_mps2: float = 1.2
    """Deceleration of the electric brake before it fades."""
    air_delays_s: tuple[float, ...] = (0.0,)
    """Hypotheses, rising from 0, of the delay of friction behind the motors. With more than one,
    the first stops are planned for late friction, which costs some seconds."""
    air_lag_s: float = 0.2
    """Time constant of the build-up of late friction."""

    def __post_init__(self) -> None:
        _positive(
            lag_s=self.lag_s,
            speed_sigma_mps=self.speed_sigma_mps,
            speed_filter_rad_s=self.speed_filter_rad_s,
            air_lag_s=self.air_lag_s,
        )
        if not 1 <= len(self.dead_times_s) <= MAX_DEAD_TIMES:
            raise ValueError(f"dead_times_s has not 1..{MAX_DEAD_TIMES} entries")
        if list(self.dead_times_s) != sorted(set(self.dead_times_s)):
            raise ValueError(f"dead_times_s {list(self.dead_times_s)} do not rise")
        if self.dead_times_s[0] < 0.0 or self.dead_times_s[-1] > 3.0:
            raise ValueError("dead_times_s are not within 0..3 s")
        if not self.dead_times_s[0] <= self.expected_dead_time_s <= self.dead_times_s[-1]:
            raise ValueError("expected_dead_time_s is not within dead_times_s")
        if not 0.0 <= self.first_dead_time_s <= 3.0:
            raise ValueError(f"first_dead_time_s {self.first_dead_time_s} is not within 0..3 s")
        if not 0.0 <= self.fade_end_mps < self.fade_begin_mps:
            raise ValueError("not 0 <= fade_end_mps < fade_begin_mps")
        if not 1 <= len(self.air_delays_s) <= MAX_DEAD_TIMES:
            raise ValueError(f"air_delays_s has not 1..{MAX_DEAD_TIMES} entries")
        if self.air_delays_s[0] != 0.0 or self.air_delays_s[-1] > 3.0:
            raise ValueError("air_delays_s do not begin with 0 or are not within 0..3 s")
        if list(self.air_delays_s) != sorted(set(self.air_delays_s)):
            raise ValueError(f"air_delays_s {list(self.air_delays_s)} do not rise")


@dataclass(frozen=True, slots=True)
class TractionBelief:
    dead_time_s: float = 0.12
    lag_s: float = 0.3
    rated_accel_mps2: float = 1.0
    """Acceleration of the loaded train on level track at full rated effort."""
    jerk_mps3: float = 0.52
    """Jerk of the reference. A higher jerk excites the couplers beyond the demand."""
    smoothing_s: float = 1.4
    """Window of the moving average over the reference acceleration. Its first null is at a coupler
    mode."""

    def __post_init__(self) -> None:
        _positive(
            lag_s=self.lag_s, rated_accel_mps2=self.rated_accel_mps2, jerk_mps3=self.jerk_mps3
        )
        if self.dead_time_s < 0.0 or self.dead_time_s > 3.0:
            raise ValueError(f"dead_time_s {self.dead_time_s} is not within 0..3 s")
        if self.smoothing_s < 0.0:
            raise ValueError(f"smoothing_s {self.smoothing_s} is negative")


@dataclass(frozen=True, slots=True)
class RunningResistance:
    """Davis formula a + b * v + c * v**2 in N per kN of weight ([Allotta 2013])."""

    a_n_per_kn: float = 2.0
    b_n_per_kn_per_mps: float = 0.04
    c_n_per_kn_per_mps2: float = 0.008

    def __post_init__(self) -> None:
        if min(self.a_n_per_kn, self.b_n_per_kn_per_mps, self.c_n_per_kn_per_mps2) < 0.0:
            raise ValueError("a coefficient of the running resistance is negative")

    def n_per_kn(self, speed_mps: float, air_ratio: float = 1.0) -> float:
        """Resistance at a speed of zero or more, with air drag divided by that in the open."""
        return self.a_n_per_kn + speed_mps * (
            self.b_n_per_kn_per_mps + speed_mps * (self.c_n_per_kn_per_mps2 * air_ratio)
        )


@dataclass(frozen=True, slots=True)
class Braking:
    """Shape of a braking: constant deceleration, a low plateau at the end, and a small last
    step.
    """

    decel_mps2: float = 0.76
    onset_jerk_mps3: float = 0.45
    """Jerk at the start of braking. A higher jerk excites the couplers beyond the demand."""
    ease_jerk_mps3: float = 0.4
    plateau_decel_mps2: float = 0.5
    plateau_speed_mps: float = 1.35
    final_decel_mps2: float = 0.065
    least_decel_mps2: float = 0.03
    """Least demand from the start of braking to the stop. If the brake were released, the next
    application would have another random delay."""
    correction_ratio: float = 2.6
    """Gain of the correction towards the stopping point. With 2 a constant brake meets it exactly;
    more removes errors earlier."""
    late_plateau_decel_mps2: float = 0.15
    late_plateau_speed_mps: float = 1.3
    late_final_decel_mps2: float = 0.05
    """The same three values for a train with late friction. At the handover from the motors a part
    of the braking is missing, and its correction comes late."""
    weak_ratio: float = WEAK_RATIO
    """Assumed deviation of the brake gain before the gain has been measured. `predictive` takes it
    as two standard deviations."""
    reserve_mps2: float = 0.02
    """Reserve for corrections between the planned demand on the worst gradient and the limit."""

    def __post_init__(self) -> None:
        _positive(
            decel_mps2=self.decel_mps2,
            onset_jerk_mps3=self.onset_jerk_mps3,
            ease_jerk_mps3=self.ease_jerk_mps3,
            plateau_speed_mps=self.plateau_speed_mps,
            final_decel_mps2=self.final_decel_mps2,
            least_decel_mps2=self.least_decel_mps2,
            correction_ratio=self.correction_ratio,
        )
        if not self.final_decel_mps2 <= self.plateau_decel_mps2 <= self.decel_mps2:
            raise ValueError("not final_decel_mps2 <= plateau_decel_mps2 <= decel_mps2")
        _positive(
            late_plateau_speed_mps=self.late_plateau_speed_mps,
            late_final_decel_mps2=self.late_final_decel_mps2,
        )
        if not self.late_final_decel_mps2 <= self.late_plateau_decel_mps2 <= self.decel_mps2:
            raise ValueError("not late_final_decel_mps2 <= late_plateau_decel_mps2 <= decel_mps2")
        if not -0.5 <= self.weak_ratio <= 0.0:
            raise ValueError(f"weak_ratio {self.weak_ratio} is not within -0.5..0")


@dataclass(frozen=True, slots=True)
class SlipperyRail:
    """Driving for a time after the wheels slipped or slid."""

    from_start: bool = False
    """The rail counts as slippery from the start, before any slip."""
    decel_mps2: float = 0.45
    """Greatest planned deceleration. An adhesion of 0.06 supports 0.54 m/s² on all wheels."""
    accel_mps2: float = 0.25
    """Greatest acceleration. The same adhesion supports 0.29 m/s² on the wheels of the motor cars.
    """
    memory_s: float = 900.0
    """How long the rail counts as slippery after the last slip."""

    def __post_init__(self) -> None:
        _positive(decel_mps2=self.decel_mps2, accel_mps2=self.accel_mps2, memory_s=self.memory_s)


@dataclass(frozen=True, slots=True)
class AuthorityStop:
    """A stop before the end of authority that stays below protection's curve.

    That curve permits a train that follows it a deceleration of v / (v + 3.5 s) in m/s². This is
    much less than a platform stop uses where the authority extends beyond.
    """

    margin_m: float = 2.2
    """Distance from the foremost front of the standing train to the end of authority. Otherwise
    protection would brake a train that may still creep. Its assumptions take 0.6 m for runaway and
    brake build-up, and more for the least speed that odometry can distinguish from 0. A control
    cycle over 50 ms adds 0.11 m for each 10 ms."""
    final_decel_mps2: float = 0.04
    creep_ease_mps3: float = 0.014
    knee_decel_mps2: float = 0.3
    ease_mps3: float = 0.03
    decel_mps2: float = 0.76
    leader_decel_mps2: float = 0.8
    """Assumed service braking of a train ahead. It determines the distance that the end of
    authority still moves away."""
    leader_jerk_mps3: float = 0.6
    """Jerk with which the train ahead changes to that brake from its present acceleration."""
    closer_s: float = 3.4
    """Limit of that distance, as time at the train's own speed. At 60 km/h the train would brake
    248 m before a fixed end; protection permits that speed up to 199 m before."""

    def __post_init__(self) -> None:
        _positive(
            final_decel_mps2=self.final_decel_mps2,
            creep_ease_mps3=self.creep_ease_mps3,
            ease_mps3=self.ease_mps3,
            decel_mps2=self.decel_mps2,
            leader_decel_mps2=self.leader_decel_mps2,
            leader_jerk_mps3=self.leader_jerk_mps3,
        )
        for name in ("margin_m", "closer_s"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is negative")
        if self.knee_decel_mps2 < self.final_decel_mps2:
            raise ValueError("knee_decel_mps2 is under final_decel_mps2")


@dataclass(frozen=True, slots=True)
class SpeedControl:
    """PID control of the predicted speed error, one set of gains for each direction of the
    reference.
    """

    rising: PidGains = field(default_factory=lambda: PidGains(0.6, 0.06, 0.0))
    constant: PidGains = field(default_factory=lambda: PidGains(0.4, 0.04, 0.0))
    falling: PidGains = field(default_factory=lambda: PidGains(0.3859, 0.0277, 0.0097))
    margin_mps: float = 0.5
    """Distance of the reference below ceiling and civil limits, for the uncertainty of odometry."""
    coast_band_mps2: float = 0.05
    """Brake demand below which a cruising train coasts instead, because each application costs a
    delay."""

    def __post_init__(self) -> None:
        if self.margin_mps < 0.0 or self.coast_band_mps2 < 0.0:
            raise ValueError("margin_mps or coast_band_mps2 is negative")


@dataclass(frozen=True, slots=True)
class StationWork:
    window_m: float = 0.3
    """Distance to the stopping point within which the stop counts as made."""
    stopping_zone_m: float = 50.0
    """Distance from which the phase counts as the three-tag stop: the distance of T1."""
    jog_reach_m: float = 5.0
    jog_attempts: int = 3
    least_run_m: float = 5.0
    """Least distance that the authority must permit before the train departs between stations."""
    hold_speed_mps: float = 0.01
    """Speed below which the holding brake is applied. It is too low for passengers to feel."""
    release_s: float = 2.0
    """Time for which the service brake must be released before departure, so that traction does not
    pull against it."""
    hold_lead_s: float = 0.15
    """Lead of the holding brake on an uphill gradient. It keeps the train from rolling back."""
    settle_s: float = 0.5
    """Time for which the holding brake must be applied before the train counts as at rest."""
    hold_decel_mps2: float = 0.4
    """Service brake demand at standstill until the holding brake is confirmed."""
    doors_patience_s: float = 10.0
    """Greatest delay between the request to open the doors and the start of the dwell time."""

    def __post_init__(self) -> None:
        _positive(
            window_m=self.window_m,
            stopping_zone_m=self.stopping_zone_m,
            least_run_m=self.least_run_m,
            hold_speed_mps=self.hold_speed_mps,
            hold_decel_mps2=self.hold_decel_mps2,
        )
        if self.jog_attempts < 0 or self.jog_reach_m < 0.0:
            raise ValueError("jog_attempts or jog_reach_m is negative")


@dataclass(frozen=True, slots=True)
class AtoConfig:
    strategy: str = "predictive"
    """Name of a control law in `vobc.ato.laws.STRATEGIES`."""
    train_length_m: float = 68.59
    rotating_mass_percent: float = 8.0
    limits: Limits = field(default_factory=Limits)
    brake: BrakeBelief = field(default_factory=BrakeBelief)
    traction: TractionBelief = field(default_factory=TractionBelief)
    resistance: RunningResistance = field(default_factory=RunningResistance)
    braking: Braking = field(default_factory=Braking)
    slippery: SlipperyRail = field(default_factory=SlipperyRail)
    authority: AuthorityStop = field(default_factory=AuthorityStop)
    speed: SpeedControl = field(default_factory=SpeedControl)
    station: StationWork = field(default_factory=StationWork)
    pid: PidScheme = field(default_factory=PidScheme)
    pid_literal: PrintedScheme = field(default_factory=PrintedScheme)
    timing: Timing = field(default_factory=Timing)
    green: Green = field(default_factory=Green)
    power_limited: PowerLimited = field(default_factory=PowerLimited)
    chasing: ChasingScheme = field(default_factory=ChasingScheme)
    output: OutputStage = field(default_factory=OutputStage)

    @property
    def brake_acts_s(self) -> float:
        """Time within which the train follows a speed that begins to fall, also the first time.

        The printed PIDs without feed-forward follow it later by the inverse of their gain.
        """
        brake, printed = self.brake, self.pid_literal
        acts_s = brake.first_dead_time_s + brake.lag_s + self.traction.smoothing_s
        if self.strategy == "pid_literal" and not printed.feed_forward:
            acts_s += 1.0 / max(LEAST_GAIN_PER_S, printed.falling.kp_per_s)
        return acts_s

    def __post_init__(self) -> None:
        _positive(train_length_m=self.train_length_m)
        if not 0.0 <= self.rotating_mass_percent <= 50.0:
            raise ValueError(f"rotating_mass_percent {self.rotating_mass_percent} is not in 0..50")
        if self.braking.decel_mps2 > self.limits.accel_mps2:
            raise ValueError("braking.decel_mps2 is over limits.accel_mps2")


def within_notches(config: AtoConfig) -> AtoConfig:
    """Settings whose greatest brake demand is the strongest notch."""
    limits, top_mps2 = config.limits, config.output.brake_levels_mps2[-1]
    most_mps2 = min(limits.brake_demand_max_mps2, top_mps2)
    return replace(config, limits=replace(limits, brake_demand_max_mps2=most_mps2))


def _positive(**values: float) -> None:
    for name, value in values.items():
        if value <= 0.0:
            raise ValueError(f"{name} {value} is not positive")
