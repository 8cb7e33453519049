"""Loads lines. The file of a circular line contains one lap, which is repeated."""

import functools
from dataclasses import dataclass, replace
from typing import Any, Final

from firmware_py import settings
from firmware_py.trackdb.line_map import LineMap
from firmware_py.trackdb.network import Running, TrackNetwork
from firmware_py.trackdb.network_file import is_network, read_network, route_path
from firmware_py.trackdb.one_track import network_of
from firmware_py.trackdb.paths import Path
from firmware_py.trackdb.sites import Station, TagSite

LAPS_MAX: Final = 100
TAG_IDS: Final = 100_000
"""Difference of tag numbers between one lap and the next."""


@dataclass(frozen=True, slots=True)
class Circuit:
    """Number of laps. The names of all laps but the first carry the lap's number."""

    laps: int

    def __post_init__(self) -> None:
        if not 1 <= self.laps <= LAPS_MAX:
            raise ValueError(f"laps {self.laps} is not in 1..{LAPS_MAX}")


def load_line(name: str) -> LineMap:
    """Load a line by path or by the name of a shipped file; raises SettingsError.

    `NAME:up` and `NAME:down` are its paths in both directions, see `one_track`. `FILE:ROUTE` is
    the path of a route of a network.
    """
    base, route = split_route(name)
    path = settings.find(base, "firmware_py.trackdb")
    text = settings.text_of(path)
    if route is None and not _is_network(text, str(path)):
        return _loaded(text, str(path))
    return _path(text, str(path), route).line


def load_path(name: str) -> Path:
    """Load a path by the name that `load_line` takes; of a line file it is up without a route."""
    base, route = split_route(name)
    path = settings.find(base, "firmware_py.trackdb")
    text = settings.text_of(path)
    if route is None and not _is_network(text, str(path)):
        route = Running.UP.value
    return _path(text, str(path), route)


def load_network(name: str) -> TrackNetwork:
    """Load a network; a line file is one of a single track. Raises SettingsError."""
    path = settings.find(name, "firmware_py.trackdb")
    return _network(settings.text_of(path), str(path))


def load_switched(name: str) -> tuple[TrackNetwork, Path] | None:
    """The network and the path of a route over it; None without a switch in the file."""
    base, _ = split_route(name)
    path = settings.find(base, "firmware_py.trackdb")
    if not _is_network(settings.text_of(path), str(path)):
        return None
    network = load_network(base)
    return (network, load_path(name)) if network.switches else None


def split_route(name: str) -> tuple[str, str | None]:
    """The file or shipped name, and the route behind the last colon, if there is one."""
    base, colon, route = name.rpartition(":")
    return (base, route) if colon and "/" not in route else (name, None)


def with_route(base: str, route: str | None) -> str:
    """The name from which `split_route` gives these two."""
    return base if route is None else f"{base}:{route}"


@functools.lru_cache(maxsize=settings.KEPT_MAX)
def _is_network(text: str, source: str) -> bool:
    return is_network(settings.tables_of(text, source))


@functools.lru_cache(maxsize=settings.KEPT_MAX)
def _network(text: str, source: str) -> TrackNetwork:
    table = settings.tables_of(text, source)
    if is_network(table):
        with settings.located(source, text):
            return read_network(table, source)
    try:
        return network_of(_loaded(text, source))
    except ValueError as error:
        raise settings.SettingsError(f"{source}: {error}") from error


@functools.lru_cache(maxsize=settings.KEPT_MAX)
def _path(text: str, source: str, route: str | None) -> Path:
    return route_path(_network(text, source), route, source)


@functools.lru_cache(maxsize=settings.KEPT_MAX)
def _loaded(text: str, path: str) -> LineMap:
    with settings.located(path, text):
        table = settings.tables_of(text, path)
        circuit = table.pop("circuit", None)
        line = settings.build(LineMap, table, path)
        if circuit is None:
            return line
        if not isinstance(circuit, dict):
            raise settings.SettingsError(f"{path}: circuit: {circuit!r} is not a table")
        laps = settings.build(Circuit, circuit, path, "circuit")
        try:
            return written_out(line, laps)
        except ValueError as error:
            raise settings.SettingsError(f"{path}: circuit: {error}") from error


def written_out(lap: LineMap, circuit: Circuit) -> LineMap:
    """Repeat a lap; each lap begins where the previous one ends.

    Raises ValueError if tag numbers are too large for another lap.
    """
    highest = max((tag.tag_id for tag in lap.tags), default=0)
    if highest >= TAG_IDS:
        raise ValueError(f"tags: tag {highest}: on a circuit numbers are under {TAG_IDS}")
    laps = range(circuit.laps)
    length_m = lap.end_m - lap.start_m
    return replace(
        lap,
        end_m=lap.start_m + circuit.laps * length_m,
        stations=tuple(_station(s, n, n * length_m) for n in laps for s in lap.stations),
        speed_sections=_shifted(lap.speed_sections, circuit.laps, length_m),
        gradients=_shifted(lap.gradients, circuit.laps, length_m),
        curves=_shifted(lap.curves, circuit.laps, length_m),
        tunnels=_shifted(lap.tunnels, circuit.laps, length_m),
        neutral_sections=_shifted(lap.neutral_sections, circuit.laps, length_m),
        power_sections=_shifted(lap.power_sections, circuit.laps, length_m),
        no_stop_zones=_shifted(lap.no_stop_zones, circuit.laps, length_m),
        evacuation_stops=_shifted(lap.evacuation_stops, circuit.laps, length_m),
        tags=tuple(_tag(tag, n, n * length_m) for n in laps for tag in lap.tags),
    )


def name_on_lap(name: str, lap: int) -> str:
    """Return a station's name on a lap; laps are counted from 0."""
    return name if lap == 0 else f"{name} {lap + 1}"


def _station(station: Station, lap: int, by_m: float) -> Station:
    return replace(
        station,
        name=name_on_lap(station.name, lap),
        stop_m=station.stop_m + by_m,
        platform_start_m=station.platform_start_m + by_m,
        platform_end_m=station.platform_end_m + by_m,
        short_stops=tuple(replace(each, stop_m=each.stop_m + by_m) for each in station.short_stops),
    )


def _tag(tag: TagSite, lap: int, by_m: float) -> TagSite:
    served = None if tag.station is None else name_on_lap(tag.station, lap)
    return replace(
        tag,
        tag_id=tag.tag_id + lap * TAG_IDS,
        position_m=tag.position_m + by_m,
        station=served,
    )


def _shifted(sections: tuple[Any, ...], laps: int, length_m: float) -> tuple[Any, ...]:
    """Return the sections of every lap; sections of neighbouring laps are not joined."""
    return tuple(
        replace(
            section,
            start_m=section.start_m + lap * length_m,
            end_m=section.end_m + lap * length_m,
        )
        for lap in range(laps)
        for section in sections
    )
