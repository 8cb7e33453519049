"""A line file as a network of one track, with a stopping point for trains that run down.

A line file describes one direction. What the other direction needs, stated rules add:

- A train that runs down stops as far before the end of the platform ahead as one that runs up.
- The tags before that stopping point are as far from it as those of the other direction. A station
  without a full set takes the distances of the nearest station that has one.
- Limits, zones and evacuation stops hold in both directions.
- A first station without dwell time, where trains of the file only start, takes that of the last.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from firmware_py.trackdb.line_map import LineMap
from firmware_py.trackdb.network import (
    PlatformEdge,
    Route,
    Running,
    Serves,
    Track,
    TrackLimit,
    TrackNetwork,
    TrackTag,
    TrackZone,
)
from firmware_py.trackdb.paths import Path, make_path
from firmware_py.trackdb.sites import LineZone, PlatformSide, Station, TagKind, TagSite

TRACK: Final = "main"
DOWN_TAGS: Final = 1_000_000_000
"""Difference of tag numbers between a stop tag and its counterpart of the other direction."""
DIRECTIONS: Final = tuple(running.value for running in Running)
FULL: Final = frozenset({TagKind.T1, TagKind.T2, TagKind.T3, TagKind.STOP})


def network_of(line: LineMap) -> TrackNetwork:
    """The line as one track between two buffer stops, with the routes `up` and `down`."""
    track = Track(
        name=TRACK,
        start_m=line.start_m,
        end_m=line.end_m,
        limits=tuple(TrackLimit(s.start_m, s.end_m, s.limit_mps) for s in line.speed_sections),
        platforms=tuple(_edges(line.stations)),
        gradients=line.gradients,
        curves=line.curves,
        tunnels=line.tunnels,
        tags=tuple(sorted(_tags(line), key=lambda tag: tag.position_m)),
        neutral_sections=_zones(line.neutral_sections),
        power_sections=_zones(line.power_sections),
        no_stop_zones=_zones(line.no_stop_zones),
        evacuation_stops=_zones(line.evacuation_stops),
    )
    return TrackNetwork(
        name=line.name,
        tracks=(track,),
        buffer_stops=(f"{TRACK}.start", f"{TRACK}.end"),
        routes=tuple(Route(each, (f"{TRACK} {each}",)) for each in DIRECTIONS),
        description=line.description,
        rollback_m=line.rollback_m,
    )


def one_track_path(line: LineMap, running: Running) -> Path:
    """The path over the whole line in one direction."""
    return make_path(network_of(line), f"{line.name}-{running.value}", ((TRACK, running),))


def _zones(zones: Sequence[LineZone]) -> tuple[TrackZone, ...]:
    """Zones of a line file hold in both directions."""
    return tuple(TrackZone(each.start_m, each.end_m, each.name) for each in zones)


def _edges(stations: Sequence[Station]) -> Iterator[PlatformEdge]:
    for index, (station, after) in enumerate(itertools.zip_longest(stations, stations[1:])):
        yield PlatformEdge(
            station=station.name,
            start_m=station.platform_start_m,
            end_m=station.platform_end_m,
            side=station.side,
            stop_up_m=station.stop_m,
            stop_down_m=_down_m(station, station.stop_m),
            dwell_s=_dwell_s(station, 0.0 if index else stations[-1].dwell_s),
            platform_doors=station.platform_doors,
            run_up_s=station.run_s,
            run_down_s=0.0 if after is None else after.run_s,
            short_up=station.short_stops,
            short_down=tuple(
                replace(each, stop_m=_down_m(station, each.stop_m)) for each in station.short_stops
            ),
        )


def _dwell_s(station: Station, otherwise_s: float) -> float:
    """The dwell time of a station with a platform, or another one if it has none."""
    if station.side is PlatformSide.NONE:
        return 0.0
    return station.dwell_s or otherwise_s


def _down_m(station: Station, stop_m: float) -> float:
    """The place as far from one end of the platform as `stop_m` is from the other."""
    return station.platform_start_m + (station.platform_end_m - stop_m)


def _tags(line: LineMap) -> Iterator[TrackTag]:
    """The tags of the file, and those of the other direction where the place is free."""
    taken_m = {tag.position_m for tag in line.tags}
    for tag in line.tags:
        stops = tag.kind is not TagKind.BALISE
        serves = Serves.UP if stops else Serves.BOTH
        yield TrackTag(tag.tag_id, tag.position_m, tag.kind, tag.station, serves)
    layouts = _layouts(line)
    for index, station in enumerate(line.stations):
        stop_m = _down_m(station, station.stop_m)
        for tag in _nearest(layouts, index):
            at_m = stop_m + (line.station(str(tag.station)).stop_m - tag.position_m)
            if at_m in taken_m or not line.start_m <= at_m <= line.end_m:
                continue
            taken_m.add(at_m)
            number = DOWN_TAGS + index * len(TagKind) + list(TagKind).index(tag.kind) + 1
            yield TrackTag(number, at_m, tag.kind, station.name, Serves.DOWN)


def _layouts(line: LineMap) -> list[tuple[TagSite, ...]]:
    """The stop tags of each station by running order."""
    return [
        tuple(
            tag
            for tag in line.tags
            if tag.station == station.name and tag.kind is not TagKind.BALISE
        )
        for station in line.stations
    ]


def _nearest(layouts: Sequence[tuple[TagSite, ...]], index: int) -> tuple[TagSite, ...]:
    """The stop tags of a station, or those of the nearest one with a full set."""
    full = [each for each, tags in enumerate(layouts) if {tag.kind for tag in tags} >= FULL]
    if not full or index in full:
        return layouts[index]
    return layouts[min(full, key=lambda each: abs(each - index))]
