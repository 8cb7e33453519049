"""Driver's desk."""

import enum
from dataclasses import dataclass

from can_dbc.binding import complete, frame


class CabMode(enum.IntEnum):
    OFF = 0
    AUTO = 1
    """ATO drives, nobody needs to sit at the desk."""
    MANUAL = 2
    """The lever drives, ATP supervises."""


@frame("cab.dbc", "DESK")
@dataclass(frozen=True, slots=True)
class Desk:
    mode: CabMode
    lever_percent: float
    """+100 full traction, -100 full service brake."""
    emergency_released: bool
    """False while the mushroom button is pressed."""
    no_passenger_alarm: bool
    departure_requested: bool
    reset_requested: bool
    """Acknowledges a latched emergency; counts only at standstill."""
    open_left_requested: bool
    open_right_requested: bool
    restricted_requested: bool = False
    """To drive on sight, at restricted speed."""
    door_bypass_requested: bool = False
    """The sealed switch: depart although doors are not proven locked. Every use is an event."""


complete("cab.dbc")
