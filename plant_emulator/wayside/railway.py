"""The rest of the railway: zone controller, operations centre and platform doors."""

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, Station
from plant_emulator.wayside.centre import Centre
from plant_emulator.wayside.interlocking import MOVE_S, Interlocking
from plant_emulator.wayside.platform_doors import PlatformDoors
from plant_emulator.wayside.zone_controller import ZoneController
from zenoh_config import keys
from zenoh_config.codec import SafetyKey

ROUTE_AHEAD_NS: Final = round((MOVE_S + 1.0) * 1e9)
"""Time before a departure at which its route is requested, so that the switch has moved then."""


def subscriptions(line_name: str) -> tuple[str, ...]:
    """Topics that the wayside's radio subscribes to."""
    return (keys.reports(line_name), keys.statuses(line_name))


class _Given(NamedTuple):
    """An authority of a master, with the farthest end so far."""

    end_m: float
    rear_m: float
    farthest_m: float


def _ignore(_: RadioMessage) -> None:
    """There is no other centre."""


class Railway:
    """Passes each message to its receiver."""

    def __init__(
        self, line: LineMap, destination: Station, interlocking: Interlocking | None = None
    ) -> None:
        """Args:
        interlocking: of a network with switches.
        """
        self.doors = PlatformDoors(line)
        self.zone = ZoneController(line, destination)
        self.centre = Centre(line, self.doors)
        self.interlocking = interlocking
        self._line = line
        self.on_status: Callable[[RadioMessage], None] = _ignore
        """Receives each status of the train, for another centre whose orders `centre` repeats."""
        self._by_master: _Given | None = None
        """The newest authority of a master; None without masters, or before the first."""
        if interlocking is not None:
            self.zone.limit_m = interlocking.limit_m
        self._answers_sent = 0
        self._statuses = keys.statuses(line.name)

    @property
    def told(self) -> int:
        """Counter that increases with each authority, answer, and change of platform doors."""
        return self._answers_sent + self.doors.changes

    @property
    def farthest_end_m(self) -> float | None:
        """Farthest end of all authorities for the train so far; None before the first one."""
        given = self._by_master
        return self.zone.farthest_end_m if given is None else given.farthest_m

    @property
    def latest_end_m(self) -> float | None:
        """End of the newest authority for the train; None before the first one."""
        if self._by_master is not None:
            return self._by_master.end_m
        return None if self.zone.latest is None else self.zone.latest.end_m

    @property
    def latest_rear_m(self) -> float:
        """Place up to which the newest authority protects the rear."""
        given = self._by_master
        return self.zone.latest_rear_m if given is None else given.rear_m

    def obey(self, *, end_m: float, rear_m: float) -> None:
        """Note an authority that a master gave the train."""
        farthest_m = end_m if self._by_master is None else max(end_m, self._by_master.farthest_m)
        self._by_master = _Given(end_m, rear_m, farthest_m)
        self._answers_sent += 1

    def use_key(self, key: SafetyKey) -> None:
        """Use the key of safety codes of a secured line, with which the train sends its status."""
        self.centre = Centre(self._line, self.doors, key=key)

    def keep_until(self, departs_ns: int) -> None:
        """Keep the train at its start until then."""
        self.zone.departs_ns = departs_ns
        if self.interlocking is not None:
            self.interlocking.departs_ns = departs_ns - ROUTE_AHEAD_NS

    def observe(self, now_ns: int, *, front_m: float, rear_m: float) -> None:
        """Set and release routes for the train at this place."""
        if self.interlocking is not None:
            self.interlocking.step(now_ns, front_m=front_m, rear_m=rear_m)
            self.zone.limit_m = self.interlocking.limit_m

    def answers(self, heard: Iterable[RadioMessage], now_ns: int) -> list[tuple[str, bytes]]:
        """Return key and payload of all answers to the received messages."""
        said = []
        for message in heard:
            side: Centre | ZoneController = self.zone
            if keys.matches(self._statuses, message.key):
                side = self.centre
                self.on_status(message)
            answer = side.answer(message, now_ns)
            if answer is not None:
                said.append(answer)
        self._answers_sent += bool(said)
        self._keep_apart()
        return said

    def _keep_apart(self) -> None:
        """Keep the track between reserved rear and end of authority from other trains."""
        zone, interlocking = self.zone, self.interlocking
        if interlocking is not None and zone.farthest_end_m is not None:
            interlocking.keep(rear_m=zone.latest_rear_m, end_m=zone.farthest_end_m)
