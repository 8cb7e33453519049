"""Division of a line where trains command themselves: areas, track sections, objects."""

import enum
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_py import settings

AREA_MAX: Final = 255
TRACKS: Final = "firmware_py.trackdb"
DIVISIONS: Final = "firmware_py.trackdb.division"
BESIDE: Final = ".areas.toml"
"""Suffix of division files: `my_line.areas.toml` divides the track of `my_line.toml`."""
ROUNDING: Final = 1e-9
"""Rounding tolerance as a share of a section's length."""
SECTION_MIN_M: Final = 25.0
"""Minimum length of a section. It exceeds the distance between any two neighbouring axles of a
train. Over a shorter section a train may have no axle, which looks like a gap between two
trains."""


class ObjectKind(enum.IntEnum):
    SWITCH = 1
    CROSSING = 2
    PLATFORM = 3
    """A platform track that may be closed, for people on it or for open doors."""


@dataclass(frozen=True, slots=True)
class Area:
    """A stretch with one master at a time. Every metre of a line belongs to exactly one area."""

    number: int
    start_m: float
    end_m: float


@dataclass(frozen=True, slots=True)
class TrackSection:
    """A stretch whose axles the wayside counts in and out."""

    number: int
    start_m: float
    end_m: float


@dataclass(frozen=True, slots=True)
class ObjectSite:
    """An object that a train may pass only while it is locked for passing; it covers [start_m,
    end_m].
    """

    number: int
    kind: ObjectKind
    start_m: float
    end_m: float


@dataclass(frozen=True, slots=True)
class AreaMap:
    """The division of one line. Raises ValueError if parts overlap or leave gaps."""

    name: str
    areas: tuple[Area, ...]
    """Areas in running order, each beginning where the previous one ends."""
    sections: tuple[TrackSection, ...] = ()
    """Sections in running order, without gaps, from the start of the first area to the end of the
    last. Each lies within one area: both masters would miss a shadow train in a section of two
    areas."""
    objects: tuple[ObjectSite, ...] = ()
    """Objects in running order, each within one area."""
    apply_m: float = 800.0
    """Distance before a border at which a train begins to report to the next area, too."""

    def __post_init__(self) -> None:
        if not self.areas:
            raise ValueError(f"line {self.name}: areas: there is none")
        _check_chain("areas", [(each.number, each.start_m, each.end_m) for each in self.areas])
        for area in self.areas:
            if not 0 < area.number <= AREA_MAX:
                raise ValueError(f"areas: number {area.number} is not in 1..{AREA_MAX}")
        if self.sections:
            _check_chain("sections", [(s.number, s.start_m, s.end_m) for s in self.sections])
            if (self.sections[0].start_m, self.sections[-1].end_m) != (self.start_m, self.end_m):
                raise ValueError(
                    f"sections: they do not reach from {self.start_m} m to {self.end_m} m"
                )
            joints_m = {section.start_m for section in self.sections}
            for area in self.areas:
                if area.start_m not in joints_m:
                    raise ValueError(
                        f"sections: none begins at {area.start_m} m, where area {area.number} does"
                    )
        for site in self.objects:
            area = self.area_at(site.start_m)
            if not area.start_m <= site.start_m < site.end_m <= area.end_m:
                raise ValueError(f"objects: object {site.number} does not lie within one area")
        if len({site.number for site in self.objects}) != len(self.objects):
            raise ValueError("objects: a number occurs twice")
        if not self.apply_m > 0.0:
            raise ValueError(f"apply_m {self.apply_m} is not positive")

    @property
    def start_m(self) -> float:
        return self.areas[0].start_m

    @property
    def end_m(self) -> float:
        return self.areas[-1].end_m

    def area(self, number: int) -> Area:
        """Return an area. Raises KeyError for a number that no area of the line has."""
        for each in self.areas:
            if each.number == number:
                return each
        raise KeyError(f"line {self.name} has no area {number}")

    def area_at(self, at_m: float) -> Area:
        """Return the area at this place; outside of the line, the nearest one."""
        for each in reversed(self.areas):
            if each.start_m <= at_m:
                return each
        return self.areas[0]

    def following(self, number: int) -> Area | None:
        """Return the area that begins where this one ends; None at the end of the line."""
        after = False
        for each in self.areas:
            if after:
                return each
            after = each.number == number
        return None

    def preceding(self, number: int) -> Area | None:
        """Return the area that ends where this one begins; None at the start of the line."""
        before: Area | None = None
        for each in self.areas:
            if each.number == number:
                return before
            before = each
        return None

    def objects_in(self, number: int) -> tuple[ObjectSite, ...]:
        area = self.area(number)
        return tuple([each for each in self.objects if area.start_m <= each.start_m < area.end_m])

    def sections_told(self, number: int) -> tuple[TrackSection, ...]:
        """Return the sections reported to an area's master: those that overlap the area, and one
        behind each border, from which trains enter and leave.
        """
        area = self.area(number)
        inside = [
            at
            for at, s in enumerate(self.sections)
            if s.start_m < area.end_m and area.start_m < s.end_m
        ]
        if not inside:
            return ()
        return self.sections[max(0, inside[0] - 1) : inside[-1] + 2]


