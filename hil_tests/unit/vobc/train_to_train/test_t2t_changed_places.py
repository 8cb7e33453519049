"""Trains that began anew and changed places: nobody knows which of them was away."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_one_area import BEYOND, OneArea, anew, report_at
from vobc.train_to_train.authority import Counted, StandingTrain
from vobc.train_to_train.occupancy import TrainRecord
from vobc.train_to_train.restart import (
    Former,
    Neighbour,
    RestartEvidence,
    RestartPlace,
    whereabouts,
)

PASSED_M = 815.9
"""Of a rear that surely is behind `BEYOND`, within the 4 m that it is unsure of."""
TWO = ((6, 700.0), (1, 500.0))


def two_anew(*others: tuple[int, float], told_m: float) -> OneArea:
    """That began anew: train 6, and train 1, which says that it is before it now."""
    area = OneArea(*TWO, *others)
    area.on_message(anew(told_m, train=6))
    area.on_message(BEYOND)
    area.reserved_m = {6: told_m + 84.0}
    return area


@pytest.mark.parametrize("told_m", [694.0, 700.0, 729.0])
def test_of_two_that_begin_anew_and_changed_places_none_is_gone(told_m: float) -> None:
    """One of them was away, nobody knows which: they stay on the roster, as they say they stand."""
    area = two_anew(told_m=told_m)

    order, gone = area.settles()

    assert [(entry.train, entry.boot) for entry in order] == [(1, 2), (6, 1)]
    assert gone == []
    assert order[0].rear_m == area.known.records[1].rear_m == 820.0
    assert area.known.records[1].report == BEYOND
    assert [report.source for report, _ in area.newborns.told()] == [6]

    area.order = order
    order, gone = area.settles()

    assert [(entry.train, entry.boot) for entry in order] == [(1, 2), (6, 2)]
    assert gone == []


@pytest.mark.parametrize("told_m", [729.1, PASSED_M, 816.0])
def test_of_two_that_changed_places_both_wait_while_one_may_come_to_the_other(
    told_m: float,
) -> None:
    """Its front is 84 m before what it says of its rear, and 7 m are kept free of it."""
    area = two_anew(told_m=told_m)

    assert area.settles() == (area.order, [])


def test_of_two_that_changed_places_both_wait_while_axles_are_nobodys() -> None:
    area = two_anew(told_m=700.0)
    area.counted = (Counted(0.0, 3000.0, True, 48),)

    assert area.settles() == (area.order, [])


def test_of_two_that_changed_places_the_one_that_cannot_have_been_away_is_in_its_place() -> None:
    area = two_anew(told_m=700.0)
    area.heard_of_life_before(6, age_ns=10_000_000_001)
    area.heard_of_life_before(1, age_ns=10_000_000_000)

    order, gone = area.settles()

    assert [(entry.train, entry.boot) for entry in order] == [(6, 1), (1, 2)]
    assert gone == []


def test_of_two_that_changed_places_both_wait_while_one_behind_is_not_heard() -> None:
    """Where that one is nobody knows: it may be ahead of both."""
    area = two_anew((7, 50.0), told_m=700.0)
    assert area.settles() == (area.order, [])

    area.heard_of_life_before(7, age_ns=0)
    order, _ = area.settles()

    assert [entry.train for entry in order] == [1, 6, 7]


def test_of_two_that_changed_places_both_wait_while_one_between_is_not_heard() -> None:
    area = OneArea((6, 700.0), (7, 600.0), (1, 500.0))
    area.on_message(anew(700.0, train=6))
    area.on_message(BEYOND)
    area.reserved_m = {6: 784.0, 7: 690.0}

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize("told_m", [688.9, 200.0])
def test_one_that_came_back_elsewhere_was_passed_by_nobody(told_m: float) -> None:
    """What it was ahead of may still be where it was, and keeps its place on the roster."""
    area = OneArea((6, 700.0), (1, 650.0), counted=(Counted(0.0, 3000.0, True, 32),))
    area.strangers = (StandingTrain(told_m, told_m + 84.0, 16),)
    area.on_message(anew(told_m, train=6, standstill=False))
    area.on_message(BEYOND)
    area.reserved_m = {6: told_m + 84.0}

    order, _ = area.settles()

    assert (1, 1) in [(entry.train, entry.boot) for entry in order]


def test_a_train_need_not_wait_for_one_behind_it_that_came_back_farther_back() -> None:
    area = OneArea((1, 900.0), (2, 700.0))
    area.on_message(anew(900.0))
    area.on_message(anew(200.0, train=2))

    order, _ = area.settles()

    assert [(entry.train, entry.boot) for entry in order] == [(1, 2)]


@pytest.mark.parametrize(
    ("anew_m", "found"),
    [
        ((1084.0, 1090.0), RestartPlace.IN_PLACE),
        ((1083.9, 1090.0), RestartPlace.UNSURE),
        ((990.0, 1000.0), RestartPlace.UNSURE),
        ((990.0, 999.9), RestartPlace.BEFORE),
    ],
)
def test_where_one_ahead_is_counts_by_what_it_tells_anew(
    anew_m: tuple[float, float], found: RestartPlace
) -> None:
    """The train is from 1000 m to 1084 m, and gets another place only where its axles are seen."""
    former = Former(
        TrainRecord(1, 900.0, 0, boot=1), (), [Neighbour(950.0, heard=True, anew_m=anew_m)]
    )

    def judged(evidence: RestartEvidence) -> RestartPlace:
        return whereabouts(former, report_at(1000.0), evidence, behind_rear_m=7.0)

    unseen = RestartPlace.UNSURE if found is RestartPlace.BEFORE else found
    assert judged(RestartEvidence(sieved=False, left=False, recent=False)) is unseen
    assert judged(RestartEvidence(sieved=True, left=False, recent=False)) is found
    assert judged(RestartEvidence(sieved=False, left=True, recent=False)) is found
    assert judged(RestartEvidence(sieved=False, left=False, recent=True)) is RestartPlace.IN_PLACE
