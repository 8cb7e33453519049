"""The order of tags, each decision on both sides of its limit."""

from dataclasses import replace

import pytest

from can_dbc.odometer import ColdMovement
from firmware_py.trackdb import LineMap, SpeedSection, Station, TagSite
from vobc.config import load_config
from vobc.odometry.references import LocatedTag, References, Windows
from vobc.vocabulary import PlaceProof, TagRefusal

CONFIG = replace(
    load_config("florence4").odometry,
    tag_bound_m=0.25,
    tag_silence_s=0.5,
    missed_tags_max=2,
    localisation_limit_m=30.0,
    cold_movement_m=2.0,
)
PLACES_M = (50.0, 100.0, 150.0, 200.0, 300.0)
STATION = Station("A", 0.0, -80.0, 5.0)


BOTH = Windows((10.0, 20.0), (10.0, 20.0))
"""Wheels and ground expect the front at the same places."""


def site(index: int) -> TagSite:
    return TagSite(10 + index, PLACES_M[index])


LINE = LineMap(
    "tags", -100.0, 900.0, (STATION,), (SpeedSection(-100.0, 900.0, 20.0),),
    tags=tuple(site(index) for index in range(len(PLACES_M))),
)  # fmt: skip


def references(proof: PlaceProof = PlaceProof.SET_UP) -> References:
    made = References(CONFIG, LINE, proof)
    made.begin(0.0)
    return made


def reading(
    index: int,
    claim_m: float = 15.0,
    *,
    bound_m: float = 0.1,
    pulses: int = 0,
    ground_m: float = 0.0,
    ground_bound_m: float = 0.0,
) -> LocatedTag:
    return LocatedTag(
        site(index), PLACES_M[index] + 2.0, claim_m, bound_m, pulses, ground_m, ground_bound_m
    )


def passed(made: References, antenna_m: float, speed_mps: float = 0.0) -> int:
    """Number of missed tags once the antenna is certainly at a chainage."""
    made.watch(antenna_m, speed_mps, 1.0)
    return made.missed


def test_a_train_started_with_a_position_is_localised_and_one_without_is_not() -> None:
    assert references().lost_cause == ""
    assert not references().waiting
    assert references(PlaceProof.UNKNOWN).lost_cause == "started at an unknown place"
    assert not references(PlaceProof.UNKNOWN).waiting
    remembered = references(PlaceProof.REMEMBERED)
    assert remembered.waiting
    assert remembered.lost_cause == "not proven yet that the train was not moved while it was off"
    assert sorted(remembered.sites) == [10, 11, 12, 13, 14]
    assert remembered.sites[12].position_m == 150.0


def test_without_a_start_position_every_tag_is_expected() -> None:
    assert passed(References(CONFIG, LINE, PlaceProof.SET_UP), 60.0) == 1


@pytest.mark.parametrize(("antenna_m", "missed"), [(49.9, 2), (50.0, 1), (100.0, 0)])
def test_tags_that_the_antenna_may_stand_behind_need_not_be_read(
    antenna_m: float, missed: int
) -> None:
    made = References(CONFIG, LINE, PlaceProof.SET_UP)
    made.begin(antenna_m)

    assert passed(made, 100.3) == missed


@pytest.mark.parametrize(
    ("antenna_m", "speed_mps", "missed"),
    [
        (50.25, 0.0, 0),
        (50.26, 0.0, 1),
        (55.25, 10.0, 0),
        (55.26, 10.0, 1),
        (50.26, -10.0, 1),
    ],
)
def test_a_tag_counts_as_missed_once_it_is_certainly_passed_and_its_reader_had_time(
    antenna_m: float, speed_mps: float, missed: int
) -> None:
    made = references()

    assert passed(made, antenna_m, speed_mps) == missed
    assert made.lost_cause == ""
    assert passed(made, antenna_m, speed_mps) == missed, "each but once"


def test_the_last_tag_of_the_line_is_missed_as_any_other_and_no_more_come() -> None:
    made = references()
    made.turned(-100)
    made.accept(reading(3), None)

    assert passed(made, 800.0) == 1
    made.accept(reading(4), None)
    assert made.missed == 0
    assert made.lost_cause == ""


def test_two_missed_tags_in_a_row_lose_the_position_and_a_reading_restarts_the_count() -> None:
    made = references()
    assert passed(made, 60.0) == 1
    made.accept(reading(1), None)
    assert made.missed == 0
    assert passed(made, 160.0) == 1
    assert made.lost_cause == ""
    assert passed(made, 210.0) == 2
    assert made.lost_cause == "2 expected tags were not read"


def test_tags_behind_a_tag_that_was_read_early_do_not_count_as_missed() -> None:
    made = references()
    made.accept(reading(2), None)

    assert passed(made, 199.0) == 0
    assert passed(made, 201.0) == 1


@pytest.mark.parametrize(("width_m", "lost"), [(30.0, False), (30.04, True)])
def test_an_interval_wider_than_its_limit_loses_the_place(width_m: float, *, lost: bool) -> None:
    made = references()
    made.watch(0.0, 0.0, width_m)

    assert made.lost_cause == (
        "the place is known to 30.0 m only; the limit is 30 m" if lost else ""
    )


