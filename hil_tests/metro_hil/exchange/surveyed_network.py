"""Tracks of a foreign file as a graph, and the line along a path through them."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from firmware_py.settings import SettingsError, nearest
from firmware_py.trackdb.line_map import CHAINAGE_MAX_M, CHAINAGE_MIN_M
from firmware_py.trackdb.sites import POWER, TUNNELS
from metro_hil.exchange.survey import CurvedStretch, SurveyedLine
from metro_hil.exchange.track_graph import PathPiece, PlaceOnTrack, TrackGraph, shortest_path

DEFAULT_LIMIT_MPS: Final = 80.0 / 3.6
"""Civil limit where no speed section applies; common on metros."""
STOP_BEFORE_END_M: Final = 5.0
"""A train stops this far before the end of a platform whose file gives no stopping point."""
STOP_BEFORE_BUFFER_M: Final = 25.0
"""A train stops at least this far before a buffer stop, so that protection lets it come there."""
PLACES: Final = 6
"""Decimals of a chainage, m: finer than any survey, coarser than the rounding of sums."""
OTHER_SIDE: Final = {"left": "right", "right": "left", "both": "both"}

ValuedRange = tuple[float, float, float]
"""Begin and end of a range of the path, m, and the value that holds there."""


@dataclass(frozen=True, slots=True)
class TrackRange:
    """A range of a track section, and a value that holds there."""

    track: str
    begin_m: float
    end_m: float
    value: float
    forward: bool | None = None
    """Direction of running in which it holds; None: both."""


@dataclass(frozen=True, slots=True)
class SurveyedPlatform:
    """A platform beside a track section."""

    station: str
    track: str
    begin_m: float
    end_m: float
    side: str | None = None
    """Side for a train that runs from the section's begin to its end."""


@dataclass(frozen=True, slots=True)
class SurveyedZone:
    """A zone on a track section, such as a neutral section."""

    key: str
    """Key of line files that has such zones."""
    track: str
    begin_m: float
    end_m: float
    forward: bool | None = None
    """Direction of running in which it holds; None: both."""
    name: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Further keys of such zones, with their values."""

    def keys(self, start_m: float, end_m: float) -> dict[str, Any]:
        """The zone in a line file, between these chainages."""
        ends: dict[str, Any] = {"start_m": start_m, "end_m": end_m}
        return {**ends, **self.values} | ({"name": self.name} if self.name else {})


@dataclass(frozen=True, slots=True)
class SurveyedTag:
    """A tag of this project's line files in a track section."""

    track: str
    position_m: float
    keys: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SurveyedSwitch:
    """A switch; each end is a section, and true at its end."""

    name: str
    tip: tuple[str, bool]
    left: tuple[str, bool]
    right: tuple[str, bool]


@dataclass(frozen=True, slots=True)
class FileTerms:
    """Names of the parts of a file format, for messages."""

    tracks: str
    joins: str
    stops: str


@dataclass(frozen=True, slots=True)
class SurveyedNetwork:
    """What a foreign file says about tracks."""

    name: str
    source: str
    terms: FileTerms
    graph: TrackGraph
    stops: Mapping[str, Sequence[PlaceOnTrack]]
    """The places of each station, by name."""
    limits: Sequence[TrackRange] = ()
    """Civil limits, m/s."""
    gradients: Sequence[TrackRange] = ()
    """Gradients, ‰; positive climbs from the section's begin to its end."""
    radii: Sequence[TrackRange] = ()
    platforms: Sequence[SurveyedPlatform] = ()
    tags: Sequence[SurveyedTag] = ()
    zones: Sequence[SurveyedZone] = ()
    switches: Sequence[SurveyedSwitch] | None = None
    """None: the file has junctions that are no simple switches."""
    exact_stops: frozenset[str] = frozenset()
    """Stations whose places are stopping points, not just somewhere at the platform."""
    origins_m: Mapping[str, float] | None = None
    """Chainage of the begin of track sections; None: the path begins at its first stop."""
    station_keys: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """What the file says about stations in the keys of line files."""
    line_keys: Mapping[str, Any] = field(default_factory=dict)
    """What the file says about the line in the keys of line files."""
    given: Mapping[str, Any] = field(default_factory=dict)
    """The table of a network file, of an export of this project. Empty: the rules make one."""
    filled: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()

    def error(self, part: str, text: str) -> SettingsError:
        """An error that names the file and the part."""
        return SettingsError(f"{self.source}: {part}: {text}")


def branches(network: SurveyedNetwork) -> bool:
    """Whether the tracks are more than one row of sections."""
    return network.graph.single_run() is None


