"""Analogue reference: currents of the 4 to 20 mA loops that the VOBC commands from its output
module.
"""

from dataclasses import dataclass

from can_dbc.binding import complete, frame


@frame("analogue.dbc", "ANALOGUE_CMD")
@dataclass(frozen=True, slots=True)
class AnalogueCommand:
    """Currents for the loops, sent in addition to the vital commands, by controllers with this
    output only.

    Without it for 150 ms the module sets no current on its loops.
    """

    traction_ma: float
    """Current of the traction loop; below 4 mA there is no effort."""
    brake_ma: float
    """Current of the service brake's loop."""


complete("analogue.dbc")
