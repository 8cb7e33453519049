"""Completes surveyed tracks to a network file: platforms, tags, limits and routes by rules."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from firmware_py.settings import build
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.network_file import read_network
from metro_hil.exchange.line_rules import (
    APPROACH,
    BALISES_M,
    DWELL_S,
    FIRST_BALISE,
    PLATFORM_SPARE_M,
    Completed,
    FittedTrain,
)
from metro_hil.exchange.survey import file_name
from metro_hil.exchange.surveyed_network import (
    DEFAULT_LIMIT_MPS,
    STOP_BEFORE_BUFFER_M,
    STOP_BEFORE_END_M,
    SurveyedNetwork,
    TrackRange,
    stop_before,
)
from metro_hil.exchange.track_graph import PlaceOnTrack, shortest_path

ROUTES_MAX: Final = 40
"""Most routes of an imported network; a larger one gets those between its first ends."""
TAG_APART_M: Final = 0.5
"""Least distance between two tags of a track."""
PLACES: Final = 6


def complete_network(network: SurveyedNetwork, train: FittedTrain) -> Completed:
    """The tracks as the table of a network file. Raises SettingsError."""
    if network.given:
        read_network(network.given, network.source)
        left_out = tuple(f"left out: {text}" for text in network.ignored)
        return Completed(dict(network.given), ("network: that of the export", *left_out))
    if network.switches is None:
        raise network.error(
            network.terms.joins,
            "a junction is no simple switch, and a network file has only these; give --stops with "
            "stations in running order" + _such_as(network),
        )
    names = _track_names(network)
    numbers = itertools.count(FIRST_BALISE)
    table: dict[str, Any] = {
        "name": network.name,
        "description": f"Imported from {network.source.rsplit('/', maxsplit=1)[-1]}",
        "buffer_stops": _buffer_stops(network, names),
        "tracks": [_track(network, track, names, train, numbers) for track in names],
        "joins": _joins(network, names),
        "switches": [
            {
                "name": switch.name,
                **{
                    leg: _end(names, end)
                    for leg, end in (
                        ("tip", switch.tip),
                        ("left", switch.left),
                        ("right", switch.right),
                    )
                },
            }
            for switch in network.switches
        ],
    }
    bare = build(TrackNetwork, table, network.source)
    table["routes"] = _routes(network, names, table, bare)
    read_network(table, network.source)
    return Completed(table, tuple(_notes(network, train, table)))


def _such_as(network: SurveyedNetwork) -> str:
    names = list(network.stops)[:3]
    return f", such as {','.join(names)}" if names else "; the file has none yet, so add them"


def _track_names(network: SurveyedNetwork) -> dict[str, str]:
    names = {track: file_name(track) for track in network.graph.lengths_m}
    if len(set(names.values())) != len(names):
        raise network.error(
            network.terms.tracks, "two ids differ only in signs that a name cannot have; rename one"
        )
    return names


def _end(names: Mapping[str, str], end: tuple[str, bool]) -> str:
    return f"{names[end[0]]}.{'end' if end[1] else 'start'}"


def _buffer_stops(network: SurveyedNetwork, names: Mapping[str, str]) -> list[str]:
    ends = [(track, at_end) for track in names for at_end in (False, True)]
    return [_end(names, end) for end in ends if _is_buffer(network, end)]


def _joins(network: SurveyedNetwork, names: Mapping[str, str]) -> list[dict[str, str]]:
    of_switches = {
        end for switch in network.switches or () for end in (switch.tip, switch.left, switch.right)
    }
    pairs = dict.fromkeys(
        tuple(sorted((one, other)))
        for one, others in network.graph.links.items()
        for other in others
        if one not in of_switches
    )
    return [{"a": _end(names, one), "b": _end(names, other)} for one, other in pairs]


def _track(
    network: SurveyedNetwork,
    track: str,
    names: Mapping[str, str],
    train: FittedTrain,
    numbers: "itertools.count[int]",
) -> dict[str, Any]:
    start_m = (network.origins_m or {}).get(track, 0.0)
    end_m = round(start_m + network.graph.lengths_m[track], PLACES)
    platforms = _platforms(network, track, train)
    table: dict[str, Any] = {
        "name": names[track],
        "start_m": round(start_m, PLACES),
        "end_m": end_m,
        "limits": _limits(network, track, train),
        "platforms": platforms,
        "gradients": _sections(network.gradients, track, "gradient_permille", network),
        "curves": [
            section | {"radius_m": abs(section["radius_m"])}
            for section in _sections(network.radii, track, "radius_m", network)
        ],
        "tags": _tags(platforms, network.graph.lengths_m[track], train, numbers),
    }
    table |= _zones(network, track)
    for key in [name for name, value in table.items() if isinstance(value, list)]:
        table[key] = [_shifted(section, start_m) for section in table[key]]
    table["platforms"].sort(key=lambda each: each["start_m"])
    return table


def _zones(network: SurveyedNetwork, track: str) -> dict[str, list[dict[str, Any]]]:
    """The zones of a track, each for its direction."""
    length_m = network.graph.lengths_m[track]
    directions = {None: {}, True: {"direction": "up"}, False: {"direction": "down"}}
    found: dict[str, list[dict[str, Any]]] = {}
    for zone in sorted(network.zones, key=lambda each: each.begin_m):
        if zone.track == track and zone.begin_m < length_m:
            keys = zone.keys(zone.begin_m, min(zone.end_m, length_m))
            found.setdefault(zone.key, []).append(keys | directions[zone.forward])
    return found


def _shifted(section: Mapping[str, Any], start_m: float) -> dict[str, Any]:
    """A section in the chainage of its track."""
    return {
        key: round(value + start_m, PLACES) + 0.0
        if key.endswith("_m") and key != "radius_m"
        else value
        for key, value in section.items()
    }


def _platforms(network: SurveyedNetwork, track: str, train: FittedTrain) -> list[dict[str, Any]]:
    """Platforms of the file, or one by rule at each station of the track that has none."""
    length_m = network.graph.lengths_m[track]
    found = []
    for platform in network.platforms:
        if platform.track == track:
            edge = _edge(network, track, platform.station, platform.begin_m, platform.end_m)
            found.append(edge if platform.side is None else edge | {"side": platform.side})
    known = {edge["station"] for edge in found}
    half_m = train.length_m / 2.0 + PLATFORM_SPARE_M
    for station, places in network.stops.items():
        for place in places:
            if place.track == track and station not in known:
                known.add(station)
                begin_m = max(0.0, place.position_m - half_m)
                end_m = min(length_m, place.position_m + half_m)
                if begin_m < end_m:
                    found.append(_edge(network, track, station, begin_m, end_m))
    return found


def _edge(
    network: SurveyedNetwork, track: str, station: str, begin_m: float, end_m: float
) -> dict[str, Any]:
    """A platform with a stopping point for each direction, clear of buffer stops."""
    length_m, keys = network.graph.lengths_m[track], network.station_keys.get(station, {})
    ahead_m = length_m if _is_buffer(network, (track, True)) else math.inf
    behind_m = 0.0 if _is_buffer(network, (track, False)) else -math.inf
    edge: dict[str, Any] = {
        "station": station,
        "start_m": begin_m,
        "end_m": end_m,
        "stop_up_m": stop_before(begin_m, end_m, ahead_m),
        "stop_down_m": -stop_before(-end_m, -begin_m, -behind_m),
        "dwell_s": keys.get("dwell_s", DWELL_S),
    }
    if keys.get("platform_doors"):
        edge["platform_doors"] = True
    return edge


def _is_buffer(network: SurveyedNetwork, end: tuple[str, bool]) -> bool:
    links = network.graph.links
    return end not in links and all(end not in others for others in links.values())


def _limits(network: SurveyedNetwork, track: str, train: FittedTrain) -> list[dict[str, Any]]:
    """Limits for both directions, or for each one where they differ."""
    length_m = network.graph.lengths_m[track]
    most_mps = train.speed_mps_max or math.inf
    sides = {
        name: _pieces(
            [
                each
                for each in network.limits
                if each.track == track and each.forward in (None, way)
            ],
            length_m,
            most_mps,
        )
        for name, way in (("up", True), ("down", False))
    }
    if sides["up"] == sides["down"]:
        return sides["up"]
    return [each | {"direction": name} for name, found in sides.items() for each in found]


def _pieces(ranges: Sequence[TrackRange], length_m: float, most_mps: float) -> list[dict[str, Any]]:
    inner = {m for each in ranges for m in (each.begin_m, each.end_m) if 0.0 < m < length_m}
    edges_m = sorted({0.0, length_m, *inner})
    found: list[dict[str, Any]] = []
    for start_m, end_m in itertools.pairwise(edges_m):
        middle_m = (start_m + end_m) / 2.0
        values = [each.value for each in ranges if each.begin_m < middle_m < each.end_m]
        limit_mps = min(*values, most_mps) if values else min(DEFAULT_LIMIT_MPS, most_mps)
        if found and found[-1]["limit_mps"] == limit_mps:
            found[-1]["end_m"] = end_m
        else:
            found.append({"start_m": start_m, "end_m": end_m, "limit_mps": limit_mps})
    return found


def _sections(
    ranges: Sequence[TrackRange], track: str, key: str, network: SurveyedNetwork
) -> list[dict[str, Any]]:
    length_m = network.graph.lengths_m[track]
    return sorted(
        (
            {"start_m": each.begin_m, "end_m": min(each.end_m, length_m), key: each.value}
            for each in ranges
            if each.track == track and each.begin_m < length_m
        ),
        key=lambda section: section["start_m"],
    )


def _tags(
    platforms: Sequence[Mapping[str, Any]],
    length_m: float,
    train: FittedTrain,
    numbers: "itertools.count[int]",
) -> list[dict[str, Any]]:
    """Balises over the whole track, and tags before each stopping point that lie on it."""
    count = max(1, math.ceil(length_m / BALISES_M))
    found = [{"position_m": (part + 0.5) * length_m / count} for part in range(count)]
    for edge in platforms:
        for direction, sign in (("up", -1.0), ("down", 1.0)):
            for kind, ahead_m in (*APPROACH, ("stop", train.antenna_m)):
                at_m = edge[f"stop_{direction}_m"] + sign * ahead_m
                if 0.0 <= at_m <= length_m:
                    keys = {"kind": kind, "station": edge["station"], "direction": direction}
                    found.append({"position_m": at_m, **keys})
    kept: list[dict[str, Any]] = []
    # Tags of stopping points go before balises where two would lie at one place.
    for tag in sorted(found, key=lambda each: ("kind" not in each, each["position_m"])):
        if all(abs(tag["position_m"] - each["position_m"]) >= TAG_APART_M for each in kept):
            kept.append(tag)
    kept.sort(key=lambda each: each["position_m"])
    return [{"tag_id": next(numbers), **tag} for tag in kept]


def _routes(
    network: SurveyedNetwork,
    names: Mapping[str, str],
    table: Mapping[str, Any],
    bare: TrackNetwork,
) -> list[dict[str, Any]]:
    """The shortest ways between track ends, if a train stops at two or more stations on them."""
    ends = [tuple(end.rsplit(".", maxsplit=1)) for end in table["buffer_stops"]]
    ids = {name: track for track, name in names.items()}
    found: list[dict[str, Any]] = []
    for one, other in itertools.permutations(ends, 2):
        places = [
            PlaceOnTrack(ids[name], 0.0 if side == "start" else network.graph.lengths_m[ids[name]])
            for name, side in (one, other)
        ]
        path = shortest_path(network.graph, [[place] for place in places])
        if path is None:
            continue
        pieces = path[0]
        tracks = [piece.track for piece in pieces]
        stations = {
            edge.station
            for track in bare.tracks
            if track.name in {names[t] for t in tracks}
            for edge in track.platforms
        }
        if len(set(tracks)) == len(tracks) and len(stations) >= 2:
            found.append(
                {
                    "name": f"{one[0]}-{other[0]}",
                    "legs": [
                        f"{names[piece.track]} {'up' if piece.forward else 'down'}"
                        for piece in pieces
                    ],
                }
            )
    return found[:ROUTES_MAX]


def _notes(network: SurveyedNetwork, train: FittedTrain, table: Mapping[str, Any]) -> list[str]:
    switches = ", ".join(switch["name"] for switch in table["switches"][:6])
    notes = [
        f"switches: {switches}; a leg is the left one where the file says so, or else the first",
        f"routes: {len(table['routes'])}, the shortest ways between track ends with two stations "
        f"or more; at most {ROUTES_MAX}",
        f"platforms: those of the file, or else {PLATFORM_SPARE_M:g} m beyond both ends of a "
        f"standing train of {train.length_m:g} m ({train.name}); doors on the right where the file "
        f"names no side, open for {DWELL_S:g} s",
        f"stopping points: {STOP_BEFORE_END_M:g} m before a platform's end, in both directions, "
        f"and at least {STOP_BEFORE_BUFFER_M:g} m before a buffer stop",
        f"tags: a balise at least every {BALISES_M:g} m of each track; t1, t2, t3 and `stop` "
        "before each stopping point, as far as they lie on its track",
        f"limits: {DEFAULT_LIMIT_MPS * 3.6:g} km/h where no speed section applies",
    ]
    return [*notes, *network.filled, *(f"left out: {text}" for text in network.ignored)]
