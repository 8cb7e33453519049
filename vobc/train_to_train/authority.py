"""How far a train may go: moving block behind the train ahead, and what lies in between. Pure.

Only one rule gives track away: the metres up to the protected rear of the next train ahead, less
what that may roll or jog back. As trains keep their order and move forwards, nothing that any
master of any time granted by it can meet what another did (DOMAIN, R6); all that does not follow
this rule, objects and newcomers, waits for promises.
"""

import enum
import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Bar(enum.Enum):
    """What something on the track means to trains that come to it."""

    SHUT = "shut"
    """No authority enters it, and those that do are shortened."""
    UNSURE = "unsure"
    """No authority newly enters it; a train that has one over it gets no other for the moment."""
    CLOSING = "closing"
    """No authority newly enters it, and those that do are shortened where the service brake is
    enough to stop before it."""


class BarredTrack(NamedTuple):
    """Track that bars a train's way."""

    start_m: float
    end_m: float
    bar: Bar


class Course(NamedTuple):
    """What bounds one train."""

    rear_m: float
    """Protected rear."""
    front_max_m: float
    easy_m: float
    """It can stop before this with the service brake."""
    granted_m: float
    """The farthest that it may have been granted."""
    ahead_m: float | None
    """Protected rear of the next train ahead; None: there is none in the area."""
    stopped: bool
    """Supervision wants it to stop where it is."""


class AreaBounds(NamedTuple):
    """What bounds every train of an area."""

    end_m: float
    stretches: tuple[BarredTrack, ...]
    """By start."""
    rollback_m: float
    """So far a train may roll back; what it may roll onto is still under it."""
    jog_m: float
    """So far it may be let back."""
    longest_m: float

    @property
    def behind_rear_m(self) -> float:
        """Kept free behind every protected rear."""
        return self.rollback_m + self.jog_m

    def barred_by(self, stretches: Iterable[BarredTrack]) -> "AreaBounds":
        ordered = sorted(stretches, key=lambda each: (each.start_m, each.end_m))
        return self._replace(stretches=tuple(ordered))


def end_of_authority_m(course: Course, space: AreaBounds) -> float | None:
    """Where the front must stop at the latest; None: issue nothing, let the train keep what it has.

    What is barred by doubt alone shortens nothing: an authority that reaches into it stays as it is
    and grows old while the doubt lasts, unless supervision wants the train to stop.

    Of a train over the border of its area nothing is shortened either, as what ends there is
    continued by the next area: one that is to stay where it is gets nothing.
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
        inside = course.front_max_m > stretch.start_m
        granted_in = course.granted_m > stretch.start_m
        shortened = course.stopped and course.granted_m > course.front_max_m
        if stretch.bar is Bar.UNSURE and (inside or granted_in) and not shortened:
            return None
        late = granted_in and course.easy_m > stretch.start_m
        if stretch.bar is Bar.CLOSING and (inside or late):
            continue
        if over:
            return None
        end_m = min(end_m, course.front_max_m if inside else stretch.start_m)
        break
    if end_m < course.front_max_m and course.granted_m <= course.front_max_m:
        # Over the border of its area the train may be by what the next one granted.
        return end_m if end_m == space.end_m else None
    return end_m


def back_to_m(course: Course, space: AreaBounds) -> float:
    """Where the rear may jog back to: onto nothing, and within nothing, that may not be passed,
    also if it rolls back from there.
    """
    least_m = course.rear_m - space.jog_m
    behind_m = [
        min(each.end_m + space.rollback_m, course.rear_m)
        for each in space.stretches
        if each.start_m < course.front_max_m and each.bar is not Bar.CLOSING
    ]
    return max([least_m, *behind_m])


class SeenSection(NamedTuple):
    """An occupied section and how sure it is that it was so when trains were where they are."""

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
        beyond_m: the one behind has come no farther than this.
        before_m: the one ahead was nowhere behind this when the sections were seen.
    """
    for section in occupied:
        if section.start_m >= beyond_m and section.end_m <= before_m:
            return section
    return None


class Counted(NamedTuple):
    """A section and the axles in it, in running order."""

    start_m: float
    end_m: float
    occupied: bool
    axles: int


class StandingTrain(NamedTuple):
    """A train among sections whose axles are counted."""

    rear_m: float
    front_m: float
    axles: int
    farther_m: float = 0.0
    """By now it may be so much farther on than it said."""
    behind_m: float = 0.0
    """When sections were counted it may have been so much farther back."""

    @property
    def middle_m(self) -> float:
        return (self.rear_m + self.front_m) / 2.0


def explained(
    sections: Sequence[Counted], train: StandingTrain, others: Sequence[StandingTrain]
) -> bool:
    """Whether all axles around a train are those of trains that say they are there.

    The sections around it that are occupied without a gap are taken together. A train that has an
    axle in them has all its axles in them, so that its middle tells whether it belongs there.
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
    """Whether all axles between these two are those of trains that stand there.

    Whoever stands in one of these sections and in the next counts with both of them.
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
        # From the rear on it grew towards the front, and grows the other way now.
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
    """Whether what is counted in sections without a gap are the trains that surely are there.

    Args:
        seen_m: where counters begin and end. Of a train that may hang over some axles are not
            counted, and as many of another may be.
    """
    if any(each.occupied and each.axles == 0 for each in run):
        # Its count is not to be trusted.
        return False
    start_m, end_m = run[0].start_m, run[-1].end_m
    there = [each for each in trains if start_m < each.middle_m < end_m]
    if any(each.middle_m - each.behind_m <= start_m for each in there):
        # It may have come since.
        return False
    if any(_may_have_left(each, end_m, beyond) for each in there):
        return False
    if any(_may_hang_over(each, *seen_m) for each in there):
        return False
    if sum(each.axles for each in run) != sum(each.axles for each in there):
        return False
    return _stand_so(run, there)


def _stand_so(run: Sequence[Counted], trains: Sequence[StandingTrain]) -> bool:
    """Up to no joint are more axles counted than of trains that may have some there, nor fewer than
    of those that surely are behind it: who hides here is not made up for by axles missed there.
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
    """Unless all is clear as far as it may have come; farther than is counted it may hang over."""
    if train.middle_m + train.farther_m < end_m:
        return False
    reach_m = train.front_m + train.farther_m
    near = itertools.takewhile(lambda each: each.start_m < reach_m, beyond)
    return any(each.occupied for each in near)


def _may_hang_over(train: StandingTrain, from_m: float, to_m: float) -> bool:
    return train.rear_m - train.behind_m < from_m or train.front_m + train.farther_m > to_m


def _touch(section: Counted, train: StandingTrain) -> bool:
    return section.start_m < train.front_m and train.rear_m < section.end_m
