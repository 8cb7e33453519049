"""How far a train may go: moving block behind the train ahead, and what lies in between. Pure.

Only one rule gives track away: the metres up to the protected rear of the next train ahead, less
what that may roll or jog back. As trains keep their order and move forwards, nothing that any
master of any time granted by it can meet what another did (DOMAIN, R6); all that does not follow
this rule, objects and newcomers, waits for promises.
"""

import enum
from collections.abc import Sequence
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


class Stretch(NamedTuple):
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


class Space(NamedTuple):
    """What bounds every train of an area."""

    end_m: float
    stretches: tuple[Stretch, ...]
    """By start."""
    behind_rear_m: float
    """Kept free behind every protected rear."""
    longest_m: float


def end_of_authority_m(course: Course, space: Space) -> float | None:
    """Where the front must stop at the latest; None: issue nothing, let the train keep what it has.

    What is barred by doubt alone shortens nothing: an authority that reaches into it stays as it is
    and grows old while the doubt lasts, unless supervision wants the train to stop.
    """
    end_m = min(space.end_m, course.front_max_m + space.longest_m)
    if course.ahead_m is not None:
        end_m = min(end_m, course.ahead_m - space.behind_rear_m)
    if course.stopped:
        end_m = min(end_m, course.front_max_m)
    for stretch in space.stretches:
        if stretch.start_m >= end_m:
            break
        if stretch.end_m <= course.rear_m:
            continue
        inside = course.front_max_m > stretch.start_m
        granted_in = course.granted_m > stretch.start_m
        shortened = course.stopped and course.granted_m > course.front_max_m
        if stretch.bar is Bar.UNSURE and (inside or granted_in) and not shortened:
            return None
        late = granted_in and course.easy_m > stretch.start_m
        if stretch.bar is Bar.CLOSING and (inside or late):
            continue
        end_m = min(end_m, course.front_max_m if inside else stretch.start_m)
        break
    if end_m < course.front_max_m and course.granted_m <= course.front_max_m:
        # Over the border of its area the train may be by what the next one granted.
        return end_m if end_m == space.end_m else None
    return end_m


def back_to_m(course: Course, stretches: Sequence[Stretch], *, jog_m: float) -> float:
    """Where the rear may jog back to: onto nothing, and within nothing, that may not be passed."""
    least_m = course.rear_m - jog_m
    behind_m = [
        min(each.end_m, course.rear_m)
        for each in stretches
        if each.start_m < course.front_max_m and each.bar is not Bar.CLOSING
    ]
    return max([least_m, *behind_m])


class Seen(NamedTuple):
    """An occupied section and how sure it is that it was so when trains were where they are."""

    start_m: float
    end_m: float


def unexplained(
    occupied: Sequence[Seen],
    *,
    beyond_m: float,
    before_m: float,
) -> Seen | None:
    """The first occupied section that neither of two neighbours on the roster can be in.

    Args:
        beyond_m: the one behind has never been granted more than this.
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


class Standing(NamedTuple):
    rear_m: float
    front_m: float
    axles: int


def explained(sections: Sequence[Counted], train: Standing, others: Sequence[Standing]) -> bool:
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
    start_m, end_m = sections[first].start_m, sections[last].end_m
    there = [e for e in (train, *others) if start_m < (e.rear_m + e.front_m) / 2.0 < end_m]
    counted = sum(each.axles for each in sections[first : last + 1])
    return counted == sum(each.axles for each in there)


def _touch(section: Counted, train: Standing) -> bool:
    return section.start_m < train.front_m and train.rear_m < section.end_m
