"""Reads infrastructure of railML 3."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from firmware_py.settings import SettingsError, build
from firmware_py.trackdb.network import TrackNetwork
from metro_hil.exchange.railml_network_export import ExportedNetwork, railml_network_text
from metro_hil.exchange.railml_own import OWN_ZONES, own_keys, tag_keys
from metro_hil.exchange.railml_places import RailmlPlaces, read_places
from metro_hil.exchange.railml_stations import read_stations
from metro_hil.exchange.railml_supply import read_supply
from metro_hil.exchange.railml_tunnels import read_tunnels, tunnel_notes
from metro_hil.exchange.survey import file_name
from metro_hil.exchange.surveyed_network import (
    FileTerms,
    SurveyedNetwork,
    SurveyedSwitch,
    SurveyedTag,
    SurveyedZone,
    TrackRange,
)
from metro_hil.exchange.track_graph import TrackGraph
from metro_hil.exchange.xml_node import XmlNode

TERMS: Final = FileTerms("netElements", "netRelations", "operationalPoints")
KMH_PER_MPS: Final = Decimal("3.6")
FUNCTIONAL: Final = ("infrastructure", "functionalInfrastructure")
GEOMETRY: Final = ("infrastructure", "geometry")
TURNOUT_M: Final = 30.0
"""Length of a switch branch whose file gives none; that of a common turnout of a metro."""
NAVIGABLE: Final = {"both": (True, True), "ab": (True, False), "ba": (False, True)}
"""Whether a train may run from element A to B, and from B to A."""
IGNORED: Final = {
    ("signalsIS", "signalIS"): "the authority comes by radio",
    ("trainDetectionElements", "trainDetectionElement"): "the bench knows where its train is",
    ("levelCrossingsIS", "levelCrossingIS"): "the bench has none",
}

End = tuple[str, bool]
"""A netElement, and true at its end."""


def read_infrastructure(root: XmlNode) -> SurveyedNetwork:
    """Read the tracks. Raises SettingsError that names file and element."""
    places = read_places(root)
    relations = _relations(root, places)
    links = _links(relations)
    stations = read_stations(root, places)
    line_keys = next(
        (keys for node in root.all(*FUNCTIONAL, "lines", "line") if (keys := own_keys(node))), {}
    )
    zones = _zones(root, places, line_keys)
    tunnels = read_tunnels(root, places)
    supply = read_supply(root, places, zones)
    network = SurveyedNetwork(
        name=str(line_keys.get("name") or file_name(Path(root.source).stem)),
        source=root.source,
        terms=TERMS,
        graph=TrackGraph(places.lengths_m, links),
        stops=stations.places,
        exact_stops=stations.exact,
        platforms=stations.platforms,
        station_keys=stations.keys,
        line_keys={
            key: value for key, value in line_keys.items() if key not in (*OWN_ZONES, "network")
        },
        zones=[*zones, *supply.zones, *tunnels],
        limits=[*_limits(root, places), *_branch_limits(root, places, relations)],
        gradients=_curves(root, places, "gradientCurves", "gradientCurve", "gradient"),
        radii=_curves(root, places, "horizontalCurves", "horizontalCurve", "radius"),
        tags=_tags(root, places),
        switches=_switches(root, relations),
        origins_m=_origins_m(places),
        filled=(
            *stations.filled,
            *tunnel_notes(tunnels),
            *_shared(places),
            *_open_ends(root, places, links),
        ),
        ignored=(*stations.left_out, *supply.left_out, *_ignored(root)),
    )
    table = line_keys.get("network")
    return _with_own_table(network, table) if isinstance(table, dict) else network


def _with_own_table(network: SurveyedNetwork, table: dict[str, Any]) -> SurveyedNetwork:
    """The network with the table of an export of this project.

    It is left out if another program has changed elements since then.
    """
    own = build(TrackNetwork, table, network.source)
    text = railml_network_text(ExportedNetwork(own, {}))
    root = XmlNode(network.source, ElementTree.fromstring(text))  # noqa: S314 - our own text
    if _elements(read_infrastructure(root)) == _elements(network):
        return replace(network, name=file_name(own.name), given=table)
    why = "elements were changed since the export, so the rules fill what they do not say"
    return replace(network, ignored=(*network.ignored, f"designator of line: {why}"))


def _elements(network: SurveyedNetwork) -> tuple[Any, ...]:
    """All that the elements say about tracks."""
    return (
        *(network.graph, network.switches, network.origins_m, network.stops, network.platforms),
        *(network.limits, network.gradients, network.radii, network.zones, network.tags),
    )


def _zones(root: XmlNode, places: RailmlPlaces, line_keys: Mapping[str, Any]) -> list[SurveyedZone]:
    """Zones of an export of this project, whose tracks are one netElement."""
    track = next(iter(places.lengths_m))
    origin_m = _origins_m(places).get(track, 0.0)
    found = []
    for key in OWN_ZONES:
        try:
            found += [
                SurveyedZone(
                    key,
                    track,
                    float(zone["start_m"]) - origin_m,
                    float(zone["end_m"]) - origin_m,
                    name=str(zone.get("name", "")),
                )
                for zone in line_keys.get(key, ())
            ]
        except (KeyError, TypeError, ValueError, AttributeError):
            raise root.error(
                f"lines: line: designator: {key} is no list of zones with start_m and end_m; "
                "export the line again"
            ) from None
    return found


def _shared(places: RailmlPlaces) -> tuple[str, ...]:
    if not places.shared:
        return ()
    names = ", ".join(places.shared)
    return (f"lengths: a share of that of their track, as they are drawn: {names}",)


def _origins_m(places: RailmlPlaces) -> dict[str, float]:
    """Chainage of the begin of each netElement whose chainage grows."""
    return {
        name: next(iter(systems.values())).begin_m
        for name, systems in places.mileages.items()
        if systems and next(iter(systems.values())).begin_m < next(iter(systems.values())).end_m
    }


def _relations(root: XmlNode, places: RailmlPlaces) -> dict[str, tuple[End, End, XmlNode]]:
    """The relations between netElements of the track level on which trains can run."""
    found: dict[str, tuple[End, End, XmlNode]] = {}
    pairs: dict[frozenset[End], str] = {}
    for node in root.all("infrastructure", "topology", "netRelations", "netRelation"):
        ends = []
        for side in ("A", "B"):
            element = node.first(f"element{side}")
            if element is None:
                raise node.error(f"has no element{side}; name the netElement")
            ref = element.need("ref", "name the netElement")
            if ref in places.parts:
                break
            if not places.elements(element, "ref"):
                break
            position = node.number(f"positionOn{side}")
            if position not in (0.0, 1.0):
                raise node.error(
                    f"positionOn{side}: {node.text(f'positionOn{side}')!r} is not 0 or 1; write "
                    "the end of the netElement"
                )
            ends.append((ref, position == 1.0))
        if len(ends) != 2 or (node.text("navigability") or "Both").lower() == "none":
            continue
        name, pair = node.need("id", "give it an id"), frozenset(ends)
        if len(pair) != 2:
            raise node.error(f"joins an end of {ends[0][0]!r} to itself; correct positionOnB")
        if pair in pairs:
            raise node.error(f"joins the same ends as netRelation {pairs[pair]!r}; remove one")
        pairs[pair] = name
        found[name] = (ends[0], ends[1], node)
    return found


def _links(relations: Mapping[str, tuple[End, End, XmlNode]]) -> dict[End, list[End]]:
    links: dict[End, list[End]] = {}
    for one, other, node in relations.values():
        text = (node.text("navigability") or "Both").lower()
        if text not in NAVIGABLE:
            raise node.error(f"navigability: {text!r} is none of Both, AB, BA, None")
        there, back = NAVIGABLE[text]
        if there:
            links.setdefault(one, []).append(other)
        if back:
            links.setdefault(other, []).append(one)
    return links


def _switches(
    root: XmlNode, relations: Mapping[str, tuple[End, End, XmlNode]]
) -> list[SurveyedSwitch] | None:
    """The simple switches of the topology; None if some junction is no simple switch."""
    meets: dict[End, list[End]] = {}
    for one, other, _ in relations.values():
        meets.setdefault(one, []).append(other)
        meets.setdefault(other, []).append(one)
    sides: dict[str, tuple[str, str]] = {}
    for node in root.all(*FUNCTIONAL, "switchesIS", "switchIS"):
        for side in ("left", "right"):
            branch = node.first(f"{side}Branch")
            ref = branch.text("netRelationRef") if branch is not None else None
            if branch is not None and ref and ref in relations:
                sides[ref] = (file_name(node.name()), side)
    pairs = {frozenset(each[:2]): name for name, each in relations.items()}
    found = []
    for tip, legs in meets.items():
        if len(legs) < 2:
            continue
        simple = all(meets[leg] == [tip] for leg in legs)
        if len(legs) != 2 or not simple:
            return None
        known = [sides.get(pairs[frozenset((tip, leg))], ("", "")) for leg in legs]
        left, right = legs if known[0][1] == "left" or known[1][1] == "right" else legs[::-1]
        name = known[0][0] or known[1][0] or f"{tip[0]}-{'end' if tip[1] else 'start'}"
        found.append(SurveyedSwitch(name, tip, left, right))
    return found


def _open_ends(
    root: XmlNode, places: RailmlPlaces, links: Mapping[End, Sequence[End]]
) -> tuple[str, ...]:
    """A sentence about ends that lead nowhere and at which the file has no buffer stop."""
    closed: set[End] = set()
    for path in (("bufferStops", "bufferStop"), ("borders", "border")):
        for node in root.all(*FUNCTIONAL, *path):
            for spot in places.spots(node):
                closed.add((spot.track, spot.position_m > places.lengths_m[spot.track] / 2.0))
    linked = {*links, *(end for ends in links.values() for end in ends)}
    open_ends = [
        f"{name} {'end' if at_end else 'begin'}"
        for name in places.lengths_m
        for at_end in (False, True)
        if (name, at_end) not in linked and (name, at_end) not in closed
    ]
    if not open_ends:
        return ()
    return (f"track ends: taken for buffer stops: {', '.join(open_ends)}",)


def _limits(root: XmlNode, places: RailmlPlaces) -> list[TrackRange]:
    found = []
    for node in root.all(*FUNCTIONAL, "speeds", "speedSection"):
        text = node.text("maxSpeed")
        if text is None or text == "end":
            continue
        kmh = node.number("maxSpeed")
        if kmh is None or not kmh > 0.0:
            raise node.error(f"maxSpeed: {text!r} is not positive; write km/h")
        # Decimal, so that a limit in m/s is the same after export and import.
        limit_mps = float(Decimal(text) / KMH_PER_MPS)
        found += [
            TrackRange(track, begin_m, end_m, limit_mps, forward)
            for track, begin_m, end_m, forward, _ in places.ranges(node)
        ]
    return found


def _branch_limits(
    root: XmlNode, places: RailmlPlaces, relations: Mapping[str, tuple[End, End, XmlNode]]
) -> list[TrackRange]:
    """Limits on the legs of switches, from the switch on, for branching and for joining trains."""
    found = []
    for node in root.all(*FUNCTIONAL, "switchesIS", "switchIS"):
        branches = [
            (branch, relations[ref][:2])
            for side in ("left", "right")
            for branch in node.all(f"{side}Branch")
            if (ref := branch.text("netRelationRef") or "") in relations
        ]
        if len(branches) != 2:
            continue
        common = {*branches[0][1]} & {*branches[1][1]}
        for branch, ends in branches:
            legs = [end for end in ends if end not in common]
            speeds_mps = _branch_speeds_mps(branch)
            if len(legs) == 1:
                length_m = branch.number("length") or TURNOUT_M
                found += _leg_limits(places, legs[0], speeds_mps, length_m)
    return found


def _branch_speeds_mps(branch: XmlNode) -> tuple[float | None, float | None]:
    """Speeds of branching and of joining trains. One of them counts for both."""
    speeds_mps = []
    for name in ("branchingSpeed", "joiningSpeed"):
        text, value = branch.text(name), branch.number(name)
        if value is not None and not value > 0.0:
            raise branch.error(f"{name}: {text!r} is not positive; write km/h")
        speeds_mps.append(None if text is None else float(Decimal(text) / KMH_PER_MPS))
    branching_mps, joining_mps = speeds_mps
    return branching_mps or joining_mps, joining_mps or branching_mps


def _leg_limits(
    places: RailmlPlaces,
    leg: End,
    speeds_mps: tuple[float | None, float | None],
    length_m: float,
) -> list[TrackRange]:
    track, at_end = leg
    whole_m = places.lengths_m[track]
    reach_m = min(abs(length_m), whole_m)
    begin_m, end_m = (whole_m - reach_m, whole_m) if at_end else (0.0, reach_m)
    # A branching train leaves the switch, so it runs from this end of the leg.
    ways = (not at_end, at_end)
    return [
        TrackRange(track, begin_m, end_m, speed_mps, forward)
        for speed_mps, forward in zip(speeds_mps, ways, strict=True)
        if speed_mps is not None
    ]


def _curves(
    root: XmlNode, places: RailmlPlaces, group: str, kind: str, value: str
) -> list[TrackRange]:
    found = []
    for node in root.all(*GEOMETRY, group, kind):
        number = node.number(value)
        if not number:
            continue
        for track, begin_m, end_m, forward, _ in places.ranges(node):
            # A gradient against the netElement falls along it.
            sign = -1.0 if forward is False and value == "gradient" else 1.0
            found.append(TrackRange(track, begin_m, end_m, sign * number))
    return found


def _tags(root: XmlNode, places: RailmlPlaces) -> list[SurveyedTag]:
    """Tags of an export of this project; foreign balises have other telegrams."""
    return [
        SurveyedTag(spot.track, spot.position_m, keys)
        for node in root.all(*FUNCTIONAL, "balises", "balise")
        if (keys := tag_keys(node))
        for spot in places.spots(node)
    ]


def _ignored(root: XmlNode) -> tuple[str, ...]:
    found = [
        f"{kind}: {why}"
        for (group, kind), why in IGNORED.items()
        if root.first(*FUNCTIONAL, group, kind)
    ]
    if any(not tag_keys(node) for node in root.all(*FUNCTIONAL, "balises", "balise")):
        found.append("balise: the rules lay out tags of their own")
    if root.first("interlocking") is not None:
        found.append("interlocking: the bench runs one train")
    return tuple(found)


def check_version(root: XmlNode) -> None:
    """Raise SettingsError unless the file is railML 3."""
    if root.tag.lower() != "railml":
        raise SettingsError(f"{root.source}: {root.tag}: is not railML; the root must be railML")
    version = root.text("version") or ""
    if not version.startswith("3"):
        raise root.error(
            f"version {version!r} is not 3.x; convert the file to railML 3, whose tracks are "
            "netElements"
        )
