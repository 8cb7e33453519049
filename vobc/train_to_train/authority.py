"""How far a train may go: moving block behind the train ahead, and bars in between. Pure functions.

A single rule grants track: up to the protected rear of the next train ahead, less its rollback and
jog distance. Trains keep their order and move forwards. Authorities granted by this rule never
conflict, even between masters of different terms. Everything else, such as objects and new trains,
waits for acknowledgements.
"""

import enum
import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Bar(enum.Enum):
    """Effect of a bar on approaching trains."""

    SHUT = "shut"
    """No authority enters the stretch. Authorities that do are shortened."""
    UNSURE = "unsure"
    """No new authority enters the stretch. A train whose authority covers it gets no other one for
    the moment."""
    CLOSING = "closing"
    """No new authority enters the stretch. An authority that does is shortened if the service brake
    can stop the train before the stretch."""


class BarredTrack(NamedTuple):
    """Stretch of track that bars trains."""

    start_m: float
    end_m: float
    bar: Bar


class Course(NamedTuple):
    """Bounds of one train."""

    rear_m: float
    """Protected rear of the train."""
    front_max_m: float
    easy_m: float
    """Farthest place that the front can reach with the service brake."""
    granted_m: float
    """Farthest place that an authority may have granted."""
    ahead_m: float | None
    """Protected rear of the next train ahead. None: there is none in the area."""
    stopped: bool
    """Supervision wants it to stop where it is."""


class AreaBounds(NamedTuple):
    """Bounds of every train of an area."""

    end_m: float
    stretches: tuple[BarredTrack, ...]
    """Barred stretches, in order of their start."""
    rollback_m: float
    """Upper bound of a train's rollback. A rolling train may enter a stretch behind it."""
    jog_m: float
    """Greatest distance that a train may be allowed to jog back."""
    longest_m: float

    @property
    def behind_rear_m(self) -> float:
        """Track kept free behind every protected rear."""
        return self.rollback_m + self.jog_m

    def barred_by(self, stretches: Iterable[BarredTrack]) -> "AreaBounds":
        ordered = sorted(stretches, key=lambda each: (each.start_m, each.end_m))
        return self._replace(stretches=tuple(ordered))


def end_of_authority_m(course: Course, space: AreaBounds) -> float | None:
    """End of the new authority. None: send none, and the train keeps what it has.

    A bar of the kind UNSURE shortens nothing. An authority that reaches into it stays unchanged and
    ages while the doubt lasts, unless supervision wants the train to stop.

    A train across the border of its area is not shortened either, because the next area continues
    its authority. If it is ordered to stop there, it gets no authority.
    """
    over = course.front_max_m > space.end_m
    if over and course.stopped:
        return None
    end_m = min(space.end_m, course.front_max_m + space.longest_m)
    if course.ahead_m is not None:
        end_m = min(end_m, course.ahead_m - space.behind_rear_m)
    if course.stopped:
        end_m = min(end_m, course.front_max_m)
    for stretch in space.stretches:
        if stretch.start_m >= end_m:
            break
        if stretch.end_m <= course.rear_m - space.rollback_m:
            continue
        effect = _effect(course, stretch)
        if effect is _Effect.PASSABLE:
            continue
        if effect is _Effect.IN_DOUBT or over:
            return None
        inside = course.front_max_m > stretch.start_m
        end_m = min(end_m, course.front_max_m if inside else stretch.start_m)
        break
    if end_m < course.front_max_m and course.granted_m <= course.front_max_m:
        # A train may be beyond its area's border by the authority of the next area.
        return end_m if end_m == space.end_m else None
    return end_m


class _Effect(enum.Enum):
    """What a barred stretch ahead means for a train."""

    ENDS = "the authority ends before it, or where the train is within it"
    PASSABLE = "the train can no longer stop before it with the service brake, or is within it"
    IN_DOUBT = "nothing new is granted while the stretch is unsure"


def _effect(course: Course, stretch: BarredTrack) -> _Effect:
    inside = course.front_max_m > stretch.start_m
    granted_in = course.granted_m > stretch.start_m
    if stretch.bar is Bar.UNSURE and (inside or granted_in):
        shortened = course.stopped and course.granted_m > course.front_max_m
        return _Effect.ENDS if shortened else _Effect.IN_DOUBT
    late = granted_in and course.easy_m > stretch.start_m
    if stretch.bar is Bar.CLOSING and (inside or late):
        return _Effect.PASSABLE
    return _Effect.ENDS


def back_to_m(course: Course, space: AreaBounds) -> float:
    """Hindmost place to which the rear may jog back.

    It does not enter or move within a barred stretch, even if the train rolls back from there.
    """
    least_m = course.rear_m - space.jog_m
    behind_m = [
        min(each.end_m + space.rollback_m, course.rear_m)
        for each in space.stretches
        if each.start_m < course.front_max_m and each.bar is not Bar.CLOSING
    ]
    return max([least_m, *behind_m])


class SeenSection(NamedTuple):
    """An occupied section."""

    start_m: float
    end_m: float


def unexplained(
    occupied: Sequence[SeenSection],
    *,
    beyond_m: float,
    before_m: float,
) -> SeenSection | None:
    """The first occupied section that neither of two neighbours on the roster can be in.

    Args:
        beyond_m: farthest place that the train behind has reached.
        before_m: the train ahead was nowhere behind this when the sections were read.
    """
    for section in occupied:
        if section.start_m >= beyond_m and section.end_m <= before_m:
            return section
    return None


class Counted(NamedTuple):
    """A section with its axle count. Sections are in running order."""

    start_m: float
    end_m: float
    occupied: bool
    axles: int


