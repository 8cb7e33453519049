"""Traction control unit and motors: tractive effort from command, permission, power and voltage."""

from typing import Final

from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand, TractionStatus
from plant_emulator.actuators.response import NS_PER_S, CommandWatch, DeadTime, Hold, Lag
from plant_emulator.train_config import TractionConfig, effort_n

SAFE_COMMAND: Final = TractionCommand(
    force_n=0.0, direction=Direction.NEUTRAL, traction_permitted=False
)
_SIGNS: Final = {Direction.NEUTRAL: 0.0, Direction.FORWARD: 1.0, Direction.REVERSE: -1.0}


class TractionUnit:
    """Gives tractive effort only while the command and both train lines permit it.

    The train lines are wires, not frames. The line from the brake cuts traction and the electric
    brake in every emergency. The line through the door locks cuts traction.
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
        """Amount of effort from the loop; None if the amount comes with the command."""
        self.ready = True
        """The unit follows its reference. The status frame carries this flag."""
        self._watch = CommandWatch(timeout_ns)
        self._dead_time = DeadTime()
        self._lag = Lag(config.lag_s, step_s)
        self._slew_step_n = config.slew_n_per_s * step_s
        self._cut_ns = round(config.cut_s * NS_PER_S)
        self._cut_due_ns: int | None = None
        """Instant at which the contactor opens; None while no opening is pending."""
        self._electric_cut_ns: int | None = None
        self._target_n = 0.0
        self.force_n = 0.0
        """Mean tractive effort at the wheels over the last step, signed in running direction, N."""
        self.traction_cut = True
        self.electric_brake_possible = True
        self.effort_ratio = config.effort_ratio
        """Share of the rated effort that is available after limits by heat, failed motors and line
        voltage."""
        self.powered = True
        """The line feeds the inverters. Without it the motors give no effort."""
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
        """Number of times that the command went missing."""
        return self._watch.losses

    @property
    def silent(self) -> bool:
        """The command was present before and is missing now."""
        return self._watch.silent

    def excuse(self, held_up_ns: int) -> None:
        """Extend the command timeout by the time for which the bench itself was stopped."""
        self._watch.excuse(held_up_ns)

    def hear(self, command: TractionCommand, heard_ns: int) -> None:
        """Accept a valid pair of command frames."""
        self._watch.heard(heard_ns)
        if command is not self._command:
            self._obey(command, heard_ns)

    def _obey(self, command: TractionCommand, at_ns: int) -> None:
        was_n = self._demand_n()
        self._command = command
        self._ask(was_n, at_ns)

    def refer(self, force_n: float, at_ns: int) -> None:
        """Take the amount of effort from a loop, with this value from now on."""
        if force_n != self._loop_n:
            was_n = self._demand_n()
            self._loop_n = force_n
            self._ask(was_n, at_ns)

    @property
    def permission(self) -> float:
        """1 while the command permits traction, 0 otherwise."""
        return 1.0 if self._command.traction_permitted else 0.0

    @property
    def said_n(self) -> float:
        """The amount of effort in the command, N."""
        return self._command.force_n

    def _demand_n(self) -> float:
        amount_n = self._command.force_n if self._loop_n is None else self._loop_n
        return amount_n * _SIGNS[self._command.direction]

    def _ask(self, was_n: float, at_ns: int) -> None:
        asked_n = self._demand_n()
        if asked_n != was_n:
            self._dead_time.ask(at_ns + round(self._config.dead_time_s * NS_PER_S), asked_n)

    def feed(self, voltage_ratio: float) -> None:
        """Limit the effort to the share that the line voltage permits, 0..1."""
        self._voltage_ratio = voltage_ratio
        self.effort_ratio = self._config.effort_ratio * voltage_ratio

    def weaken(self, gain_ratio: float) -> None:
        """A fault: the motors give only this share of the demand."""
        self._gain_ratio = gain_ratio
        self._note_faults()

    def delay_removal(self, late_s: float) -> None:
        """A fault: reductions of effort and withdrawals of the permission take effect this much
        later.

        The train lines still act at once.
        """
        self._late_ns = round(late_s * NS_PER_S)
        self._hold = Hold(self._late_ns) if self._late_ns > 0 else None
        self._permitted_until_ns = 0
        self._note_faults()

    def run_away(self, force_n: float | None, *, obeys_cut_off: bool) -> None:
        """A fault: the motors push with this force whatever the command is; None ends the fault.

        A contactor that still obeys its train lines opens for an emergency brake and for unlocked
        doors. Motors that push cannot brake.
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
        """Compute the tractive effort over the step, before adhesion.

        Args:
            emergency: the brake's train line demands the emergency brake.
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
            # The inverters block at once; the contactor opens later.
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
        if config.effort:
            most_n = effort_n(config.effort, speed_mps) * self.effort_ratio
            return max(-most_n, min(most_n, asked_n))
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
