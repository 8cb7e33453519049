"""A network: tracks with their own chainage, and the joins and switches between their ends."""

import enum
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from firmware_py.trackdb.sites import (
    ZONES,
    CurveSection,
    GradientSection,
    PlatformSide,
    StoppingPoint,
    TagKind,
    TunnelSection,
    check_order,
    check_siding,
)


class Running(enum.Enum):
    """Direction of running on a track."""

    UP = "up"
    """Chainage of the track grows."""
    DOWN = "down"
    """Chainage of the track falls."""

    @property
    def other(self) -> "Running":
        """The opposite direction."""
        return Running.DOWN if self is Running.UP else Running.UP


class Serves(enum.Enum):
    """Directions of running that a limit or a stop tag is for."""

    UP = "up"
    DOWN = "down"
    BOTH = "both"

    def serves(self, running: Running) -> bool:
        """Whether it is for trains in this direction."""
        return self is Serves.BOTH or self.value == running.value


@dataclass(frozen=True, slots=True)
class PlatformEdge:
    """A platform beside a track, with a stopping point for each direction that stops there."""

    station: str
    start_m: float
    end_m: float
    side: PlatformSide = PlatformSide.RIGHT
    """Side for a train that runs up."""
    stop_up_m: float | None = None
    """Place of the front coupler of a train that runs up. None: such trains do not stop."""
    stop_down_m: float | None = None
    """Place of the front coupler of a train that runs down. None: such trains do not stop."""
    dwell_s: float = 30.0
    platform_doors: bool = False
    run_up_s: float = 0.0
    """Planned run time of a train that runs up, from the station before; 0: no plan."""
    run_down_s: float = 0.0
    """The same of a train that runs down."""
    short_up: tuple[StoppingPoint, ...] = ()
    """Stopping points of shorter trains that run up, the shortest first."""
    short_down: tuple[StoppingPoint, ...] = ()
    """The same of trains that run down."""

    def __post_init__(self) -> None:
        if not self.start_m < self.end_m:
            raise ValueError(f"end_m {self.end_m} is not beyond start_m {self.start_m}")
        check_siding(self.side, self.dwell_s)
        for name in ("stop_up_m", "stop_down_m"):
            stop_m = getattr(self, name)
            if stop_m is not None and not self.start_m <= stop_m <= self.end_m:
                raise ValueError(
                    f"{name} {stop_m} of {self.station} is not along its platform, "
                    f"{self.start_m:g} m to {self.end_m:g} m"
                )

    def stop_m(self, running: Running) -> float | None:
        """Stopping point for a direction."""
        return self.stop_up_m if running is Running.UP else self.stop_down_m


@dataclass(frozen=True, slots=True)
class TrackLimit:
    """A civil speed limit on a stretch, for one direction or for both."""

    start_m: float
    end_m: float
    limit_mps: float
    direction: Serves = Serves.BOTH

    def __post_init__(self) -> None:
        if not self.start_m < self.end_m:
            raise ValueError(f"end_m {self.end_m} is not beyond start_m {self.start_m}")
        if not self.limit_mps > 0.0:
            raise ValueError(f"limit_mps {self.limit_mps} is not positive")


@dataclass(frozen=True, slots=True)
class TrackTag:
    """A tag in a track. A stop tag serves one direction; the other reads it as a balise."""

    tag_id: int
    position_m: float
    kind: TagKind = TagKind.BALISE
    station: str | None = None
    direction: Serves = Serves.BOTH

    def __post_init__(self) -> None:
        if self.kind is not TagKind.BALISE and self.direction is Serves.BOTH:
            raise ValueError(
                f"tag {self.tag_id}: kind {self.kind.value} serves one stopping point; give "
                "direction up or down"
            )


@dataclass(frozen=True, slots=True)
class TrackZone:
    """A zone of a track, for one direction of running or for both."""

    start_m: float
    end_m: float
    name: str = ""
    direction: Serves = Serves.BOTH

    def __post_init__(self) -> None:
        if not self.start_m < self.end_m:
            raise ValueError(f"end_m {self.end_m} is not beyond start_m {self.start_m}")


