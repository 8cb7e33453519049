"""Door frames: VOBC to the door control unit and back."""

import enum
from dataclasses import dataclass
from typing import Final

from can_dbc.binding import complete, frame

CARS_MAX: Final = 20
"""Greatest number of cars that DOOR_CARS can carry."""
ALL_CARS: Final = (1 << CARS_MAX) - 1


def cars_text(cars: int) -> str:
    """Chosen cars as text, such as `cars 1 to 4` or `cars 2, 3 and 6`."""
    numbers = [index + 1 for index in range(CARS_MAX) if cars >> index & 1]
    if len(numbers) == 1:
        return f"car {numbers[0]}"
    first, last = numbers[0], numbers[-1]
    if len(numbers) > 2 and last - first + 1 == len(numbers):
        return f"cars {first} to {last}"
    return f"cars {', '.join(map(str, numbers[:-1]))} and {last}"


class DoorState(enum.IntEnum):
    UNKNOWN = 0
    LOCKED = 1
    """Closed and locked."""
    OPENING = 2
    OPEN = 3
    CLOSING = 4
    OBSTRUCTED = 5
    FAULT = 6


@frame("doors.dbc", "DOOR_CMD")
@dataclass(frozen=True, slots=True)
class DoorCommand:
    """Vital, sent with an inverted twin. A side without enable closes and locks."""

    enable_left: bool
    enable_right: bool
    open_left: bool
    open_right: bool


@frame("doors.dbc", "DOOR_CARS")
@dataclass(frozen=True, slots=True)
class DoorCars:
    """Vital, sent with an inverted twin, only while single cars are enabled and once thereafter.

    It enables cars in addition to `DoorCommand`, which then enables no side. The demand to open
    stays in `DoorCommand`.
    """

    left_cars: int
    """Cars whose left doors may be open: bit 0 is the front car."""
    right_cars: int


@frame("doors.dbc", "DOOR_STATUS")
@dataclass(frozen=True, slots=True)
class DoorStatus:
    closed_and_locked: bool
    """Every door of the train is closed and locked."""
    left: DoorState
    right: DoorState
    no_obstruction: bool


complete("doors.dbc")
