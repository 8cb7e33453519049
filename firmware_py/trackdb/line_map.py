"""The line by chainage: stations, speed limits, gradients, curves and tags.

Chainage grows in running direction. Sections are half-open, [start, end). Where no gradient or curve
section lies the track is level and straight; speed sections must cover the line without a hole.
"""

import enum
import itertools
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

from firmware_py import settings


class PlatformSide(enum.Enum):
    LEFT = "left"
    RIGHT = "right"


class TagKind(enum.Enum):
    BALISE = "balise"
    """Plain location reference."""
    T1 = "t1"
    T2 = "t2"
    T3 = "t3"
    """The three magnetic tags before a stopping point (Allotta et al. 2013, section II.B)."""
    STOP = "stop"
    """Under the antenna of a train that stands at the stopping point."""


@dataclass(frozen=True, slots=True)
class Station:
    name: str
    stop_m: float
    """Where the front coupler of a train stands that stopped exactly."""
    platform_start_m: float
    platform_end_m: float
    side: PlatformSide = PlatformSide.RIGHT
    dwell_s: float = 30.0

    def __post_init__(self) -> None:
        if not self.platform_start_m < self.stop_m <= self.platform_end_m:
            raise ValueError(f"station {self.name}: stop_m {self.stop_m} is not along its platform")
        if self.dwell_s < 0.0:
            raise ValueError(f"station {self.name}: dwell_s {self.dwell_s} is negative")


@dataclass(frozen=True, slots=True)
class SpeedSection:
    start_m: float
    end_m: float
    limit_mps: float

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if self.limit_mps <= 0.0:
            raise ValueError(f"limit_mps {self.limit_mps} is not positive")


@dataclass(frozen=True, slots=True)
class GradientSection:
    start_m: float
    end_m: float
    gradient_permille: float
    """Positive climbs in running direction."""

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if abs(self.gradient_permille) > 120.0:
            raise ValueError(f"gradient_permille {self.gradient_permille} is beyond ±120")


@dataclass(frozen=True, slots=True)
class CurveSection:
    start_m: float
    end_m: float
    radius_m: float

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if self.radius_m < 50.0:
            raise ValueError(f"radius_m {self.radius_m} is under 50")


@dataclass(frozen=True, slots=True)
class TagSite:
    tag_id: int
    position_m: float
    kind: TagKind = TagKind.BALISE
    station: str | None = None
    """The station whose stop the tag serves; None for a balise between stations."""

    def __post_init__(self) -> None:
        if not 0 < self.tag_id < 2**32:
            raise ValueError(f"tag_id {self.tag_id} is not in 1..{2**32 - 1}")


