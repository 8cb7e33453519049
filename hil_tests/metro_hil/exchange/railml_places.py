"""Places of railML 3: the netElements of the track level, and what lies where on them."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from firmware_py.settings import nearest
from metro_hil.exchange.track_graph import PlaceOnTrack
from metro_hil.exchange.xml_node import XmlNode

UNITS: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometres", "kilometer", "kilometers"), 1000.0),
}
"""Metres for each unit of a linear positioning system, in small letters."""
COLLECTIONS: Final = ("elementCollectionUnordered", "elementCollectionOrdered")
MILLIMETRES: Final = 3
TOLERANCE_M: Final = 1.0
"""A place may lie this far beyond an end of its netElement; rounded files have such places."""
DIRECTIONS: Final = {"both": None, "normal": True, "reverse": False, None: None}


@dataclass(frozen=True, slots=True)
class Mileage:
    """Chainages at both ends of a netElement in one linear positioning system, m."""

    begin_m: float
    end_m: float

    def position_m(self, measure_m: float, length_m: float) -> float:
        """Distance from the netElement's begin."""
        if self.end_m == self.begin_m:
            return 0.0
        if abs(abs(self.end_m - self.begin_m) - length_m) < TOLERANCE_M:
            # The same scale: no division, so that chainages keep all their digits.
            return (measure_m - self.begin_m) * (1.0 if self.end_m > self.begin_m else -1.0)
        return (measure_m - self.begin_m) / (self.end_m - self.begin_m) * length_m


@dataclass(frozen=True, slots=True)
class RailmlPlaces:
    """The netElements of the track level, and the ones that others are made of."""

    metres_per_unit: Mapping[str, float]
    """Metres for each unit of each linear positioning system."""
    lengths_m: dict[str, float]
    mileages: dict[str, dict[str, Mileage]]
    parts: dict[str, list[str]] = field(default_factory=dict)
    """NetElements of the track level that a collection has."""
    shared: list[str] = field(default_factory=list)
    """NetElements whose length is a share of that of their track."""

    def elements(self, node: XmlNode, name: str = "netElementRef") -> list[str]:
        """The netElements of the track level that an attribute refers to."""
        ref = node.need(name, "name the netElement on which it lies")
        if ref in self.lengths_m:
            return [ref]
        if ref in self.parts:
            return self.parts[ref]
        hint = nearest(ref, [*self.lengths_m, *self.parts], "netElement")
        raise node.error(f"{name}: there is no netElement {ref!r}; {hint}")

    def spots(self, entity: XmlNode) -> list[PlaceOnTrack]:
        """The places of the entity's spot locations on the track level."""
        found = []
        for spot in entity.all("spotLocation"):
            for track in self.elements(spot):
                position_m = self._position_m(
                    spot, track, "pos", "intrinsicCoord", "linearCoordinate"
                )
                if position_m is not None and self._is_on(position_m, track):
                    found.append(PlaceOnTrack(track, self._clipped_m(position_m, track)))
        return list(dict.fromkeys(found))

    def ranges(self, entity: XmlNode) -> Iterator[tuple[str, float, float, bool | None, XmlNode]]:
        """Track, begin, end, direction and element of each range of the entity."""
        for kind in ("linearLocation", "areaLocation"):
            for location in entity.all(kind):
                direction = location.text("applicationDirection")
                if direction not in DIRECTIONS:
                    raise location.error(
                        f"applicationDirection: {direction!r} is none of both, normal, reverse"
                    )
                for part in location.all("associatedNetElement"):
                    for track in self.elements(part):
                        begin_m, end_m = self._range_m(part, track)
                        if begin_m < end_m:
                            yield track, begin_m, end_m, DIRECTIONS[direction], part

    def has_ends(self, part: XmlNode) -> bool:
        """Whether a range says where on its netElement it lies."""
        named = any(part.text(f"{kind}Begin") for kind in ("pos", "intrinsicCoord"))
        return named or part.first("linearCoordinateBegin") is not None

    def _range_m(self, part: XmlNode, track: str) -> tuple[float, float]:
        ends_m = [
            self._position_m(
                part, track, f"pos{end}", f"intrinsicCoord{end}", f"linearCoordinate{end}"
            )
            for end in ("Begin", "End")
        ]
        begin_m, end_m = ends_m
        whole_m = self.lengths_m[track]
        places_m = sorted(
            (0.0 if begin_m is None else begin_m, whole_m if end_m is None else end_m)
        )
        first_m, last_m = (self._clipped_m(at_m, track) for at_m in places_m)
        return first_m, last_m

    def _position_m(
        self, node: XmlNode, track: str, pos: str, intrinsic: str, linear: str
    ) -> float | None:
        """Distance from the netElement's begin; None if the element gives no place on it."""
        whole = node.text("netElementRef") == track
        measured = node.first(linear)
        if measured is not None:
            system = measured.need("positioningSystemRef", "name the linear positioning system")
            mileage = self.mileages.get(track, {}).get(system)
            if mileage is not None:
                measure_m = measured.number("measure", self.unit(measured, system))
                if measure_m is None:
                    raise measured.error("has no 'measure'; write the chainage")
                at_m = mileage.position_m(measure_m, self.lengths_m[track])
                if whole and not self._is_on(at_m, track):
                    raise measured.error(
                        f"measure {measured.text('measure')!r} is not on netElement {track!r}, "
                        f"from {mileage.begin_m:g} m to {mileage.end_m:g} m; correct it"
                    )
                return at_m
        if not whole:
            return None
        position_m = node.number(pos)
        if position_m is None:
            position_m = node.number(intrinsic, self.lengths_m[track])
        if position_m is not None and not self._is_on(position_m, track):
            raise node.error(
                f"{pos} {position_m:g} m is not on netElement {track!r}, which is "
                f"{self.lengths_m[track]:g} m long; correct it"
            )
        return position_m

    def unit(self, node: XmlNode, system: str) -> float:
        """Metres for each unit of a system. Raises SettingsError for an unknown one."""
        if system not in self.metres_per_unit:
            hint = nearest(system, list(self.metres_per_unit), "linearPositioningSystem")
            raise node.error(f"positioningSystemRef: there is no system {system!r}; {hint}")
        return self.metres_per_unit[system]

    def _is_on(self, position_m: float, track: str) -> bool:
        return -TOLERANCE_M <= position_m <= self.lengths_m[track] + TOLERANCE_M

    def _clipped_m(self, position_m: float, track: str) -> float:
        return min(max(position_m, 0.0), self.lengths_m[track])


