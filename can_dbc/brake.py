"""Brake frames: VOBC to the brake control unit and back."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("brake.dbc", "BRAKE_CMD")
@dataclass(frozen=True, slots=True)
class BrakeCommand:
    """Vital, sent with an inverted twin. Without a valid pair for 150 ms it brakes by itself."""

    service_decel_mps2: float
    """Deceleration asked of the service brake; 0 releases it."""
    emergency_released: bool
    """The emergency brake stays off only while this is true: energise to release."""
    holding_released: bool
    """The holding brake may come off."""


@frame("brake.dbc", "BRAKE_STATUS")
@dataclass(frozen=True, slots=True)
class BrakeStatus:
    applied_decel_mps2: float
    """What electric and friction brake together give by the unit's own estimate."""
    cylinder_pressure_kpa: float
    emergency_applied: bool
    holding_applied: bool
    released: bool
    """No brake of any kind is applied."""
    ready: bool


complete("brake.dbc")
