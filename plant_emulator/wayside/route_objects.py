"""The wayside of trains that command themselves on a network: each path is a line of its own.

A path is the chainage on which a master computes. Its areas end at the switches of the
interlocking, and each route is an object of the path: trains pass it only while it is locked for
the master. The object is locked only while the interlocking proves the route for a train that has
not reached its signal yet. The interlocking moves no switch of a locked object for another path.
Pure.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Final

from firmware_py.settings import SettingsError
from firmware_py.trackdb.areas import (
    SECTION_MIN_M,
    Area,
    AreaMap,
    ObjectKind,
    ObjectSite,
    sections_between,
)
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path, TrackPlace
from plant_emulator.wayside.detection import INSET_M
from plant_emulator.wayside.interlocking import (
    AT_STOP_M,
    NOT_SHARED,
    SIGNAL_M,
    Interlocking,
    RouteSection,
    Shared,
    sections_of,
)
from plant_emulator.wayside.line_wayside import WaysideTruth
from zenoh_config.t2t import ObjectState

AXLES: Final = 16
"""Number of axles of each train."""
SECTION_M: Final = 100.0
"""Length of the sections whose axles are counted."""
APPLY_M: Final = 800.0
"""Distance before an area at which a train reports to it, too."""


def shared_tracks(paths: Iterable[Path]) -> dict[str, bool]:
    """Tracks that several paths run over, or that cross a track.

    The masters of one path do not know the trains of another. So only trains of one path at a time
    are on such a track, and each has a signal before it.

    Returns:
        By track, whether all paths run over it in the same direction.
    """
    paths = {path.line.name: path for path in paths}.values()
    runs = [leg for path in paths for leg in path.legs]
    count = Counter(leg.track.name for leg in runs)
    cross = {track for path in paths for each in path.crossings for track in (each.a, each.b)}
    ways = {
        leg.track.name: {each.running for each in runs if each.track == leg.track} for leg in runs
    }
    return {
        track: len(runnings) == 1
        for track, runnings in ways.items()
        if count[track] > 1 or track in cross
    }


def area_borders_m(path: Path) -> list[float]:
    """The borders that the tracks of a path name, by its chainage."""
    return [leg.path_m(at_m) for leg in path.legs for at_m in leg.track.area_borders_m]


def divided(network: TrackNetwork, path: Path, shared: Shared = NOT_SHARED) -> AreaMap:
    """Areas, axle sections and objects of a path, by its chainage.

    A route is an object from its signal to its last switch, where its area ends. Areas also end at
    the borders that the tracks name. So every metre of the path has one owner. A vehicle of another
    path can only be behind a switch or in a shared track, where a section begins.
    """
    routes = sections_of(network, path, shared)
    start_m, end_m = path.line.start_m, path.line.end_m
    sites = tuple(
        ObjectSite(number, ObjectKind.SWITCH, route.signal_m, route.last_m)
        for number, route in enumerate(routes, start=1)
    )
    borders_m = {start_m, *(site.end_m for site in sites), *area_borders_m(path), end_m}
    joints_m = [*borders_m]
    for route in routes:
        inner_m = [route.first_m, *(each.at_m for each in route.crossings)]
        joints_m += [at_m for at_m in inner_m if route.last_m - at_m >= SECTION_MIN_M]
    areas = tuple(
        Area(number, *ends_m) for number, ends_m in enumerate(pairwise(sorted(borders_m)), start=1)
    )
    sections = sections_between(sorted(set(joints_m)), SECTION_M)
    return AreaMap(path.line.name, areas, sections, sites, APPLY_M)


def check_masters(network: TrackNetwork, trips: Iterable[tuple[Path, str]], source: str) -> None:
    """Raise SettingsError for trips that masters cannot command.

    A trip must not begin between a signal and the end of its route's object, because the train
    would need no locked object. Nor may an area end there.

    Args:
        trips: path and station of departure of each.
    """
    trips = list(trips)
    shared = shared_tracks(path for path, _ in trips)
    for path, start in trips:
        stop_m = path.line.station(start).stop_m
        routes = sections_of(network, path, shared)
        for route in routes:
            if route.signal_m - AT_STOP_M < stop_m < route.last_m:
                raise SettingsError(
                    f"{source}: the trip over {path.line.name} begins at {start}, "
                    f"{route.last_m - stop_m:.1f} m before a track or switch that its masters must "
                    f"lock first; let it begin at least {SIGNAL_M + AT_STOP_M:g} m before"
                )
        _check_borders(path, routes, source)


def _check_borders(path: Path, routes: Sequence[RouteSection], source: str) -> None:
    """Each border lies outside of all objects, and a section's length from all other ends."""
    ends_m = [path.line.start_m, *(each.last_m for each in routes), path.line.end_m]
    borders_m = sorted(area_borders_m(path))
    for number, at_m in enumerate(borders_m):
        near = any(abs(at_m - end_m) < SECTION_MIN_M for end_m in (*ends_m, *borders_m[:number]))
        if near or any(each.signal_m <= at_m < each.last_m for each in routes):
            place = path.to_track(at_m)
            raise SettingsError(
                f"{source}: track {place.track}: area_borders_m {place.at_m:g} is within "
                f"{SECTION_MIN_M:g} m of an end of route {path.line.name} or another border, or "
                "between a signal and its switch; move it"
            )


def truth_of(
    areas: AreaMap, path: Path, trains: Iterable[Interlocking], axles: int = AXLES
) -> WaysideTruth:
    """What the detectors of a path and the interlocking report to its objects.

    Args:
        trains: all trains on the network, of any path.
        axles: of each train.
    """
    counted: Counter[int] = Counter()
    occupied: set[int] = set()
    failed: set[int] = set()
    wanted = {site.number for site in areas.objects}
    starts_m = [section.start_m for section in areas.sections]
    for train in trains:
        body = train.body
        own = body.path.line.name == path.line.name
        if not own and not any(body.parts_on(path)):
            continue
        step_m = (body.end_m - body.rear_m - 2.0 * INSET_M) / (axles - 1)
        for n in range(axles):
            at_m = body.end_m - INSET_M - n * step_m
            on_m = at_m if own else _on(path, body.path.to_track(at_m))
            if on_m is not None and areas.start_m <= on_m < areas.end_m:
                counted[areas.sections[bisect_right(starts_m, on_m) - 1].number] += 1
        for index, site in enumerate(areas.objects if own else ()):
            if body.rear_m < site.end_m and site.start_m < body.end_m:
                occupied.add(site.number)
            if train.is_set_ahead(index):
                wanted.discard(site.number)
            if train.has_failed(index):
                failed.add(site.number)
    return WaysideTruth(counted, occupied, wanted, failed)


def claimed(
    sections: Iterable[RouteSection], areas: AreaMap, states: Mapping[int, ObjectState]
) -> frozenset[str]:
    """The switches of all objects that are not free."""
    return frozenset(
        switch
        for section, site in zip(sections, areas.objects, strict=True)
        if states[site.number] is not ObjectState.FREE
        for switch, _, _ in section.locks
    )


def _on(path: Path, place: TrackPlace) -> float | None:
    """Chainage of a place on another path; None if that path does not run over the track."""
    return path.to_path(place) if any(leg.track.name == place.track for leg in path.legs) else None