@dataclass(frozen=True, slots=True)
class Track:
    """One track between two ends, without a switch in it."""

    name: str
    start_m: float
    end_m: float
    limits: tuple[TrackLimit, ...]
    platforms: tuple[PlatformEdge, ...] = ()
    gradients: tuple[GradientSection, ...] = ()
    """Positive climbs for a train that runs up."""
    curves: tuple[CurveSection, ...] = ()
    tags: tuple[TrackTag, ...] = ()
    neutral_sections: tuple[TrackZone, ...] = ()
    """Sections without power, in which trains demand no traction: `start_m`, `end_m`, and if wanted
    `name` and `direction` (`up`, `down` or `both`)."""
    power_sections: tuple[TrackZone, ...] = ()
    """Stretches of contact line that can be switched off by themselves: `start_m`, `end_m` and
    `name`. Two sections meet at a section insulator; parts with one name are one section."""
    no_stop_zones: tuple[TrackZone, ...] = ()
    """Zones in which trains do not stop by themselves, such as tunnels, with the same keys."""
    evacuation_stops: tuple[TrackZone, ...] = ()
    """Places at which a train that is held for long stands, its front at the far end, with the same
    keys; `name` is needed."""
    area_borders_m: tuple[float, ...] = ()
    """Where areas of trains that command themselves end on this track, besides those at switches.
    They are borders for all routes over the track, in both directions."""
    tunnels: tuple[TunnelSection, ...] = ()
    """Tunnels: `start_m`, `end_m`, `drag_ratio`, and `name` if wanted."""

    def __post_init__(self) -> None:
        if not self.name or any(each in self.name for each in " .:"):
            raise ValueError(f"name {self.name!r} is empty or has a blank, a dot or a colon")
        if not self.start_m < self.end_m:
            raise ValueError(f"end_m {self.end_m} is not beyond start_m {self.start_m}")
        for running in Running:
            self._check_limits(running)
        check_order("gradients", self.gradients)
        check_order("curves", self.curves)
        check_order("tunnels", self.tunnels)
        for running in Running:
            for name in ZONES:
                zones = [each for each in getattr(self, name) if each.direction.serves(running)]
                check_order(name, zones)
        for section in self.power_sections:
            if section.direction is not Serves.BOTH:
                raise ValueError(
                    f"power_sections: {section.name}: direction {section.direction.value}: a "
                    "contact line feeds both; leave direction out"
                )
        for what, at_m in self._places():
            if not self.start_m <= at_m <= self.end_m:
                raise ValueError(
                    f"{what} at {at_m:g} m is not on the track, {self.start_m:g} m to "
                    f"{self.end_m:g} m"
                )
        for before, after in itertools.pairwise(self.tags):
            if not before.position_m < after.position_m:
                raise ValueError(
                    f"tags: tag {after.tag_id} at {after.position_m:g} m is out of order after "
                    f"tag {before.tag_id} at {before.position_m:g} m"
                )

    def limits_for(self, running: Running) -> tuple[TrackLimit, ...]:
        """The limits for one direction, by rising chainage."""
        return tuple(limit for limit in self.limits if limit.direction.serves(running))

    def _check_limits(self, running: Running) -> None:
        reached_m = self.start_m
        for limit in self.limits_for(running):
            if limit.start_m != reached_m:
                raise ValueError(
                    f"limits: {running.value}: a limit begins at {limit.start_m:g} m where "
                    f"{reached_m:g} m is needed; together they must cover the track once"
                )
            reached_m = limit.end_m
        if reached_m != self.end_m:
            raise ValueError(
                f"limits: {running.value}: they end at {reached_m:g} m, the track at "
                f"{self.end_m:g} m"
            )

    def _places(self) -> Iterator[tuple[str, float]]:
        for border_m in self.area_borders_m:
            yield "area_borders_m: a border", border_m
        for edge in self.platforms:
            yield f"platforms: {edge.station}", edge.start_m
            yield f"platforms: {edge.station}", edge.end_m
        for grade in self.gradients:
            yield "gradients: a section", grade.start_m
            yield "gradients: a section", grade.end_m
        for curve in self.curves:
            yield "curves: a section", curve.start_m
            yield "curves: a section", curve.end_m
        for tunnel in self.tunnels:
            yield "tunnels: a tunnel", tunnel.start_m
            yield "tunnels: a tunnel", tunnel.end_m
        for name in ZONES:
            for zone in getattr(self, name):
                yield f"{name}: a zone", zone.start_m
                yield f"{name}: a zone", zone.end_m
        for tag in self.tags:
            yield f"tags: tag {tag.tag_id}", tag.position_m


@dataclass(frozen=True, slots=True)
class Join:
    """Two track ends that lead into each other; an end is written `TRACK.start` or `TRACK.end`."""

    a: str
    b: str


@dataclass(frozen=True, slots=True)
class TrackSwitch:
    """A switch: from its tip, a train takes the left or the right leg."""

    name: str
    tip: str
    left: str
    right: str

    @property
    def ends(self) -> tuple[str, str, str]:
        """The three track ends."""
        return self.tip, self.left, self.right


@dataclass(frozen=True, slots=True)
class TrackCrossing:
    """A place where two tracks cross on the level, without a switch, for one train at a time."""

    name: str
    a: str
    """One of the two tracks."""
    a_m: float
    """Chainage of that track at the crossing."""
    b: str
    b_m: float
    clear_m: float = 20.0
    """Distance from the crossing at which a vehicle clears the other track."""

    def __post_init__(self) -> None:
        if self.a == self.b:
            raise ValueError(f"{self.name}: a and b both name track {self.a}; name two tracks")
        if not self.clear_m > 0.0:
            raise ValueError(f"{self.name}: clear_m {self.clear_m} is not positive")

    def across(self, track: str, start_m: float, end_m: float) -> tuple[str, float, float] | None:
        """The stretch of the other track that a stretch of this one bars; None if it bars none."""
        for (own, own_m), (other, other_m) in (
            ((self.a, self.a_m), (self.b, self.b_m)),
            ((self.b, self.b_m), (self.a, self.a_m)),
        ):
            if own == track and start_m < own_m + self.clear_m and own_m - self.clear_m < end_m:
                return other, other_m - self.clear_m, other_m + self.clear_m
        return None


