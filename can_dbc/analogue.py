"""Analogue reference: what the VOBC has its output module put onto the 4 to 20 mA loops."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("analogue.dbc", "ANALOGUE_CMD")
@dataclass(frozen=True, slots=True)
class AnalogueCommand:
    """Sent beside the vital commands, and only by a controller whose output is the current loops.

    Without it for 150 ms the module puts no current onto its loops.
    """

    traction_ma: float
    """Current of the traction loop; under 4 mA there is no effort."""
    brake_ma: float
    """Current of the service brake's loop."""


complete("analogue.dbc")
