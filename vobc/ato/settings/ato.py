"""Tuning of the automatic operation: its belief of train and brake, how it drives and stops."""

from dataclasses import dataclass, field
from typing import Final

from vobc.ato.settings.chasing import ChasingScheme
from vobc.ato.settings.green import Green
from vobc.ato.settings.output import OutputStage
from vobc.ato.settings.pid import PidGains, PidScheme, PrintedScheme
from vobc.ato.settings.power_limited import PowerLimited
from vobc.ato.settings.timing import Timing

MAX_DEAD_TIMES: Final = 20
"""Bound on the hypotheses of brake delay, which keeps the cost of a cycle bounded."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What passengers are promised (Allotta et al. 2013, table 1), emergency braking apart."""

    accel_mps2: float = 0.8
    jerk_mps3: float = 0.6

    def __post_init__(self) -> None:
        _positive(accel_mps2=self.accel_mps2, jerk_mps3=self.jerk_mps3)


@dataclass(frozen=True, slots=True)
class BrakeBelief:
    dead_times_s: tuple[float, ...] = (
        *(0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75),
        *(0.85, 0.95, 1.05, 1.15, 1.25, 1.35, 1.45, 1.55, 1.7, 1.85),
    )
    """Hypotheses, rising, from the demand leaving this cycle to the first bite; the last are for a
    late brake that also builds up slowly."""
    expected_dead_time_s: float = 1.1
    """Until an application has shown its own. Too long a guess only starts the braking early; too
    short a one has to be made up for by a brake that may be weak."""
    lag_s: float = 0.35
    """Of the first-order build-up after the dead time; an error in it is found as dead time. A
    brake that bites sooner than this is taken to build up as quickly."""
    speed_sigma_mps: float = 0.03
    """Spread of speed innovations on the true hypothesis, couplers included."""
    speed_filter_rad_s: float = 8.0
    """Bandwidth of the filter that odometry takes the speed by; behind a braking that grows or
    eases off it lags, which is reckoned with."""
    fade_begin_mps: float = 8.0 / 3.6
    """Under this speed the motors can do less and less of the braking."""
    fade_end_mps: float = 3.0 / 3.6
    """Under this they do nothing of it."""
    motors_mps2: float = 1.2
    """What they can do before they begin to fade."""
    air_delays_s: tuple[float, ...] = (0.0,)
    """Hypotheses, rising from none, of how much later than the motors friction answers. With more
    than one the first stops are planned as if it might be late, which costs some seconds."""
    air_lag_s: float = 0.2
    """Of the build-up of friction that is late."""

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
    """What the full rated effort gives the loaded train on the level."""
    jerk_mps3: float = 0.52
    """Of the reference: faster, and the couplers make more of it than was asked for."""
    smoothing_s: float = 1.4
    """Moving average over the reference acceleration; its first null is a coupler mode."""

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
    """Davis formula a + b * v + c * v**2 in N for each kN of weight (Allotta et al. 2013)."""

    a_n_per_kn: float = 2.0
    b_n_per_kn_per_mps: float = 0.04
    c_n_per_kn_per_mps2: float = 0.008

    def __post_init__(self) -> None:
        if min(self.a_n_per_kn, self.b_n_per_kn_per_mps, self.c_n_per_kn_per_mps2) < 0.0:
            raise ValueError("a coefficient of the running resistance is negative")

    def n_per_kn(self, speed_mps: float) -> float:
        """At a speed of zero or more."""
        return self.a_n_per_kn + speed_mps * (
            self.b_n_per_kn_per_mps + speed_mps * self.c_n_per_kn_per_mps2
        )


@dataclass(frozen=True, slots=True)
class Braking:
    """Shape of a braking: steady at speed, a low plateau at the end, a small last step."""

    decel_mps2: float = 0.76
    onset_jerk_mps3: float = 0.45
    """Of the brake coming on: faster, and the couplers make more of it than was asked for."""
    ease_jerk_mps3: float = 0.4
    plateau_decel_mps2: float = 0.5
    plateau_speed_mps: float = 1.35
    final_decel_mps2: float = 0.065
    least_decel_mps2: float = 0.03
    """The brake stays on with at least this from the start of braking to the stop: ending the
    application would let the next one draw another delay."""
    correction_ratio: float = 2.6
    """2 aims at the mark with a steady brake; more removes errors earlier than at the mark."""
    late_plateau_decel_mps2: float = 0.15
    late_plateau_speed_mps: float = 1.3
    late_final_decel_mps2: float = 0.05
    """The same three for a train whose friction may be late: at the handover from the motors a
    part of the braking will be missing, and what is corrected after it comes late."""
    weak_ratio: float = -0.16
    """Before a brake's gain was ever seen, braking is planned for one that much weaker."""
    reserve_mps2: float = 0.02
    """Kept between the planned demand on the worst gradient and the limit, for corrections."""

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
    """How the train is driven for a while after its wheels slipped or slid."""

    from_start: bool = False
    """The rail is known to be slippery before any wheel has shown it."""
    decel_mps2: float = 0.45
    """Braking is planned no harder: an adhesion of 0.06 bears 0.54 m/s² on all wheels."""
    accel_mps2: float = 0.25
    """On the wheels of the motor cars it bears 0.29 m/s²."""
    memory_s: float = 900.0
    """From the last slip on."""

    def __post_init__(self) -> None:
        _positive(decel_mps2=self.decel_mps2, accel_mps2=self.accel_mps2, memory_s=self.memory_s)


