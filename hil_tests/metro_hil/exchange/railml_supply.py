"""Supply sections of railML 3: where the contact line has no power, and how it is divided."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from firmware_py.trackdb.sites import NEUTRAL, POWER
from metro_hil.exchange.railml_places import RailmlPlaces
from metro_hil.exchange.surveyed_network import SurveyedZone
from metro_hil.exchange.xml_node import XmlNode

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
TOUCH_M: Final = 0.01
"""Distance at which the ends of two sections still count as one place."""


@dataclass(slots=True)
class SurveyedSupply:
    """The neutral sections and power sections of a file."""

    zones: list[SurveyedZone] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """A sentence about each section that the line cannot have."""


def read_supply(
    root: XmlNode, places: RailmlPlaces, zones: Sequence[SurveyedZone]
) -> SurveyedSupply:
    """Read neutral sections and power sections; `zones` are known from elsewhere.

    Neutral are sections without contact line, and those that separate phases or systems. All others
    are power sections, if together with the neutral ones they cover each track once. Raises
    SettingsError.
    """
    found, power = SurveyedSupply(), []
    neutral = [each for each in zones if each.key == NEUTRAL]
    parents = {node.text("ref") for node in root.all(*SECTIONS, "belongsToParent")}
    for node in root.all(*SECTIONS):
        separation = _separation(node)
        if separation is not None or (node.text("contactLineType") or "").lower() == NO_LINE:
            _read_neutral(node, separation, places, found)
        elif node.text("id") not in parents:
            power += [
                SurveyedZone(POWER, track, begin_m, end_m, name=node.name())
                for track, begin_m, end_m, _, _ in places.ranges(node)
            ]
    if problem := _not_once(places, [*power, *found.zones, *neutral]) if power else "":
        found.left_out.append(f"electrificationSection: as power sections, since {problem}")
    else:
        found.zones += power
    return found


def _not_once(places: RailmlPlaces, zones: Sequence[SurveyedZone]) -> str:
    """A place that no power or neutral section covers, or two power sections; empty if none."""
    for track, length_m in places.lengths_m.items():
        reached_m, before = 0.0, SurveyedZone("", track, 0.0, 0.0, name=f"the begin of {track}")
        end = SurveyedZone("", track, length_m, length_m, name=f"the end of {track}")
        of_track = [each for each in zones if each.track == track]
        for zone in (*sorted(of_track, key=lambda each: each.begin_m), end):
            names = f"{before.name or before.key} and {zone.name or zone.key}"
            if zone.begin_m > reached_m + TOUCH_M:
                return f"{names} leave a gap at {reached_m:g} m of {track}"
            if before.key == zone.key == POWER and zone.begin_m < before.end_m - TOUCH_M:
                return f"{names} overlap at {zone.begin_m:g} m of {track}"
            if zone.key == POWER or zone.end_m > reached_m:
                before = zone
            reached_m = max(reached_m, zone.end_m)
    return ""


def _read_neutral(
    node: XmlNode, separation_m: float | None, places: RailmlPlaces, found: SurveyedSupply
) -> None:
    """Read one neutral section.

    A separation has a length, but no place. So it is read only if its section is not longer.
    """
    zones = [
        SurveyedZone(NEUTRAL, track, begin_m, end_m, forward, node.text("id") or "")
        for track, begin_m, end_m, forward, _ in places.ranges(node)
    ]
    length_m = sum(zone.end_m - zone.begin_m for zone in zones)
    name = f"electrificationSection {node.text('id')!r}"
    if not zones:
        found.left_out.append(f"{name}: has no linearLocation, so its place is unknown")
    elif separation_m is not None and length_m > separation_m + TOLERANCE_M:
        found.left_out.append(
            f"{name}: the file does not say where in its {length_m:g} m the separation of "
            f"{separation_m:g} m lies"
        )
    elif any(zone.end_m - zone.begin_m >= places.lengths_m[zone.track] for zone in zones):
        found.left_out.append(f"{name}: a whole track without power; the train brings its own")
    else:
        found.zones += zones


def _separation(node: XmlNode) -> float | None:
    """Length of the separation in a section, m; infinite if not given, None without one."""
    for tag, attribute in SEPARATIONS.items():
        part = node.first(tag)
        if part is not None:
            length_m = part.number(attribute)
            return float("inf") if length_m is None else length_m
    return None