def read_places(root: XmlNode) -> RailmlPlaces:
    """Read units, netElements and their lengths. Raises SettingsError."""
    units = _units(root)
    nodes: dict[str, XmlNode] = {}
    for node in root.all("infrastructure", "topology", "netElements", "netElement"):
        name = node.need("id", "give each netElement its own id")
        if name in nodes:
            raise node.error("is there twice, two tracks at one place; remove one")
        nodes[name] = node
    if not nodes:
        raise root.error(
            "has no infrastructure/topology/netElements; the import needs the tracks of railML 3"
        )
    tracks = {
        name: node
        for name, node in nodes.items()
        if not any(node.first(kind) for kind in COLLECTIONS)
    }
    places = RailmlPlaces(units, {}, {})
    for name, node in tracks.items():
        places.mileages[name] = _mileages(node, places)
    places.parts.update({name: _parts(name, nodes) for name in nodes if name not in tracks})
    places.lengths_m.update(_lengths_m(root, tracks, places.mileages, places.shared))
    return places


def _units(root: XmlNode) -> dict[str, float]:
    found = {}
    for system in root.all(
        "common", "positioning", "linearPositioningSystems", "linearPositioningSystem"
    ):
        unit = system.need("units", 'write units="m" or units="km"')
        if unit.lower() not in UNITS:
            raise system.error(f"units: {unit!r} is unknown; convert the measures to m or km")
        found[system.need("id", "give it an id")] = UNITS[unit.lower()]
    return found


