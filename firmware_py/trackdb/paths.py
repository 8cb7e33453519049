"""Paths: the line that a train sees ahead of it, whose chainage grows in its running direction.

This is the one place that translates between tracks and paths.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

from firmware_py.trackdb.line_map import LineMap
from firmware_py.trackdb.network import (
    PlatformEdge,
    Running,
    Track,
    TrackCrossing,
    TrackNetwork,
    TrackZone,
)
from firmware_py.trackdb.sites import (
    POWER,
    CurveSection,
    GradientSection,
    LineZone,
    PlatformSide,
    SpeedSection,
    Station,
    TagKind,
    TagSite,
    TunnelSection,
)

T = TypeVar("T")
OTHER_SIDE: Final = {
    PlatformSide.LEFT: PlatformSide.RIGHT,
    PlatformSide.RIGHT: PlatformSide.LEFT,
    PlatformSide.BOTH: PlatformSide.BOTH,
    PlatformSide.NONE: PlatformSide.NONE,
}
CHAINAGE_DIGITS: Final = 6
"""Decimals of a chainage in metres on the map of a path. A survey is coarser than a micrometre.
Without rounding, a line and its mirrored copy differ by what the sums of chainages round off."""


@dataclass(frozen=True, slots=True)
class TrackPlace:
    """A place on a track, and the direction in which a train looks from there."""

    track: str
    at_m: float
    running: Running


@dataclass(frozen=True, slots=True)
class Leg:
    """One track of a path, run in one direction, from `from_m` to `to_m` of the path."""

    track: Track
    running: Running
    from_m: float

    @property
    def to_m(self) -> float:
        """Chainage of the path where the next leg begins."""
        return round(self.from_m + (self.track.end_m - self.track.start_m), CHAINAGE_DIGITS)

    def path_m(self, at_m: float) -> float:
        """Chainage of the path at a chainage of the track."""
        if self.running is Running.UP:
            return at_m + (self.from_m - self.track.start_m)
        return (self.from_m + self.track.end_m) - at_m

    def track_m(self, path_m: float) -> float:
        """Chainage of the track at a chainage of the path."""
        if self.running is Running.UP:
            return path_m - (self.from_m - self.track.start_m)
        return (self.from_m + self.track.end_m) - path_m

    def site_m(self, at_m: float) -> float:
        """Chainage on the map of the path of a fixed place of the track."""
        return round(self.path_m(at_m), CHAINAGE_DIGITS)

    def section_m(self, start_m: float, end_m: float) -> tuple[float, float]:
        """Both ends of a section of the track on the map of the path, in its order."""
        one_m, other_m = self.site_m(start_m), self.site_m(end_m)
        return min(one_m, other_m), max(one_m, other_m)


@dataclass(frozen=True, slots=True)
class Path:
    """A way over tracks, and its line. Each track occurs once."""

    legs: tuple[Leg, ...]
    line: LineMap
    crossings: tuple[TrackCrossing, ...] = ()
    """Crossings of the network."""

    def to_track(self, path_m: float) -> TrackPlace:
        """Where a place of the path is. Places beyond an end belong to the nearest track."""
        leg = next((leg for leg in self.legs if path_m < leg.to_m), self.legs[-1])
        return TrackPlace(leg.track.name, leg.track_m(path_m), leg.running)

    def to_path(self, place: TrackPlace) -> float:
        """Chainage of the path at a place of a track. Raises KeyError for a track elsewhere."""
        for leg in self.legs:
            if leg.track.name == place.track:
                return leg.path_m(place.at_m)
        raise KeyError(f"path {self.line.name} does not run over track {place.track}")


def make_path(network: TrackNetwork, name: str, way: Sequence[tuple[str, Running]]) -> Path:
    """A path over tracks in running order. Its chainage begins with that of the first track.

    Raises ValueError if the tracks do not follow each other, or if the line contradicts itself.
    """
    if not way:
        raise ValueError("legs: there is none")
    for track_name, _ in way:
        if [each for each, _ in way].count(track_name) > 1:
            raise ValueError(f"legs: {track_name} occurs twice; a path runs over a track once")
    for (one, leaves), (other, enters) in itertools.pairwise(way):
        exit_end = f"{one}.{'end' if leaves is Running.UP else 'start'}"
        entry_end = f"{other}.{'start' if enters is Running.UP else 'end'}"
        if not network.connected(exit_end, entry_end):
            raise ValueError(f"legs: no join or switch leads from {exit_end} to {entry_end}")
    legs: list[Leg] = []
    for track_name, running in way:
        try:
            track = network.track(track_name)
        except KeyError as error:
            raise ValueError(f"legs: {error.args[0]}") from None
        legs.append(Leg(track, running, legs[-1].to_m if legs else track.start_m))
    return Path(tuple(legs), _line(network, name, legs), network.crossings)


def _line(network: TrackNetwork, name: str, legs: Sequence[Leg]) -> LineMap:
    return LineMap(
        name=name,
        start_m=legs[0].from_m,
        end_m=legs[-1].to_m,
        stations=tuple(sorted(_stations(legs), key=lambda station: station.stop_m)),
        speed_sections=_limits(legs),
        gradients=tuple(each for leg in legs for each in _gradients(leg)),
        curves=tuple(each for leg in legs for each in _curves(leg)),
        tunnels=tuple(each for leg in legs for each in _tunnels(leg)),
        tags=tuple(sorted(_tags(legs), key=lambda tag: tag.position_m)),
        description=network.description,
        rollback_m=network.rollback_m,
        neutral_sections=_zones(legs, "neutral_sections"),
        power_sections=_zones(legs, "power_sections"),
        no_stop_zones=_zones(legs, "no_stop_zones"),
        evacuation_stops=_zones(legs, "evacuation_stops"),
    )


def _stations(legs: Sequence[Leg]) -> Iterator[Station]:
    for leg in legs:
        for edge in leg.track.platforms:
            stop_m = edge.stop_m(leg.running)
            if stop_m is not None:
                yield _station(leg, edge, stop_m)


def _station(leg: Leg, edge: PlatformEdge, stop_m: float) -> Station:
    start_m, end_m = leg.section_m(edge.start_m, edge.end_m)
    up = leg.running is Running.UP
    short = edge.short_up if up else edge.short_down
    return Station(
        name=edge.station,
        stop_m=leg.site_m(stop_m),
        platform_start_m=start_m,
        platform_end_m=end_m,
        side=edge.side if up else OTHER_SIDE[edge.side],
        dwell_s=edge.dwell_s,
        platform_doors=edge.platform_doors,
        run_s=edge.run_up_s if up else edge.run_down_s,
        short_stops=tuple(replace(each, stop_m=leg.site_m(each.stop_m)) for each in short),
    )


def _limits(legs: Sequence[Leg]) -> tuple[SpeedSection, ...]:
    """Limits that touch each other exactly, whatever rounding did to their ends."""
    sections = sorted(
        (leg.section_m(limit.start_m, limit.end_m), limit.limit_mps)
        for leg in legs
        for limit in leg.track.limits_for(leg.running)
    )
    starts_m = [legs[0].from_m, *(start_m for (start_m, _), _ in sections[1:])]
    ends_m = [*starts_m[1:], legs[-1].to_m]
    return tuple(
        SpeedSection(start_m, end_m, limit_mps)
        for start_m, end_m, (_, limit_mps) in zip(starts_m, ends_m, sections, strict=True)
    )


def _in_order(leg: Leg, items: Sequence[T]) -> Sequence[T]:
    return items if leg.running is Running.UP else items[::-1]


def _gradients(leg: Leg) -> Iterator[GradientSection]:
    sign = 1.0 if leg.running is Running.UP else -1.0
    for grade in _in_order(leg, leg.track.gradients):
        start_m, end_m = leg.section_m(grade.start_m, grade.end_m)
        yield GradientSection(start_m, end_m, sign * grade.gradient_permille)


def _curves(leg: Leg) -> Iterator[CurveSection]:
    for curve in _in_order(leg, leg.track.curves):
        yield CurveSection(*leg.section_m(curve.start_m, curve.end_m), curve.radius_m)


def _tunnels(leg: Leg) -> Iterator[TunnelSection]:
    for tunnel in _in_order(leg, leg.track.tunnels):
        start_m, end_m = leg.section_m(tunnel.start_m, tunnel.end_m)
        yield replace(tunnel, start_m=start_m, end_m=end_m)


def _zones(legs: Sequence[Leg], key: str) -> tuple[LineZone, ...]:
    """The zones for trains of this path. Parts that meet where two tracks do become one.

    Power sections with different names stay apart: there is an insulator between them.
    """
    found: list[LineZone] = []
    for leg in legs:
        zones: Sequence[TrackZone] = getattr(leg.track, key)
        for zone in _in_order(leg, zones):
            if not zone.direction.serves(leg.running):
                continue
            start_m, end_m = leg.section_m(zone.start_m, zone.end_m)
            apart = key == POWER and found and found[-1].name != zone.name
            if found and start_m <= found[-1].end_m and not apart:
                last = found.pop()
                start_m, name = last.start_m, last.name or zone.name
                found.append(LineZone(start_m, max(last.end_m, end_m), name))
            else:
                found.append(LineZone(start_m, end_m, zone.name))
    return tuple(found)


def _tags(legs: Sequence[Leg]) -> Iterator[TagSite]:
    for leg in legs:
        for tag in leg.track.tags:
            at_m = leg.site_m(tag.position_m)
            if tag.direction.serves(leg.running) and tag.kind is not TagKind.BALISE:
                yield TagSite(tag.tag_id, at_m, tag.kind, tag.station)
            else:
                yield TagSite(tag.tag_id, at_m)
