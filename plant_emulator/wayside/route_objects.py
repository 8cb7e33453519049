"""The wayside of trains that command themselves on a network: each path is a line of its own.

A path is the chainage on which a master computes. Its areas end at the switches of the
interlocking, and each route is an object of the path: trains pass it only while it is locked for
the master. The object is locked only while the interlocking proves the route for a train that has
not reached its signal yet. The interlocking moves no switch of a locked object for another path.
Pure.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping
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
from firmware_py.trackdb.network import Running, TrackNetwork
from firmware_py.trackdb.paths import Path, TrackPlace
from plant_emulator.wayside.detection import INSET_M
from plant_emulator.wayside.interlocking import Interlocking, sections_of
from plant_emulator.wayside.line_wayside import WaysideTruth
from zenoh_config.t2t import ObjectState

SECTION_M: Final = 100.0
"""Length of the sections whose axles are counted."""
APPLY_M: Final = 800.0
"""Distance before an area at which a train reports to it, too."""


def divided(network: TrackNetwork, path: Path) -> AreaMap:
    """Areas, axle sections and objects of a path, by its chainage.

    A route is an object from its signal to its last switch, where its area ends. So every metre of
    the path has one owner. A vehicle of another path can only be behind a switch, where a section
    begins.
    """
    routes = sections_of(network, path)
    start_m, end_m = path.line.start_m, path.line.end_m
    sites = tuple(
        ObjectSite(number, ObjectKind.SWITCH, route.signal_m, route.crossings[-1].at_m)
        for number, route in enumerate(routes, start=1)
    )
    borders_m = (start_m, *(site.end_m for site in sites), end_m)
    joints_m = [start_m, end_m]
    for route in routes:
        last_m = route.crossings[-1].at_m
        joints_m.append(last_m)
        joints_m += [c.at_m for c in route.crossings if last_m - c.at_m >= SECTION_MIN_M]
    areas = tuple(
        Area(number, *ends_m) for number, ends_m in enumerate(pairwise(borders_m), start=1)
    )
    sections = sections_between(sorted(set(joints_m)), SECTION_M)
    return AreaMap(path.line.name, areas, sections, sites, APPLY_M)


def check_paths(paths: Iterable[Path], source: str) -> None:
    """Raise SettingsError if two paths run over a track in the same direction, or over a crossing.

    Their masters would not know of each other's trains.
    """
    owners: dict[tuple[str, Running], str] = {}
    for path in paths:
        for crossing in path.crossings:
            if {crossing.a, crossing.b} & {leg.track.name for leg in path.legs}:
                raise SettingsError(
                    f"{source}: route {path.line.name} runs over crossing {crossing.name}, which "
                    "masters do not know; use routes without it, or leave out --masters"
                )
        for leg in path.legs:
            owner = owners.setdefault((leg.track.name, leg.running), path.line.name)
            if owner != path.line.name:
                raise SettingsError(
                    f"{source}: routes {owner} and {path.line.name} both run {leg.running.value} "
                    f"over track {leg.track.name}, so two masters would command trains there; use "
                    "one route for each direction of a track, or leave out --masters"
                )


def truth_of(
    areas: AreaMap, path: Path, trains: Iterable[Interlocking], axles: int
) -> WaysideTruth:
    """What the detectors of a path and the interlocking report to its objects.

    Args:
        trains: all trains on the network, of any path.
        axles: of each train.
    """
    counted: Counter[int] = Counter()
    occupied: set[int] = set()
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
    return WaysideTruth(counted, occupied, wanted)


def claimed(
    network: TrackNetwork, path: Path, areas: AreaMap, states: Mapping[int, ObjectState]
) -> frozenset[str]:
    """The switches of all objects that are not free."""
    return frozenset(
        switch
        for section, site in zip(sections_of(network, path), areas.objects, strict=True)
        if states[site.number] is not ObjectState.FREE
        for switch, _, _ in section.locks
    )


def _on(path: Path, place: TrackPlace) -> float | None:
    """Chainage of a place on another path; None if that path does not run over the track."""
    return path.to_path(place) if any(leg.track.name == place.track for leg in path.legs) else None
