"""Reads infrastructure of OSRD (RailJSON): one path through its track sections becomes a line."""

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from firmware_py.settings import nearest
from metro_hil.exchange.railjson_path import PathPiece, PlaceOnTrack, TrackGraph, shortest_path
from metro_hil.exchange.railjson_train import positive
from metro_hil.exchange.survey import CurvedStretch, Element, SurveyedLine, file_name

DEFAULT_LIMIT_MPS: Final = 80.0 / 3.6
"""Civil limit where no speed section applies; common on metros."""
BEGIN: Final = "BEGIN"
ENDPOINTS: Final = (BEGIN, "END")
SHIPPED_SWITCHES: Final = {
    "link": {("A", "B")},
    "point_switch": {("A", "B1"), ("A", "B2")},
    "crossing": {("A1", "B1"), ("A2", "B2")},
    "single_slip_switch": {("A1", "B1"), ("A1", "B2"), ("A2", "B2")},
    "double_slip_switch": {("A1", "B1"), ("A1", "B2"), ("A2", "B1"), ("A2", "B2")},
}
"""Pairs of ports that each built-in type of switch connects."""
IGNORED: Final = {
    "signals": "the authority comes by radio",
    "electrifications": "the supply is that of the train",
    "neutral_sections": "the emulated supply has none",
    "level_crossings": "the bench has none",
}


ValuedRange = tuple[float, float, float]
"""Begin and end of a range of the path, m, and the value that holds there."""


def read_infra(file: Element, stops: Sequence[str]) -> SurveyedLine:
    """Read the path through the named operational points, or through all of a single track.

    Raises SettingsError that names file and element.
    """
    sections = _by_id(file.part("track_sections"))
    lengths_m = {name: positive(section.part("length")) for name, section in sections.items()}
    graph = TrackGraph(lengths_m, _links(file, lengths_m))
    points = _points(file.part("operational_points"), lengths_m)
    names = list(stops) or _all_on_one_track(file, graph, points)
    for name in names:
        if name not in points:
            hint = nearest(name, list(points), "operational point")
            raise file.part("operational_points").error(f"has no {name!r}; {hint}")
    if len(names) < 2:
        raise file.part("operational_points").error(f"{len(names)} stops; a line needs two or more")
    path = shortest_path(graph, [points[name] for name in names])
    if path is None:
        raise file.part("track_sections").error(
            f"no path leads through {', '.join(names)} in this order without turning round; "
            "change --stops"
        )
    pieces, stops_m = path
    return SurveyedLine(
        name=file_name(Path(file.source).stem),
        source=file.source,
        stops=tuple(zip(names, stops_m, strict=True)),
        limits=_changes(_limits(file, pieces), stops_m[-1], DEFAULT_LIMIT_MPS, min),
        gradients=_changes(_gradients(sections, pieces), stops_m[-1], 0.0, _steepest),
        bends=_bends(sections, pieces),
        filled=(
            f"limits: {DEFAULT_LIMIT_MPS * 3.6:g} km/h where no speed section applies; the lowest "
            "where several do; those of tags and routes are not distinguished",
            f"path: the shortest through {len(names)} operational points, over "
            f"{len(pieces)} track sections",
        ),
        ignored=tuple(
            f"{name}: {why}" for name, why in IGNORED.items() if file.has(name) and _any(file, name)
        ),
    )


def _any(file: Element, name: str) -> bool:
    return bool(file.part(name).entries())


def _by_id(elements: Element) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for element in elements.entries():
        name = element.part("id").text()
        if name in found:
            raise element.part("id").error(f"{name!r} is used twice")
        found[name] = element
    return found


def _track_of(element: Element, lengths_m: dict[str, float]) -> str:
    track = element.part("track")
    if track.text() not in lengths_m:
        hint = nearest(track.text(), list(lengths_m), "track section")
        raise track.error(f"{track.value!r} is no track section; {hint}")
    return track.text()


def _links(
    file: Element, lengths_m: dict[str, float]
) -> dict[tuple[str, bool], list[tuple[str, bool]]]:
    """The ends of tracks that switches connect; the flag is true at the end, false at the begin."""
    types = dict(SHIPPED_SWITCHES)
    extended = file.optional("extended_switch_types")
    for own in extended.entries() if extended is not None else []:
        groups = own.part("groups")
        names = groups.keys()
        types[own.part("id").text()] = {
            (link.part("src").text(), link.part("dst").text())
            for name in names
            for link in groups.part(name).entries()
        }
    links: dict[tuple[str, bool], list[tuple[str, bool]]] = {}
    for switch in file.part("switches").entries():
        kind, ports = switch.part("switch_type"), switch.part("ports")
        if kind.text() not in types:
            raise kind.error(
                f"{kind.value!r} is unknown; {nearest(kind.text(), list(types), 'type')}"
            )
        for one, other in sorted(types[kind.text()]):
            ends = [_end(ports.part(port), lengths_m) for port in (one, other)]
            for here, there in (ends, ends[::-1]):
                links.setdefault(here, []).append(there)
    return links


def _end(port: Element, lengths_m: dict[str, float]) -> tuple[str, bool]:
    endpoint = port.part("endpoint")
    if endpoint.value not in ENDPOINTS:
        raise endpoint.error(f"{endpoint.value!r} is neither BEGIN nor END")
    return _track_of(port, lengths_m), endpoint.value != BEGIN