def line_along(network: SurveyedNetwork, stops: Sequence[str]) -> SurveyedLine:
    """The line through the named stations, or through all of a single track.

    Raises SettingsError that names file and element.
    """
    names = list(stops) or _all_on_one_track(network)
    for name in names:
        if name not in network.stops:
            hint = nearest(name, list(network.stops), network.terms.stops.replace("_", " ")[:-1])
            raise network.error(network.terms.stops, f"has no {name!r}; {hint}")
    if len(names) < 2:
        raise network.error(network.terms.stops, f"{len(names)} stops; a line needs two or more")
    path = shortest_path(network.graph, [network.stops[name] for name in names])
    if path is None:
        raise network.error(
            network.terms.tracks,
            f"no path leads through {', '.join(names)} in this order without turning round; "
            "change --stops",
        )
    pieces, stops_m = path
    if network.origins_m is not None:
        pieces = _whole(pieces)
    shift_m = _shift_m(network, pieces)
    return _line(network, names, [piece.moved(shift_m) for piece in pieces], stops_m, shift_m)


def _whole(pieces: Sequence[PathPiece]) -> list[PathPiece]:
    """The path with the whole of its first and its last section."""
    return [
        piece.extended(to_begin=piece is pieces[0], to_end=piece is pieces[-1]) for piece in pieces
    ]


def _shift_m(network: SurveyedNetwork, pieces: Sequence[PathPiece]) -> float:
    """How far chainages move so that they are those of the file, where it has growing ones."""
    first, last = pieces[0], pieces[-1]
    if network.origins_m is None or first.track not in network.origins_m or not first.forward:
        return 0.0
    start_m = network.origins_m[first.track]
    end_m = start_m + last.chainage_m + last.to_m - last.from_m - first.chainage_m
    if not CHAINAGE_MIN_M <= start_m < end_m <= CHAINAGE_MAX_M:
        return 0.0
    return start_m - first.chainage_m


def _line(
    network: SurveyedNetwork,
    names: Sequence[str],
    pieces: Sequence[PathPiece],
    path_stops_m: Sequence[float],
    shift_m: float,
) -> SurveyedLine:
    start_m, end_m = _m(pieces[0].chainage_m), _m(pieces[-1].chainage_m + pieces[-1].run_m)
    stations, stops_m = {}, []
    for name, path_m in zip(names, path_stops_m, strict=True):
        keys = _platform_keys(network, name, pieces, path_m + shift_m)
        exact = name in network.exact_stops or "platform_end_m" not in keys
        stop_m = path_m + shift_m if exact else _stop_m(keys, end_m)
        stations[name] = {**keys, **network.station_keys.get(name, {})}
        stops_m.append(_m(stop_m))
    given: dict[str, Any] = {"stations": stations, **network.line_keys}
    if network.origins_m is not None:
        given |= {"start_m": start_m, "end_m": end_m}
    if network.tags:
        given["tags"] = _tags(network, pieces)
    given |= _zones(network, pieces)
    return SurveyedLine(
        name=network.name,
        source=network.source,
        stops=tuple(zip(names, stops_m, strict=True)),
        limits=_changes(_on_path(network.limits, pieces), (start_m, end_m), DEFAULT_LIMIT_MPS, min),
        gradients=_changes(
            _on_path(network.gradients, pieces, -1.0), (start_m, end_m), 0.0, _steepest
        ),
        bends=tuple(
            CurvedStretch(begin_m, finish_m, abs(radius_m))
            for begin_m, finish_m, radius_m in sorted(_on_path(network.radii, pieces))
        ),
        given=given,
        filled=(
            f"limits: {DEFAULT_LIMIT_MPS * 3.6:g} km/h where no speed section applies; the lowest "
            "where several do; those of tags and routes are not distinguished",
            f"path: the shortest through {len(names)} operational points, over "
            f"{len(pieces)} track sections",
            *network.filled,
        ),
        ignored=network.ignored,
    )


def _m(at_m: float) -> float:
    return round(at_m, PLACES) + 0.0


def _stop_m(keys: Mapping[str, Any], track_end_m: float) -> float:
    """The stopping point of a platform: before its end, but never before its middle."""
    start_m, end_m = float(keys["platform_start_m"]), float(keys["platform_end_m"])
    return stop_before(start_m, end_m, track_end_m)


def stop_before(start_m: float, end_m: float, track_end_m: float) -> float:
    """The stopping point at a platform, with regard to the end of the track ahead."""
    last_m = min(end_m - STOP_BEFORE_END_M, track_end_m - STOP_BEFORE_BUFFER_M)
    return max(last_m, (start_m + end_m) / 2.0)


