"""Reads infrastructure of OSRD (RailJSON)."""

from pathlib import Path
from typing import Final

from firmware_py.settings import nearest
from metro_hil.exchange.railjson_train import positive
from metro_hil.exchange.survey import Element, file_name
from metro_hil.exchange.surveyed_network import (
    FileTerms,
    SurveyedNetwork,
    SurveyedSwitch,
    SurveyedZone,
    TrackRange,
)
from metro_hil.exchange.track_graph import PlaceOnTrack, TrackGraph

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
SIMPLE: Final = ("link", "crossing", "point_switch")
"""Types in which no track end leads to two others, except the tip of a point switch."""
DIRECTIONS: Final = {"BOTH": None, "START_TO_STOP": True, "STOP_TO_START": False}
IGNORED: Final = {
    "signals": "the authority comes by radio",
    "electrifications": "the supply is that of the train",
    "level_crossings": "the bench has none",
}


TERMS: Final = FileTerms("track_sections", "switches", "operational_points")
ALONG: Final = {"START_TO_STOP": True, "STOP_TO_START": False}
"""Directions of a neutral section, and whether they are that of the track section."""
LEGS: Final = ("A", "B1", "B2")
"""Ports of a point switch: the tip, and the legs that count as left and right."""


def read_infra(file: Element) -> SurveyedNetwork:
    """Read the tracks. Raises SettingsError that names file and element."""
    sections = _by_id(file.part("track_sections"))
    lengths_m = {name: positive(section.part("length")) for name, section in sections.items()}
    links, switches = _links(file, lengths_m)
    return SurveyedNetwork(
        name=file_name(Path(file.source).stem),
        source=file.source,
        terms=TERMS,
        graph=TrackGraph(lengths_m, links),
        stops=_points(file.part("operational_points"), lengths_m),
        limits=_limits(file),
        gradients=_ranges(sections, "slopes", "gradient"),
        radii=[each for each in _ranges(sections, "curves", "radius") if each.value != 0.0],
        zones=_neutral_sections(file, lengths_m),
        switches=switches,
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
) -> tuple[dict[tuple[str, bool], list[tuple[str, bool]]], list[SurveyedSwitch] | None]:
    """The ends of tracks that switches connect, and the point switches; None if others branch."""
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
    found: list[SurveyedSwitch] | None = []
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
        if kind.value == "point_switch":
            legs = [_end(ports.part(port), lengths_m) for port in LEGS]
            found = None if found is None else [*found, SurveyedSwitch(_id(switch), *legs)]
        elif kind.value not in SIMPLE:
            found = None
    return links, found


def _id(element: Element) -> str:
    return element.part("id").text()


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


def _range(element: Element) -> tuple[float, float]:
    begin, end = element.part("begin"), element.part("end")
    if not 0.0 <= begin.number() < end.number():
        raise element.error(f"begin {begin.value!r} is not before end {end.value!r}")
    return begin.number(), end.number()


def _limits(file: Element) -> list[TrackRange]:
    found = []
    for section in file.part("speed_sections").entries():
        limit = section.optional("speed_limit")
        if limit is None or limit.value is None:
            continue
        limit_mps = positive(limit)
        for reach in section.part("track_ranges").entries():
            directions = reach.part("applicable_directions")
            if directions.value not in DIRECTIONS:
                raise directions.error(f"{directions.value!r} is none of {', '.join(DIRECTIONS)}")
            track, forward = reach.part("track").text(), DIRECTIONS[directions.value]
            found.append(TrackRange(track, *_range(reach), limit_mps, forward))
    return found


def _neutral_sections(file: Element, lengths_m: dict[str, float]) -> list[SurveyedZone]:
    """The neutral sections, each for one direction of a track section."""
    sections = file.optional("neutral_sections")
    found = []
    for section in sections.entries() if sections is not None else []:
        for reach in section.part("track_ranges").entries():
            direction = reach.part("direction")
            if direction.value not in ALONG:
                raise direction.error(f"{direction.value!r} is none of {', '.join(ALONG)}")
            track = _track_of(reach, lengths_m)
            name = file_name(section.part("id").text()) if section.has("id") else ""
            forward = ALONG[direction.value]
            zone = SurveyedZone("neutral_sections", track, *_range(reach), forward, name)
            found.append(zone)
    return found


def _ranges(sections: dict[str, Element], kind: str, value: str) -> list[TrackRange]:
    return [
        TrackRange(track, *_range(reach), reach.part(value).number())
        for track, section in sections.items()
        for reach in section.part(kind).entries()
    ]