@dataclass(frozen=True, slots=True)
class Route:
    """A way through the network, as `vobc run --line FILE:NAME` takes it."""

    name: str
    legs: tuple[str, ...]
    """Tracks in running order with the direction of running, such as `main up`."""


@dataclass(frozen=True, slots=True)
class TrackNetwork:
    """Tracks and what connects them. Raises ValueError if its parts contradict each other."""

    name: str
    tracks: tuple[Track, ...]
    joins: tuple[Join, ...] = ()
    switches: tuple[TrackSwitch, ...] = ()
    buffer_stops: tuple[str, ...] = ()
    """Track ends where the track ends."""
    routes: tuple[Route, ...] = ()
    description: str = ""
    rollback_m: float = 2.0
    crossings: tuple[TrackCrossing, ...] = ()
    """Places where two tracks cross on the level: `name`, tracks `a` and `b`, chainages `a_m`
    and `b_m`, and `clear_m`, 20 m from there, where a vehicle clears the other track."""

    def __post_init__(self) -> None:
        self._check_names()
        self._check_ends()
        self._check_crossings()
        self._check_tags()

    def track(self, name: str) -> Track:
        """A track by name. Raises KeyError with the known names."""
        for track in self.tracks:
            if track.name == name:
                return track
        names = ", ".join(track.name for track in self.tracks)
        raise KeyError(f"network {self.name} has no track {name}; it has {names}")

    def connected(self, leaving: str, entering: str) -> bool:
        """Whether a train that leaves a track over one end enters another over the other end."""
        pairs = [{join.a, join.b} for join in self.joins]
        for switch in self.switches:
            pairs += [{switch.tip, switch.left}, {switch.tip, switch.right}]
        return {leaving, entering} in pairs

    def _check_names(self) -> None:
        if not self.tracks:
            raise ValueError("tracks: there is none")
        for what, names in (
            ("tracks", [track.name for track in self.tracks]),
            ("switches", [switch.name for switch in self.switches]),
            ("crossings", [crossing.name for crossing in self.crossings]),
            ("routes", [route.name for route in self.routes]),
        ):
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"{what}: {name} occurs twice; give each its own name")

    def _check_ends(self) -> None:
        used: dict[str, str] = {}
        known = [f"{track.name}.{end}" for track in self.tracks for end in ("start", "end")]
        for what, end in self._ends():
            if not end:
                raise ValueError(f"{what} has no track end; write TRACK.start or TRACK.end")
            if end not in known:
                raise ValueError(
                    f"{what}: there is no track end {end!r}; the ends are {', '.join(known)}"
                )
            if end in used:
                raise ValueError(
                    f"{what}: {end} already belongs to {used[end]}; two tracks would lie at one "
                    "place"
                )
            used[end] = what
        for end in known:
            if end not in used:
                raise ValueError(
                    f"buffer_stops: {end} leads nowhere; join it, give it to a switch, or list "
                    "it as a buffer stop"
                )

    def _ends(self) -> Iterator[tuple[str, str]]:
        for join in self.joins:
            yield f"joins: {join.a} to {join.b}", join.a
            yield f"joins: {join.a} to {join.b}", join.b
        for switch in self.switches:
            for leg, end in zip(("tip", "left", "right"), switch.ends, strict=True):
                yield f"switches: {switch.name}: {leg}", end
        for end in self.buffer_stops:
            yield "buffer_stops", end

    def _check_crossings(self) -> None:
        known = {track.name: track for track in self.tracks}
        for crossing in self.crossings:
            for key, name, at_m in (
                ("a", crossing.a, crossing.a_m),
                ("b", crossing.b, crossing.b_m),
            ):
                what = f"crossings: {crossing.name}: {key}"
                if name not in known:
                    raise ValueError(
                        f"{what}: there is no track {name!r}; the tracks are {', '.join(known)}"
                    )
                track = known[name]
                if not track.start_m <= at_m <= track.end_m:
                    raise ValueError(
                        f"{what}_m {at_m:g} is not on track {name}, {track.start_m:g} m to "
                        f"{track.end_m:g} m"
                    )

    def _check_tags(self) -> None:
        seen: dict[int, str] = {}
        for track in self.tracks:
            for tag in track.tags:
                if tag.tag_id in seen:
                    raise ValueError(
                        f"tags: tag_id {tag.tag_id} is on track {seen[tag.tag_id]} and on track "
                        f"{track.name}; give each tag its own number"
                    )
                seen[tag.tag_id] = track.name