@dataclass(frozen=True, slots=True)
class AuthorityStop:
    """A stop before the end of authority keeps under the curve of protection.

    That curve allows v / (v + 3.5 s) of deceleration in m/s² to a train that follows it, much less
    than a stop at a platform needs where the authority reaches beyond.
    """

    margin_m: float = 2.2
    """From the foremost front that the standing train may have to the end of authority. Protection
    brakes a train that might creep there still: what it reckons with takes 0.6 m for a runaway
    and the build-up of the brake, and more for the least speed that odometry can tell from none."""
    final_decel_mps2: float = 0.04
    creep_ease_mps3: float = 0.014
    knee_decel_mps2: float = 0.3
    ease_mps3: float = 0.03
    decel_mps2: float = 0.76
    leader_decel_mps2: float = 0.8
    """A train ahead is braked no harder in service: so much way it still makes at least when the
    end of authority moves away with it."""
    leader_jerk_mps3: float = 0.6
    """With which it goes over to that brake, from what it does now."""
    closer_s: float = 3.4
    """Of that way, no more is reckoned with than the train itself makes in this time. At 60 km/h it
    would brake 248 m before an end that stands; protection permits that speed up to 199 m before.
    """

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
    """PIDs on the predicted speed error, one for each direction of the reference."""

    rising: PidGains = field(default_factory=lambda: PidGains(0.6, 0.06, 0.0))
    constant: PidGains = field(default_factory=lambda: PidGains(0.4, 0.04, 0.0))
    falling: PidGains = field(default_factory=lambda: PidGains(0.3859, 0.0277, 0.0097))
    margin_mps: float = 0.5
    """Kept under the ceiling and the civil limits: room for odometry's uncertainty."""
    coast_band_mps2: float = 0.05
    """While cruising, a smaller brake demand is coasted instead: each application costs a delay."""

    def __post_init__(self) -> None:
        if self.margin_mps < 0.0 or self.coast_band_mps2 < 0.0:
            raise ValueError("margin_mps or coast_band_mps2 is negative")


@dataclass(frozen=True, slots=True)
class StationWork:
    window_m: float = 0.3
    """Distance to the stopping point within which the stop counts as made."""
    stopping_zone_m: float = 50.0
    """From here on the three-tag stop is spoken of; the distance of T1."""
    jog_reach_m: float = 5.0
    jog_attempts: int = 3
    least_run_m: float = 5.0
    """Between stations the train sets off only when the authority lets it go at least so far."""
    hold_speed_mps: float = 0.01
    """The holding brake comes on under this: slow enough for its grip not to be felt."""
    release_s: float = 2.0
    """The service brake has to be off so long before departure, or traction pulls against it."""
    hold_lead_s: float = 0.15
    """On a rising gradient it comes on so much earlier, which keeps the train from rolling back."""
    settle_s: float = 0.5
    """The holding brake has to be on so long before the train counts as at rest."""
    hold_decel_mps2: float = 0.4
    """Service brake asked at standstill until the holding brake is confirmed."""
    doors_patience_s: float = 10.0
    """The dwell begins at the latest so long after the doors were asked to open."""

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
    """A name from `vobc.ato.laws.STRATEGIES`."""
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

    def __post_init__(self) -> None:
        _positive(train_length_m=self.train_length_m)
        if not 0.0 <= self.rotating_mass_percent <= 50.0:
            raise ValueError(f"rotating_mass_percent {self.rotating_mass_percent} is not in 0..50")
        if self.braking.decel_mps2 > self.limits.accel_mps2:
            raise ValueError("braking.decel_mps2 is over limits.accel_mps2")


def _positive(**values: float) -> None:
    for name, value in values.items():
        if value <= 0.0:
            raise ValueError(f"{name} {value} is not positive")