def _check_chain(what: str, parts: list[tuple[int, float, float]]) -> None:
    if len({number for number, _, _ in parts}) != len(parts):
        raise ValueError(f"{what}: a number occurs twice")
    for number, start_m, end_m in parts:
        if not start_m < end_m:
            raise ValueError(f"{what}: {number} from {start_m} m to {end_m} m is no stretch")
    for (_, _, end_m), (number, start_m, _) in itertools.pairwise(parts):
        if start_m != end_m:
            raise ValueError(f"{what}: {number} starts at {start_m} m where {end_m} m is needed")


@dataclass(frozen=True, slots=True)
class Division:
    """Contents of a division file. Raises ValueError for an impossible division."""

    name: str
    """Name of the line."""
    borders_m: tuple[float, ...]
    """Start of the line, borders of areas, end of the line; areas are numbered from 1."""
    section_m: float
    """Length of the axle-counter sections. The last section of an area may be shorter; a rest below
    `SECTION_MIN_M` is added to the section before it. 0 means that there are none, and then
    non-communicating trains remain undetected."""
    apply_m: float
    objects: tuple[ObjectSite, ...] = ()

    def __post_init__(self) -> None:
        if len(self.borders_m) < 2:
            raise ValueError("borders_m: a line has a start and an end")
        if not self.section_m >= 0.0:
            raise ValueError(f"section_m {self.section_m} is negative")
        if 0.0 < self.section_m < SECTION_MIN_M:
            raise ValueError(
                f"section_m {self.section_m}: a train may stand over it without an axle in it, "
                f"so that it counts as clear; at least {SECTION_MIN_M:g}, or 0 for none"
            )
        if self.section_m and (self.borders_m[-1] - self.borders_m[0]) / self.section_m > 10_000:
            raise ValueError(f"section_m {self.section_m} makes more than 10,000 sections")
        self.area_map()

    def area_map(self) -> AreaMap:
        borders_m = self.borders_m
        return AreaMap(
            self.name,
            tuple([Area(n, a, b) for n, (a, b) in enumerate(itertools.pairwise(borders_m), 1)]),
            sections_between(borders_m, self.section_m),
            self.objects,
            self.apply_m,
        )


def load_areas(name: str) -> AreaMap:
    """Load the division of a line by the name of a shipped file, by its own path, or by the path of
    the track beside it.

    Raises SettingsError.
    """
    divided = settings.shipped_names(DIVISIONS)
    if settings.is_path(name):
        table = settings.parse(Path(name))
        # Every line has stations, and no division has.
        return _beside(Path(name), table.get("name")) if "stations" in table else _division(name)
    if name not in divided and name in settings.shipped_names(TRACKS):
        raise settings.SettingsError(
            f"line {name} is not divided into areas; divided ones that ship: {', '.join(divided)}; "
            f"to divide your own line, write a file TRACK.toml with TRACK{BESIDE} beside it"
        )
    return _division(name)


def _beside(track: Path, line_name: object) -> AreaMap:
    """Load the division beside a track.

    For a copy of a shipped line, the shipped division serves if there is none.
    """
    path = track.with_suffix(BESIDE)
    if path.exists():
        areas = _division(str(path))
        if areas.name != line_name:
            raise settings.SettingsError(
                f"{path}: name: {areas.name!r} is not that of the line in {track}, {line_name!r}"
            )
        return areas
    if line_name in settings.shipped_names(DIVISIONS):
        return _division(str(line_name))
    raise settings.SettingsError(
        f"{track}: line {line_name} is not divided into areas; {path} would say how"
    )


def _division(name: str) -> AreaMap:
    return settings.load(Division, name, DIVISIONS).area_map()


def sections_between(borders_m: Sequence[float], length_m: float) -> tuple[TrackSection, ...]:
    """Divide the stretches between borders into sections. Each stretch begins with a new one."""
    ends_m: list[float] = []
    for start_m, end_m in itertools.pairwise(borders_m if length_m else ()):
        before_last = max(0, math.floor((end_m - start_m - SECTION_MIN_M) / length_m + ROUNDING))
        ends_m += [start_m + n * length_m for n in range(1, before_last + 1)] + [end_m]
    joints_m = itertools.pairwise([borders_m[0], *ends_m])
    return tuple([TrackSection(n, a, b) for n, (a, b) in enumerate(joints_m, 1)])
