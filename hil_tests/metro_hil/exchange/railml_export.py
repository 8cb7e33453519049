"""Writes a line as infrastructure of railML 3.2."""

import json
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Any, Final, Protocol, TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from firmware_py.trackdb import LineMap, Station
from firmware_py.trackdb.sites import CurveSection, GradientSection, TrackStretch, TunnelSection
from metro_hil.exchange.railml_own import OWN_ZONES, REGISTER

NAMESPACE: Final = "https://www.railml.org/schemas/3.2"
TRACK: Final = "ne_track"
SYSTEM: Final = "lps_line"
KMH_PER_MPS: Final = Decimal("3.6")
NO_SIDE: Final = "none"
"""Side of a siding, which railML has no word for."""
LANGUAGE: Final = "en"
SHORT_DECIMALS: Final = 9
Owner = TypeVar("Owner")
"""A line or a track."""


class NamedStretch(TrackStretch, Protocol):
    """A stretch of a line or track with a name."""

    @property
    def name(self) -> str: ...


def railml_text(line: LineMap) -> str:
    """The line as a railML file: one netElement whose chainage is that of the line."""
    root = Element("railML", {"xmlns": NAMESPACE, "version": "3.2"})
    _common(root, line)
    infrastructure = SubElement(root, "infrastructure", {"id": "is_line"})
    _topology(infrastructure, line)
    curves = [(line, each) for each in line.curves]
    grades = [(line, each) for each in line.gradients]
    write_geometry(infrastructure, curves, grades, _range)
    functional = SubElement(infrastructure, "functionalInfrastructure")
    _balises(functional, line)
    _buffer_stops(functional, line)
    write_power_sections(functional, [(line, each) for each in line.power_sections], _range)
    _line(functional, line)
    _operational_points(functional, line)
    write_tunnels(functional, [(line, each) for each in line.tunnels], _range)
    _platforms(functional, line)
    _speeds(functional, line)
    _stopping_places(functional, line)
    _tracks(functional, line)
    ElementTree.indent(root)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        + ElementTree.tostring(root, encoding="unicode")
        + "\n"
    )


def decimal_text(number: float | Decimal) -> str:
    """A number as xs:decimal, which has no exponent, with all its digits."""
    text = format(number if isinstance(number, Decimal) else Decimal(repr(float(number))), "f")
    return text.rstrip("0").rstrip(".") if "." in text else text


def kmh(speed_mps: float) -> Decimal:
    """A speed in km/h, with as few digits as give the same m/s again."""
    exact = Decimal(repr(speed_mps)) * KMH_PER_MPS
    short = round(exact, SHORT_DECIMALS)
    return short if float(short / KMH_PER_MPS) == speed_mps else exact


def _common(root: Element, line: LineMap) -> None:
    systems = SubElement(
        SubElement(SubElement(root, "common", {"id": "co_line"}), "positioning"),
        "linearPositioningSystems",
    )
    system = SubElement(
        systems,
        "linearPositioningSystem",
        {
            "id": SYSTEM,
            "units": "m",
            "startMeasure": decimal_text(line.start_m),
            "endMeasure": decimal_text(line.end_m),
            "linearReferencingMethod": "absolute",
        },
    )
    write_name(system, f"chainage of {line.name}")
    SubElement(system, "isValid")


def write_name(parent: Element, name: str) -> None:
    SubElement(parent, "name", {"name": name, "language": LANGUAGE})


def write_own(parent: Element, keys: Mapping[str, Any]) -> None:
    """Keys that railML has no place for."""
    entry = json.dumps(keys, ensure_ascii=False, sort_keys=True)
    SubElement(parent, "designator", {"register": REGISTER, "entry": entry})


def _topology(parent: Element, line: LineMap) -> None:
    topology = SubElement(parent, "topology")
    element = SubElement(
        SubElement(topology, "netElements"),
        "netElement",
        {"id": TRACK, "length": decimal_text(_length(line))},
    )
    system = SubElement(
        element,
        "associatedPositioningSystem",
        {"id": f"{TRACK}_aps", "positioningSystemRef": SYSTEM},
    )
    for end, at_m in enumerate((line.start_m, line.end_m)):
        intrinsic = SubElement(
            system, "intrinsicCoordinate", {"id": f"{TRACK}_ic{end}", "intrinsicCoord": str(end)}
        )
        _coordinate(intrinsic, "linearCoordinate", at_m)
    network = SubElement(SubElement(topology, "networks"), "network", {"id": "nw_line"})
    level = SubElement(network, "level", {"id": "lv_micro", "descriptionLevel": "Micro"})
    SubElement(level, "networkResource", {"ref": TRACK})


