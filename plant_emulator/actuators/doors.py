"""Door control unit. A car opens on a side only if command and enable are both set."""

from typing import Final

from can_dbc.doors import DoorCars, DoorCommand, DoorState, DoorStatus
from plant_emulator.actuators.response import CommandWatch
from plant_emulator.train_config import DoorConfig

SAFE_COMMAND: Final = DoorCommand(
    enable_left=False, enable_right=False, open_left=False, open_right=False
)
NO_CARS: Final = DoorCars(left_cars=0, right_cars=0)
OBSTRUCTED_AT: Final = 0.5
"""Share of opening at which closing doors meet an obstacle."""
INSTANT_S: Final = 1.0e-9


class DoorSide:
    """All doors of one side. Those of the chosen cars move as one door, the others stay locked."""

    __slots__ = (
        "_config",
        "_step_s",
        "_timer_s",
        "blocked",
        "cars",
        "deaf",
        "obstacles",
        "open_ratio",
        "state",
    )

    def __init__(self, config: DoorConfig, step_s: float) -> None:
        self._config = config
        self._step_s = step_s
        self._timer_s = 0.0
        self.obstacles = config.obstructed_closings
        """Number of further closings that will meet an obstacle."""
        self.open_ratio = 0.0
        self.state = DoorState.LOCKED
        self.cars = 0
        """Cars whose doors are not locked: bit 0 is the front car."""
        self.blocked = False
        """A fault: every closing meets an obstacle."""
        self.deaf = False
        """A fault: closed and closing doors do not open; doors that are already opening
        continue."""

    def step(self, wanted_cars: int) -> None:
        """Move the doors of the cars that unlocked together.

        If one of them is no longer wanted, all of them close. A car that is wanted later waits
        until then.
        """
        state = self.state
        wanted_open = wanted_cars != 0 and not self.cars & ~wanted_cars
        if self.deaf and (state is DoorState.LOCKED or state is DoorState.CLOSING):
            wanted_open = False
        if state is DoorState.LOCKED:
            self._unlock(wanted_cars if wanted_open else 0)
        elif state is DoorState.OBSTRUCTED:
            self._reopen(wanted_open)
        elif wanted_open:
            self._open()
        else:
            self._close()

    def ask_again(self) -> None:
        """Restart the unlocking time after an interrupted unlocking."""
        if self.state is DoorState.LOCKED:
            self._timer_s = 0.0

    def _unlock(self, wanted_cars: int) -> None:
        if not wanted_cars:
            return
        self._timer_s += self._step_s
        if self._timer_s >= self._config.unlock_s:
            self._timer_s = 0.0
            self.state = DoorState.OPENING
            self.cars = wanted_cars

    def _open(self) -> None:
        if self.state is not DoorState.OPEN:
            self.open_ratio += self._step_s / max(self._config.open_s, INSTANT_S)
            self.state = DoorState.OPENING
            if self.open_ratio >= 1.0:
                self.open_ratio = 1.0
                self.state = DoorState.OPEN

    def _close(self) -> None:
        self.state = DoorState.CLOSING
        self.open_ratio -= self._step_s / max(self._config.close_s, INSTANT_S)
        if (self.obstacles > 0 or self.blocked) and self.open_ratio <= OBSTRUCTED_AT:
            self.obstacles = max(0, self.obstacles - 1)
            self.open_ratio = 1.0
            self.state = DoorState.OBSTRUCTED
        elif self.open_ratio <= 0.0:
            self.open_ratio = 0.0
            self.state = DoorState.LOCKED
            self.cars = 0

    def _reopen(self, wanted_open: bool) -> None:
        self._timer_s += self._step_s
        if self._timer_s >= self._config.reopen_s:
            self._timer_s = 0.0
            self.state = DoorState.OPEN if wanted_open else DoorState.CLOSING


class DoorUnit:
    """The door unit closes and locks all doors when its command is missing."""

    __slots__ = (
        "_all_cars",
        "_cars",
        "_cars_watch",
        "_command",
        "_left_forced",
        "_left_wanted",
        "_line_lost",
        "_right_forced",
        "_right_wanted",
        "_watch",
        "left",
        "locked",
        "right",
    )

    def __init__(self, config: DoorConfig, *, cars: int, step_s: float, timeout_ns: int) -> None:
        """`cars`: number of cars of the train."""
        self._command = SAFE_COMMAND
        self._all_cars = (1 << cars) - 1
        self._cars = NO_CARS
        self._left_wanted = self._right_wanted = 0
        """Cars whose doors are to be open on a side."""
        self._left_forced = self._right_forced = False
        self._line_lost = False
        self._watch = CommandWatch(timeout_ns)
        self._cars_watch = CommandWatch(timeout_ns)
        self.left = DoorSide(config, step_s)
        self.right = DoorSide(config, step_s)
        self.locked = True
        """The train line through all door locks is closed."""

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
        self._cars_watch.excuse(held_up_ns)

    def hear(self, command: DoorCommand, heard_ns: int) -> None:
        """Accept a valid pair of command frames."""
        self._watch.heard(heard_ns)
        if command is not self._command:
            self._obey(command)

    def hear_cars(self, cars: DoorCars, heard_ns: int) -> None:
        """Accept a valid pair of frames that enable single cars."""
        self._cars_watch.heard(heard_ns)
        if cars != self._cars:
            self._obey_cars(cars)

    def _obey(self, command: DoorCommand) -> None:
        self._command = command
        self._change()

    def _obey_cars(self, cars: DoorCars) -> None:
        self._cars = cars
        self._change()

    def _change(self) -> None:
        self._want()
        self.left.ask_again()
        self.right.ask_again()

    def _want(self) -> None:
        command, cars, whole = self._command, self._cars, self._all_cars
        left = whole if command.enable_left else cars.left_cars & whole
        right = whole if command.enable_right else cars.right_cars & whole
        self._left_wanted = whole if self._left_forced else left if command.open_left else 0
        self._right_wanted = whole if self._right_forced else right if command.open_right else 0

    def wanted_open(self, side: DoorSide) -> bool:
        """Return whether command or fault wants a car of this side open."""
        return bool(self._left_wanted if side is self.left else self._right_wanted)

    def force_open(self, *, left: bool, right: bool) -> None:
        """A fault: these sides open whatever the command is."""
        self._left_forced, self._right_forced = left, right
        self._want()

    def lose_lock_line(self, lost: bool) -> None:
        """A fault: the train line through the locks is interrupted, whatever the state of the
        doors.
        """
        self._line_lost = lost
        if lost:
            self.locked = False

    def step(self, end_ns: int) -> None:
        if end_ns > self._watch.expires_ns:
            self._obey(SAFE_COMMAND)
            self._watch.lost()
        if end_ns > self._cars_watch.expires_ns:
            self._obey_cars(NO_CARS)
            self._cars_watch.lost()
        if self.locked and not self._left_wanted and not self._right_wanted:
            return
        self.left.step(self._left_wanted)
        self.right.step(self._right_wanted)
        locked = DoorState.LOCKED
        closed = self.left.state is locked and self.right.state is locked
        self.locked = closed and not self._line_lost

    def status(self) -> DoorStatus:
        obstructed = DoorState.OBSTRUCTED
        return DoorStatus(
            closed_and_locked=self.locked,
            left=self.left.state,
            right=self.right.state,
            no_obstruction=self.left.state is not obstructed and self.right.state is not obstructed,
        )
