"""Brake control unit and brakes: service brake with blending, emergency brake, holding brake.

Each has its own delay and build-up; the strongest of the three acts, they do not add.
"""

from typing import Final

from can_dbc.brake import BrakeCommand, BrakeStatus
from plant_emulator.actuators.response import NS_PER_S, DeadTime, Lag, Shift, Watch
from plant_emulator.noise import Generators, Source, Uniform
from plant_emulator.train_config import BrakeConfig, DeadTimeKind, ServiceBrakeConfig

HOLDING_CONFIRMED: Final = 0.9
"""Share of its force from which the holding brake counts as applied."""
OFF_RATIO: Final = 0.02
OFF_MPS2: Final = 0.01
"""A brake that gives no more than this counts as released."""


class ServiceBrake:
    """From the demand to the brake forces on motor cars and on the others."""

    __slots__ = (
        "_asked_mps2",
        "_bites_ns",
        "_config",
        "_dead_time",
        "_dead_time_ns",
        "_dead_times",
        "_fade_per_mps",
        "_force_gain",
        "_inertia_kg",
        "_lag",
        "_motor_ratio",
        "_pneumatic_gain",
        "_pneumatic_lags",
        "_pneumatic_shifts",
        "decel_mps2",
        "electric_n",
        "motor_friction_n",
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
        motor_ratio: share of the train's mass that motor cars have.
        """
        self._config = config
        self._inertia_kg = inertia_kg
        self._motor_ratio = motor_ratio
        draws = generators.of
        spread = config.dead_time_s
        self._dead_times = Uniform(draws(Source.BRAKE_DEAD_TIME), low=spread.low, high=spread.high)
        self._dead_time_ns = 0
        self._bites_ns = 0
        self._dead_time = DeadTime()
        self._lag = Lag(config.lag_s.draw(draws(Source.BRAKE_LAG)), step_s)
        self._force_gain = config.gain_ratio.draw(draws(Source.BRAKE_GAIN)) * inertia_kg
        air = config.pneumatic
        air_dead_s = air.dead_time_s.draw(draws(Source.PNEUMATIC_DEAD_TIME))
        self._pneumatic_gain = air.gain_ratio.draw(draws(Source.PNEUMATIC_GAIN))
        self._pneumatic_shifts = (Shift(air_dead_s, step_s), Shift(air_dead_s, step_s))
        self._pneumatic_lags = (Lag(air.lag_s, step_s), Lag(air.lag_s, step_s))
        fade_mps = config.electric.fade_begin_mps - config.electric.fade_end_mps
        self._fade_per_mps = 1.0 / fade_mps
        self._asked_mps2 = 0.0
        self.decel_mps2 = 0.0
        """What the unit believes it gives: the demand, delayed and built up."""
        self.electric_n = 0.0
        self.motor_friction_n = 0.0
        self.trailer_friction_n = 0.0

    @property
    def dead_time_s(self) -> float:
        """Of the present application or the last one."""
        return self._dead_time_ns / NS_PER_S

    @property
    def at_rest(self) -> bool:
        """Nothing is asked, nothing is under way, nothing is left."""
        return (
            self._asked_mps2 == self.decel_mps2 == 0.0
            and self.motor_friction_n == self.trailer_friction_n == 0.0
            and self._dead_time.settled
            and all(shift.empty for shift in self._pneumatic_shifts)
        )

    def ask(self, decel_mps2: float, at_ns: int) -> None:
        asked_mps2 = min(decel_mps2, self._config.max_decel_mps2)
        if asked_mps2 == self._asked_mps2:
            return
        if self._asked_mps2 == 0.0:
            self._dead_time_ns = round(self._dead_times.draw() * NS_PER_S)
            self._bites_ns = at_ns + self._dead_time_ns
        self._asked_mps2 = asked_mps2
        if self._config.dead_time_kind is DeadTimeKind.TRANSPORT:
            self._dead_time.ask(at_ns + self._dead_time_ns, asked_mps2)
        else:
            self._dead_time.ask(max(at_ns, self._bites_ns), asked_mps2)

    def step(self, start_ns: int, end_ns: int, speed_mps: float, electric_possible: bool) -> None:
        decel_mps2 = self._lag.step(self._dead_time.mean(start_ns, end_ns))
        self.decel_mps2 = decel_mps2
        total_n = decel_mps2 * self._force_gain
        electric_n = self._electric(total_n, speed_mps) if electric_possible else 0.0
        self.electric_n = electric_n
        # Motor cars brake their own mass first, electrically and then with friction; only what the
        # motors do beyond that is done for the other cars.
        motor_n = max(0.0, total_n * self._motor_ratio - electric_n)
        trailer_n = max(0.0, total_n - electric_n - motor_n)
        shifts, lags, gain = self._pneumatic_shifts, self._pneumatic_lags, self._pneumatic_gain
        self.motor_friction_n = gain * lags[0].step(shifts[0].step(motor_n))
        self.trailer_friction_n = gain * lags[1].step(shifts[1].step(trailer_n))

    def _electric(self, total_n: float, speed_mps: float) -> float:
        config = self._config.electric
        if total_n == 0.0 or speed_mps <= config.fade_end_mps:
            return 0.0
        most_n = config.max_force_n
        if most_n * speed_mps > config.max_power_w:
            most_n = config.max_power_w / speed_mps
        if speed_mps < config.fade_begin_mps:
            most_n *= (speed_mps - config.fade_end_mps) * self._fade_per_mps
        return min(config.share_ratio * total_n, most_n)


class BrakeUnit:
    """Everything that brakes the train. Not hearing its command, it applies the emergency brake."""

    __slots__ = (
        "_command",
        "_config",
        "_emergency_dead",
        "_emergency_lag",
        "_holding_dead",
        "_holding_lag",
        "_holding_on",
        "_inertia_kg",
        "_motor_ratio",
        "_steady",
        "_watch",
        "electric_n",
        "emergency_mps2",
        "emergency_wanted",
        "friction_n",
        "holding_mps2",
        "motor_n",
        "service",
        "trailer_n",
    )

    def __init__(
        self,
        config: BrakeConfig,
        generators: Generators,
        *,
        step_s: float,
        timeout_ns: int,
        inertia_kg: float,
        motor_ratio: float,
    ) -> None:
        """The train is found with emergency and holding brake fully applied."""
        self._config = config
        self._inertia_kg = inertia_kg
        self._motor_ratio = motor_ratio
        self._watch = Watch(timeout_ns)
        self._command = BrakeCommand(
            service_decel_mps2=0.0, emergency_released=False, holding_released=False
        )
        self.service = ServiceBrake(
            config.service,
            generators,
            step_s=step_s,
            inertia_kg=inertia_kg,
            motor_ratio=motor_ratio,
        )
        self._emergency_dead = DeadTime(1.0)
        self._emergency_lag = Lag(config.emergency.lag_s, step_s, 1.0)
        self._holding_dead = DeadTime(1.0)
        self._holding_lag = Lag(config.holding.lag_s, step_s, 1.0)
        self._holding_on = True
        self._steady = False
        """No force will change before the command does, so there is nothing to compute."""
        self.emergency_wanted = True
        """The train line to traction: asked for by command or by silence, from that instant on."""
        self.emergency_mps2 = config.emergency.decel_mps2
        self.holding_mps2 = config.holding.decel_mps2
        self.electric_n = 0.0
        self.motor_n = 0.0
        """Brake force on the motor cars together, electric part included, before adhesion."""
        self.trailer_n = 0.0
        self.friction_n = 0.0

    @property
    def losses(self) -> int:
        """How often the command went missing."""
        return self._watch.losses

    @property
    def silent(self) -> bool:
        """The command was there and is missing now."""
        return self._watch.silent

    def hear(self, command: BrakeCommand, heard_ns: int) -> None:
        """A valid pair has been received."""
        self._watch.heard(heard_ns)
        if command is not self._command:
            self._obey(command, heard_ns)

    def _obey(self, command: BrakeCommand, at_ns: int) -> None:
        self._command = command
        self._steady = False
        self.service.ask(command.service_decel_mps2, at_ns)
        self._want_emergency(not command.emergency_released, at_ns)

    def _want_emergency(self, wanted: bool, at_ns: int) -> None:
        if wanted != self.emergency_wanted:
            self.emergency_wanted = wanted
            config = self._config.emergency
            delay_s = config.dead_time_s if wanted else config.release_s
            if wanted:
                # A release that is still on its way must not hold up the next application.
                self._emergency_dead = DeadTime(self._emergency_dead.value)
            self._emergency_dead.ask(at_ns + round(delay_s * NS_PER_S), 1.0 if wanted else 0.0)

    def _want_holding(self, at_ns: int, speed_mps: float) -> None:
        config = self._config.holding
        wanted = not self._command.holding_released and (
            self._holding_on or speed_mps < config.engage_under_mps
        )
        if wanted != self._holding_on:
            self._holding_on = wanted
            due_ns = at_ns + round(config.dead_time_s * NS_PER_S)
            self._holding_dead.ask(due_ns, 1.0 if wanted else 0.0)

    def step(
        self, start_ns: int, end_ns: int, speed_mps: float, *, electric_possible: bool
    ) -> None:
        """Forces over the step, before adhesion."""
        if end_ns > self._watch.expires_ns:
            self._fall_silent(self._watch.expires_ns)
        if self._steady:
            return
        speed_mps = abs(speed_mps)
        self._want_holding(start_ns, speed_mps)
        service, config = self.service, self._config
        service.step(start_ns, end_ns, speed_mps, electric_possible)
        built_up = self._emergency_lag.step(self._emergency_dead.mean(start_ns, end_ns))
        held = self._holding_lag.step(self._holding_dead.mean(start_ns, end_ns))
        self.emergency_mps2 = built_up * config.emergency.decel_mps2
        self.holding_mps2 = held * config.holding.decel_mps2
        friction_mps2 = max(self.emergency_mps2, self.holding_mps2)
        least_motor_n = friction_mps2 * self._inertia_kg * self._motor_ratio
        least_trailer_n = friction_mps2 * self._inertia_kg - least_motor_n
        self.electric_n = service.electric_n
        self.motor_n = max(service.electric_n + service.motor_friction_n, least_motor_n)
        self.trailer_n = max(service.trailer_friction_n, least_trailer_n)
        self.friction_n = self.motor_n + self.trailer_n - self.electric_n
        self._steady = service.decel_mps2 == 0.0 and self._is_steady(built_up, held)

    def _is_steady(self, built_up: float, held: float) -> bool:
        return (
            self.service.at_rest
            and self._emergency_dead.settled
            and built_up == self._emergency_lag.value == self._emergency_dead.value
            and self._holding_dead.settled
            and held == self._holding_lag.value == self._holding_dead.value
            # A train that rolls under a commanded holding brake may yet become slow enough for it.
            and (self._holding_on or self._command.holding_released)
        )

    def _fall_silent(self, at_ns: int) -> None:
        """Silence counts as the most restrictive command; the service brake stays as it is."""
        self._obey(
            BrakeCommand(
                service_decel_mps2=self._command.service_decel_mps2,
                emergency_released=False,
                holding_released=False,
            ),
            at_ns,
        )
        self._watch.lost()

    def status(self) -> BrakeStatus:
        config = self._config
        applied_mps2 = max(self.service.decel_mps2, self.emergency_mps2, self.holding_mps2)
        full_n = self._inertia_kg * config.emergency.decel_mps2
        emergency_ratio = self.emergency_mps2 / config.emergency.decel_mps2
        holding_ratio = self.holding_mps2 / config.holding.decel_mps2
        return BrakeStatus(
            applied_decel_mps2=applied_mps2,
            cylinder_pressure_kpa=config.full_pressure_kpa * self.friction_n / full_n,
            emergency_applied=self.emergency_wanted or emergency_ratio > OFF_RATIO,
            holding_applied=self._holding_on and holding_ratio >= HOLDING_CONFIRMED,
            released=applied_mps2 <= OFF_MPS2 and not self.emergency_wanted,
            ready=True,
        )
