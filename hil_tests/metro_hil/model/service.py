"""Services: trips of trains over routes of a network or directions of a line."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Final

from firmware_py import settings
from firmware_py.settings import SettingsError, check_ranges, nearest
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.circuit import load_network, load_path, split_route, with_route
from firmware_py.trackdb.paths import Path
from metro_hil.model.case import Setup
from metro_hil.model.case_setup import Files, file_name
from vobc.config import plan_mission
from vobc.vocabulary import Mission

ROUND_TRIPS_MAX: Final = 100
LAYOVER_MAX_S: Final = 600.0
"""Longest layover, s. A train that stands for longer counts as stuck."""
DWELL_MAX_S: Final = 600.0
TRAINS_MAX: Final = 20
HEADWAY_MAX_S: Final = 3600.0


@dataclass(frozen=True, slots=True)
class Trip:
    """One trip of a service."""

    route: str
    """Route of the network, or `up` or `down` of a line."""
    start: str | None = None
    """Station of departure. Default: where the trip before ends, or the first of the route."""
    end: str | None = None
    """Station of arrival. Default: the last of the route."""
    stops: tuple[str, ...] | None = None
    """Stations to stop at, the last included. Default: all."""
    dwell_s: Mapping[str, float] = field(default_factory=dict)
    """Dwell times by station; at other stations the file of the line applies."""
    run_s: Mapping[str, float] = field(default_factory=dict)
    """Planned running times by the station where the run ends; of others the line's file applies.
    """
    layover_s: float = 0.0
    """Time for which the wayside keeps the train at the start of the trip."""

    def __post_init__(self) -> None:
        check_ranges(self, {"layover_s": (0.0, LAYOVER_MAX_S)})
        for key, times_s in (("dwell_s", self.dwell_s), ("run_s", self.run_s)):
            for station, time_s in times_s.items():
                if not 0.0 <= time_s <= DWELL_MAX_S:
                    raise ValueError(f"{key}.{station} {time_s:g} is not in 0..{DWELL_MAX_S:g}")


@dataclass(frozen=True, slots=True)
class Service:
    """A service file: trips that each of its trains makes one after the other."""

    line: str
    """Network or line: a shipped name, or a file beside the service file."""
    trips: tuple[Trip, ...]
    round_trips: int = 1
    """How often each train makes all trips."""
    trains: int = 1
    """Number of trains. Each enters the network at the start of the first trip as soon as there is
    room, and leaves it at the end of the last."""
    headway_s: float = 0.0
    """Time between two departures on the first trip. With N trains, each train leaves again after
    N times this value. 0: trains leave as soon as their routes are free."""
    description: str = ""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            {
                "round_trips": (1, ROUND_TRIPS_MAX),
                "trains": (1, TRAINS_MAX),
                "headway_s": (0.0, HEADWAY_MAX_S),
            },
        )
        if not self.trips:
            raise ValueError("trips: there is none; add [[trips]]")
        if split_route(self.line)[1] is not None:
            raise ValueError(f"line {self.line!r} names a route; each trip names its own")


@dataclass(frozen=True, slots=True)
class PlannedTrip:
    """A trip that fits its route and the trip before it."""

    line: str
    """Name by which `load_line` gives the line of the trip."""
    path: Path
    start: str
    end: str
    stops: tuple[str, ...] | None
    dwell_s: Mapping[str, float]
    run_s: Mapping[str, float]
    layover_s: float

    def timed(self, line: LineMap) -> LineMap:
        """The line with the dwell and running times of the trip."""
        stations = tuple(
            replace(
                each,
                dwell_s=self.dwell_s.get(each.name, each.dwell_s),
                run_s=self.run_s.get(each.name, each.run_s),
            )
            for each in line.stations
        )
        return replace(line, stations=stations)

    def mission(self, line: LineMap) -> Mission:
        """The mission of the trip on its line."""
        return plan_mission(line, self.start, self.end, self.stops)


def read_service(name: str) -> Service:
    """Read a service file. Raises SettingsError."""
    text = settings.text_of(FilePath(name))
    with settings.located(name, text):
        return settings.build(Service, settings.tables_of(text, name), name)


def several(name: str) -> bool:
    """Whether a service file names several trains. Raises SettingsError."""
    return read_service(name).trains > 1


def load_service(name: str, line: str | None = None) -> tuple[PlannedTrip, ...]:
    """Read a service file and plan the trips of each train. Raises SettingsError.

    Args:
        line: network or line that replaces that of the file.
    """
    service, path = read_service(name), FilePath(name)
    with settings.located(name, settings.text_of(path)):
        return plan_trips(service, line or line_beside(service, path), name)


def needs_switches(trains: int, line: str) -> str:
    """The text about several trains on a line without switches."""
    return (
        f"trains {trains}: {line} has no switches, so trains that turn round would meet; name a "
        "network with switches, or leave trains out"
    )


def service_of(setup: Setup, files: Files) -> tuple[PlannedTrip, ...]:
    """The trips of a case; none for a case without a service. Raises SettingsError."""
    if setup.service is None:
        return ()
    base, _ = split_route(file_name(setup.line, files))
    return load_service(file_name(setup.service, files), base)


def trains_of(setup: Setup, files: Files) -> int:
    """Number of trains of a case. Raises SettingsError."""
    if setup.service is None:
        return 1
    return setup.trains or read_service(file_name(setup.service, files)).trains


def line_of_service(name: str) -> str:
    """The line that a service file names, as `load_line` takes it. Raises SettingsError."""
    return line_beside(read_service(name), FilePath(name))


def line_beside(service: Service, path: FilePath) -> str:
    """The name of the line from the folder in which the program runs."""
    is_file = settings.is_path(service.line)
    return str(path.parent / service.line) if is_file else service.line


def plan_trips(service: Service, line: str, source: str) -> tuple[PlannedTrip, ...]:
    """Plan all trips of all round trips. Raises SettingsError.

    Args:
        line: name of the network or line, which replaces that of the service.
        source: name of the file in messages.
    """
    first = _round(service, line, source, None)
    if service.round_trips == 1:
        return first
    return first + _round(service, line, source, first[-1]) * (service.round_trips - 1)


def _round(
    service: Service, line: str, source: str, last: PlannedTrip | None
) -> tuple[PlannedTrip, ...]:
    """Plan one round trip. `last` is the last trip of the round trip before, if there is one."""
    planned: list[PlannedTrip] = []
    for index, trip in enumerate(service.trips):
        before = planned[-1] if planned else last
        again = last is not None and index == 0
        planned.append(_planned(trip, line, before, f"{source}: trips[{index}]", again=again))
    return tuple(planned)


def _planned(
    trip: Trip, line: str, before: PlannedTrip | None, where: str, *, again: bool
) -> PlannedTrip:
    routes = [route.name for route in load_network(line).routes]
    if trip.route not in routes:
        hint = nearest(trip.route, routes, "route")
        raise SettingsError(f"{where}.route: {trip.route!r}: not a route of {line}; {hint}")
    name = with_route(line, trip.route)
    path = load_path(name)
    names = [station.name for station in path.line.stations]
    start = trip.start or (before.end if before else names[0])
    end = trip.end or names[-1]
    given = {
        "start": [start],
        "end": [end],
        "stops": trip.stops or (),
        "dwell_s": trip.dwell_s,
        "run_s": trip.run_s,
    }
    for key, stations in given.items():
        for station in stations:
            if station not in names:
                hint = nearest(station, names, "station")
                raise SettingsError(
                    f"{where}.{key}: {station!r}: no stop on route {trip.route}; {hint}"
                )
    if before is not None and start != before.end:
        raise SettingsError(
            f"{where}.start: {start!r}: the trip before{' (the last one)' if again else ''} ends "
            f"at {before.end}; let the train start there"
        )
    times_s = trip.dwell_s, trip.run_s, trip.layover_s
    planned = PlannedTrip(name, path, start, end, trip.stops, *times_s)
    try:
        planned.mission(planned.timed(path.line))
    except (SettingsError, ValueError) as error:
        raise SettingsError(f"{where}: {_plain(str(error))}") from error
    if before is not None:
        _check_track(before, planned, where)
    return planned


def _plain(text: str) -> str:
    """An error text of a mission, with the key of the trip in place of the option."""
    return text.replace("--from ", "start ").replace("--to ", "end ")


def _check_track(before: PlannedTrip, after: PlannedTrip, where: str) -> None:
    """Check that the train leaves over the track on which it arrived."""
    place = before.path.to_track(before.path.line.station(before.end).stop_m)
    tracks = [leg.track.name for leg in after.path.legs]
    if place.track not in tracks:
        raise SettingsError(
            f"{where}.route: {after.path.line.name} does not leave {before.end} over track "
            f"{place.track}, where the train stands; choose a route that does"
        )
