"""How far an authority reaches: the moving block, barred track, and unaccounted axles."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.train_to_train.authority import (
    AreaBounds,
    Bar,
    BarredTrack,
    Counted,
    Course,
    SeenSection,
    StandingTrain,
    all_explained,
    back_to_m,
    end_of_authority_m,
    explained,
    unexplained,
)
from vobc.train_to_train.occupancy import cleared_to_m
from zenoh_config.t2t import SectionState

SPACE = AreaBounds(end_m=2000.0, stretches=(), rollback_m=2.0, jog_m=5.0, longest_m=5000.0)


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


def between(start_m: float, end_m: float, bar: Bar) -> AreaBounds:
    return SPACE._replace(stretches=(BarredTrack(start_m, end_m, bar),))


@pytest.mark.parametrize(
    ("bound", "end_m"),
    [
        (course(), 2000.0),
        (course(ahead_m=900.0), 893.0),
        (course(ahead_m=2500.0), 2000.0),
        (course(stopped=True, granted_m=900.0), 500.0),
        (course(ahead_m=505.0), None),  # No authority to give and none to take back.
        (course(ahead_m=505.0, granted_m=600.0), 498.0),
        # The authority extends over the border as far as the next area granted.
        (course(2010.0), 2000.0),
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


def test_barred_track_beyond_the_rollback_distance_does_not_matter() -> None:
    assert end_of_authority_m(course(), between(400.0, 418.0, Bar.SHUT)) == 2000.0
    assert end_of_authority_m(course(), between(400.0, 419.0, Bar.SHUT)) == 500.0
    assert end_of_authority_m(course(granted_m=900.0), between(400.0, 419.0, Bar.SHUT)) == 500.0


def test_an_authority_is_never_longer_than_the_line_allows() -> None:
    assert end_of_authority_m(course(), SPACE._replace(longest_m=1499.0)) == 1999.0
    assert end_of_authority_m(course(), SPACE._replace(longest_m=1501.0)) == 2000.0


def test_a_train_ordered_to_stop_gets_an_authority_that_ends_at_its_front() -> None:
    assert end_of_authority_m(course(stopped=True), SPACE) == 500.0


def test_a_train_ordered_to_stop_still_keeps_its_distance() -> None:
    bound = course(stopped=True, granted_m=900.0, ahead_m=505.0)

    assert end_of_authority_m(bound, SPACE) == 498.0


@pytest.mark.parametrize("bar", list(Bar))
@pytest.mark.parametrize("ahead_m", [807.0, 800.0])
def test_barred_track_that_begins_at_the_end_of_authority_does_not_matter(
    bar: Bar, ahead_m: float
) -> None:
    bound = course(granted_m=900.0, easy_m=900.0, ahead_m=ahead_m)

    assert end_of_authority_m(bound, between(800.0, 840.0, bar)) == ahead_m - 7.0


def test_an_authority_that_would_end_in_barred_track_ends_before_it() -> None:
    bound = course(ahead_m=827.0)

    assert end_of_authority_m(bound, between(800.0, 840.0, Bar.SHUT)) == 800.0


@pytest.mark.parametrize("bar", list(Bar))
def test_a_train_that_touches_the_start_of_something_is_not_in_it(bar: Bar) -> None:
    assert end_of_authority_m(course(), between(500.0, 540.0, bar)) == 500.0


@pytest.mark.parametrize("granted_m", [480.0, 500.0, 900.0])
@pytest.mark.parametrize(
    ("bar", "end_m"), [(Bar.SHUT, 500.0), (Bar.UNSURE, None), (Bar.CLOSING, 2000.0)]
)
def test_a_train_on_barred_track_stops_waits_or_leaves_by_its_kind(
    bar: Bar, granted_m: float, end_m: float | None
) -> None:
    """This holds for every granted authority; the train may have come by one of the area before."""
    bound = course(granted_m=granted_m)

    assert end_of_authority_m(bound, between(490.0, 540.0, bar)) == end_m


@pytest.mark.parametrize(
    ("bar", "front_max_m", "end_m"),
    [
        (Bar.SHUT, 2000.0, 2000.0),
        (Bar.SHUT, 2000.1, None),
        (Bar.UNSURE, 2000.1, None),
        (Bar.CLOSING, 2000.1, 2000.0),
    ],
)
@pytest.mark.parametrize("granted_m", [2000.0, 2100.0])
def test_the_next_area_does_not_release_a_train_on_barred_track(
    bar: Bar, front_max_m: float, end_m: float | None, granted_m: float
) -> None:
    """The next area continues an authority that ends at the border. A train without one stays
    where it is."""
    bound = course(front_max_m, granted_m=granted_m)

    assert end_of_authority_m(bound, between(1910.0, 1940.0, bar)) == end_m
    assert end_of_authority_m(bound, between(1890.0, 1918.0, bar)) == 2000.0
    assert end_of_authority_m(bound, between(2050.0, 2060.0, bar)) == 2000.0


@pytest.mark.parametrize(("front_max_m", "end_m"), [(2000.0, 2000.0), (2000.1, None)])
@pytest.mark.parametrize("granted_m", [2000.0, 2100.0])
def test_the_next_area_does_not_release_a_train_that_supervision_stops(
    front_max_m: float, end_m: float | None, granted_m: float
) -> None:
    bound = course(front_max_m, granted_m=granted_m, stopped=True)

    assert end_of_authority_m(bound, SPACE) == end_m


@pytest.mark.parametrize("bar", [Bar.SHUT, Bar.UNSURE])
def test_beyond_an_object_that_closes_too_late_the_next_barred_track_stops_the_train(
    bar: Bar,
) -> None:
    space = SPACE._replace(
        stretches=(BarredTrack(700.0, 720.0, Bar.CLOSING), BarredTrack(900.0, 920.0, bar))
    )

    assert end_of_authority_m(course(granted_m=800.0, easy_m=750.0), space) == 900.0


def test_barred_track_behind_a_train_does_not_mask_what_lies_ahead() -> None:
    space = SPACE._replace(
        stretches=(BarredTrack(300.0, 320.0, Bar.SHUT), BarredTrack(900.0, 920.0, Bar.SHUT))
    )

    assert end_of_authority_m(course(), space) == 900.0


def test_a_train_in_a_shut_stretch_is_stopped_whatever_else_lies_there() -> None:
    space = SPACE._replace(
        stretches=(BarredTrack(480.0, 540.0, Bar.SHUT), BarredTrack(490.0, 540.0, Bar.UNSURE))
    )

    assert end_of_authority_m(course(granted_m=900.0), space) == 500.0


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
    """The trains stand where they report, and each receives its authority in one pass."""
    trains = sorted(rears_m, reverse=True)
    space = SPACE._replace(
        stretches=tuple(
            sorted([BarredTrack(at, at + 30.0, bar) for at, bar in bars], key=lambda s: s[:2])
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
        ((0, 10, 6), [], False),  # The sum is right, but the train does not stand over that joint.
        ((0, 10, 10), [], False),
        ((0, 16, 0, 16), [], True),  # Another vehicle, separated by a clear section.
        ((0, 16, 16), [StandingTrain(210.0, 290.0, 16)], True),
        ((0, 16, 16), [StandingTrain(1210.0, 1290.0, 16)], False),
        # The other train only just enters.
        ((16, 16, 0), [StandingTrain(199.0, 279.0, 16)], False),
        ((0, 0, 0), [], False),  # The train reports itself in a clear section.
        ((16, 0, 16), [], False),
        ((0, 0, 16), [StandingTrain(210.0, 290.0, 16)], False),
        # The count may end at either side.
        ((16, 16), [StandingTrain(10.0, 90.0, 16)], True),
        ((16, 16, 16), [StandingTrain(10.0, 90.0, 16), StandingTrain(210.0, 290.0, 16)], True),
        # The train's middle is at the joint.
        ((0, 16, 0), [StandingTrain(160.0, 240.0, 16)], True),
        ((0, 32, 0), [StandingTrain(160.0, 239.8, 16)], True),
        ((0, 16, 0), [StandingTrain(60.0, 140.0, 16)], True),
        ((0, 32, 0), [StandingTrain(60.2, 140.0, 16)], True),
        ((0, 32), [StandingTrain(120.0, 200.0, 16)], True),
        # The train may extend beyond the count.
        ((0, 32), [StandingTrain(120.0, 200.1, 16)], False),
        ((32, 0), [StandingTrain(0.0, 80.0, 16)], False),
        ((16, 16, 0), [StandingTrain(0.0, 80.0, 16)], True),
        ((16, 16, 0), [StandingTrain(-0.1, 79.9, 16)], False),
        ((0, 16, 16, 0), [StandingTrain(210.0, 290.0, 16), StandingTrain(310.0, 390.0, 16)], True),
    ],
)
def test_axles_around_a_train_must_belong_to_trains_reported_there(
    axles: tuple[int, ...], others: list[StandingTrain], answer: bool
) -> None:
    assert explained(sections(*axles), StandingTrain(115.0, 198.0, 16), others) is answer


@pytest.mark.parametrize(
    ("occupied", "rear_m", "to_m"),
    [
        ((False, False, True), 50.0, 196.0),
        ((True, False, False), 50.0, 50.0),  # The train may be in its former section.
        ((False, True, False), 50.0, 96.0),
        ((False, False, False), 150.0, 296.0),
        ((True, False, False), 150.0, 296.0),
        ((False, True, False), 99.0, 99.0),  # Only its overhang is past the joint.
    ],
)
def test_a_silent_train_is_past_the_clear_sections_behind_it_but_for_its_overhang(
    occupied: tuple[bool, ...], rear_m: float, to_m: float
) -> None:
    told = [(n * 100.0, n * 100.0 + 100.0, SectionState(n, o, 0)) for n, o in enumerate(occupied)]

    assert cleared_to_m(rear_m, told, overhang_m=4.0) == to_m


@pytest.mark.parametrize(
    ("axles", "rear_m", "front_m", "answer"),
    [
        ((16, 0, 16), 5.0, 95.0, True),
        ((16, 0, 16), 205.0, 295.0, True),
        ((16, 0, 0, 16), 50.0, 148.0, True),  # The front overhangs into a clear section.
        ((0, 16, 0, 16), 115.0, 210.0, True),
        ((16, 0, 16), 100.0, 200.0, False),  # Only the sections beside the train are occupied.
        ((16, 0, 16), 99.9, 190.0, False),  # So small an overhang cannot hold axles.
        ((8, 8), 60.0, 140.0, True),
        ((8, 0, 8), 60.0, 240.0, True),  # The section lies between its bogies.
    ],
)
def test_only_the_sections_under_a_train_and_the_occupied_ones_next_to_them_count(
    axles: tuple[int, ...], rear_m: float, front_m: float, *, answer: bool
) -> None:
    assert explained(sections(*axles), StandingTrain(rear_m, front_m, 16), []) is answer


@pytest.mark.parametrize(("rear_m", "front_m"), [(115.0, 200.0), (200.0, 285.0)])
def test_a_train_beside_a_joint_is_not_accounted_for_by_another_beyond_it(
    rear_m: float, front_m: float
) -> None:
    there = (0, 16) if rear_m >= 200.0 else (0, 0, 16)
    other = StandingTrain(110.0, 190.0, 16) if rear_m >= 200.0 else StandingTrain(210.0, 290.0, 16)

    assert explained(sections(*there, 0), StandingTrain(rear_m, front_m, 16), [other]) is False


def test_axles_of_a_clear_section_do_not_count() -> None:
    told = sections(0, 16, 0)
    told[2] = Counted(200.0, 300.0, False, 4)

    assert explained(told, StandingTrain(115.0, 198.0, 16), []) is True


@pytest.mark.parametrize(
    ("axles", "farther_m", "answer"),
    [
        ((0, 32, 0, 0), 0.0, True),
        ((0, 32, 0, 0), 50.0, True),  # The train's middle is at most at 145 m, in that section.
        ((0, 32, 0, 0), 54.9, True),
        # The train's front stays before the occupied section.
        ((0, 32, 0, 16), 55.0, True),
        ((0, 32, 0, 16), 114.9, True),
        ((0, 32, 0, 16), 115.1, False),
        ((0, 32, 0, 16), 54.0, True),
        ((0, 32, 0, 0), 215.0, True),  # All of the track that it may reach is clear.
        ((0, 32, 0, 0), 215.1, False),  # The track beyond 400 m is unreported.
        ((0, 32, 0, 16), 115.0, True),
        ((0, 32, 0), 60.0, True),
        ((0, 32, 0, 0, 0), 250.0, True),
        ((0, 32), 15.0, True),
        ((0, 32), 15.1, False),  # Some of its axles may be past the counted track.
    ],
)
def test_a_silent_train_accounts_for_axles_only_where_it_certainly_is(
    axles: tuple[int, ...], farther_m: float, *, answer: bool
) -> None:
    other = StandingTrain(105.0, 185.0, 16, farther_m)

    assert explained(sections(*axles), StandingTrain(115.0, 198.0, 16), [other]) is answer


@pytest.mark.parametrize(("behind_m", "answer"), [(0.0, True), (44.9, True), (45.0, False)])
def test_a_train_that_may_have_arrived_after_the_count_accounts_for_no_axles(
    behind_m: float, *, answer: bool
) -> None:
    """A clear section that may be short lies between; the middle of the other train is at 145 m."""
    other = StandingTrain(105.0, 185.0, 16, behind_m=behind_m)

    assert explained(sections(0, 32, 0), StandingTrain(115.0, 198.0, 16), [other]) is answer
    first = StandingTrain(45.1, 95.0, 16, behind_m=behind_m)
    assert explained(sections(16, 16, 0), first, [other]) is True


@pytest.mark.parametrize(("behind_m", "answer"), [(0.0, True), (5.0, True), (5.1, False)])
def test_a_train_that_may_have_extended_beyond_the_line_accounts_for_no_axles(
    behind_m: float, *, answer: bool
) -> None:
    first = StandingTrain(5.0, 95.0, 16, behind_m=behind_m)

    assert explained(sections(16, 0), first, []) is answer


@pytest.mark.parametrize(
    ("axles", "front_m", "farther_m", "answer"),
    [
        ((16, 16), 200.0, 0.0, True),
        ((17, 15), 200.0, 0.0, True),  # The second train may have one axle before the joint.
        ((15, 17), 200.0, 0.0, False),  # The first train has no axle beyond the joint.
        ((31, 1), 200.0, 0.0, True),
        ((15, 17), 200.1, 0.0, True),
        ((15, 17), 200.0, 0.1, True),
    ],
)
def test_the_sum_of_axles_and_their_distribution_must_both_fit_the_trains(
    axles: tuple[int, int], front_m: float, farther_m: float, *, answer: bool
) -> None:
    """Axles missed elsewhere cannot compensate for a shadow train."""
    told = [Counted(100.0, 200.0, True, axles[0]), Counted(200.0, 400.0, True, axles[1])]
    told = [Counted(0.0, 100.0, False, 0), *told, Counted(400.0, 500.0, False, 0)]
    first = StandingTrain(120.0, front_m, 16, farther_m)
    second = StandingTrain(190.0, 290.0, 16)

    assert explained(told, first, [second]) is answer
    assert explained(told, second, [first]) is answer
    if not farther_m:
        assert all_explained(told, [first, second], from_m=100.0, to_m=400.0) is answer


@pytest.mark.parametrize(("before", "answer"), [(48, True), (47, False), (63, True), (64, False)])
def test_every_train_wholly_before_a_joint_has_its_axles_counted_there(
    before: int, *, answer: bool
) -> None:
    """Three trains are wholly before the joint, and a fourth stands over it."""
    told = [Counted(0.0, 400.0, True, before), Counted(400.0, 600.0, True, 64 - before)]
    told = [*told, Counted(600.0, 700.0, False, 0)]
    trains = [StandingTrain(at, at + 80.0, 16) for at in (10.0, 110.0, 210.0, 350.0)]

    assert explained(told, trains[0], trains[1:]) is answer


@pytest.mark.parametrize(("farther_m", "answer"), [(54.9, True), (55.0, False)])
def test_a_train_that_may_be_half_past_a_joint_no_longer_counts_before_it(
    farther_m: float, *, answer: bool
) -> None:
    told = [*sections(0, 32), Counted(200.0, 230.0, False, 0), Counted(230.0, 400.0, True, 16)]
    other = StandingTrain(105.0, 185.0, 16, farther_m)

    assert explained(told, StandingTrain(115.0, 198.0, 16), [other]) is answer


@pytest.mark.parametrize(
    ("rear_m", "behind_m", "answer"), [(200.0, 0.0, False), (199.9, 0.0, True), (200.0, 0.1, True)]
)
def test_a_train_past_a_joint_during_the_count_has_no_axles_before_it(
    rear_m: float, behind_m: float, *, answer: bool
) -> None:
    told = [Counted(0.0, 200.0, True, 17), Counted(200.0, 400.0, True, 15)]
    told = [*told, Counted(400.0, 500.0, False, 0)]
    second = StandingTrain(rear_m, 290.0, 16, behind_m=behind_m)

    assert explained(told, StandingTrain(20.0, 100.0, 16), [second]) is answer


@pytest.mark.parametrize("beside", [0, 2])
def test_no_train_accounts_for_an_untrusted_count(beside: int) -> None:
    told = sections(0, 16, 0)
    assert explained(told, StandingTrain(115.0, 198.0, 16), [])

    told[beside] = told[beside]._replace(occupied=True)
    assert explained(told, StandingTrain(115.0, 198.0, 16), []) is False
    assert all_explained(told, [StandingTrain(115.0, 198.0, 16)], from_m=0.0, to_m=300.0) is False


HERE, THERE = StandingTrain(110.0, 190.0, 16), StandingTrain(310.0, 390.0, 24)
OVER, BESIDE, AHEAD = (
    StandingTrain(60.0, 139.0, 16),
    StandingTrain(5.0, 58.0, 16),
    StandingTrain(361.0, 441.0, 16),
)


@pytest.mark.parametrize(
    ("axles", "standing", "answer"),
    [
        ((0, 0, 0, 0, 0), [], True),
        ((0, 16, 0, 0, 0), [], False),
        ((0, 16, 0, 0, 0), [HERE], True),
        ((0, 16, 0, 24, 0), [HERE], False),
        ((0, 16, 0, 24, 0), [HERE, THERE], True),
        ((0, 24, 0, 16, 0), [HERE, THERE], False),  # The axles are not where the trains report.
        ((16, 0, 0, 0, 0), [], True),  # These axles are behind the examined stretch.
        ((0, 0, 0, 0, 16), [], True),  # These axles are beyond the examined stretch.
        ((16, 16, 0, 0, 0), [HERE], True),
        ((0, 16, 0, 24, 16), [HERE, THERE], True),
        ((8, 8, 0, 0, 0), [OVER], True),
        ((8, 8, 0, 0, 0), [], False),
        # Another vehicle stands there too.
        ((24, 8, 0, 0, 0), [OVER], False),
        ((24, 8, 0, 0, 0), [OVER, BESIDE], True),  # That vehicle is known and counts too.
        ((0, 0, 0, 8, 8), [AHEAD], True),
        ((0, 0, 0, 8, 24), [AHEAD], False),
        ((16, 8, 8, 0, 0), [StandingTrain(160.0, 240.0, 16)], True),
        ((0, 0, 0, 24, 0), [HERE, THERE], False),  # One reported train has no axles.
    ],
)
def test_all_axles_between_two_places_belong_to_trains_that_stand_there(
    axles: tuple[int, ...], standing: list[StandingTrain], *, answer: bool
) -> None:
    assert all_explained(sections(*axles), standing, from_m=100.0, to_m=400.0) is answer


@pytest.mark.parametrize(
    ("from_m", "to_m", "answer"),
    [(200.0, 400.0, True), (199.9, 400.0, False), (0.0, 100.0, True), (0.0, 100.1, False)],
)
def test_a_section_counts_when_any_of_it_lies_between(
    from_m: float, to_m: float, *, answer: bool
) -> None:
    assert all_explained(sections(0, 16, 0, 0), [], from_m=from_m, to_m=to_m) is answer


@pytest.mark.parametrize(
    ("start_m", "end_m", "hides"),
    [
        (500.0, 800.0, True),
        (499.9, 800.0, False),  # The train behind may have come this far.
        (500.0, 800.1, False),  # The train ahead may have been there.
        (500.1, 799.9, True),
        (100.0, 200.0, False),
        (900.0, 950.0, False),
    ],
)
def test_an_occupied_section_between_two_trains_holds_a_shadow_train(
    start_m: float, end_m: float, *, hides: bool
) -> None:
    section = SeenSection(start_m, end_m)

    found = unexplained([section], beyond_m=500.0, before_m=800.0)

    assert found == (section if hides else None)


def test_the_first_section_that_no_known_train_can_occupy_is_returned() -> None:
    seen = [SeenSection(400.0, 500.0), SeenSection(500.0, 600.0), SeenSection(600.0, 700.0)]

    assert unexplained(seen, beyond_m=450.0, before_m=800.0) == SeenSection(500.0, 600.0)
    assert unexplained([], beyond_m=450.0, before_m=800.0) is None


@pytest.mark.parametrize("begins_m", [490.0, 600.0])
def test_an_unsure_stretch_does_not_keep_a_train_going_that_supervision_stops(
    begins_m: float,
) -> None:
    doubt = BarredTrack(begins_m, 640.0, Bar.UNSURE)
    space = SPACE._replace(stretches=(doubt,))

    assert end_of_authority_m(course(granted_m=900.0), space) is None
    assert end_of_authority_m(course(granted_m=900.0, stopped=True), space) == 500.0
    assert end_of_authority_m(course(granted_m=500.1, stopped=True), space) == 500.0


def test_an_order_to_stop_gives_no_authority_to_a_train_in_an_unsure_stretch() -> None:
    """A train that starts over an open switch may not use even its position uncertainty
    (simulation seed 2685)."""
    space = SPACE._replace(stretches=(BarredTrack(490.0, 640.0, Bar.UNSURE),))

    assert end_of_authority_m(course(granted_m=500.0, stopped=True), space) is None


@pytest.mark.parametrize(
    ("start_m", "end_m", "bar", "told_m"),
    [
        (410.0, 450.0, Bar.SHUT, 420.0),
        (410.0, 450.0, Bar.UNSURE, 420.0),
        (410.0, 450.0, Bar.CLOSING, 415.0),
        (400.0, 418.0, Bar.SHUT, 420.0),
        (400.0, 417.0, Bar.SHUT, 419.0),
        (400.0, 413.0, Bar.SHUT, 415.0),
        (400.0, 412.0, Bar.SHUT, 415.0),
        (499.9, 600.0, Bar.SHUT, 420.0),
        (500.0, 600.0, Bar.SHUT, 415.0),
        (420.0, 420.0, Bar.SHUT, 420.0),
    ],
)
def test_a_train_jogs_back_at_most_5_m_and_never_over_barred_track(
    start_m: float, end_m: float, bar: Bar, told_m: float
) -> None:
    """The rear is at 420 m and the front at 500 m.

    A failed switch may lie under the train or within its rollback distance (simulation seed 2685).
    """
    seen = course()._replace(rear_m=420.0, front_max_m=500.0)

    assert back_to_m(seen, between(start_m, end_m, bar)) == told_m
