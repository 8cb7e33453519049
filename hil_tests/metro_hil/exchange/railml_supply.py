"""Neutral sections of railML 3: where the contact line has no power."""

from dataclasses import dataclass, field
from typing import Final

from metro_hil.exchange.railml_own import ZONES
from metro_hil.exchange.railml_places import RailmlPlaces
from metro_hil.exchange.surveyed_network import SurveyedZone
from metro_hil.exchange.xml_node import XmlNode

NEUTRAL: Final = ZONES[0]
SECTIONS: Final = (
    *("infrastructure", "functionalInfrastructure"),
    *("electrifications", "electrificationSection"),
)
SEPARATIONS: Final = {
    "phaseSeparationSection": "lengthPhaseSeparation",
    "systemSeparationSection": "lengthSystemSeparation",
}
"""Elements of a section that separates supplies, with the attribute of its length in m."""
NO_LINE: Final = "none"
"""Value of `contactLineType` of a section without contact line."""
TOLERANCE_M: Final = 1.0
"""Excess of a section over the separation in it at which both still count as the same place."""


@dataclass(slots=True)
class SurveyedNeutrals:
    """The neutral sections of a file."""

    zones: list[SurveyedZone] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """A sentence about each section that the line cannot have."""


def read_neutral_sections(root: XmlNode, places: RailmlPlaces) -> SurveyedNeutrals:
    """Read sections without contact line, and those that separate phases or systems.

    A separation has a length, but no place. So it is read only if its section is not longer.
    Raises SettingsError.
    """
    found = SurveyedNeutrals()
    for node in root.all(*SECTIONS):
        separation = _separation(node)
        if separation is None and (node.text("contactLineType") or "").lower() != NO_LINE:
            continue
        zones = [
            SurveyedZone(NEUTRAL, track, begin_m, end_m, forward, node.text("id") or "")
            for track, begin_m, end_m, forward, _ in places.ranges(node)
        ]
        length_m = sum(zone.end_m - zone.begin_m for zone in zones)
        name = f"electrificationSection {node.text('id')!r}"
        if not zones:
            found.left_out.append(f"{name}: has no linearLocation, so its place is unknown")
        elif separation is not None and length_m > separation + TOLERANCE_M:
            found.left_out.append(
                f"{name}: the file does not say where in its {length_m:g} m the separation of "
                f"{separation:g} m lies"
            )
        elif any(zone.end_m - zone.begin_m >= places.lengths_m[zone.track] for zone in zones):
            found.left_out.append(f"{name}: a whole track without power; the train brings its own")
        else:
            found.zones += zones
    return found


def _separation(node: XmlNode) -> float | None:
    """Length of the separation in a section, m; infinite if not given, None without one."""
    for tag, attribute in SEPARATIONS.items():
        part = node.first(tag)
        if part is not None:
            length_m = part.number(attribute)
            return float("inf") if length_m is None else length_m
    return None
