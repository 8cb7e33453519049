"""Writes a network as infrastructure of railML 3.2, with the speeds of its switches' branches."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from firmware_py.trackdb import PlatformSide
from firmware_py.trackdb.network import Running, Serves, Track, TrackNetwork
from metro_hil.exchange.railml_export import (
    NAMESPACE,
    decimal_text,
    kmh,
    write_geometry,
    write_name,
    write_power_sections,
    write_tunnels,
)
from metro_hil.exchange.railml_own import REGISTER
from metro_hil.exchange.survey import file_name

IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
DIRECTIONS: Final = {Serves.UP: "normal", Serves.DOWN: "reverse", Serves.BOTH: "both"}
BRANCH_M: Final = 30.0
"""Length of a leg whose least limit is the speed of the branch."""


@dataclass(frozen=True, slots=True)
class ExportedNetwork:
    """A network with the table of its file, which the import takes back unchanged."""

    network: TrackNetwork
    table: dict[str, Any]


def railml_network_text(exported: ExportedNetwork) -> str:
    """The network as a railML file: one netElement for each track."""
    network = exported.network
    root = Element("railML", {"xmlns": NAMESPACE, "version": "3.2"})
    _systems(root, network)
    infrastructure = SubElement(root, "infrastructure", {"id": "is_network"})
    _topology(infrastructure, network)
    curves = [(track, each) for track in network.tracks for each in track.curves]
    grades = [(track, each) for track in network.tracks for each in track.gradients]
    write_geometry(infrastructure, curves, grades, _range)
    functional = SubElement(infrastructure, "functionalInfrastructure")
    _buffer_stops(functional, network)
    sections = [(track, each) for track in network.tracks for each in track.power_sections]
    write_power_sections(functional, sections, _range)
    _line(functional, exported)
    platforms = Element("platforms")
    _stations(functional, network, platforms)
    tunnels = [(track, each) for track in network.tracks for each in track.tunnels]
    write_tunnels(functional, tunnels, _range)
    functional.extend([platforms] if len(platforms) else [])
    _speeds(functional, network)
    _switches(functional, network)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _id(track: str) -> str:
    """The id of a track's netElement: its name, where that is an id of XML."""
    return track if IDENTIFIER.fullmatch(track) else f"ne_{file_name(track)}"


def _difference(at_m: float, from_m: float) -> str:
    return decimal_text(Decimal(repr(float(at_m))) - Decimal(repr(float(from_m))))


def _systems(root: Element, network: TrackNetwork) -> None:
    """Each track has a chainage of its own."""
    positioning = SubElement(SubElement(root, "common", {"id": "co_network"}), "positioning")
    systems = SubElement(positioning, "linearPositioningSystems")
    for track in network.tracks:
        keys = {
            "id": f"lps_{_id(track.name)}",
            "units": "m",
            "startMeasure": decimal_text(track.start_m),
            "endMeasure": decimal_text(track.end_m),
            "linearReferencingMethod": "absolute",
        }
        system = SubElement(systems, "linearPositioningSystem", keys)
        write_name(system, f"chainage of {track.name}")
        SubElement(system, "isValid")


def _topology(parent: Element, network: TrackNetwork) -> None:
    topology = SubElement(parent, "topology")
    elements = SubElement(topology, "netElements")
    for track in network.tracks:
        name = _id(track.name)
        length = {"id": name, "length": _difference(track.end_m, track.start_m)}
        element = SubElement(elements, "netElement", length)
        keys = {"id": f"{name}_aps", "positioningSystemRef": f"lps_{name}"}
        system = SubElement(element, "associatedPositioningSystem", keys)
        for end, at_m in enumerate((track.start_m, track.end_m)):
            keys = {"id": f"{name}_ic{end}", "intrinsicCoord": str(end)}
            place = {"positioningSystemRef": f"lps_{name}", "measure": decimal_text(at_m)}
            SubElement(SubElement(system, "intrinsicCoordinate", keys), "linearCoordinate", place)
    relations = SubElement(topology, "netRelations")
    for name, one, other, navigability in _relations(network):
        keys = {"id": name, "navigability": navigability}
        ends = {"A": one.rpartition("."), "B": other.rpartition(".")}
        keys |= {f"positionOn{side}": str(int(end[2] == "end")) for side, end in ends.items()}
        relation = SubElement(relations, "netRelation", keys)
        for side, (name, _, _) in ends.items():
            SubElement(relation, f"element{side}", {"ref": _id(name)})


def _relations(network: TrackNetwork) -> Iterator[tuple[str, str, str, str]]:
    """Id, both ends and navigability of each relation."""
    for number, join in enumerate(network.joins, start=1):
        yield f"nr_join{number}", join.a, join.b, "Both"
    for number, switch in enumerate(network.switches, start=1):
        yield f"nr_swi{number}_left", switch.tip, switch.left, "Both"
        yield f"nr_swi{number}_right", switch.tip, switch.right, "Both"
        yield f"nr_swi{number}_none", switch.left, switch.right, "None"


