"""Brake control unit with service brake, emergency brake and holding brake.

Each brake has its own delay and build-up. The strongest of the three acts; they do not add.
"""

import math
from typing import Final

from can_dbc.brake import BrakeCommand, BrakeStatus
from plant_emulator.actuators.response import NS_PER_S, CommandWatch, DeadTime, Lag
from plant_emulator.actuators.service_brake import OFF_MPS2, ServiceBrake
from plant_emulator.noise import Generators
from plant_emulator.train_config import BrakeConfig

HOLDING_CONFIRMED: Final = 0.9
"""Share of full force from which the holding brake counts as applied."""
OFF_RATIO: Final = 0.02


class BrakeUnit:
    """All brakes of the train. The unit applies the emergency brake when its command is missing."""

    __slots__ = (
        "_command",
        "_config",
        "_emergency_dead",
        "_emergency_extra_ns",
        "_emergency_lag",
        "_holding_dead",
        "_holding_extra_ns",
        "_holding_lag",
        "_holding_on",
        "_inertia_kg",
        "_loop_mps2",
        "_motor_ratio",
        "_release_extra_ns",
        "_rolls",
        "_service_ratio",
        "_steady",
        "_waits_for_brake",
        "_watch",
        "electric_n",
        "emergency_mps2",
        "emergency_wanted",
        "friction_n",
        "holding_mps2",
        "motor_n",
        "ready",
        "service",
        "trailer_n",
        "working_ratio",
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
        """Start with emergency and holding brake fully applied."""
        self._config = config
        self._inertia_kg = inertia_kg
        self._motor_ratio = motor_ratio
        self._watch = CommandWatch(timeout_ns)
        self._waits_for_brake = False
        self._rolls = False
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
        self._emergency_extra_ns = 0
        self._holding_extra_ns = 0
        self._release_extra_ns = 0
        self._service_ratio = 1.0
        self.working_ratio = 1.0
        """Share of the brakes that works. The unit does not know of failed brakes: only the mean
        cylinder pressure shows them."""
        self._loop_mps2: float | None = None
        """Reference of the service brake from its loop; None if the reference comes with the
        command."""
        self.ready = True
        """The unit follows its reference. The status frame carries this flag."""
        self._steady = False
        """No force changes before the command does, so the step needs no computation."""
        self.emergency_wanted = True
        """Emergency demand on the train line to traction, set by command or by a missing
        command."""
        self.emergency_mps2 = config.emergency.decel_mps2
        self.holding_mps2 = config.holding.decel_mps2
        self.electric_n = 0.0
        self.motor_n = 0.0
        """Brake force of all motor cars, electric part included, before adhesion."""
        self.trailer_n = 0.0
        self.friction_n = 0.0

    @property
    def losses(self) -> int:
        """Number of times that the command went missing."""
        return self._watch.losses

    @property
    def silent(self) -> bool:
        """The command was present before and is missing now."""
        return self._watch.silent

    def excuse(self, held_up_ns: int) -> None:
        """Extend the command timeout by the time for which the bench itself was stopped."""
        self._watch.excuse(held_up_ns)

    def hear(self, command: BrakeCommand, heard_ns: int) -> None:
        """Accept a valid pair of command frames.

        After a timeout on a rolling train, only a command to brake or standstill ends the emergency
        brake. Old commands that another node repeats after the controller is gone therefore release
        nothing. A working controller commands the brake as soon as it sees it applied; a restarted
        one does so at once.
        """
        if heard_ns > self._watch.expires_ns:
            self._fall_silent(self._watch.expires_ns)
        self._watch.heard(heard_ns)
        if self._waits_for_brake and self._rolls and command.emergency_released:
            return
        self._waits_for_brake = False
        if command is not self._command:
            self._obey(command, heard_ns)

    def _obey(self, command: BrakeCommand, at_ns: int) -> None:
        self._command = command
        self._steady = False
        if self._loop_mps2 is None:
            self.service.ask(command.service_decel_mps2, at_ns)
        self._want_emergency(not command.emergency_released, at_ns)

    @property
    def holding_wanted(self) -> bool:
        """The holding brake is demanded."""
        return self._holding_on

    @property
    def applied(self) -> bool:
        """Any of the three brakes is on."""
        return self.service.works or max(self.emergency_mps2, self.holding_mps2) > OFF_MPS2

    @property
    def said_mps2(self) -> float:
        """Deceleration of the service brake in the command."""
        return self._command.service_decel_mps2

    def refer(self, decel_mps2: float, at_ns: int) -> None:
        """Take the service brake's reference from a loop, with this value from now on."""
        if decel_mps2 != self._loop_mps2:
            self._loop_mps2 = decel_mps2
            self._steady = False
            self.service.ask(decel_mps2, at_ns)

    def _want_emergency(self, wanted: bool, at_ns: int) -> None:
        if wanted != self.emergency_wanted:
            self.emergency_wanted = wanted
            config = self._config.emergency
            delay_s = config.dead_time_s if wanted else config.release_s
            due_ns = at_ns + round(delay_s * NS_PER_S)
            if wanted:
                # A pending release must not delay the next application.
                self._emergency_dead = DeadTime(self._emergency_dead.value)
                due_ns += self._emergency_extra_ns
            self._emergency_dead.ask(due_ns, 1.0 if wanted else 0.0)

    def _want_holding(self, at_ns: int, speed_mps: float) -> None:
        config = self._config.holding
        wanted = not self._command.holding_released and (
            self._holding_on or speed_mps < config.engage_under_mps
        )
        if wanted != self._holding_on:
            self._holding_on = wanted
            due_ns = at_ns + round(config.dead_time_s * NS_PER_S)
            due_ns += self._holding_extra_ns if wanted else self._release_extra_ns
            self._holding_dead.ask(due_ns, 1.0 if wanted else 0.0)

    def step(
        self,
        start_ns: int,
        end_ns: int,
        speed_mps: float,
        *,
        electric_possible: bool,
        electric_limit_w: float = math.inf,
    ) -> None:
        """Compute the forces over the step, before adhesion.

        Args:
            electric_limit_w: power that line and resistor accept from the motors, measured at the
                rail.
        """
        speed_mps = abs(speed_mps)
        self._rolls = speed_mps > 0.0
        if end_ns > self._watch.expires_ns:
            self._fall_silent(self._watch.expires_ns)
        if self._steady:
            return
        self._want_holding(start_ns, speed_mps)
        service, config = self.service, self._config
        service.step(start_ns, end_ns, speed_mps, electric_limit_w if electric_possible else 0.0)
        built_up = self._emergency_lag.step(self._emergency_dead.mean(start_ns, end_ns))
        held = self._holding_lag.step(self._holding_dead.mean(start_ns, end_ns))
        self.emergency_mps2 = built_up * config.emergency.decel_mps2
        self.holding_mps2 = held * config.holding.decel_mps2
        friction_mps2 = max(self.emergency_mps2, self.holding_mps2) * self.working_ratio
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
            # A rolling train with a commanded holding brake may still become slow enough for it to
            # engage.
            and (self._holding_on or self._command.holding_released)
        )

    def weaken_service(self, gain_ratio: float) -> None:
        """A fault: the service brake gives only this share of its force."""
        self._service_ratio = gain_ratio
        self.service.weaken(gain_ratio * self.working_ratio)
        self._steady = False

    def fail(self, working_ratio: float) -> None:
        """A fault: only this share of all brakes works."""
        self.working_ratio = working_ratio
        self.weaken_service(self._service_ratio)

    def stick(self, stuck: bool) -> None:
        """A fault: the service brake keeps its present force."""
        self.service.stuck = stuck
        self._steady = False

    def delay_service(self, extra_s: float) -> None:
        """A fault: changes of the service brake are delayed by this time, including those already
        pending.
        """
        self.service.delay(extra_s)
        self._steady = False

    def delay_emergency(self, extra_s: float) -> None:
        extra_ns = round(extra_s * NS_PER_S)
        self._emergency_dead.shift(extra_ns - self._emergency_extra_ns, 1.0)
        self._emergency_extra_ns = extra_ns

    def delay_holding(self, extra_s: float) -> None:
        extra_ns = round(extra_s * NS_PER_S)
        self._holding_dead.shift(extra_ns - self._holding_extra_ns, 1.0)
        self._holding_extra_ns = extra_ns

    def delay_holding_release(self, extra_s: float) -> None:
        extra_ns = round(extra_s * NS_PER_S)
        self._holding_dead.shift(extra_ns - self._release_extra_ns, 0.0)
        self._release_extra_ns = extra_ns

    def _fall_silent(self, at_ns: int) -> None:
        """Apply the most restrictive command after a timeout; the service brake keeps its
        demand.
        """
        self._obey(
            BrakeCommand(
                service_decel_mps2=self._command.service_decel_mps2,
                emergency_released=False,
                holding_released=False,
            ),
            at_ns,
        )
        self._waits_for_brake = True
        self._watch.lost()

    def status(self) -> BrakeStatus:
        config = self._config
        applied_mps2 = max(max(self.service.decel_mps2, self.emergency_mps2), self.holding_mps2)
        full_n = self._inertia_kg * config.emergency.decel_mps2
        emergency_ratio = self.emergency_mps2 / config.emergency.decel_mps2
        holding_ratio = self.holding_mps2 / config.holding.decel_mps2
        return BrakeStatus(
            applied_decel_mps2=applied_mps2,
            cylinder_pressure_kpa=config.full_pressure_kpa * self.friction_n / full_n,
            # A pending application takes effect even if the release returns before it.
            emergency_applied=self.emergency_wanted
            or emergency_ratio > OFF_RATIO
            or not self._emergency_dead.settled,
            holding_applied=self._holding_on and holding_ratio >= HOLDING_CONFIRMED,
            released=applied_mps2 <= OFF_MPS2 and not self.emergency_wanted,
            ready=self.ready,
        )