def test_the_first_cause_is_reported_and_a_pending_proof_is_no_cause() -> None:
    made = references()
    made.lose("first")
    made.lose("second")
    assert made.lost_cause == "first"
    waiting = references(PlaceProof.REMEMBERED)
    waiting.lose("found to be elsewhere")
    assert (waiting.lost_cause, waiting.waiting) == ("found to be elsewhere", False)


def test_losing_the_position_discards_the_tag_read_before() -> None:
    """While the proof is pending one tag was read. A lost position then needs two tags."""
    made = references(PlaceProof.REMEMBERED)
    assert made.find_again(reading(0), 0.01, 0.01) is None
    made.lose("moved")
    assert made.find_again(reading(1, pulses=5000), 0.01, 0.01) is None
    assert made.lost_cause == "moved"
    kept = references(PlaceProof.UNKNOWN)
    assert kept.find_again(reading(0), 0.01, 0.01) is None
    kept.lose("again")
    assert kept.find_again(reading(1, pulses=5000), 0.01, 0.01) is None
    assert kept.lost_cause == ""


@pytest.mark.parametrize(
    ("moved_m", "monitored", "pulses", "proven_m", "cause"),
    [
        (2.0, True, 10, 2.0, ""),
        (-2.0, True, -10, 2.0, ""),
        (0.0, True, 0, 0.0, ""),
        (2.25, True, 0, None, "moved by 2.2 m while it was off"),
        (-2.25, True, 0, None, "moved by -2.2 m while it was off"),
        (
            0.0, False, 0, None,
            "the train may have been moved while it was off: movement was not monitored",
        ),
        (
            0.0, True, 11, None,
            "moved before it was proven to stand where it was switched off",
        ),
        (
            0.0, True, -11, None,
            "moved before it was proven to stand where it was switched off",
        ),
    ],
)  # fmt: skip
def test_a_remembered_position_needs_a_monitored_hardly_moved_and_standing_train(
    moved_m: float, *, monitored: bool, pulses: int, proven_m: float | None, cause: str
) -> None:
    made = references(PlaceProof.REMEMBERED)

    assert made.check_cold(ColdMovement(moved_m, monitored), pulses) == proven_m
    assert (made.lost_cause, made.waiting) == (cause, False)


# The window.


@pytest.mark.parametrize(
    ("claim_m", "off_m"),
    [
        (10.0, None), (20.0, None), (15.0, None), (9.75, None), (20.25, None),
        (9.5, -0.5), (20.5, 0.5),
    ],
)  # fmt: skip
def test_a_tag_is_accepted_within_its_bound_of_the_window(
    claim_m: float, off_m: float | None
) -> None:
    refused = references().judge(reading(0, claim_m, bound_m=0.25), BOTH, disputed=False)

    if off_m is None:
        assert refused is None
    else:
        assert refused is not None
        assert refused.tag_id == 10
        assert (refused.reason, refused.off_m) == (TagRefusal.OUTSIDE_WINDOW, off_m)


@pytest.mark.parametrize(
    ("index", "reason"), [(1, TagRefusal.REPEATED), (0, TagRefusal.OUT_OF_ORDER), (2, None)]
)
@pytest.mark.parametrize(("claim_m", "off_m"), [(15.0, 0.0), (20.05, 0.05), (9.95, -0.05)])
def test_tags_come_in_order_and_each_once(
    index: int, reason: TagRefusal | None, claim_m: float, off_m: float
) -> None:
    made = references()
    made.accept(reading(1), None)
    refused = made.judge(reading(index, claim_m), BOTH, disputed=False)

    assert (refused is None) is (reason is None)
    if refused is not None:
        assert (refused.tag_id, refused.reason) == (10 + index, reason)
        assert refused.off_m == pytest.approx(off_m)


def test_two_tags_at_one_place_are_in_any_order() -> None:
    made = references()
    made.accept(reading(1), None)
    twin = replace(reading(1), site=TagSite(99, PLACES_M[1]))

    assert made.judge(twin, BOTH, disputed=False) is None


def test_the_distance_back_counts_from_the_furthest_position_since_the_tag() -> None:
    """Later movement does not matter, nor does a reading that arrives shortly after the passage."""
    for pulses, again in (
        ([1000, 1100, 1100 - 4], False),
        ([1000, 1100, 1100 - 5], True),
        ([1000, 1000 - 4], False),
        ([1000, 1000 - 5], True),
        ([1100, 1100 - 5, 1100 - 4], True),
        ([1100, 1050, 1100, 1099], True),
        ([1100, 1098, 1096, 1200, 1197], False),
    ):
        made = references()
        made.accept(reading(1, pulses=1000), None)
        for count in pulses:
            made.turned(count)

        assert (made.judge(reading(1), BOTH, disputed=False) is None) is again
        assert (made.judge(reading(0), BOTH, disputed=False) is None) is again


