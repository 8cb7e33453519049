"""A master's view of its track: which trains are where, and shadow trains between them."""

import pytest

from firmware_py.trackdb.areas import Area, AreaMap, TrackSection
from vobc.train_to_train.authority import Bar, BarredTrack, Counted, SeenSection
from vobc.train_to_train.axle_counting import (
    TrackView,
    hidden_between,
    moved_on_m,
    restrictions_for,
    view_of,
)
from vobc.train_to_train.occupancy import TrainRecord
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import SectionState, TrackStatus

LINE = AreaMap(
    "line",
    (Area(1, 0.0, 300.0),),
    (
        TrackSection(1, 0.0, 100.0),
        TrackSection(2, 100.0, 200.0),
        TrackSection(3, 200.0, 300.0),
    ),
)
SEEN_NS = 5_000_000_000
SLOW = SpeedRestriction(40.0, 60.0, 5.0)
CLOSED = SpeedRestriction(110.0, 130.0, 0.0)


def status(*sections: SectionState) -> TrackStatus:
    return TrackStatus(0, 4, 1, 7, 1, 1, 99, SEEN_NS, sections, (SLOW,), (CLOSED,))


def view(*occupied: int) -> TrackView:
    return view_of(status(*[SectionState(n, n in occupied, 0) for n in (1, 2, 3)]), LINE)


def test_a_view_holds_the_time_and_the_sections_by_chainage() -> None:
    first, third = SectionState(1, False, 0), SectionState(3, True, 16)

    # The sections are in another order than on the line, one is missing and one is unknown.
    seen = view_of(status(third, SectionState(8, True, 4), first), LINE)

    assert seen == TrackView(
        SEEN_NS,
        (Counted(0.0, 100.0, False, 0), Counted(200.0, 300.0, True, 16)),
        (SeenSection(200.0, 300.0),),
        ((0.0, 100.0, first), (200.0, 300.0, third)),
        (SLOW,),
        (BarredTrack(110.0, 130.0, Bar.SHUT),),
    )


def hidden(
    *occupied: int, beyond_m: float = 100.0, before_m: float = 200.0, ahead_ns: int = SEEN_NS
) -> BarredTrack | None:
    return hidden_between(view(*occupied), beyond_m=beyond_m, before_m=before_m, ahead_ns=ahead_ns)


@pytest.mark.parametrize(("then_m", "found"), [(199.9, False), (200.0, True), (400.0, True)])
def test_a_train_that_reported_itself_beyond_before_the_count_was_not_counted_there(
    then_m: float, *, found: bool
) -> None:
    """The present report alone would permit that the train came from there meanwhile (simulation
    seed 239837)."""
    since_ns = SEEN_NS + 200_000_000
    seen = hidden_between(view(2), beyond_m=100.0, before_m=204.0, ahead_ns=since_ns, then_m=then_m)

    assert seen == (BarredTrack(100.0, 200.0, Bar.SHUT) if found else None)


@pytest.mark.parametrize(
    ("beyond_m", "before_m", "hides"),
    [
        (100.0, 200.0, True),
        (0.0, 300.0, True),
        (100.1, 200.0, False),
        (100.0, 199.9, False),
    ],
)
def test_a_section_occupied_by_neither_neighbour_holds_a_shadow_train(
    beyond_m: float, before_m: float, *, hides: bool
) -> None:
    found = hidden(2, beyond_m=beyond_m, before_m=before_m)

    assert found == (BarredTrack(100.0, 200.0, Bar.SHUT) if hides else None)


def test_clear_sections_and_those_of_the_neighbours_hold_no_shadow_train() -> None:
    assert hidden() is None
    assert hidden(1, 3) is None


@pytest.mark.parametrize(
    ("later_ns", "before_m", "bar"),
    [
        (0, 200.0, Bar.SHUT),
        (0, 199.9, None),
        (-1_000_000_000, 200.0, Bar.SHUT),
        (-1_000_000_000, 199.9, None),
        # At 40 m/s in an eighth of a second.
        (125_000_000, 205.0, Bar.SHUT),
        (125_000_000, 204.9, None),
        # With an older count, only 5 m behind the train ahead count as its own.
        (126_000_000, 205.0, Bar.UNSURE),
        (126_000_000, 204.9, None),
        (1_000_000_000, 240.0, Bar.SHUT),
        (1_000_000_000, 239.9, Bar.UNSURE),
        (1_000_000_000, 205.0, Bar.UNSURE),
        (1_000_000_000, 204.9, None),
    ],
)
def test_the_train_ahead_may_have_been_farther_back_during_the_count(
    later_ns: int, before_m: float, bar: Bar | None
) -> None:
    found = hidden(2, before_m=before_m, ahead_ns=SEEN_NS + later_ns)

    assert found == (bar and BarredTrack(100.0, 200.0, bar))


def test_a_certain_shadow_train_counts_before_a_possible_one() -> None:
    found = hidden(1, 2, beyond_m=0.0, before_m=239.9, ahead_ns=SEEN_NS + 1_000_000_000)

    assert found == BarredTrack(0.0, 100.0, Bar.SHUT)


def test_a_silent_train_advances_over_clear_sections_except_for_its_overhang() -> None:
    assert moved_on_m(view(3), TrainRecord(4, 50.0, 0), overhang_m=4.0) == 196.0
    assert moved_on_m(view(1), TrainRecord(4, 50.0, 0), overhang_m=4.0) == 50.0


@pytest.mark.parametrize(
    ("rear_m", "end_m", "met"),
    [
        (0.0, 100.0, True),
        (0.0, 40.0, True),
        (0.0, 39.9, False),
        (60.0, 100.0, True),
        (60.1, 100.0, False),
        (45.0, 50.0, True),
        (50.0, 100.0, True),
        (0.0, 50.0, True),
    ],
)
def test_a_restriction_applies_from_the_rear_to_the_end_of_authority_inclusive(
    rear_m: float, end_m: float, *, met: bool
) -> None:
    assert restrictions_for((SLOW,), rear_m=rear_m, end_m=end_m) == ((SLOW,) if met else ())
