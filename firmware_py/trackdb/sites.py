"""Sites along a line: stations, tags, and sections with one limit, gradient or radius."""

import enum
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

GRADIENT_MAX_PERMILLE: Final = 120.0
RADIUS_MIN_M: Final = 50.0
DRAG_MAX_RATIO: Final = 10.0
"""Far above the tunnel factor of a train in the narrowest single-track tunnel."""
TAG_ID_MAX: Final = 2**32 - 1
NEUTRAL: Final = "neutral_sections"
POWER: Final = "power_sections"
TUNNELS: Final = "tunnels"
ZONES: Final = (NEUTRAL, POWER, "no_stop_zones", "evacuation_stops")
"""Keys of lines and tracks that have zones."""
NAMED: Final = (POWER, "evacuation_stops")
"""Keys whose zones need names: faults and messages to people refer to them."""


class PlatformSide(enum.Enum):
    LEFT = "left"
    RIGHT = "right"
    BOTH = "both"
    """The track lies between two platforms, or between two edges of one."""
    NONE = "none"
    """There is no platform: trains stop in a siding, with their doors shut."""

    @property
    def left(self) -> bool:
        """Whether there is a platform on the left."""
        return self in (PlatformSide.LEFT, PlatformSide.BOTH)

    @property
    def right(self) -> bool:
        return self in (PlatformSide.RIGHT, PlatformSide.BOTH)


def check_siding(side: PlatformSide, dwell_s: float) -> None:
    """Raise ValueError for a dwell time where no doors can open."""
    if side is PlatformSide.NONE and dwell_s > 0.0:
        raise ValueError(f"dwell_s {dwell_s:g} must be 0 where side is none: no doors open there")


class TagKind(enum.Enum):
    BALISE = "balise"
    """Plain location reference."""
    T1 = "t1"
    T2 = "t2"
    T3 = "t3"
    """The three magnetic tags before a stopping point ([Allotta 2013], section II.B)."""
    STOP = "stop"
    """The tag under the antenna of a train at the stopping point."""


@dataclass(frozen=True, slots=True)
class StoppingPoint:
    """A stopping point for trains up to one length."""

    train_length_max_m: float
    stop_m: float

    def __post_init__(self) -> None:
        if not self.train_length_max_m > 0.0:
            raise ValueError(f"train_length_max_m {self.train_length_max_m} is not positive")


@dataclass(frozen=True, slots=True)
class Station:
    name: str
    stop_m: float
    """Place of the front coupler of a train that stopped exactly."""
    platform_start_m: float
    platform_end_m: float
    side: PlatformSide = PlatformSide.RIGHT
    dwell_s: float = 30.0
    run_s: float = 0.0
    """Planned run time from leaving the previous station to standing here; 0: no plan."""
    platform_doors: bool = False
    """The platform has doors, which open and close with those of the train."""
    short_stops: tuple[StoppingPoint, ...] = ()
    """Stopping points of shorter trains, the shortest first. A train takes the first one that its
    length permits; `stop_m` is that of all longer trains."""

    def __post_init__(self) -> None:
        lengths_m = [each.train_length_max_m for each in self.short_stops]
        if any(not shorter < longer for shorter, longer in itertools.pairwise(lengths_m)):
            raise ValueError(f"station {self.name}: short_stops: train_length_max_m must rise")
        for stop_m in self.stops_m:
            if not self.platform_start_m < stop_m <= self.platform_end_m:
                raise ValueError(f"station {self.name}: stop_m {stop_m} is not along its platform")
        if not self.dwell_s >= 0.0:
            raise ValueError(f"station {self.name}: dwell_s {self.dwell_s} is negative")
        check_siding(self.side, self.dwell_s)
        if not self.run_s >= 0.0:
            raise ValueError(f"station {self.name}: run_s {self.run_s} is negative")

    @property
    def stops_m(self) -> tuple[float, ...]:
        """Stopping points of trains of all lengths."""
        return (self.stop_m, *(each.stop_m for each in self.short_stops))

    def for_train(self, length_m: float) -> "Station":
        """Return the station with the stopping point of such a train alone."""
        fits = (each.stop_m for each in self.short_stops if length_m <= each.train_length_max_m)
        return replace(self, stop_m=next(fits, self.stop_m), short_stops=())