def test_each_accepted_tag_restarts_the_order() -> None:
    made = references()
    made.accept(reading(1, pulses=1000), None)
    made.turned(1000)
    made.turned(900)
    made.accept(reading(0, pulses=900), None)
    made.turned(903)
    made.turned(900)

    refused = made.judge(reading(0), BOTH, disputed=False)
    assert refused is not None
    assert refused.reason is TagRefusal.REPEATED
    assert made.judge(reading(1), BOTH, disputed=False) is None


# Found again.


def second(
    first: int,
    then: int,
    *,
    pulses: int,
    ground_m: float,
    bound_m: float = 0.125,
    ground_bound_m: float = 0.5,
) -> tuple[TagRefusal | None, float, bool]:
    """Read two tags while the position is lost; return the refusal of the second and whether it
    gave a position."""
    made = references(PlaceProof.UNKNOWN)
    before = reading(first, bound_m=0.125, pulses=300, ground_m=7.0, ground_bound_m=0.25)
    assert made.find_again(before, 0.0625, 0.125) is None
    assert made.lost_cause == "started at an unknown place"
    after = reading(
        then, bound_m=bound_m, pulses=300 + pulses, ground_m=7.0 + ground_m,
        ground_bound_m=0.25 + ground_bound_m,
    )  # fmt: skip
    refused = made.find_again(after, 0.0625, 0.125)
    found = made.lost_cause == ""
    if refused is None:
        assert found
        return None, 0.0, found
    assert refused.tag_id == 10 + then
    return refused.reason, refused.off_m, found


WRONG = TagRefusal.OUTSIDE_WINDOW


@pytest.mark.parametrize(
    ("pulses", "ground_m", "refusal", "off_m"),
    [
        # The tags are 50 m apart. By the wheels, each pulse is 1/16 m to 1/8 m, with 1/4 m of
        # slack.
        (398, 45.0, None, 0.0),
        (397, 45.0, WRONG, 0.125),
        (804, 55.0, None, 0.0),
        (808, 55.0, WRONG, -0.25),
        # Over ground alone the slack is 3/4 m.
        (100, 49.25, None, 0.0),
        (100, 49.125, WRONG, 0.125),
        (2000, 50.75, None, 0.0),
        (2000, 50.875, WRONG, -0.125),
        (-800, 45.0, WRONG, 4.25),
    ],
)
def test_a_second_tag_must_fit_the_distance_by_wheels_or_over_ground(
    pulses: int, ground_m: float, refusal: TagRefusal | None, off_m: float
) -> None:
    assert second(0, 1, pulses=pulses, ground_m=ground_m) == (refusal, off_m, refusal is None)


@pytest.mark.parametrize(
    ("pulses", "ground_m", "refusal", "off_m"),
    [
        (-398, -45.0, None, 0.0),
        (-397, -45.0, WRONG, -0.125),
        (-804, -55.0, None, 0.0),
        (-808, -55.0, WRONG, 0.25),
        (-100, -49.25, None, 0.0),
        (-100, -49.125, WRONG, -0.125),
    ],
)
def test_backwards_it_is_the_same(
    pulses: int, ground_m: float, refusal: TagRefusal | None, off_m: float
) -> None:
    assert second(1, 0, pulses=pulses, ground_m=ground_m) == (refusal, off_m, refusal is None)


def test_the_bounds_of_both_tags_and_of_the_ground_widen_the_tolerance() -> None:
    assert second(0, 1, pulses=394, ground_m=45.0)[0] is WRONG
    assert second(0, 1, pulses=394, ground_m=45.0, bound_m=0.625)[0] is None
    assert second(0, 1, pulses=100, ground_m=49.0, bound_m=0.375)[0] is None
    assert second(0, 1, pulses=100, ground_m=48.0)[0] is WRONG
    assert second(0, 1, pulses=100, ground_m=48.0, ground_bound_m=1.75)[0] is None
    assert second(0, 1, pulses=100, ground_m=48.0, ground_bound_m=-1.75)[0] is None


def test_the_same_tag_again_is_no_second_one() -> None:
    assert second(0, 0, pulses=0, ground_m=0.0) == (TagRefusal.REPEATED, 0.0, False)


def test_of_two_contradicting_tags_the_later_one_is_kept() -> None:
    made = references(PlaceProof.UNKNOWN)
    for first, pulses, lost in ((0, 0, True), (2, 5000, True), (3, 10_000, False)):
        made.find_again(reading(first, pulses=pulses, ground_m=pulses * 0.01), 0.01, 0.01)

        assert bool(made.lost_cause) is lost


def test_a_recovered_position_expects_the_next_tags_and_needs_two_when_lost_again() -> None:
    made = references(PlaceProof.REMEMBERED)
    made.find_again(reading(1), 0.01, 0.01)
    made.find_again(reading(2, pulses=5000), 0.01, 0.01)
    assert (made.lost_cause, made.waiting) == ("", False)
    assert passed(made, 199.0) == 0
    assert passed(made, 201.0) == 1

    made.lose("again")
    made.find_again(reading(3, pulses=10_000), 0.01, 0.01)
    assert made.lost_cause == "again"
