"""The rest of the railway: zone controller, operations centre and platform doors."""

from collections.abc import Iterable
from typing import Final

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, Station
from plant_emulator.wayside.centre import Centre
from plant_emulator.wayside.interlocking import MOVE_S, Interlocking
from plant_emulator.wayside.platform_doors import PlatformDoors
from plant_emulator.wayside.zone_controller import ZoneController
from zenoh_config import keys

ROUTE_AHEAD_NS: Final = round((MOVE_S + 1.0) * 1e9)
"""Time before a departure at which its route is requested, so that the switch has moved then."""


def subscriptions(line_name: str) -> tuple[str, ...]:
    """Topics that the wayside's radio subscribes to."""
    return (keys.reports(line_name), keys.statuses(line_name))


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
        if interlocking is not None:
            self.zone.limit_m = interlocking.limit_m
        self._answers_sent = 0
        self._statuses = keys.statuses(line.name)

    @property
    def told(self) -> int:
        """Counter that increases when an answer was sent or platform doors changed."""
        return self._answers_sent + self.doors.changes

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
            side = self.centre if keys.matches(self._statuses, message.key) else self.zone
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
