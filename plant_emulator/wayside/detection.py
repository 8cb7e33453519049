"""True places of trains, from the emulated rails to the emulated axle counters; not a radio
message.

Key `m/<line>/x/<train>`: chainages of front and rear, the number of axles, and the instant by the
monotonic clock of the train's emulator, in network order.
"""

import math
import struct
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from typing import Final, NamedTuple

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import AreaMap
from zenoh_config.keys import line_chunk

LAYOUT: Final = struct.Struct(">ddHQ")
INSET_M: Final = 2.0
"""Distance from a coupler to the nearest axle."""
TRAINS_MAX: Final = 512


class Place(NamedTuple):
    front_m: float
    rear_m: float
    axles: int
    stamp_ns: int = 0
    """Instant of the measurement. The message itself may arrive later."""


def key_of(line: str, train: int) -> str:
    return f"m/{line_chunk(line)}/x/{train}"


def subscription(line: str) -> str:
    return f"m/{line_chunk(line)}/x/*"


def packed(place: Place) -> bytes:
    return LAYOUT.pack(place.front_m, place.rear_m, place.axles, place.stamp_ns)


class Detection:
    """Axles in sections and trains at objects.

    A train counts at its last reported place for ever.
    """

    def __init__(self, areas: AreaMap) -> None:
        self._areas = areas
        self.places: dict[str, Place] = {}
        """Last place of each train by key. A train that reports no more stays where it was."""
        self._starts_m = [section.start_m for section in areas.sections]
        self._under: dict[str, dict[int, int]] = {}
        """Axles in each section, by the train's key."""
        self._axles: Counter[int] = Counter()

    def on_message(self, messages: Iterable[RadioMessage]) -> list[RadioMessage]:
        """Take the messages for the rails and return all others."""
        prefix = subscription(self._areas.name).removesuffix("*")
        others = []
        for message in messages:
            if not message.key.startswith(prefix):
                others.append(message)
            elif len(message.payload) == LAYOUT.size and self._has_room(message.key):
                place = Place(*LAYOUT.unpack(message.payload))
                if -math.inf < place.rear_m < place.front_m < math.inf:
                    self._moves(message.key, place)
        return others

    def _has_room(self, key: str) -> bool:
        return key in self.places or len(self.places) < TRAINS_MAX

    def _moves(self, key: str, place: Place) -> None:
        self.places[key] = place
        counted = self._under_train(place)
        self._axles.update(counted)
        self._axles.subtract(self._under.get(key, {}))
        self._under[key] = counted

    def _under_train(self, place: Place) -> dict[int, int]:
        """Count the train's axles in each section; sections are contiguous."""
        counted: dict[int, int] = {}
        sections, starts_m = self._areas.sections, self._starts_m
        first_m = place.front_m - INSET_M
        step_m = (first_m - place.rear_m - INSET_M) / max(1, place.axles - 1)
        for n in range(place.axles if sections else 0):
            at_m = first_m - n * step_m
            section = sections[max(0, bisect_right(starts_m, at_m) - 1)]
            if section.start_m <= at_m < section.end_m:
                counted[section.number] = counted.get(section.number, 0) + 1
        return counted

    def axles(self) -> dict[int, int]:
        """Number of axles in each section that has any."""
        return {number: count for number, count in self._axles.items() if count}

    def occupied(self) -> set[int]:
        """Numbers of objects with a part of a train in them."""
        return {
            site.number
            for site in self._areas.objects
            for place in self.places.values()
            if place.rear_m < site.end_m and site.start_m < place.front_m
        }