class StandingTrain(NamedTuple):
    """A train in sections whose axles are counted."""

    rear_m: float
    front_m: float
    axles: int
    farther_m: float = 0.0
    """Greatest distance that it may be ahead of its reported place by now."""
    behind_m: float = 0.0
    """Greatest distance that it may have been behind its reported place when the axles were
    counted."""

    @property
    def middle_m(self) -> float:
        return (self.rear_m + self.front_m) / 2.0


def explained(
    sections: Sequence[Counted], train: StandingTrain, others: Sequence[StandingTrain]
) -> bool:
    """Whether reporting trains account for all axles around a train.

    Adjoining occupied sections are judged together. A train with one axle in them has all its axles
    in them, so the place of its middle decides whether it belongs there.
    """
    run = [at for at, each in enumerate(sections) if each.occupied and _touch(each, train)]
    if not run:
        return False
    first, last = run[0], run[-1]
    while first > 0 and sections[first - 1].occupied:
        first -= 1
    while last + 1 < len(sections) and sections[last + 1].occupied:
        last += 1
    together, beyond = sections[first : last + 1], sections[last + 1 :]
    return _explained(together, beyond, (train, *others), seen_m=_seen_m(sections))


def all_explained(
    sections: Sequence[Counted], standing: Sequence[StandingTrain], *, from_m: float, to_m: float
) -> bool:
    """Whether trains at standstill account for all axles between two places.

    A train that stands across a section joint extends the search to both sections.
    """
    starts_m, ends_m = [each.start_m for each in sections], [each.end_m for each in sections]
    first, beyond = bisect_right(ends_m, from_m), bisect_left(starts_m, to_m)
    there: list[StandingTrain] = []
    waiting = sorted(standing, key=lambda each: each.rear_m)
    while True:
        elsewhere: list[StandingTrain] = []
        for each in waiting:
            at = bisect_right(ends_m, each.rear_m)
            least = max(first, at)
            if least < beyond and starts_m[least] < each.front_m:
                there.append(each)
                first, beyond = min(first, at), max(beyond, bisect_left(starts_m, each.front_m))
            else:
                elsewhere.append(each)
        if len(elsewhere) == len(waiting):
            break
        # This pass extended the range towards the front. The next one extends it towards the rear.
        waiting = elsewhere[::-1]
    there.sort(key=lambda each: each.middle_m)
    middles_m = [each.middle_m for each in there]
    for _, group in itertools.groupby(sections[first:beyond], key=lambda each: each.occupied):
        run = list(group)
        behind = bisect_right(middles_m, run[0].start_m)
        ahead = bisect_left(middles_m, run[-1].end_m)
        if not _explained(run, (), there[behind:ahead], seen_m=_seen_m(sections)):
            return False
    return True


def _seen_m(sections: Sequence[Counted]) -> tuple[float, float]:
    return sections[0].start_m, sections[-1].end_m


def _explained(
    run: Sequence[Counted],
    beyond: Sequence[Counted],
    trains: Iterable[StandingTrain],
    *,
    seen_m: tuple[float, float],
) -> bool:
    """Whether trains that are certainly there account for the axles in adjoining sections.

    Args:
        seen_m: first and last place that counters cover. A train that may extend beyond is partly
            uncounted, and a shadow train could have as many axles.
    """
    if any(each.occupied and each.axles == 0 for each in run):
        # An occupied section with zero axles is a faulty count.
        return False
    start_m, end_m = run[0].start_m, run[-1].end_m
    there = [each for each in trains if start_m < each.middle_m < end_m]
    if any(each.middle_m - each.behind_m <= start_m for each in there):
        # This train may have arrived after the count.
        return False
    if any(_may_have_left(each, end_m, beyond) for each in there):
        return False
    if any(_may_hang_over(each, *seen_m) for each in there):
        return False
    if sum(each.axles for each in run) != sum(each.axles for each in there):
        return False
    return _stand_so(run, there)


def _stand_so(run: Sequence[Counted], trains: Sequence[StandingTrain]) -> bool:
    """Whether the counts match the trains at every section joint.

    The count up to a joint is at most the axles of trains that may be there. It is at least the
    axles of trains that are certainly behind the joint. A shadow train is therefore not masked by
    axles missing elsewhere.
    """
    fronts = sorted([(each.front_m + each.farther_m, each.axles) for each in trains])
    rears = sorted([(each.rear_m - each.behind_m, each.axles) for each in trains])
    counted = least = most = wholly = partly = 0
    for section in run:
        counted += section.axles
        while wholly < len(fronts) and fronts[wholly][0] <= section.end_m:
            least += fronts[wholly][1]
            wholly += 1
        while partly < len(rears) and rears[partly][0] < section.end_m:
            most += rears[partly][1]
            partly += 1
        if not least <= counted <= most:
            return False
    return True


def _may_have_left(train: StandingTrain, end_m: float, beyond: Sequence[Counted]) -> bool:
    """Whether the train may have left, unless all sections within its possible reach are clear.

    Beyond the last counted section, `_may_hang_over` decides.
    """
    if train.middle_m + train.farther_m < end_m:
        return False
    reach_m = train.front_m + train.farther_m
    near = itertools.takewhile(lambda each: each.start_m < reach_m, beyond)
    return any(each.occupied for each in near)


def _may_hang_over(train: StandingTrain, from_m: float, to_m: float) -> bool:
    return train.rear_m - train.behind_m < from_m or train.front_m + train.farther_m > to_m


def _touch(section: Counted, train: StandingTrain) -> bool:
    return section.start_m < train.front_m and train.rear_m < section.end_m