def _points(elements: Element, lengths_m: dict[str, float]) -> dict[str, list[PlaceOnTrack]]:
    """The places of each operational point, one for each track, by its name, or else its id."""
    found: dict[str, list[PlaceOnTrack]] = {}
    for element in elements.entries():
        name = element.part("id").text()
        extensions = element.optional("extensions")
        identifier = extensions.optional("identifier") if extensions is not None else None
        if identifier is not None:
            name = identifier.part("name").text()
        if name in found:
            raise element.error(f"{name!r} is the name of two operational points; rename one")
        found[name] = [_place(part, lengths_m) for part in element.part("parts").entries()]
    return found


def _place(part: Element, lengths_m: dict[str, float]) -> PlaceOnTrack:
    track, position = _track_of(part, lengths_m), part.part("position")
    if not 0.0 <= position.number() <= lengths_m[track]:
        raise position.error(
            f"{position.value!r} is not on {track}, which is {lengths_m[track]:g} m long"
        )
    return PlaceOnTrack(track, position.number())


def _all_on_one_track(
    file: Element, graph: TrackGraph, points: dict[str, list[PlaceOnTrack]]
) -> list[str]:
    """All operational points in running order, if the track has two ends and no switch."""
    run = graph.single_run()
    if run is None:
        names = ", ".join(list(points)[:4])
        raise file.part("switches").error(
            "the tracks branch, close to a loop or lie apart; give --stops with operational points "
            f"in running order, separated by commas, such as {names}"
        )
    order = {piece.track: (piece, number) for number, piece in enumerate(run)}
    places: list[tuple[int, float, str]] = []
    for name, parts in points.items():
        for part in parts:
            piece, number = order[part.track]
            places.append((number, piece.offset_m(part.position_m), name))
    return list(dict.fromkeys(name for _, _, name in sorted(places)))


def _clipped(
    pieces: Sequence[PathPiece], track: str, begin_m: float, end_m: float
) -> list[tuple[float, float, bool]]:
    """Where a range of a track lies on the path, and whether the path runs towards its end."""
    found = []
    for piece in pieces:
        if piece.track == track:
            start_m, finish_m = piece.chainages_m(begin_m, end_m)
            if start_m < finish_m:
                found.append((start_m, finish_m, piece.forward))
    return found


def _range(element: Element) -> tuple[float, float]:
    begin, end = element.part("begin"), element.part("end")
    if not 0.0 <= begin.number() < end.number():
        raise element.error(f"begin {begin.value!r} is not before end {end.value!r}")
    return begin.number(), end.number()


def _limits(file: Element, pieces: Sequence[PathPiece]) -> list[ValuedRange]:
    known = {piece.track for piece in pieces}
    found = []
    for section in file.part("speed_sections").entries():
        limit = section.optional("speed_limit")
        if limit is None or limit.value is None:
            continue
        limit_mps = positive(limit)
        for reach in section.part("track_ranges").entries():
            track = reach.part("track").text()
            if track not in known:
                continue
            directions = reach.part("applicable_directions").text()
            found += [
                (start_m, finish_m, limit_mps)
                for start_m, finish_m, forward in _clipped(pieces, track, *_range(reach))
                if directions in ("BOTH", "START_TO_STOP" if forward else "STOP_TO_START")
            ]
    return found


def _gradients(sections: dict[str, Element], pieces: Sequence[PathPiece]) -> list[ValuedRange]:
    """The gradients in the direction of travel; positive climbs."""
    return [
        (start_m, finish_m, permille if forward else -permille)
        for track in dict.fromkeys(piece.track for piece in pieces)
        for slope in sections[track].part("slopes").entries()
        for permille in (slope.part("gradient").number(),)
        for start_m, finish_m, forward in _clipped(pieces, track, *_range(slope))
    ]


def _bends(sections: dict[str, Element], pieces: Sequence[PathPiece]) -> tuple[CurvedStretch, ...]:
    found = [
        CurvedStretch(start_m, finish_m, abs(radius_m))
        for track in dict.fromkeys(piece.track for piece in pieces)
        for curve in sections[track].part("curves").entries()
        for radius_m in (curve.part("radius").number(),)
        if radius_m != 0.0
        for start_m, finish_m, _ in _clipped(pieces, track, *_range(curve))
    ]
    return tuple(sorted(found, key=lambda bend: bend.start_m))


def _steepest(values: Sequence[float]) -> float:
    return max(values, key=abs)


def _changes(
    stretches: Sequence[ValuedRange],
    end_m: float,
    default: float,
    join: Callable[[Sequence[float]], float],
) -> tuple[tuple[float, float], ...]:
    """Chainages and the values that hold from there on."""
    edges_m = sorted({0.0, end_m, *(m for each in stretches for m in each[:2])})
    changes: list[tuple[float, float]] = []
    for start_m, finish_m in itertools.pairwise(edges_m):
        middle_m = (start_m + finish_m) / 2.0
        values = [value for begin_m, stop_m, value in stretches if begin_m < middle_m < stop_m]
        value = join(values) if values else default
        if not changes or changes[-1][1] != value:
            changes.append((start_m, value))
    return tuple(changes)
