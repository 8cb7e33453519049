"""The rest of the railway: zone controller, operations centre and platform doors."""

from collections.abc import Iterable

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import LineMap, Station
from plant_emulator.wayside.centre import Centre
from plant_emulator.wayside.platform_doors import PlatformDoors
from plant_emulator.wayside.zone_controller import ZoneController
from zenoh_config import keys


def subscriptions(line_name: str) -> tuple[str, ...]:
    """What the wayside's radio has to listen to."""
    return (keys.reports(line_name), keys.statuses(line_name))


class Railway:
    """Hands each message to whom it is for."""

    def __init__(self, line: LineMap, destination: Station) -> None:
        self.doors = PlatformDoors(line)
        self.zone = ZoneController(line, destination)
        self.centre = Centre(line, self.doors)
        self._said = 0
        self._statuses = keys.statuses(line.name)

    @property
    def told(self) -> int:
        """Grows whenever something new was said, or platform doors were moved."""
        return self._said + self.doors.changes

    def answers(self, heard: Iterable[RadioMessage], now_ns: int) -> list[tuple[str, bytes]]:
        """Key and payload of everything that is to be said to what was heard."""
        said = []
        for message in heard:
            side = self.centre if keys.matches(self._statuses, message.key) else self.zone
            answer = side.answer(message, now_ns)
            if answer is not None:
                said.append(answer)
        self._said += bool(said)
        return said
