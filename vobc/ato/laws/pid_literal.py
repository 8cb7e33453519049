"""[Allotta 2013] as printed: PIDs on measured values, without a predictor.

With a brake that delays every change the position loop is unstable, and this law is kept to show
that. Phases, limits of the demand and station work are those of every other law.
"""

from typing import Final

from firmware_py.trackdb import LineMap
from vobc.ato.laws.law import Drive, Target
from vobc.ato.motion import profile
from vobc.ato.motion.pid import Pid
from vobc.ato.motion.rate_limiter import RateLimiter
from vobc.ato.settings.ato import AtoConfig
from vobc.ato.settings.pid import PidGains
from vobc.vocabulary import AtoInput

FLAT_MPS2: Final = 0.02


class PidLiteral:
    """Three sections before the stop: slow down from T1, creep from T2, then position control."""

    __slots__ = (
        "_accel_max_mps2",
        "_config",
        "_demand_mps2",
        "_dt_s",
        "_gains",
        "_governor",
        "_limits",
        "_pid",
        "_since_t3_s",
        "speed_mps",
    )

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        self._config = config
        self._dt_s = dt_s
        self._accel_max_mps2 = config.limits.accel_mps2
        self._limits = profile.SpeedLimits(config, line)
        self._governor = RateLimiter(config.limits.jerk_mps3, 0.0, dt_s)
        self._pid = Pid()
        self._gains: PidGains | None = None
        self._since_t3_s = 0.0
        self._demand_mps2 = 0.0
        self.speed_mps = 0.0

    def observe(self, inputs: AtoInput, cycles: int) -> None:
        self.speed_mps = inputs.speed_mps

    def rest(self) -> None:
        self.speed_mps = 0.0

    def set_off(self, inputs: AtoInput, demand_mps2: float) -> None:
        self._governor.restart(max(0.0, inputs.speed_mps), demand_mps2)
        self._pid.reset()
        self._gains = None
        self._since_t3_s = 0.0

    def issued(self, demand_mps2: float) -> None:
        self._demand_mps2 = demand_mps2

    def drive(self, inputs: AtoInput, target: Target) -> Drive:
        distance_m = target.at_m - inputs.front_m
        if distance_m <= self._config.pid_literal.t3_m:
            return self._follow_position(inputs, distance_m)
        stop_mps, stop_mps2 = self._stop_reference(distance_m)
        limit_mps, limit_mps2 = self._signal_reference(inputs)
        self._governor.step(
            limit_mps, rise_mps2=self._accel_max_mps2, fall_mps2=self._accel_max_mps2
        )
        reference_mps, reference_mps2 = self._governor.speed_mps, self._governor.accel_mps2
        if limit_mps2 < 0.0 and limit_mps <= reference_mps:
            reference_mps2 = limit_mps2
        braking = stop_mps < reference_mps
        if braking:
            reference_mps, reference_mps2 = stop_mps, stop_mps2
        gains = self._gains_for(reference_mps2, in_zone=distance_m <= self._config.pid_literal.t1_m)
        accel_mps2 = self._control(gains, reference_mps - inputs.speed_mps, reference_mps2)
        return Drive(accel_mps2, reference_mps, braking)

    def _stop_reference(self, distance_m: float) -> tuple[float, float]:
        """Speed and acceleration of the paper's reference at this distance before the stop."""
        scheme = self._config.pid_literal
        creep_mps, t1_mps = scheme.creep_speed_mps, scheme.t1_speed_mps
        if distance_m <= scheme.t2_m:
            return creep_mps, 0.0
        if distance_m <= scheme.t1_m:
            decel_mps2 = (t1_mps**2 - creep_mps**2) / (2.0 * (scheme.t1_m - scheme.t2_m))
            squared = creep_mps**2 + 2.0 * decel_mps2 * (distance_m - scheme.t2_m)
            return squared**0.5, -decel_mps2
        squared = t1_mps**2 + 2.0 * scheme.decel_mps2 * (distance_m - scheme.t1_m)
        return squared**0.5, -scheme.decel_mps2

    def _signal_reference(self, inputs: AtoInput) -> tuple[float, float]:
        """The lowest of ceiling, limits under the train and the next lower limit ahead."""
        margin_mps = self._config.speed.margin_mps
        limit_mps = (
            min(self._limits.under_train_mps(inputs.front_m), inputs.ceiling_mps) - margin_mps
        )
        lowering = self._limits.lowering(self._limits.next_lowering(inputs.front_m))
        if lowering is None:
            return max(0.0, limit_mps), 0.0
        curve = lowering.curve
        room_m = max(0.0, lowering.at_m - inputs.front_m)
        squared = curve.end_mps**2 + 2.0 * curve.steady_decel_mps2 * room_m
        if squared < limit_mps**2:
            return squared**0.5, -curve.steady_decel_mps2
        return max(0.0, limit_mps), 0.0

    def _gains_for(self, reference_mps2: float, *, in_zone: bool) -> PidGains:
        scheme = self._config.pid_literal
        if reference_mps2 < -FLAT_MPS2:
            return scheme.falling
        if reference_mps2 > FLAT_MPS2 or not in_zone:
            return scheme.rising
        return scheme.constant

    def _follow_position(self, inputs: AtoInput, distance_m: float) -> Drive:
        """From T3 on: x_ref = v2 * t - a3 * t**2 / 2, which ends at rest at the stop."""
        scheme = self._config.pid_literal
        creep_mps = scheme.creep_speed_mps
        decel_mps2 = creep_mps**2 / (2.0 * scheme.t3_m)
        self._since_t3_s += self._dt_s
        t_s = min(self._since_t3_s, creep_mps / decel_mps2)
        reference_m = creep_mps * t_s - decel_mps2 * t_s * t_s / 2.0
        error_m = reference_m - (scheme.t3_m - distance_m)
        accel_mps2 = self._control(scheme.position, error_m, -decel_mps2)
        return Drive(accel_mps2, max(0.0, creep_mps - decel_mps2 * t_s), True)

    def _control(self, gains: PidGains, error: float, reference_mps2: float) -> float:
        """One PID step. `error` is in m/s, or in m for the position loop."""
        ahead_mps2 = reference_mps2 if self._config.pid_literal.feed_forward else 0.0
        low_mps2, high_mps2 = -self._accel_max_mps2, self._accel_max_mps2
        if gains is not self._gains:
            self._pid.take_over(gains, error=error, output_mps2=self._demand_mps2 - ahead_mps2)
            self._gains = gains
        return ahead_mps2 + self._pid.step(
            gains,
            error,
            self._dt_s,
            low_mps2=low_mps2 - ahead_mps2,
            high_mps2=high_mps2 - ahead_mps2,
        )
