"""Door frames: VOBC to the door control unit and back."""

import enum
from dataclasses import dataclass

from can_dbc.binding import complete, frame


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


@frame("doors.dbc", "DOOR_STATUS")
@dataclass(frozen=True, slots=True)
class DoorStatus:
    closed_and_locked: bool
    """Every door of the train is closed and locked."""
    left: DoorState
    right: DoorState
    no_obstruction: bool


complete("doors.dbc")
