"""Service brake: from the demand to the forces of motors and friction, with blending."""

from typing import Final

from plant_emulator.actuators.response import NS_PER_S, DeadTime, DelayLine, Lag
from plant_emulator.noise import Generators, NoiseSource, Uniform
from plant_emulator.train_config import DeadTimeKind, ServiceBrakeConfig, effort_n

OFF_MPS2: Final = 0.01
"""Deceleration up to which a brake counts as released."""


class ServiceBrake:
    """Computes the brake forces of motor cars and trailers from the demanded deceleration."""

    __slots__ = (
        "_bites_ns",
        "_config",
        "_dead_time",
        "_dead_time_ns",
        "_dead_times",
        "_demand_mps2",
        "_extra_ns",
        "_fade_per_mps",
        "_force_gain",
        "_gain",
        "_gain_fault_ratio",
        "_inertia_kg",
        "_lag",
        "_motor_ratio",
        "_pneumatic_gain",
        "_pneumatic_lags",
        "_pneumatic_shifts",
        "_redraws",
        "_step_s",
        "decel_mps2",
        "electric_n",
        "motor_friction_n",
        "stuck",
        "trailer_friction_n",
    )

    def __init__(
        self,
        config: ServiceBrakeConfig,
        generators: Generators,
        *,
        step_s: float,
        inertia_kg: float,
        motor_ratio: float,
    ) -> None:
        """Args:
        motor_ratio: share of the train's mass on motor cars.
        """
        self._config = config
        self._inertia_kg = inertia_kg
        self._motor_ratio = motor_ratio
        draws = generators.of
        spread = config.dead_time_s
        self._dead_times = Uniform(
            draws(NoiseSource.BRAKE_DEAD_TIME), low=spread.low, high=spread.high
        )
        self._dead_time_ns = 0
        self._bites_ns = 0
        self._dead_time = DeadTime()
        self._step_s = step_s
        self._extra_ns = 0
        self._gain_fault_ratio = 1.0
        self._redraws: Generators | None = None
        """Generators for new lags and gains at the next application from rest; None if no change is
        due."""
        self._draw(generators)
        fade_mps = config.electric.fade_begin_mps - config.electric.fade_end_mps
        self._fade_per_mps = 1.0 / fade_mps
        self._demand_mps2 = 0.0
        self.decel_mps2 = 0.0
        """Deceleration that the unit assumes it gives: the demand after delay and build-up."""
        self.electric_n = 0.0
        self.motor_friction_n = 0.0
        self.trailer_friction_n = 0.0
        self.stuck = False
        """A fault: the deceleration keeps its value. Motors and friction continue to share it."""

    def _draw(self, generators: Generators) -> None:
        """Sample the values that hold until the next reseeding. The brake must be at rest."""
        config, draws, step_s = self._config, generators.of, self._step_s
        self._lag = Lag(config.lag_s.draw(draws(NoiseSource.BRAKE_LAG)), step_s)
        self._gain = config.gain_ratio.draw(draws(NoiseSource.BRAKE_GAIN)) * self._inertia_kg
        self._force_gain = self._gain * self._gain_fault_ratio
        air = config.pneumatic
        air_dead_s = air.dead_time_s.draw(draws(NoiseSource.PNEUMATIC_DEAD_TIME))
        self._pneumatic_gain = air.gain_ratio.draw(draws(NoiseSource.PNEUMATIC_GAIN))
        self._pneumatic_shifts = (DelayLine(air_dead_s, step_s), DelayLine(air_dead_s, step_s))
        self._pneumatic_lags = (Lag(air.lag_s, step_s), Lag(air.lag_s, step_s))

    def reseed(self, generators: Generators) -> None:
        """Take further samples from other generators.

        Each application samples its dead time; lags and gains are sampled once more at the next
        application from rest.
        """
        self._dead_times.reseed(generators.of(NoiseSource.BRAKE_DEAD_TIME))
        self._redraws = generators

    def weaken(self, gain_ratio: float) -> None:
        """A fault: the brake gives only this share of its force."""
        self._gain_fault_ratio = gain_ratio
        self._force_gain = self._gain * gain_ratio

    def delay(self, extra_s: float) -> None:
        """A fault: changes of the demand are delayed by this time, including those already
        pending.
        """
        extra_ns = round(extra_s * NS_PER_S)
        self._dead_time.shift(extra_ns - self._extra_ns)
        self._extra_ns = extra_ns

    @property
    def dead_time_s(self) -> float:
        """Dead time of the present application, or of the last one, s."""
        return self._dead_time_ns / NS_PER_S

    @property
    def at_rest(self) -> bool:
        """No demand is present or pending, and no force is left."""
        return (
            self._demand_mps2 == self.decel_mps2 == 0.0
            and self.motor_friction_n == self.trailer_friction_n == 0.0
            and self._dead_time.settled
            and all(shift.empty for shift in self._pneumatic_shifts)
        )

    @property
    def held_back(self) -> bool:
        """The brake is stuck at another deceleration than the one demanded."""
        return self.stuck and abs(self._dead_time.value - self.decel_mps2) > OFF_MPS2

    @property
    def works(self) -> bool:
        """A demand is present, or the brake still gives more than a released brake."""
        return self._demand_mps2 > 0.0 or self.decel_mps2 > OFF_MPS2

    def ask(self, decel_mps2: float, at_ns: int) -> None:
        asked_mps2 = min(decel_mps2, self._config.max_decel_mps2)
        if asked_mps2 == self._demand_mps2:
            return
        if self._demand_mps2 == 0.0:
            if self._redraws is not None and self.at_rest:
                self._draw(self._redraws)
                self._redraws = None
            self._dead_time_ns = round(self._dead_times.draw() * NS_PER_S)
            self._bites_ns = at_ns + self._dead_time_ns
        self._demand_mps2 = asked_mps2
        if self._config.dead_time_kind is DeadTimeKind.TRANSPORT:
            due_ns = at_ns + self._dead_time_ns
        else:
            due_ns = max(at_ns, self._bites_ns)
        self._dead_time.ask(due_ns + self._extra_ns, asked_mps2)

    def step(self, start_ns: int, end_ns: int, speed_mps: float, electric_limit_w: float) -> None:
        decel_mps2 = self._dead_time.mean(start_ns, end_ns)
        decel_mps2 = self.decel_mps2 if self.stuck else self._lag.step(decel_mps2)
        self.decel_mps2 = decel_mps2
        total_n = decel_mps2 * self._force_gain
        electric_n = self._electric(total_n, speed_mps, electric_limit_w)
        self.electric_n = electric_n
        # Motor cars brake their own mass first, electrically and then by friction. Only the
        # electric force beyond that brakes the other cars.
        motor_n = max(0.0, total_n * self._motor_ratio - electric_n)
        trailer_n = max(0.0, total_n - electric_n - motor_n)
        shifts, lags, gain = self._pneumatic_shifts, self._pneumatic_lags, self._pneumatic_gain
        self.motor_friction_n = gain * lags[0].step(shifts[0].step(motor_n))
        self.trailer_friction_n = gain * lags[1].step(shifts[1].step(trailer_n))

    def _electric(self, total_n: float, speed_mps: float, limit_w: float) -> float:
        config = self._config.electric
        if total_n == 0.0 or limit_w == 0.0 or speed_mps <= config.fade_end_mps:
            return 0.0
        most_n, most_w = config.max_force_n, min(config.max_power_w, limit_w)
        if config.effort:
            most_n, most_w = effort_n(config.effort, speed_mps), limit_w
        if most_n * speed_mps > most_w:
            most_n = most_w / speed_mps
        if speed_mps < config.fade_begin_mps:
            most_n *= (speed_mps - config.fade_end_mps) * self._fade_per_mps
        return min(config.share_ratio * total_n, most_n)
