"""Brake control unit and brakes: service brake, emergency brake, holding brake.

Each has its own delay and build-up; the strongest of the three acts, they do not add.
"""

import math
from typing import Final

from can_dbc.brake import BrakeCommand, BrakeStatus
from plant_emulator.actuators.response import NS_PER_S, CommandWatch, DeadTime, Lag
from plant_emulator.actuators.service_brake import OFF_MPS2, ServiceBrake
from plant_emulator.noise import Generators
from plant_emulator.train_config import BrakeConfig

HOLDING_CONFIRMED: Final = 0.9
"""Share of its force from which the holding brake counts as applied."""
OFF_RATIO: Final = 0.02


class BrakeUnit:
    """Everything that brakes the train. Not hearing its command, it applies the emergency brake."""

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
        """The train is found with emergency and holding brake fully applied."""
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
        """Share of all brakes that gives anything. Pressures are as if all did: the unit does not
        know; only the mean cylinder pressure shows it."""
        self._loop_mps2: float | None = None
        """Reference of the service brake; None where it comes with the command."""
        self.ready = True
        """The unit follows what it is told; it says so on the bus."""
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

    def excuse(self, held_up_ns: int) -> None:
        """The bench stood still for so long; that is not the controller's silence."""
        self._watch.excuse(held_up_ns)

    def hear(self, command: BrakeCommand, heard_ns: int) -> None:
        """A valid pair has been received.

        What silence asked for while the train rolls only a command to brake ends, or rest: old
        commands that somebody repeats while the controller is gone release nothing. A controller
        that is there asks for the brake as soon as it sees it on, and one that starts anew at once.
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
        """The holding brake is asked for."""
        return self._holding_on

    @property
    def applied(self) -> bool:
        """Any of the three brakes is on."""
        return self.service.works or max(self.emergency_mps2, self.holding_mps2) > OFF_MPS2

    @property
    def said_mps2(self) -> float:
        """What the command asks of the service brake."""
        return self._command.service_decel_mps2

    def refer(self, decel_mps2: float, at_ns: int) -> None:
        """The service brake's reference comes from a loop, and is this from now on."""
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
                # A release that is still on its way must not hold up the next application.
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
        """Forces over the step, before adhesion.

        Args:
            electric_limit_w: what line and resistor take from the motors, counted at the rail.
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
            # A train that rolls under a commanded holding brake may yet become slow enough for it.
            and (self._holding_on or self._command.holding_released)
        )

    def weaken_service(self, gain_ratio: float) -> None:
        """A fault: the share of its force that the service brake gives."""
        self._service_ratio = gain_ratio
        self.service.weaken(gain_ratio * self.working_ratio)
        self._steady = False

    def fail(self, working_ratio: float) -> None:
        """A fault: the share of all brakes that gives anything."""
        self.working_ratio = working_ratio
        self.weaken_service(self._service_ratio)

    def stick(self, stuck: bool) -> None:
        """A fault: the service brake stays as it is."""
        self.service.stuck = stuck
        self._steady = False

    def delay_service(self, extra_s: float) -> None:
        """A fault: so much later than it should, like the other three; also what is under way."""
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
        """Silence counts as the most restrictive command; the service brake stays as it is."""
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
            # One that is on its way comes, even if the command is back before it bites.
            emergency_applied=self.emergency_wanted
            or emergency_ratio > OFF_RATIO
            or not self._emergency_dead.settled,
            holding_applied=self._holding_on and holding_ratio >= HOLDING_CONFIRMED,
            released=applied_mps2 <= OFF_MPS2 and not self.emergency_wanted,
            ready=self.ready,
        )