def _length(line: LineMap) -> Decimal:
    return Decimal(repr(line.end_m)) - Decimal(repr(line.start_m))


def _position(line: LineMap, at_m: float) -> str:
    return decimal_text(Decimal(repr(float(at_m))) - Decimal(repr(float(line.start_m))))


def _coordinate(parent: Element, tag: str, at_m: float, side: str | None = None) -> None:
    keys = {"positioningSystemRef": SYSTEM, "measure": decimal_text(at_m)}
    SubElement(parent, tag, keys | ({"lateralSide": side} if side not in (None, NO_SIDE) else {}))


def _range(
    parent: Element, line: LineMap, start_m: float, end_m: float, side: str | None = None
) -> None:
    location = SubElement(
        parent,
        "linearLocation",
        {"id": f"{parent.get('id')}_loc", "applicationDirection": "normal"},
    )
    part = SubElement(
        location,
        "associatedNetElement",
        {
            "netElementRef": TRACK,
            "keepsOrientation": "true",
            "posBegin": _position(line, start_m),
            "posEnd": _position(line, end_m),
        },
    )
    _coordinate(part, "linearCoordinateBegin", start_m, side)
    _coordinate(part, "linearCoordinateEnd", end_m, side)


def _spot(parent: Element, line: LineMap, at_m: float) -> None:
    location = SubElement(
        parent,
        "spotLocation",
        {
            "id": f"{parent.get('id')}_loc",
            "netElementRef": TRACK,
            "applicationDirection": "normal",
            "pos": _position(line, at_m),
        },
    )
    _coordinate(location, "linearCoordinate", at_m)


def write_geometry(
    parent: Element,
    curves: Sequence[tuple[Owner, CurveSection]],
    grades: Sequence[tuple[Owner, GradientSection]],
    place: Callable[[Element, Owner, float, float], object],
) -> None:
    """Write curves and gradients.

    Args:
        curves: each with its line or track, like the gradients.
        place: writes where a curve or gradient lies, from its start to its end in m.
    """
    if not curves and not grades:
        return
    geometry = SubElement(parent, "geometry")
    if curves:
        group = SubElement(geometry, "horizontalCurves")
        for number, (owner, curve) in enumerate(curves, start=1):
            keys = {"id": f"hc{number}", "curveType": "arc", "radius": decimal_text(curve.radius_m)}
            place(SubElement(group, "horizontalCurve", keys), owner, curve.start_m, curve.end_m)
    if grades:
        group = SubElement(geometry, "gradientCurves")
        for number, (owner, grade) in enumerate(grades, start=1):
            permille = decimal_text(grade.gradient_permille)
            keys = {"id": f"gc{number}", "curveType": "straight", "gradient": permille}
            place(SubElement(group, "gradientCurve", keys), owner, grade.start_m, grade.end_m)


def write_power_sections(
    parent: Element,
    sections: Sequence[tuple[Owner, NamedStretch]],
    place: Callable[[Element, Owner, float, float], object],
) -> None:
    """Write power sections, each with its line or track; see `write_geometry`."""
    if not sections:
        return
    group = SubElement(parent, "electrifications")
    for number, (owner, section) in enumerate(sections, start=1):
        node = SubElement(group, "electrificationSection", {"id": f"els{number}"})
        write_name(node, section.name)
        place(node, owner, section.start_m, section.end_m)


def write_tunnels(
    parent: Element,
    tunnels: Sequence[tuple[Owner, TunnelSection]],
    place: Callable[[Element, Owner, float, float], object],
) -> None:
    """Write tunnels, each with its line or track; see `write_geometry`."""
    if not tunnels:
        return
    group = SubElement(parent, "overCrossings")
    for number, (owner, tunnel) in enumerate(tunnels, start=1):
        keys = {"id": f"ovc{number}", "constructionType": "tunnel"}
        node = SubElement(group, "overCrossing", keys)
        write_name(node, tunnel.name or keys["id"])
        place(node, owner, tunnel.start_m, tunnel.end_m)
        write_own(node, {"drag_ratio": tunnel.drag_ratio, "name": tunnel.name})


def _balises(parent: Element, line: LineMap) -> None:
    if not line.tags:
        return
    group = SubElement(parent, "balises")
    for tag in line.tags:
        node = SubElement(group, "balise", {"id": f"bal{tag.tag_id}", "type": "fixed"})
        where = f" of {tag.station}" if tag.station is not None else ""
        write_name(node, f"{tag.kind.value} {tag.tag_id}{where}")
        _spot(node, line, tag.position_m)
        keys: dict[str, Any] = {"tag_id": tag.tag_id, "kind": tag.kind.value}
        write_own(node, keys | ({"station": tag.station} if tag.station is not None else {}))


