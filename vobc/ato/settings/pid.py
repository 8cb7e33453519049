"""Settings of both PID laws: printed and tuned gains, and the sections before a stop."""

import math
from dataclasses import dataclass
from typing import Final

CREEP_LIMIT_MPS2: Final = 0.6
"""Greatest deceleration that any section between tags needs. Higher section speeds are a mistake.
"""


@dataclass(frozen=True, slots=True)
class PidGains:
    """Gains from a speed error to an acceleration. For a position error each unit has one
    more 1/s.
    """

    kp_per_s: float
    ki_per_s2: float
    kd_ratio: float

    def __post_init__(self) -> None:
        if min(self.kp_per_s, self.ki_per_s2, self.kd_ratio) < 0.0:
            raise ValueError("a PID gain is negative")


@dataclass(frozen=True, slots=True)
class PidScheme:
    """Law `pid`: four PIDs on the state predicted past dead time and lag, with feed-forward.

    Sections and choice of gains are those of [Allotta 2013], section II. The speeds at the tags
    determine the deceleration of each section: (v1² - v2²) / (2 * (d1 - d2)).
    """

    rising: PidGains = PidGains(0.6, 0.06, 0.0)
    """Gains for a rising reference, predicted past the delay of traction only."""
    falling: PidGains = PidGains(0.3859, 0.0277, 0.0097)
    """Gains for a falling reference down to T2, as printed."""
    constant: PidGains = PidGains(0.4, 0.04, 0.0)
    """Gains for a constant reference, and between T2 and T3."""
    position: PidGains = PidGains(0.2, 0.03, 1.8)
    """Gains of the position loop from T3 to the stop."""
    identify_delay: bool = True
    """Identify the dead time of the brake in each application. If off, `brake.expected_dead_time_s`
    is used."""
    t1_m: float = 50.0
    """Distance of tag T1 before the stop: place of the front when the antenna reaches the tag."""
    t2_m: float = 10.0
    t3_m: float = 1.5
    t1_speed_mps: float = 15.0 / 3.6
    t2_speed_mps: float = 1.3
    t3_speed_mps: float = 0.7
    """Speed at T3. At a much lower speed the position becomes so uncertain before the stop that
    doors stay closed."""
    last_decel_mps2: float = 0.08
    """Final deceleration at the stop, which passengers feel. The deceleration falls to it from T3.
    """
    decel_mps2: float = 0.6
    """Deceleration down to the speed at T1."""
    rise_jerk_mps3: float = 0.4
    """Jerk of a rising reference. It is below the limit to reduce coupler oscillation."""
    ease_jerk_mps3: float = 0.3
    """Jerk of the change between the decelerations of two sections."""
    least_decel_mps2: float = 0.03
    """Least brake demand from the start of braking to the stop. A new application would have a new
    random delay."""

    def __post_init__(self) -> None:
        _check_sections(self.t3_m, self.t2_m, self.t1_m)
        if not 0.0 < self.t3_speed_mps < self.t2_speed_mps < self.t1_speed_mps:
            raise ValueError("not 0 < t3_speed_mps < t2_speed_mps < t1_speed_mps")
        least_mps2 = self.t3_speed_mps**2 / (2.0 * self.t3_m)
        if not 0.0 < self.last_decel_mps2 <= least_mps2:
            raise ValueError(
                f"last_decel_mps2 {self.last_decel_mps2} is not in 0..{least_mps2:.3g}"
            )
        sections = (self.section_decel_mps2, self.creep_decel_mps2, self.t3_decel_mps2)
        if max(sections) > CREEP_LIMIT_MPS2:
            raise ValueError(f"speeds at the tags ask for more than {CREEP_LIMIT_MPS2} m/s²")
        for name in ("decel_mps2", "rise_jerk_mps3", "ease_jerk_mps3", "least_decel_mps2"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")

    @property
    def section_decel_mps2(self) -> float:
        """Deceleration between T1 and T2."""
        return (self.t1_speed_mps**2 - self.t2_speed_mps**2) / (2.0 * (self.t1_m - self.t2_m))

    @property
    def creep_decel_mps2(self) -> float:
        """Deceleration between T2 and T3. It is 0 in the paper."""
        return (self.t2_speed_mps**2 - self.t3_speed_mps**2) / (2.0 * (self.t2_m - self.t3_m))

    @property
    def t3_decel_mps2(self) -> float:
        """Deceleration at T3, from which it decreases."""
        speed_mps = self.t3_speed_mps
        return falling_decel(speed_mps, self.t3_m, self.last_decel_mps2)[0]


def falling_decel(speed_mps: float, way_m: float, last_mps2: float) -> tuple[float, float]:
    """Initial deceleration and time to the stop for a linear decrease to `last_mps2` at the stop.

    v = (b0 + b1) T / 2 and d = v T / 3 + b1 T² / 6. A train too slow for that brakes at a constant
    rate.
    """
    assert speed_mps > 0.0
    assert way_m > 0.0
    steady_mps2 = speed_mps * speed_mps / (2.0 * way_m)
    if steady_mps2 <= last_mps2:
        return steady_mps2, speed_mps / steady_mps2
    root_mps = math.sqrt(speed_mps * speed_mps + 6.0 * last_mps2 * way_m)
    stop_s = (root_mps - speed_mps) / last_mps2
    return 2.0 * speed_mps / stop_s - last_mps2, stop_s


@dataclass(frozen=True, slots=True)
class PrintedScheme:
    """Law `pid_literal`: [Allotta 2013], tables 5 and 6, and the speeds of section II."""

    rising: PidGains = PidGains(5.4781, 0.0097, 0.0079)
    falling: PidGains = PidGains(0.3859, 0.0277, 0.0097)
    constant: PidGains = PidGains(0.6832, 0.2242, 0.2401)
    position: PidGains = PidGains(0.7926, 0.2764, 0.7683)
    feed_forward: bool = False
    """Add the reference acceleration to the PID output. The paper does not mention it."""
    t1_m: float = 50.0
    t2_m: float = 10.0
    t3_m: float = 1.5
    t1_speed_mps: float = 15.0 / 3.6
    creep_speed_mps: float = 0.67
    """Constant speed between T2 and T3."""
    decel_mps2: float = 0.6
    """Deceleration down to the speed at T1."""

    def __post_init__(self) -> None:
        _check_sections(self.t3_m, self.t2_m, self.t1_m)
        if not 0.0 < self.creep_speed_mps < self.t1_speed_mps:
            raise ValueError("not 0 < creep_speed_mps < t1_speed_mps")
        if self.decel_mps2 <= 0.0:
            raise ValueError(f"decel_mps2 {self.decel_mps2} is not positive")


def _check_sections(t3_m: float, t2_m: float, t1_m: float) -> None:
    if not 0.0 < t3_m < t2_m < t1_m:
        raise ValueError("not 0 < t3_m < t2_m < t1_m")
