"""Driver's desk."""

import enum
from dataclasses import dataclass

from can_dbc.binding import complete, frame


class CabMode(enum.IntEnum):
    OFF = 0
    AUTO = 1
    """Automatic operation drives; the desk may be unattended."""
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
    """Acknowledges a latched emergency; effective only at standstill."""
    open_left_requested: bool
    open_right_requested: bool
    restricted_requested: bool = False
    """The person at the desk requests driving on sight at restricted speed."""
    door_bypass_requested: bool = False
    """The sealed switch: permits departure although doors are not proven locked. Every use is an
    event."""


complete("cab.dbc")