def _range(
    parent: Element, track: Track, start_m: float, end_m: float, direction: str = "normal"
) -> Element:
    keys = {"id": f"{parent.get('id')}_loc", "applicationDirection": direction}
    location = SubElement(parent, "linearLocation", keys)
    part = {
        "netElementRef": _id(track.name),
        "keepsOrientation": "true",
        "posBegin": _difference(start_m, track.start_m),
        "posEnd": _difference(end_m, track.start_m),
    }
    return SubElement(location, "associatedNetElement", part)


def _buffer_stops(parent: Element, network: TrackNetwork) -> None:
    if not network.buffer_stops:
        return
    group = SubElement(parent, "bufferStops")
    for number, end in enumerate(network.buffer_stops, start=1):
        name, _, side = end.rpartition(".")
        track = network.track(name)
        at_m = track.end_m if side == "end" else track.start_m
        stop = SubElement(group, "bufferStop", {"id": f"bus{number}"})
        place = {
            "id": f"bus{number}_loc",
            "netElementRef": _id(name),
            "pos": _difference(at_m, track.start_m),
        }
        SubElement(stop, "spotLocation", place)


def _line(parent: Element, exported: ExportedNetwork) -> None:
    """The network as a line, whose designator has the table of the file."""
    line = SubElement(SubElement(parent, "lines"), "line", {"id": "line1"})
    write_name(line, exported.network.name)
    if exported.table:
        entry = json.dumps({"network": exported.table}, ensure_ascii=False, sort_keys=True)
        SubElement(line, "designator", {"register": REGISTER, "entry": entry})


def _stations(parent: Element, network: TrackNetwork, platforms: Element) -> None:
    """Write stations, and their platforms into a group of their own."""
    edges = [(track, edge) for track in network.tracks for edge in track.platforms]
    if not edges:
        return
    points = SubElement(parent, "operationalPoints")
    for number, station in enumerate(dict.fromkeys(edge.station for _, edge in edges), start=1):
        point = SubElement(points, "operationalPoint", {"id": f"opp{number}"})
        write_name(point, station)
        equipment = SubElement(point, "opEquipment")
        for index, (track, edge) in enumerate(edges, start=1):
            if edge.station != station:
                continue
            SubElement(equipment, "ownsPlatform", {"ref": f"plf{index}"})
            platform = SubElement(platforms, "platform", {"id": f"plf{index}"})
            write_name(platform, station)
            part = _range(platform, track, edge.start_m, edge.end_m)
            for end, at_m in (("Begin", edge.start_m), ("End", edge.end_m)):
                keys = {
                    "positioningSystemRef": f"lps_{_id(track.name)}",
                    "measure": decimal_text(at_m),
                }
                if edge.side is not PlatformSide.NONE:
                    keys["lateralSide"] = edge.side.value
                SubElement(part, f"linearCoordinate{end}", keys)


def _speeds(parent: Element, network: TrackNetwork) -> None:
    group = SubElement(parent, "speeds")
    limits = [(track, limit) for track in network.tracks for limit in track.limits]
    for number, (track, limit) in enumerate(limits, start=1):
        keys = {"id": f"sps{number}", "maxSpeed": decimal_text(kmh(limit.limit_mps))}
        section = SubElement(group, "speedSection", keys)
        _range(section, track, limit.start_m, limit.end_m, DIRECTIONS[limit.direction])


def _switches(parent: Element, network: TrackNetwork) -> None:
    if not network.switches:
        return
    group = SubElement(parent, "switchesIS")
    for number, switch in enumerate(network.switches, start=1):
        node = SubElement(group, "switchIS", {"id": f"swi{number}", "type": "ordinarySwitch"})
        write_name(node, switch.name)
        for side, end in (("left", switch.left), ("right", switch.right)):
            branching_mps, joining_mps = _branch_mps(network, end)
            keys = {
                "netRelationRef": f"nr_swi{number}_{side}",
                "branchingSpeed": decimal_text(kmh(branching_mps)),
                "joiningSpeed": decimal_text(kmh(joining_mps)),
            }
            SubElement(node, f"{side}Branch", keys)


def _branch_mps(network: TrackNetwork, end: str) -> Sequence[float]:
    """Least limit of a leg near its switch, for branching and for joining trains."""
    name, _, side = end.rpartition(".")
    track = network.track(name)
    begin_m, finish_m = track.start_m, min(track.start_m + BRANCH_M, track.end_m)
    ways = (Running.UP, Running.DOWN)
    if side == "end":
        begin_m, finish_m = max(track.end_m - BRANCH_M, track.start_m), track.end_m
        ways = (Running.DOWN, Running.UP)
    return [
        min(
            limit.limit_mps
            for limit in track.limits_for(running)
            if limit.start_m < finish_m and limit.end_m > begin_m
        )
        for running in ways
    ]