def _buffer_stops(parent: Element, line: LineMap) -> None:
    """The ends of the netElement; trains of the line see no track beyond them."""
    group = SubElement(parent, "bufferStops")
    for name, at_m in (("bus_start", line.start_m), ("bus_end", line.end_m)):
        _spot(SubElement(group, "bufferStop", {"id": name}), line, at_m)


def _line(parent: Element, line: LineMap) -> None:
    node = SubElement(SubElement(parent, "lines"), "line", {"id": "line1"})
    write_name(node, line.name)
    _range(node, line, line.start_m, line.end_m)
    keys: dict[str, Any] = {
        "name": line.name,
        "description": line.description,
        "rollback_m": line.rollback_m,
    }
    for key in OWN_ZONES:
        if zones := getattr(line, key):
            keys[key] = [
                {"start_m": each.start_m, "end_m": each.end_m}
                | ({"name": each.name} if each.name else {})
                for each in zones
            ]
    # Without this, the import would lay out tags by its rules.
    write_own(node, keys if line.tags else keys | {"tags": []})


def _numbered(line: LineMap) -> Sequence[tuple[int, Station]]:
    return list(enumerate(line.stations, start=1))


def _operational_points(parent: Element, line: LineMap) -> None:
    group = SubElement(parent, "operationalPoints")
    for number, station in _numbered(line):
        node = SubElement(group, "operationalPoint", {"id": f"opp{number}"})
        write_name(node, station.name)
        _spot(node, line, station.stop_m)
        write_own(node, _station_keys(station))
        equipment = SubElement(node, "opEquipment")
        SubElement(equipment, "ownsPlatform", {"ref": f"plf{number}"})
        SubElement(equipment, "ownsStoppingPlace", {"ref": f"stp{number}"})
        operations = SubElement(node, "opOperations")
        SubElement(
            operations, "opOperation", {"operationalType": "station", "trafficType": "passenger"}
        )


def _station_keys(station: Station) -> dict[str, Any]:
    keys: dict[str, Any] = {
        "dwell_s": station.dwell_s,
        "run_s": station.run_s,
        "platform_doors": station.platform_doors,
    }
    if station.side.value == NO_SIDE:
        keys["side"] = NO_SIDE
    if station.short_stops:
        keys["short_stops"] = [
            {"train_length_max_m": each.train_length_max_m, "stop_m": each.stop_m}
            for each in station.short_stops
        ]
    return keys


def _platforms(parent: Element, line: LineMap) -> None:
    """A platform and its edge; the side is that of a train in running direction."""
    platforms = SubElement(parent, "platforms")
    edges = SubElement(parent, "platformEdges")
    for number, station in _numbered(line):
        ends_m = (station.platform_start_m, station.platform_end_m)
        platform = SubElement(platforms, "platform", {"id": f"plf{number}"})
        write_name(platform, station.name)
        _range(platform, line, *ends_m, station.side.value)
        SubElement(platform, "ownsPlatformEdge", {"ref": f"ple{number}"})
        edge = SubElement(
            edges, "platformEdge", {"id": f"ple{number}", "belongsToPlatform": f"plf{number}"}
        )
        _range(edge, line, *ends_m, station.side.value)


def _speeds(parent: Element, line: LineMap) -> None:
    group = SubElement(parent, "speeds")
    for number, section in enumerate(line.speed_sections, start=1):
        keys = {"id": f"sps{number}", "maxSpeed": decimal_text(kmh(section.limit_mps))}
        _range(SubElement(group, "speedSection", keys), line, section.start_m, section.end_m)


def _stopping_places(parent: Element, line: LineMap) -> None:
    group = SubElement(parent, "stoppingPlaces")
    for number, station in _numbered(line):
        keys = {"id": f"stp{number}", "trainRelation": "headOfTrain"}
        node = SubElement(group, "stoppingPlace", keys)
        write_name(node, station.name)
        _spot(node, line, station.stop_m)
        SubElement(node, "allowsUsageOfPlatformEdge", {"ref": f"ple{number}"})


def _tracks(parent: Element, line: LineMap) -> None:
    node = SubElement(SubElement(parent, "tracks"), "track", {"id": "trk1", "type": "mainTrack"})
    _range(node, line, line.start_m, line.end_m)
    SubElement(node, "trackBegin", {"ref": "bus_start"})
    SubElement(node, "trackEnd", {"ref": "bus_end"})
    SubElement(node, "length", {"type": "physical", "value": decimal_text(_length(line))})