@dataclass(frozen=True, slots=True)
class SpeedSection:
    start_m: float
    end_m: float
    limit_mps: float

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if not self.limit_mps > 0.0:
            raise ValueError(f"limit_mps {self.limit_mps} is not positive")


@dataclass(frozen=True, slots=True)
class GradientSection:
    start_m: float
    end_m: float
    gradient_permille: float
    """Positive climbs in running direction."""

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if not abs(self.gradient_permille) <= GRADIENT_MAX_PERMILLE:
            raise ValueError(
                f"gradient_permille {self.gradient_permille} is beyond ±{GRADIENT_MAX_PERMILLE}"
            )


@dataclass(frozen=True, slots=True)
class CurveSection:
    start_m: float
    end_m: float
    radius_m: float

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if not self.radius_m >= RADIUS_MIN_M:
            raise ValueError(f"radius_m {self.radius_m} is under {RADIUS_MIN_M}")


@dataclass(frozen=True, slots=True)
class TunnelSection:
    """A tunnel, which raises the air drag of a train."""

    start_m: float
    end_m: float
    drag_ratio: float
    """Air drag inside, divided by that in the open: the tunnel factor of [EN 14067-3]."""
    name: str = ""

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)
        if not 1.0 <= self.drag_ratio <= DRAG_MAX_RATIO:
            raise ValueError(f"drag_ratio {self.drag_ratio} is not in 1..{DRAG_MAX_RATIO:g}")


@dataclass(frozen=True, slots=True)
class TagSite:
    tag_id: int
    position_m: float
    kind: TagKind = TagKind.BALISE
    station: str | None = None
    """The station whose stop the tag serves; None for a balise between stations."""

    def __post_init__(self) -> None:
        if not 0 < self.tag_id <= TAG_ID_MAX:
            raise ValueError(f"tag_id {self.tag_id} is not in 1..{TAG_ID_MAX}")


@dataclass(frozen=True, slots=True)
class LineZone:
    """A stretch with a property of its own for a train, from its front until its rear has left."""

    start_m: float
    end_m: float
    name: str = ""

    def __post_init__(self) -> None:
        _check_section(self.start_m, self.end_m)

    def covers(self, rear_m: float, front_m: float) -> bool:
        """Whether any part of a train between these places is inside."""
        return rear_m < self.end_m and self.start_m < front_m

    @property
    def text(self) -> str:
        """The name, if it has one, and both ends."""
        ends = f"{self.start_m:g} m to {self.end_m:g} m"
        return f"{self.name}, {ends}" if self.name else ends


class TrackStretch(Protocol):
    """A section or zone between two chainages."""

    @property
    def start_m(self) -> float: ...

    @property
    def end_m(self) -> float: ...


def check_order(key: str, stretches: Sequence[TrackStretch]) -> None:
    """Raise ValueError if one begins before the end of the one before it, or lacks its name."""
    for before, after in itertools.pairwise(stretches):
        if after.start_m < before.end_m:
            raise ValueError(
                f"{key}: {_called(after, 'the section')} at {after.start_m:g} m begins before "
                f"{_called(before, 'the one ahead of it')} ends, at {before.end_m:g} m"
            )
    for each in stretches if key in NAMED else ():
        if not _called(each, ""):
            raise ValueError(f"{key}: the one at {each.start_m:g} m has no name; give it one")


def _called(stretch: TrackStretch, otherwise: str) -> str:
    return getattr(stretch, "name", "") or otherwise


def _check_section(start_m: float, end_m: float) -> None:
    if not start_m < end_m:
        raise ValueError(f"end_m {end_m} is not beyond start_m {start_m}")
