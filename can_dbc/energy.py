"""High-voltage box: line supply and energy meter. Not safety-related."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("energy.dbc", "LINE_SUPPLY")
@dataclass(frozen=True, slots=True)
class LineSupply:
    line_voltage_v: float
    line_current_a: float
    """Current from the line; negative while the train feeds back."""
    breaker_closed: bool


@frame("energy.dbc", "ENERGY_METER")
@dataclass(frozen=True, slots=True)
class EnergyMeter:
    drawn_kwh: float
    regenerated_kwh: float


complete("energy.dbc")
