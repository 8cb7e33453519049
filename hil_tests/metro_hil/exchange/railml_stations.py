"""Stations of railML 3: operational points with their platforms and stopping places."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from firmware_py.settings import SettingsError
from metro_hil.exchange.railml_own import own_keys
from metro_hil.exchange.railml_places import RailmlPlaces
from metro_hil.exchange.surveyed_network import (
    STOP_BEFORE_BUFFER_M,
    STOP_BEFORE_END_M,
    SurveyedPlatform,
)
from metro_hil.exchange.track_graph import PlaceOnTrack
from metro_hil.exchange.xml_node import XmlNode

FUNCTIONAL: Final = ("infrastructure", "functionalInfrastructure")
SIDES: Final = ("left", "right", "both")


@dataclass(slots=True)
class Stations:
    """Stations of a file, by name."""

    places: dict[str, list[PlaceOnTrack]] = field(default_factory=dict)
    platforms: list[SurveyedPlatform] = field(default_factory=list)
    keys: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    exact: frozenset[str] = frozenset()
    filled: tuple[str, ...] = ()
    left_out: list[str] = field(default_factory=list)
    """Sentences about platforms whose place is wrong."""


@dataclass(frozen=True, slots=True)
class _Owners:
    """The station of each platform, stopping place and netElement."""

    by_id: Mapping[str, str]
    by_track: Mapping[str, str]

    def of(self, names: Sequence[str | None], tracks: Sequence[str]) -> str | None:
        """The station that owns an object of one of these ids, or else one of the tracks."""
        for name in names:
            if name is not None and name in self.by_id:
                return self.by_id[name]
        return next((self.by_track[track] for track in tracks if track in self.by_track), None)


def read_stations(root: XmlNode, places: RailmlPlaces) -> Stations:
    """Read where trains stop. Raises SettingsError that names file and element."""
    stations = Stations()
    points = _named(root, "operationalPoints", "operationalPoint")
    owners = _owners(root, points, places)
    _add_platforms(root, places, owners, stations)
    _add_stopping_places(root, places, owners, stations)
    for name, node in points.items():
        stations.keys[name] = own_keys(node)
        if name not in stations.places:
            spots = places.spots(node)
            if spots:
                stations.places[name] = spots
    with_platform = {platform.station for platform in stations.platforms} - stations.exact
    if with_platform:
        stations.filled = (
            f"stopping points: {STOP_BEFORE_END_M:g} m before the end of a platform whose file "
            f"gives none, and at least {STOP_BEFORE_BUFFER_M:g} m before the end of the track",
        )
    return stations


def _named(root: XmlNode, group: str, kind: str) -> dict[str, XmlNode]:
    """Objects by name; a name that occurs again has the id behind it."""
    found: dict[str, XmlNode] = {}
    for node in root.all(*FUNCTIONAL, group, kind):
        name = node.name()
        if name in found:
            name = f"{name} {node.need('id', 'give it an id')}"
        found[name] = node
    return found


def _owners(root: XmlNode, points: Mapping[str, XmlNode], places: RailmlPlaces) -> _Owners:
    by_id: dict[str, str] = {}
    by_track: dict[str, str] = {}
    for name, node in points.items():
        for kind in ("ownsPlatform", "ownsStoppingPlace", "ownsInfrastructureElement"):
            for each in node.all("opEquipment", kind):
                by_id[each.need("ref", "name the object")] = name
        for track, *_ in places.ranges(node):
            by_track.setdefault(track, name)
    for platform in root.all(*FUNCTIONAL, "platforms", "platform"):
        owner = by_id.get(platform.text("id") or "")
        for edge in platform.all("ownsPlatformEdge"):
            if owner is not None:
                by_id[edge.need("ref", "name the platform edge")] = owner
    return _Owners(by_id, by_track)


def _edges(root: XmlNode) -> Iterator[XmlNode]:
    yield from root.all(*FUNCTIONAL, "platformEdges", "platformEdge")
    yield from root.all(*FUNCTIONAL, "platforms", "platform")


def _add_platforms(
    root: XmlNode, places: RailmlPlaces, owners: _Owners, stations: Stations
) -> None:
    taken: set[tuple[str, str]] = set()
    for node in _edges(root):
        try:
            ranges = list(places.ranges(node))
        except SettingsError as error:
            # Other platforms may be right, and a path may not pass this one.
            stations.left_out.append(str(error).removeprefix(f"{node.source}: "))
            continue
        if not ranges:
            continue
        names = [node.text(key) for key in ("id", "belongsToPlatform", "belongsToParent")]
        owner = owners.of(names, [track for track, *_ in ranges])
        station = owner if owner is not None else _fresh(node, stations)
        for track, begin_m, end_m, _, part in ranges:
            if (station, track) in taken and node.tag == "platform":
                continue  # the platform of edges that are already there
            taken.add((station, track))
            if places.has_ends(part):
                platform = SurveyedPlatform(station, track, begin_m, end_m, _side(part))
                stations.platforms.append(platform)
            stations.places.setdefault(station, []).append(
                PlaceOnTrack(track, (begin_m + end_m) / 2.0)
            )


def _fresh(node: XmlNode, stations: Stations) -> str:
    """The platform's own name, if no station has it."""
    name = node.name()
    return f"{name} {node.text('id')}" if name in stations.places else name


def _side(part: XmlNode) -> str | None:
    for end in ("Begin", "End"):
        coordinate = part.first(f"linearCoordinate{end}")
        side = coordinate.text("lateralSide") if coordinate is not None else None
        if coordinate is not None and side is not None:
            if side not in SIDES:
                raise coordinate.error(f"lateralSide: {side!r} is none of left, right, both")
            return side
    return None


def _add_stopping_places(
    root: XmlNode, places: RailmlPlaces, owners: _Owners, stations: Stations
) -> None:
    found: dict[str, list[PlaceOnTrack]] = {}
    for node in root.all(*FUNCTIONAL, "stoppingPlaces", "stoppingPlace"):
        spots = places.spots(node)
        edges = [each.text("ref") for each in node.all("allowsUsageOfPlatformEdge")]
        owner = owners.of([node.text("id"), *edges, node.text("platformEdgeRef")], [])
        if spots:
            found.setdefault(owner if owner is not None else node.name(), []).extend(spots)
    stations.places.update(found)
    stations.exact = frozenset(found)