def _mileages(node: XmlNode, places: RailmlPlaces) -> dict[str, Mileage]:
    """Chainages at both ends, for each linear positioning system."""
    ends: dict[str, dict[float, float]] = {}
    for coordinate in node.all("associatedPositioningSystem", "intrinsicCoordinate"):
        at = coordinate.number("intrinsicCoord")
        for linear in coordinate.all("linearCoordinate"):
            system = linear.need("positioningSystemRef", "name the linear positioning system")
            measure_m = linear.number("measure", places.unit(linear, system))
            if at in (0.0, 1.0) and measure_m is not None:
                ends.setdefault(system, {})[at] = measure_m
    return {
        system: Mileage(found[0.0], found[1.0]) for system, found in ends.items() if len(found) == 2
    }


def _parts(name: str, nodes: Mapping[str, XmlNode], depth: int = 0) -> list[str]:
    """NetElements of the track level in a collection."""
    found = []
    for kind in COLLECTIONS:
        for part in nodes[name].all(kind, "elementPart"):
            ref = part.need("ref", "name a netElement")
            if ref not in nodes:
                raise part.error(
                    f"there is no netElement {ref!r}; {nearest(ref, list(nodes), 'id')}"
                )
            if depth > len(nodes):
                raise part.error("is a part of itself; remove it")
            inner = any(nodes[ref].first(each) for each in COLLECTIONS)
            found += _parts(ref, nodes, depth + 1) if inner else [ref]
    return list(dict.fromkeys(found))


def _lengths_m(
    root: XmlNode,
    tracks: Mapping[str, XmlNode],
    mileages: Mapping[str, Mapping[str, Mileage]],
    shared: list[str],
) -> dict[str, float]:
    """The length of each netElement: its own, that of its chainages, or that of its track."""
    lengths_m: dict[str, float] = {}
    for name, node in tracks.items():
        length_m = node.number("length")
        if length_m is None:
            spans_m = [abs(each.end_m - each.begin_m) for each in mileages[name].values()]
            length_m = next((span_m for span_m in spans_m if span_m > 0.0), None)
        if length_m is not None:
            lengths_m[name] = length_m
    shared += _add_lengths_of_tracks(root, tracks, lengths_m)
    for name, node in tracks.items():
        if not lengths_m.get(name, 1.0) > 0.0:
            raise node.error(f"length {lengths_m[name]:g} m is not positive; correct it")
        if name not in lengths_m:
            raise node.error(
                "has no length; give it 'length', chainages at both ends, or a track of its own "
                "with a length"
            )
    return lengths_m


def _add_lengths_of_tracks(
    root: XmlNode, tracks: Mapping[str, XmlNode], lengths_m: dict[str, float]
) -> list[str]:
    """NetElements of unknown length share what the known ones leave of their track, as drawn.

    Returns those whose length is such a share.
    """
    shared: list[str] = []
    for track in root.all("infrastructure", "functionalInfrastructure", "tracks", "track"):
        whole_m = next(
            (m for each in track.all("length") if (m := each.number("value")) is not None), None
        )
        names = dict.fromkeys(
            part.text("netElementRef") or ""
            for location in track.all("linearLocation")
            for part in location.all("associatedNetElement")
        )
        unknown = [name for name in names if name in tracks and name not in lengths_m]
        if whole_m is None or not unknown:
            continue
        rest_m = whole_m - sum(lengths_m.get(name, 0.0) for name in names)
        drawn = [_drawn(tracks[name]) for name in unknown]
        weights = drawn if min(drawn) > 0.0 else [1.0] * len(unknown)
        if rest_m > 0.0:
            for name, weight in zip(unknown, weights, strict=True):
                lengths_m[name] = round(rest_m * weight / sum(weights), MILLIMETRES)
        if len(unknown) > 1:
            shared += unknown
    return shared


def _drawn(node: XmlNode) -> float:
    """Length of the netElement in the drawing, in units of the drawing."""
    points = [
        (at, coordinate.number("x") or 0.0, coordinate.number("y") or 0.0)
        for intrinsic in node.all("associatedPositioningSystem", "intrinsicCoordinate")
        for coordinate in intrinsic.all("geometricCoordinate")
        for at in (intrinsic.number("intrinsicCoord") or 0.0,)
    ]
    return sum(math.dist(one[1:], other[1:]) for one, other in itertools.pairwise(sorted(points)))