def _platform_keys(
    network: SurveyedNetwork, name: str, pieces: Sequence[PathPiece], near_m: float
) -> dict[str, Any]:
    """The platform of a station on the path; if there are several, the nearest to the stop."""
    found = [
        (start_m, finish_m, platform.side, piece.forward)
        for platform in network.platforms
        if platform.station == name
        for piece in pieces
        if piece.track == platform.track
        for start_m, finish_m in (piece.chainages_m(platform.begin_m, platform.end_m),)
        if start_m < finish_m
    ]
    if not found:
        return {}
    start_m, finish_m, side, forward = min(
        found, key=lambda each: abs((each[0] + each[1]) / 2.0 - near_m)
    )
    keys: dict[str, Any] = {"platform_start_m": _m(start_m), "platform_end_m": _m(finish_m)}
    if side is not None:
        keys["side"] = side if forward else OTHER_SIDE[side]
    return keys


def _tags(network: SurveyedNetwork, pieces: Sequence[PathPiece]) -> list[dict[str, Any]]:
    found = [
        {**tag.keys, "position_m": _m(piece.at_m(tag.position_m))}
        for tag in network.tags
        for piece in pieces
        if piece.track == tag.track and piece.from_m <= piece.offset_m(tag.position_m) <= piece.to_m
    ]
    return sorted(found, key=lambda tag: tag["position_m"])


def _zones(
    network: SurveyedNetwork, pieces: Sequence[PathPiece]
) -> dict[str, list[dict[str, Any]]]:
    """The zones on the path that hold in its direction. Parts that meet are one."""
    found: dict[str, list[dict[str, Any]]] = {}
    for zone in network.zones:
        for piece in pieces:
            if piece.track == zone.track and zone.forward in (None, piece.forward):
                start_m, end_m = (_m(m) for m in piece.chainages_m(zone.begin_m, zone.end_m))
                if start_m < end_m:
                    found.setdefault(zone.key, []).append(zone.keys(start_m, end_m))
    return {key: _joined(key, zones) for key, zones in found.items()}


def _joined(key: str, zones: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The zones, each with those that it touches and that have the same name and values.

    The name of a neutral section or no-stop zone does not count.
    """
    joined: list[dict[str, Any]] = []
    for zone in sorted(zones, key=lambda each: (each["start_m"], each["end_m"])):
        ends = {each: zone[each] for each in ("start_m", "end_m")}
        apart = key in (POWER, TUNNELS) and joined and {**joined[-1], **ends} != zone
        if joined and zone["start_m"] <= joined[-1]["end_m"] and not apart:
            joined[-1]["end_m"] = max(joined[-1]["end_m"], zone["end_m"])
        else:
            joined.append(dict(zone))
    return joined


def _all_on_one_track(network: SurveyedNetwork) -> list[str]:
    """All stations in running order, if the track has two ends and no switch."""
    run = network.graph.single_run()
    if run is None:
        names = ", ".join(list(network.stops)[:4])
        raise network.error(
            network.terms.joins,
            "the tracks branch, close to a loop or lie apart; give --stops with operational points "
            f"in running order, separated by commas, such as {names}",
        )
    order = {piece.track: (piece, number) for number, piece in enumerate(run)}
    places: list[tuple[int, float, str]] = []
    for name, parts in network.stops.items():
        for part in parts:
            piece, number = order[part.track]
            places.append((number, piece.offset_m(part.position_m), name))
    return list(dict.fromkeys(name for _, _, name in sorted(places)))


def _on_path(
    ranges: Sequence[TrackRange], pieces: Sequence[PathPiece], backward_sign: float = 1.0
) -> list[ValuedRange]:
    """Where ranges lie on the path, if they hold in its direction."""
    found = []
    for reach in ranges:
        for piece in pieces:
            if piece.track != reach.track or reach.forward not in (None, piece.forward):
                continue
            start_m, finish_m = (_m(at_m) for at_m in piece.chainages_m(reach.begin_m, reach.end_m))
            if start_m < finish_m:
                value = reach.value if piece.forward else backward_sign * reach.value
                found.append((start_m, finish_m, value))
    return found


def _steepest(values: Sequence[float]) -> float:
    return max(values, key=abs)


def _changes(
    stretches: Sequence[ValuedRange],
    extent_m: tuple[float, float],
    default: float,
    join: Callable[[Sequence[float]], float],
) -> tuple[tuple[float, float], ...]:
    """Chainages and the values that hold from there on."""
    edges_m = sorted({*extent_m, *(m for each in stretches for m in each[:2])})
    changes: list[tuple[float, float]] = []
    for start_m, finish_m in itertools.pairwise(edges_m):
        middle_m = (start_m + finish_m) / 2.0
        values = [value for begin_m, stop_m, value in stretches if begin_m < middle_m < stop_m]
        value = join(values) if values else default
        if not changes or changes[-1][1] != value:
            changes.append((start_m, value))
    return tuple(changes)
