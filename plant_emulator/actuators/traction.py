"""Traction control unit and motors: tractive effort from command, permission, power and voltage."""

from typing import Final

from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand, TractionStatus
from plant_emulator.actuators.response import NS_PER_S, CommandWatch, DeadTime, Hold, Lag
from plant_emulator.train_config import TractionConfig

SAFE_COMMAND: Final = TractionCommand(
    force_n=0.0, direction=Direction.NEUTRAL, traction_permitted=False
)
_SIGNS: Final = {Direction.NEUTRAL: 0.0, Direction.FORWARD: 1.0, Direction.REVERSE: -1.0}


class TractionUnit:
    """Effort exists only while the command permits it and both train lines do.

    The train lines are wires, not frames: one from the brake, which takes away traction and the
    electric brake with every emergency, one through the door locks, which takes away traction.
    """

    __slots__ = (
        "_command",
        "_config",
        "_cut_due_ns",
        "_cut_ns",
        "_dead_time",
        "_electric_cut_ns",
        "_faulty",
        "_gain_ratio",
        "_hold",
        "_lag",
        "_late_ns",
        "_loop_n",
        "_obeys_cut_off",
        "_permitted_until_ns",
        "_runaway_n",
        "_slew_step_n",
        "_target_n",
        "_voltage_ratio",
        "_watch",
        "effort_ratio",
        "electric_brake_possible",
        "force_n",
        "powered",
        "ready",
        "traction_cut",
    )

    def __init__(self, config: TractionConfig, *, step_s: float, timeout_ns: int) -> None:
        self._config = config
        self._command = SAFE_COMMAND
        self._loop_n: float | None = None
        """Amount of effort; None where it comes with the command."""
        self.ready = True
        """The unit follows what it is told; it says so on the bus."""
        self._watch = CommandWatch(timeout_ns)
        self._dead_time = DeadTime()
        self._lag = Lag(config.lag_s, step_s)
        self._slew_step_n = config.slew_n_per_s * step_s
        self._cut_ns = round(config.cut_s * NS_PER_S)
        self._cut_due_ns: int | None = None
        """When the contactor will have opened; None while it is closed and stays so."""
        self._electric_cut_ns: int | None = None
        self._target_n = 0.0
        self.force_n = 0.0
        """Tractive effort at the wheels, signed in running direction, mean of the last step."""
        self.traction_cut = True
        self.electric_brake_possible = True
        self.effort_ratio = config.effort_ratio
        """Share of the rated effort that heat, motors and line voltage leave."""
        self.powered = True
        """The line feeds the inverters; without it there is no effort at all."""
        self._voltage_ratio = 1.0
        self._faulty = False
        self._gain_ratio = 1.0
        self._hold: Hold | None = None
        self._late_ns = 0
        self._permitted_until_ns = 0
        self._runaway_n: float | None = None
        self._obeys_cut_off = True

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

    def hear(self, command: TractionCommand, heard_ns: int) -> None:
        """A valid pair has been received."""
        self._watch.heard(heard_ns)
        if command is not self._command:
            self._obey(command, heard_ns)

    def _obey(self, command: TractionCommand, at_ns: int) -> None:
        was_n = self._asked_n()
        self._command = command
        self._ask(was_n, at_ns)

    def refer(self, force_n: float, at_ns: int) -> None:
        """The amount of effort comes from a loop, and is this from now on."""
        if force_n != self._loop_n:
            was_n = self._asked_n()
            self._loop_n = force_n
            self._ask(was_n, at_ns)

    @property
    def permission(self) -> float:
        """1 while the command permits traction, 0 otherwise."""
        return 1.0 if self._command.traction_permitted else 0.0

    @property
    def said_n(self) -> float:
        """The amount of effort in the command."""
        return self._command.force_n

    def _asked_n(self) -> float:
        amount_n = self._command.force_n if self._loop_n is None else self._loop_n
        return amount_n * _SIGNS[self._command.direction]

    def _ask(self, was_n: float, at_ns: int) -> None:
        asked_n = self._asked_n()
        if asked_n != was_n:
            self._dead_time.ask(at_ns + round(self._config.dead_time_s * NS_PER_S), asked_n)

    def feed(self, voltage_ratio: float) -> None:
        """The share of effort that the line voltage leaves, 0..1."""
        self._voltage_ratio = voltage_ratio
        self.effort_ratio = self._config.effort_ratio * voltage_ratio

    def weaken(self, gain_ratio: float) -> None:
        """A fault: the share of what is asked that the motors give."""
        self._gain_ratio = gain_ratio
        self._note_faults()

    def delay_removal(self, late_s: float) -> None:
        """A fault: what the command takes away, effort or permission, goes so much later.

        The train lines act at once all the same.
        """
        self._late_ns = round(late_s * NS_PER_S)
        self._hold = Hold(self._late_ns) if self._late_ns > 0 else None
        self._permitted_until_ns = 0
        self._note_faults()

    def run_away(self, force_n: float | None, *, obeys_cut_off: bool) -> None:
        """A fault: motors push with this force whatever the command says; None ends it.

        A contactor that still obeys its train lines opens for emergency brake and unlocked doors.
        Motors that push cannot brake.
        """
        self._runaway_n, self._obeys_cut_off = force_n, obeys_cut_off
        self._note_faults()

    def _note_faults(self) -> None:
        self._faulty = (
            self._gain_ratio != 1.0 or self._hold is not None or self._runaway_n is not None
        )

    def step(
        self, start_ns: int, end_ns: int, speed_mps: float, *, emergency: bool, doors_locked: bool
    ) -> float:
        """Tractive effort over the step, before adhesion.

        Args:
            emergency: the brake's train line says that the emergency brake is asked for.
        """
        if end_ns > self._watch.expires_ns:
            self._obey(SAFE_COMMAND, self._watch.expires_ns)
            self._watch.lost()
        permitted = self._command.traction_permitted
        asked_n = self._dead_time.mean(start_ns, end_ns)
        lines_permit = doors_locked and not emergency
        if self._faulty:
            permitted = self._permitted_with_faults(permitted, start_ns)
            asked_n = self._asked_with_faults(asked_n, start_ns)
            lines_permit = lines_permit or not self._obeys_cut_off
        permitted = permitted and lines_permit
        self._move_contactor(end_ns, permitted)
        self._move_electric_brake(end_ns, emergency)
        if self.traction_cut or not self.powered:
            self._target_n = self._lag.value = self.force_n = 0.0
            return 0.0
        if permitted:
            change_n = self._limited(asked_n, abs(speed_mps)) - self._target_n
            if change_n != 0.0:
                self._target_n += max(-self._slew_step_n, min(self._slew_step_n, change_n))
        else:
            # The inverters are blocked at once; the contactor only follows.
            self._target_n = 0.0
        self.force_n = self._lag.step(self._target_n)
        return self.force_n

    def _permitted_with_faults(self, permitted: bool, now_ns: int) -> bool:
        if self._runaway_n is not None:
            return True
        if self._hold is None:
            return permitted
        if permitted:
            self._permitted_until_ns = now_ns + self._late_ns
        return now_ns < self._permitted_until_ns

    def _asked_with_faults(self, asked_n: float, now_ns: int) -> float:
        if self._hold is not None:
            asked_n = self._hold.greatest(now_ns, asked_n)
        return asked_n * self._gain_ratio

    def _limited(self, asked_n: float, speed_mps: float) -> float:
        if self._runaway_n is not None:
            return self._runaway_n * self._voltage_ratio
        config = self._config
        most_n = config.rated_force_n * self.effort_ratio
        power_w = config.max_power_w * self.effort_ratio
        if most_n * speed_mps > power_w:
            most_n = power_w / speed_mps
        return max(-most_n, min(most_n, asked_n))

    def _move_contactor(self, now_ns: int, permitted: bool) -> None:
        if permitted:
            self._cut_due_ns = None
            self.traction_cut = False
        elif not self.traction_cut:
            if self._cut_due_ns is None:
                self._cut_due_ns = now_ns + self._cut_ns
            elif now_ns >= self._cut_due_ns:
                self.traction_cut = True

    def _move_electric_brake(self, now_ns: int, emergency: bool) -> None:
        if self._runaway_n is not None:
            self._electric_cut_ns = None
            self.electric_brake_possible = False
        elif not emergency:
            self._electric_cut_ns = None
            self.electric_brake_possible = True
        elif self._electric_cut_ns is None:
            self._electric_cut_ns = now_ns + self._cut_ns
        elif now_ns >= self._electric_cut_ns:
            self.electric_brake_possible = False

    def status(self, electric_brake_n: float) -> TractionStatus:
        return TractionStatus(
            force_n=self.force_n - electric_brake_n,
            effort_available_ratio=self.effort_ratio,
            traction_cut=self.traction_cut,
            ready=self.ready,
        )
