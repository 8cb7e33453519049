"""How far a train may go: the moving block, what lies in between, and what stands unexplained."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.t2t.authority import (
    Bar,
    Counted,
    Course,
    Space,
    Standing,
    Stretch,
    end_of_authority_m,
    explained,
)
from vobc.t2t.table import cleared_to_m
from zenoh_config.t2t import SectionState

SPACE = Space(end_m=2000.0, stretches=(), behind_rear_m=7.0, longest_m=5000.0)


def course(
    front_m: float = 500.0,
    *,
    granted_m: float | None = None,
    easy_m: float | None = None,
    ahead_m: float | None = None,
    stopped: bool = False,
) -> Course:
    return Course(
        rear_m=front_m - 80.0,
        front_max_m=front_m,
        easy_m=front_m if easy_m is None else easy_m,
        granted_m=front_m if granted_m is None else granted_m,
        ahead_m=ahead_m,
        stopped=stopped,
    )


def between(start_m: float, end_m: float, bar: Bar) -> Space:
    return SPACE._replace(stretches=(Stretch(start_m, end_m, bar),))


@pytest.mark.parametrize(
    ("bound", "end_m"),
    [
        (course(), 2000.0),
        (course(ahead_m=900.0), 893.0),
        (course(ahead_m=2500.0), 2000.0),
        (course(stopped=True, granted_m=900.0), 500.0),
        (course(ahead_m=505.0), None),  # Nothing to give, and nothing to take back.
        (course(ahead_m=505.0, granted_m=600.0), 498.0),
        (course(2010.0), 2000.0),  # Over the border by what the next area granted.
    ],
)
def test_it_ends_behind_the_train_ahead_or_with_the_area(
    bound: Course, end_m: float | None
) -> None:
    assert end_of_authority_m(bound, SPACE) == end_m


@pytest.mark.parametrize(
    ("bar", "granted_m", "easy_m", "end_m"),
    [
        (Bar.SHUT, 500.0, 500.0, 800.0),
        (Bar.SHUT, 900.0, 850.0, 800.0),
        (Bar.UNSURE, 800.0, 500.0, 800.0),
        (Bar.UNSURE, 800.1, 500.0, None),
        (Bar.CLOSING, 900.0, 800.0, 800.0),
        (Bar.CLOSING, 900.0, 800.1, 2000.0),
        (Bar.CLOSING, 800.0, 800.1, 800.0),
    ],
)
def test_what_lies_ahead_is_met_as_it_deserves(
    bar: Bar, granted_m: float, easy_m: float, end_m: float | None
) -> None:
    bound = course(granted_m=granted_m, easy_m=easy_m)

    assert end_of_authority_m(bound, between(800.0, 840.0, bar)) == end_m


def test_what_lies_behind_a_train_does_not_concern_it() -> None:
    assert end_of_authority_m(course(), between(400.0, 420.0, Bar.SHUT)) == 2000.0
    assert end_of_authority_m(course(), between(400.0, 421.0, Bar.SHUT)) == 500.0
    assert end_of_authority_m(course(granted_m=900.0), between(400.0, 421.0, Bar.SHUT)) == 500.0


METRES = st.floats(0.0, 1900.0)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(METRES, min_size=2, max_size=8),
    st.lists(st.tuples(METRES, st.sampled_from(list(Bar))), max_size=4),
    st.floats(0.0, 300.0),
)
def test_no_two_trains_in_order_get_the_same_metre_whatever_lies_between(
    rears_m: list[float], bars: list[tuple[float, Bar]], granted_beyond_m: float
) -> None:
    """The trains stand where they say; each is given what it is given, in one go."""
    trains = sorted(rears_m, reverse=True)
    space = SPACE._replace(
        stretches=tuple(
            sorted([Stretch(at, at + 30.0, bar) for at, bar in bars], key=lambda s: s[:2])
        )
    )
    held_m = []
    for rear_m, ahead_m in zip(trains, [None, *trains], strict=False):
        bound = course(rear_m + 80.0, ahead_m=ahead_m, granted_m=rear_m + 80.0 + granted_beyond_m)
        held_m.append((rear_m, end_of_authority_m(bound, space)))

    for (ahead_m, _), (_, end_m) in itertools.pairwise(held_m):
        assert end_m is None or end_m <= ahead_m - 7.0


def sections(*axles: int) -> list[Counted]:
    return [Counted(n * 100.0, n * 100.0 + 100.0, bool(a), a) for n, a in enumerate(axles)]


@pytest.mark.parametrize(
    ("axles", "others", "answer"),
    [
        ((0, 16, 0), [], True),
        ((0, 17, 0), [], False),
        ((0, 10, 6), [], True),
        ((0, 10, 10), [], False),
        ((0, 16, 0, 16), [], True),  # Somebody else, apart by a clear section.
        ((0, 16, 16), [Standing(210.0, 290.0, 16)], True),
        ((0, 16, 16), [Standing(1210.0, 1290.0, 16)], False),
        ((16, 16, 0), [Standing(199.0, 279.0, 16)], False),  # That one only looks in.
        ((0, 0, 0), [], False),  # It says it is where nobody is.
    ],
)
def test_axles_around_a_train_are_explained_by_trains_that_say_they_are_there(
    axles: tuple[int, ...], others: list[Standing], answer: bool
) -> None:
    assert explained(sections(*axles), Standing(115.0, 198.0, 16), others) is answer


@pytest.mark.parametrize(
    ("occupied", "rear_m", "to_m"),
    [
        ((False, False, True), 50.0, 196.0),
        ((True, False, False), 50.0, 50.0),  # It may be in the section that it was in.
        ((False, True, False), 50.0, 96.0),
        ((False, False, False), 150.0, 296.0),
        ((True, False, False), 150.0, 296.0),
        ((False, True, False), 99.0, 99.0),  # Over the joint with its overhang only.
    ],
)
def test_a_silent_train_is_past_the_clear_sections_behind_it_but_for_its_overhang(
    occupied: tuple[bool, ...], rear_m: float, to_m: float
) -> None:
    told = [(n * 100.0, n * 100.0 + 100.0, SectionState(n, o, 0)) for n, o in enumerate(occupied)]

    assert cleared_to_m(rear_m, told, overhang_m=4.0) == to_m
