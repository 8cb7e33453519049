"""Settings of both PID laws: gains as printed and as tuned, the sections before a stop."""

import math
from dataclasses import dataclass
from typing import Final

CREEP_LIMIT_MPS2: Final = 0.6
"""No section between tags needs to brake harder; faster sections than that are a mistake."""


@dataclass(frozen=True, slots=True)
class PidGains:
    """From a speed error to an acceleration; a position error takes one more power of a second."""

    kp_per_s: float
    ki_per_s2: float
    kd_ratio: float

    def __post_init__(self) -> None:
        if min(self.kp_per_s, self.ki_per_s2, self.kd_ratio) < 0.0:
            raise ValueError("a PID gain is negative")


@dataclass(frozen=True, slots=True)
class PidScheme:
    """Law `pid`: four PIDs on the state predicted past dead time and lag, with feed-forward.

    Sections and choice of gains are those of Allotta et al. 2013, section II. The speeds at the
    tags make each section's deceleration: (v1² - v2²) / (2 * (d1 - d2)).
    """

    rising: PidGains = PidGains(0.6, 0.06, 0.0)
    """Reference rising; after the delay of traction only."""
    falling: PidGains = PidGains(0.3859, 0.0277, 0.0097)
    """Reference falling, down to T2; as printed."""
    constant: PidGains = PidGains(0.4, 0.04, 0.0)
    """Reference constant, and between T2 and T3."""
    position: PidGains = PidGains(0.2, 0.03, 1.8)
    """From T3 to the stop."""
    identify_delay: bool = True
    """Take the dead time of the brake from how the present application answers; otherwise it is
    believed to be `brake.expected_dead_time_s` always."""
    t1_m: float = 50.0
    """Before the stop; front of the train when the antenna meets the tag."""
    t2_m: float = 10.0
    t3_m: float = 1.5
    t1_speed_mps: float = 15.0 / 3.6
    t2_speed_mps: float = 1.3
    t3_speed_mps: float = 0.7
    """Much slower, and the place grows so uncertain before the stop that doors stay shut."""
    last_decel_mps2: float = 0.08
    """Of the deceleration, which falls from T3 to the stop; what the stop feels like."""
    decel_mps2: float = 0.6
    """Down to the speed at T1."""
    rise_jerk_mps3: float = 0.4
    """Of a rising reference. The couplers swing less than at the limit."""
    ease_jerk_mps3: float = 0.3
    """With which one section's deceleration goes over to the next one's."""
    least_decel_mps2: float = 0.03
    """Asked of the brake at least, from the start of braking to the stop: a new application would
    draw a new delay."""

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
        """Between T1 and T2."""
        return (self.t1_speed_mps**2 - self.t2_speed_mps**2) / (2.0 * (self.t1_m - self.t2_m))

    @property
    def creep_decel_mps2(self) -> float:
        """Between T2 and T3; the paper's is 0."""
        return (self.t2_speed_mps**2 - self.t3_speed_mps**2) / (2.0 * (self.t2_m - self.t3_m))

    @property
    def t3_decel_mps2(self) -> float:
        """At T3, from where it falls."""
        speed_mps = self.t3_speed_mps
        return falling_decel(speed_mps, self.t3_m, self.last_decel_mps2)[0]


def falling_decel(speed_mps: float, way_m: float, last_mps2: float) -> tuple[float, float]:
    """Deceleration at first, and time to the stop, so that it falls steadily to `last_mps2` there.

    v = (b0 + b1) T / 2 and d = v T / 3 + b1 T² / 6. A train too slow for that brakes steadily.
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
    """Law `pid_literal`: Allotta et al. 2013, tables 5 and 6, and the speeds of section II."""

    rising: PidGains = PidGains(5.4781, 0.0097, 0.0079)
    falling: PidGains = PidGains(0.3859, 0.0277, 0.0097)
    constant: PidGains = PidGains(0.6832, 0.2242, 0.2401)
    position: PidGains = PidGains(0.7926, 0.2764, 0.7683)
    feed_forward: bool = False
    """Add the reference acceleration to the output of the PIDs; the paper does not mention one."""
    t1_m: float = 50.0
    t2_m: float = 10.0
    t3_m: float = 1.5
    t1_speed_mps: float = 15.0 / 3.6
    creep_speed_mps: float = 0.67
    """Constant between T2 and T3."""
    decel_mps2: float = 0.6
    """Down to the speed at T1."""

    def __post_init__(self) -> None:
        _check_sections(self.t3_m, self.t2_m, self.t1_m)
        if not 0.0 < self.creep_speed_mps < self.t1_speed_mps:
            raise ValueError("not 0 < creep_speed_mps < t1_speed_mps")
        if self.decel_mps2 <= 0.0:
            raise ValueError(f"decel_mps2 {self.decel_mps2} is not positive")


def _check_sections(t3_m: float, t2_m: float, t1_m: float) -> None:
    if not 0.0 < t3_m < t2_m < t1_m:
        raise ValueError("not 0 < t3_m < t2_m < t1_m")
