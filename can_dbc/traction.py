"""Traction frames: VOBC to the traction control unit and back."""

from dataclasses import dataclass

from can_dbc.binding import complete, frame
from can_dbc.nodes import Direction


@frame("traction.dbc", "TRACTION_CMD")
@dataclass(frozen=True, slots=True)
class TractionCommand:
    """Vital, sent with an inverted twin.

    The unit cuts traction after 150 ms without a valid pair.
    """

    force_n: float
    """Tractive effort at the rail for the whole consist; never negative."""
    direction: Direction
    traction_permitted: bool


@frame("traction.dbc", "TRACTION_STATUS")
@dataclass(frozen=True, slots=True)
class TractionStatus:
    force_n: float
    """Effort at the rail for the whole consist; negative while the motors brake."""
    effort_available_ratio: float
    """Share of the rated effort that is available at the present voltage and temperature, 0..1."""
    traction_cut: bool
    """The contactor confirms that no tractive effort is possible."""
    ready: bool


complete("traction.dbc")
