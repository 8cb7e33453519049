"""The line by chainage: stations, speed limits, gradients, curves and tags.

Chainage increases in running direction. Sections are half-open, [start, end). Track outside of
gradient and curve sections is level and straight. Speed sections must cover the line without a gap.
"""

import itertools
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

from firmware_py.trackdb.sites import (
    TUNNELS,
    ZONES,
    CurveSection,
    GradientSection,
    LineZone,
    SpeedSection,
    Station,
    TagSite,
    TrackStretch,
    TunnelSection,
    check_order,
)
from firmware_py.trackdb.sites import TagKind as TagKind

T = TypeVar("T")
ROLLBACK_MAX_M: Final = 10.0

CHAINAGE_MIN_M: Final = -1000.0
"""Least chainage of a line. The train's position frame carries no smaller one."""
CHAINAGE_MAX_M: Final = 160_000.0
"""Greatest chainage of a line, for the same reason."""


@dataclass(frozen=True, slots=True)
class LineMap:
    """One line in running direction.

    Raises ValueError when its parts contradict each other.

    Beyond both ends the track is level and straight, and the limit is that of the nearest section.
    """

    name: str
    start_m: float
    end_m: float
    stations: tuple[Station, ...]
    speed_sections: tuple[SpeedSection, ...]
    gradients: tuple[GradientSection, ...] = ()
    curves: tuple[CurveSection, ...] = ()
    tags: tuple[TagSite, ...] = ()
    description: str = ""
    rollback_m: float = 2.0
    """Greatest distance that a train may roll back. The wayside keeps that much track free behind
    each train."""
    neutral_sections: tuple[LineZone, ...] = ()
    """Sections without power, in which trains demand no traction: `start_m`, `end_m`, and `name` if
    wanted. They hold in both directions."""
    power_sections: tuple[LineZone, ...] = ()
    """Stretches of contact line that can be switched off by themselves: `start_m`, `end_m` and
    `name`. Two sections meet at a section insulator. They feed both directions."""
    no_stop_zones: tuple[LineZone, ...] = ()
    """Zones in which trains do not stop by themselves, such as tunnels: `start_m`, `end_m`, and
    `name` if wanted. They hold in both directions."""
    evacuation_stops: tuple[LineZone, ...] = ()
    """Places at which a train that is held for long stands, its front at the far end: `start_m`,
    `end_m` and `name`. They serve both directions."""
    tunnels: tuple[TunnelSection, ...] = ()
    """Tunnels: `start_m`, `end_m`, `drag_ratio`, and `name` if wanted."""
    # Each quantity is stored as the chainages of its changes and its values, one more than changes.
    # value[i] holds on [edge[i - 1], edge[i]), so that bisect_right(edges, at) is its index.
    _limit_edges_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _limits_mps: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _grade_edges_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _grades_permille: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _height_at_edges_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _curve_edges_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _radii_m: tuple[float | None, ...] = field(init=False, repr=False, compare=False, default=())
    _tunnel_edges_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _drag_ratio: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _stops_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())

    def __post_init__(self) -> None:
        if not self.start_m < self.end_m:
            raise ValueError(f"end_m {self.end_m} is not beyond start_m {self.start_m}")
        for name in ("start_m", "end_m"):
            if not CHAINAGE_MIN_M <= getattr(self, name) <= CHAINAGE_MAX_M:
                raise ValueError(
                    f"{name} {getattr(self, name)} is not in {CHAINAGE_MIN_M:g}.."
                    f"{CHAINAGE_MAX_M:g}, which VOBC_POSITION can carry; shift the chainages"
                )
        if not 0.0 < self.rollback_m <= ROLLBACK_MAX_M:
            raise ValueError(f"rollback_m {self.rollback_m} is not in 0..{ROLLBACK_MAX_M:g}")
        self._check_stations()
        self._check_speeds()
        for name in ("gradients", "curves", TUNNELS, *ZONES):
            self._check_sections(name, getattr(self, name))
        self._check_tags()
        self._index()

    def _check_stations(self) -> None:
        if not self.stations:
            raise ValueError("stations: there is none")
        for earlier, later in itertools.pairwise(self.stations):
            if not earlier.stop_m < later.stop_m:
                raise ValueError(
                    f"stations: {later.name} at {later.stop_m} m is out of order after "
                    f"{earlier.name} at {earlier.stop_m} m"
                )
        names: set[str] = set()
        for station in self.stations:
            if station.name in names:
                raise ValueError(f"stations: {station.name} occurs twice")
            names.add(station.name)
            if not self.start_m <= station.platform_start_m <= station.platform_end_m <= self.end_m:
                raise ValueError(f"stations: {station.name} is not on the line")

    def _check_speeds(self) -> None:
        reached_m = self.start_m
        for section in self.speed_sections:
            if section.start_m != reached_m:
                raise ValueError(
                    f"speed_sections: a section starts at {section.start_m} m "
                    f"where {reached_m} m is needed"
                )
            reached_m = section.end_m
        if reached_m != self.end_m:
            raise ValueError(
                f"speed_sections: they end at {reached_m} m, the line at {self.end_m} m"
            )

    def _check_sections(self, what: str, sections: Sequence[TrackStretch]) -> None:
        check_order(what, sections)
        for each in sections:
            if not self.start_m <= each.start_m < each.end_m <= self.end_m:
                raise ValueError(
                    f"{what}: the section from {each.start_m} m to {each.end_m} m is not on the "
                    "line"
                )

    def _check_tags(self) -> None:
        names = {station.name for station in self.stations}
        seen: set[int] = set()
        for earlier, later in itertools.pairwise(self.tags):
            if not earlier.position_m < later.position_m:
                raise ValueError(
                    f"tags: tag {later.tag_id} at {later.position_m} m is out of order after "
                    f"tag {earlier.tag_id} at {earlier.position_m} m"
                )
        for tag in self.tags:
            if tag.tag_id in seen:
                raise ValueError(f"tags: tag_id {tag.tag_id} occurs twice")
            seen.add(tag.tag_id)
            if not self.start_m <= tag.position_m <= self.end_m:
                raise ValueError(f"tags: tag {tag.tag_id} at {tag.position_m} m is not on the line")
            if tag.station is not None and tag.station not in names:
                raise ValueError(f"tags: tag {tag.tag_id} serves unknown station {tag.station}")

    def _index(self) -> None:
        limits = [(s.start_m, s.end_m, s.limit_mps) for s in self.speed_sections]
        grades = [(g.start_m, g.end_m, g.gradient_permille) for g in self.gradients]
        curves = [(c.start_m, c.end_m, c.radius_m) for c in self.curves]
        grade_edges_m, grades_permille = _pieces(grades, 0.0)
        curve_edges_m, radii_m = _pieces(curves, None)
        tunnels = [(t.start_m, t.end_m, t.drag_ratio) for t in self.tunnels]
        tunnel_edges_m, drag_ratios = _pieces(tunnels, 1.0)
        heights_m = [0.0]
        for (start_m, end_m), grade_permille in zip(
            itertools.pairwise(grade_edges_m), grades_permille[1:], strict=False
        ):
            heights_m.append(heights_m[-1] + (end_m - start_m) * grade_permille / 1000.0)
        for name, value in (
            ("_limit_edges_m", tuple(start_m for start_m, _, _ in limits[1:])),
            ("_limits_mps", tuple(limit_mps for _, _, limit_mps in limits)),
            ("_grade_edges_m", grade_edges_m),
            ("_grades_permille", grades_permille),
            ("_height_at_edges_m", tuple(heights_m)),
            ("_curve_edges_m", curve_edges_m),
            ("_radii_m", radii_m),
            ("_tunnel_edges_m", tunnel_edges_m),
            ("_drag_ratio", drag_ratios),
            ("_stops_m", tuple(station.stop_m for station in self.stations)),
        ):
            object.__setattr__(self, name, value)

    def for_train(self, length_m: float) -> "LineMap":
        """Return the line with the stopping points of a train of this length."""
        if not any(station.short_stops for station in self.stations):
            return self
        return replace(self, stations=tuple(each.for_train(length_m) for each in self.stations))

    def height_m(self, at_m: float) -> float:
        """Height of the track above its start."""
        index = bisect_right(self._grade_edges_m, at_m)
        if index == 0:
            return 0.0
        run_m = at_m - self._grade_edges_m[index - 1]
        rise_m = run_m * self._grades_permille[index] / 1000.0
        return self._height_at_edges_m[index - 1] + rise_m

    def gradient_permille(self, at_m: float) -> float:
        """Gradient at one point."""
        return self._grades_permille[bisect_right(self._grade_edges_m, at_m)]

    def mean_gradient_permille(self, rear_m: float, front_m: float) -> float:
        """Mean gradient over a stretch, such as the train's length; rear_m < front_m."""
        assert rear_m < front_m
        edges_m = self._grade_edges_m
        first = bisect_right(edges_m, rear_m)
        # Without a change of gradient under the train there is nothing to integrate.
        if first == len(edges_m) or front_m < edges_m[first]:
            return self._grades_permille[first]
        return (self.height_m(front_m) - self.height_m(rear_m)) / (front_m - rear_m) * 1000.0

    def worst_gradient_permille(self, rear_m: float, front_m: float) -> float:
        """The lowest (steepest falling) gradient anywhere in [rear_m, front_m]; level is 0."""
        assert rear_m <= front_m
        first = bisect_right(self._grade_edges_m, rear_m)
        last = bisect_right(self._grade_edges_m, front_m)
        return min(self._grades_permille[first : last + 1])

    def steepest_climb_permille(self, rear_m: float, front_m: float) -> float:
        """The highest (steepest climbing) gradient anywhere in [rear_m, front_m]; level is 0."""
        assert rear_m <= front_m
        first = bisect_right(self._grade_edges_m, rear_m)
        last = bisect_right(self._grade_edges_m, front_m)
        return max(self._grades_permille[first : last + 1])

    def limit_mps(self, at_m: float) -> float:
        """Civil speed limit at one point."""
        return self._limits_mps[bisect_right(self._limit_edges_m, at_m)]

    def least_limit_mps(self, rear_m: float, front_m: float) -> float:
        """The lowest civil limit anywhere under a train that covers [rear_m, front_m]."""
        assert rear_m <= front_m
        first = bisect_right(self._limit_edges_m, rear_m)
        last = bisect_right(self._limit_edges_m, front_m)
        if first == last:
            return self._limits_mps[first]
        return min(self._limits_mps[first : last + 1])

    def radius_m(self, at_m: float) -> float | None:
        """Radius of the curve at one point; None on straight track."""
        return self._radii_m[bisect_right(self._curve_edges_m, at_m)]

    def drag_ratio(self, at_m: float) -> float:
        """Air drag at one point, divided by that in the open."""
        return self._drag_ratio[bisect_right(self._tunnel_edges_m, at_m)]

    def mean_drag_ratio(self, rear_m: float, front_m: float) -> float:
        """Mean of that ratio over a stretch, such as the train's length; rear_m < front_m."""
        assert rear_m < front_m
        more_m = 0.0
        for tunnel in self.tunnels:
            inside_m = min(front_m, tunnel.end_m) - max(rear_m, tunnel.start_m)
            more_m += max(0.0, inside_m) * (tunnel.drag_ratio - 1.0)
        return 1.0 + more_m / (front_m - rear_m)

    def station(self, name: str) -> Station:
        """Return a station. Raises KeyError with the known names for an unknown one."""
        for station in self.stations:
            if station.name == name:
                return station
        names = ", ".join(station.name for station in self.stations)
        raise KeyError(f"line {self.name} has no station {name}; it has {names}")

    def stations_between(self, after_m: float, up_to_m: float) -> Sequence[Station]:
        """Return the stations whose stopping point lies in (after_m, up_to_m], in running order."""
        stops_m = self._stops_m
        return self.stations[bisect_right(stops_m, after_m) : bisect_right(stops_m, up_to_m)]


def _pieces(
    sections: Sequence[tuple[float, float, T]], between: T
) -> tuple[tuple[float, ...], tuple[T, ...]]:
    """Return edges and values (one more than edges) of sections, with the value `between` outside
    of them.
    """
    edges_m: list[float] = []
    values: list[T] = [between]
    for start_m, end_m, value in sections:
        if edges_m and edges_m[-1] == start_m:
            values[-1] = value
        else:
            edges_m.append(start_m)
            values.append(value)
        edges_m.append(end_m)
        values.append(between)
    return tuple(edges_m), tuple(values)
