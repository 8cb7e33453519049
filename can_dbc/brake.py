"""Brake frames: VOBC to the brake control unit and back."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("brake.dbc", "BRAKE_CMD")
@dataclass(frozen=True, slots=True)
class BrakeCommand:
    """Vital, sent with an inverted twin.

    Without a valid pair for 150 ms the unit applies the emergency brake.
    """

    service_decel_mps2: float
    """Demanded deceleration of the service brake; 0 releases it."""
    emergency_released: bool
    """The emergency brake stays off only while this is true: energise to release."""
    holding_released: bool
    """The holding brake may release."""


@frame("brake.dbc", "BRAKE_STATUS")
@dataclass(frozen=True, slots=True)
class BrakeStatus:
    applied_decel_mps2: float
    """Deceleration of electric and friction brake together, as the unit estimates it."""
    cylinder_pressure_kpa: float
    emergency_applied: bool
    holding_applied: bool
    released: bool
    """No brake of any kind is applied."""
    ready: bool


complete("brake.dbc")