@dataclass(frozen=True, slots=True)
class LineMap:
    """One line in running direction. Raises ValueError when its parts contradict each other."""

    name: str
    start_m: float
    end_m: float
    stations: tuple[Station, ...]
    speed_sections: tuple[SpeedSection, ...]
    gradients: tuple[GradientSection, ...] = ()
    curves: tuple[CurveSection, ...] = ()
    tags: tuple[TagSite, ...] = ()
    description: str = ""
    _speed_starts: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _grade_edges_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())
    _grade_heights_m: tuple[float, ...] = field(init=False, repr=False, compare=False, default=())

    def __post_init__(self) -> None:
        if self.end_m <= self.start_m:
            raise ValueError(f"end_m {self.end_m} is not beyond start_m {self.start_m}")
        self._check_stations()
        self._check_speeds()
        _check_order("gradients", [(g.start_m, g.end_m) for g in self.gradients])
        _check_order("curves", [(c.start_m, c.end_m) for c in self.curves])
        self._check_tags()
        object.__setattr__(self, "_speed_starts", tuple(s.start_m for s in self.speed_sections))
        self._index_gradients()

    def _check_stations(self) -> None:
        if not self.stations:
            raise ValueError("stations: there is none")
        names: set[str] = set()
        for earlier, later in itertools.pairwise(self.stations):
            if later.stop_m <= earlier.stop_m:
                raise ValueError(
                    f"stations: {later.name} at {later.stop_m} m is out of order after "
                    f"{earlier.name} at {earlier.stop_m} m"
                )
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
                    f"speed_sections: a section starts at {section.start_m} m where {reached_m} m is needed"
                )
            reached_m = section.end_m
        if reached_m != self.end_m:
            raise ValueError(f"speed_sections: they end at {reached_m} m, the line at {self.end_m} m")

    def _check_tags(self) -> None:
        names = {station.name for station in self.stations}
        seen: set[int] = set()
        for earlier, later in itertools.pairwise(self.tags):
            if later.position_m <= earlier.position_m:
                raise ValueError(f"tags: tag {later.tag_id} at {later.position_m} m is out of order")
        for tag in self.tags:
            if tag.tag_id in seen:
                raise ValueError(f"tags: tag_id {tag.tag_id} occurs twice")
            seen.add(tag.tag_id)
            if not self.start_m <= tag.position_m <= self.end_m:
                raise ValueError(f"tags: tag {tag.tag_id} at {tag.position_m} m is not on the line")
            if tag.station is not None and tag.station not in names:
                raise ValueError(f"tags: tag {tag.tag_id} serves unknown station {tag.station}")

    def _index_gradients(self) -> None:
        edges_m, heights_m, height_m, at_m = [self.start_m], [0.0], 0.0, self.start_m
        for section in self.gradients:
            if section.start_m > at_m:
                edges_m.append(section.start_m)
                heights_m.append(height_m)
            height_m += (section.end_m - section.start_m) * section.gradient_permille / 1000.0
            at_m = section.end_m
            edges_m.append(at_m)
            heights_m.append(height_m)
        object.__setattr__(self, "_grade_edges_m", tuple(edges_m))
        object.__setattr__(self, "_grade_heights_m", tuple(heights_m))

    def height_m(self, at_m: float) -> float:
        """Height over the start of the line; the track is level beyond the last gradient section."""
        edges_m, heights_m = self._grade_edges_m, self._grade_heights_m
        index = bisect_right(edges_m, at_m) - 1
        if index < 0:
            return 0.0
        if index + 1 >= len(edges_m):
            return heights_m[-1]
        share_ratio = (at_m - edges_m[index]) / (edges_m[index + 1] - edges_m[index])
        return heights_m[index] + share_ratio * (heights_m[index + 1] - heights_m[index])

    def mean_gradient_permille(self, rear_m: float, front_m: float) -> float:
        """Mean over a stretch, so over the train's length; rear_m < front_m."""
        assert rear_m < front_m
        return (self.height_m(front_m) - self.height_m(rear_m)) / (front_m - rear_m) * 1000.0

    def worst_gradient_permille(self, rear_m: float, front_m: float) -> float:
        """The lowest (steepest falling) gradient anywhere in [rear_m, front_m]; at most 0 off all sections."""
        lowest_permille: float | None = None
        covered_m = 0.0
        for section in self.gradients:
            overlap_m = min(front_m, section.end_m) - max(rear_m, section.start_m)
            if overlap_m > 0.0 or section.start_m <= rear_m == front_m < section.end_m:
                covered_m += overlap_m
                if lowest_permille is None or section.gradient_permille < lowest_permille:
                    lowest_permille = section.gradient_permille
        if lowest_permille is None or (covered_m < front_m - rear_m and lowest_permille > 0.0):
            return 0.0
        return lowest_permille

    def limit_mps(self, at_m: float) -> float:
        """Civil speed limit at one point; the nearest section's outside the line."""
        index = max(0, bisect_right(self._speed_starts, at_m) - 1)
        return self.speed_sections[index].limit_mps

    def least_limit_mps(self, rear_m: float, front_m: float) -> float:
        """The lowest civil limit anywhere under a train that covers [rear_m, front_m]."""
        first = max(0, bisect_right(self._speed_starts, rear_m) - 1)
        last = max(first, bisect_right(self._speed_starts, front_m) - 1)
        return min(section.limit_mps for section in self.speed_sections[first : last + 1])

    def radius_m(self, at_m: float) -> float | None:
        """Radius of the curve at one point; None on straight track."""
        for curve in self.curves:
            if curve.start_m <= at_m < curve.end_m:
                return curve.radius_m
        return None

    def station(self, name: str) -> Station:
        """Raises KeyError, with the names there are, for an unknown one."""
        for station in self.stations:
            if station.name == name:
                return station
        names = ", ".join(station.name for station in self.stations)
        raise KeyError(f"line {self.name} has no station {name}; it has {names}")

    def stations_between(self, after_m: float, up_to_m: float) -> Sequence[Station]:
        """Stations whose stopping point lies in (after_m, up_to_m], in running order."""
        return [s for s in self.stations if after_m < s.stop_m <= up_to_m]


def load_line(name: str) -> LineMap:
    """A line by path or by the stem of a shipped file; raises SettingsError."""
    return settings.load(LineMap, name, "firmware_py.trackdb")


def _check_section(start_m: float, end_m: float) -> None:
    if end_m <= start_m:
        raise ValueError(f"end_m {end_m} is not beyond start_m {start_m}")


def _check_order(what: str, sections: Sequence[tuple[float, float]]) -> None:
    for (_, end_m), (start_m, _) in itertools.pairwise(sections):
        if start_m < end_m:
            raise ValueError(f"{what}: the section at {start_m} m overlaps the one that ends at {end_m} m")
