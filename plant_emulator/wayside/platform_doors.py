"""Platform doors. They open and close with the doors of the train in front of them."""

from collections.abc import Iterable
from typing import Final

from firmware_py.trackdb import LineMap, Station

STEP_S: Final = 0.01
"""Period of `step`; the same as the plant's."""
OPEN_S: Final = 1.5
CLOSE_S: Final = 1.5
"""Time from the end of the demand to closed and locked; shorter than that of train doors."""
REOPEN_S: Final = 3.0
"""Time that the doors stay open after an obstacle before they try again."""
OBSTRUCTED_AT: Final = 0.5
"""Share of opening at which closing doors meet an obstacle."""
DEMAND_NS: Final = 1_000_000_000
"""Time after which a demand that is not repeated has ended."""


class DoorRow:
    """All doors of one platform, modelled as one door."""

    __slots__ = ("_until_ns", "_wait_s", "_wanted", "obstacles_met", "open_ratio")

    def __init__(self) -> None:
        self.open_ratio = 0.0
        self._wanted = False
        self._until_ns = 0
        self._wait_s = 0.0
        self.obstacles_met = 0

    @property
    def closed(self) -> bool:
        return self.open_ratio == 0.0

    @property
    def resting(self) -> bool:
        return self.open_ratio == 0.0 and not self._wanted

    def ask(self, wanted: bool, now_ns: int) -> None:
        self._wanted = wanted
        self._until_ns = now_ns + DEMAND_NS

    def step(self, now_ns: int, *, obstructed: bool) -> None:
        if now_ns >= self._until_ns:
            self._wanted = False
        if self._wanted:
            self._wait_s = 0.0
            self.open_ratio = min(1.0, self.open_ratio + STEP_S / OPEN_S)
        elif self._wait_s > 0.0:
            self._wait_s -= STEP_S
        elif self.open_ratio > 0.0:
            self.open_ratio = max(0.0, self.open_ratio - STEP_S / CLOSE_S)
            if obstructed and self.open_ratio <= OBSTRUCTED_AT:
                self.open_ratio = 1.0
                self._wait_s = REOPEN_S
                self.obstacles_met += 1


class PlatformDoors:
    """The doors of all platforms of a line that have any."""

    __slots__ = ("_proven", "_rows", "changes", "obstructed", "resting")

    def __init__(self, line: LineMap) -> None:
        self._rows = {each.name: DoorRow() for each in line.stations if each.platform_doors}
        self.resting = True
        """All doors are closed and none is requested to open, so `step` changes nothing."""
        self.changes = 0
        """Increases when doors begin to open, have closed, or change their proof of locking."""
        self.obstructed = False
        """A fault: every closing meets an obstacle."""
        self._proven = True

    def lose_proof(self, lost: bool) -> None:
        """A fault: the circuit through the locks is open, whatever the state of the doors."""
        self._proven = not lost
        self.changes += 1

    def ask(self, station: Station | None, *, wanted: bool, now_ns: int) -> None:
        """Take the demand of the train at this platform; doors of all other platforms close."""
        if self.resting and not (wanted and station is not None):
            return
        for name, row in self._rows.items():
            at_train = station is not None and name == station.name
            if at_train and wanted:
                row.ask(True, now_ns)
                self.resting = False
            elif not row.resting:
                row.ask(False, now_ns)

    def step(self, now_ns: int) -> None:
        if self.resting:
            return
        for row in self._rows.values():
            was_closed = row.closed
            row.step(now_ns, obstructed=self.obstructed)
            if row.closed is not was_closed:
                self.changes += 1
        self.resting = all(row.resting for row in self._rows.values())

    def locked(self, stations: Iterable[Station]) -> bool:
        """Return whether the doors at all these stations are closed and the circuit proves it."""
        rows = [self._rows[each.name] for each in stations if each.name in self._rows]
        return all(row.closed for row in rows) and (self._proven or not rows)

    @property
    def obstacles_met(self) -> int:
        """Number of closings that met an obstacle."""
        return sum(row.obstacles_met for row in self._rows.values())

    @property
    def all_closed(self) -> bool:
        return all(row.closed for row in self._rows.values())

    @property
    def all_locked(self) -> bool:
        return self.all_closed and (self._proven or not self._rows)

    def open_ratio(self, station: str) -> float:
        """Opening from 0 (closed) to 1; also 0 at a platform without doors."""
        row = self._rows.get(station)
        return 0.0 if row is None else row.open_ratio
