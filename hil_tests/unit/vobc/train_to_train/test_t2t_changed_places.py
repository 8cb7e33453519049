"""Restarted trains that changed places: the master cannot tell which of them was away."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_one_area import BEYOND, OneArea, report_at, restarted
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
"""A rear that is certainly behind `BEYOND`, with its position uncertainty of 4 m."""
TWO = ((6, 700.0), (1, 500.0))


def two_restarted(*others: tuple[int, float], told_m: float) -> OneArea:
    """An area with two restarted trains: train 6, and train 1, which now reports a place before
    it."""
    area = OneArea(*TWO, *others)
    area.on_message(restarted(told_m, train=6))
    area.on_message(BEYOND)
    area.reserved_m = {6: told_m + 84.0}
    return area


@pytest.mark.parametrize("told_m", [694.0, 700.0, 729.0, PASSED_M, 816.0])
def test_two_restarted_trains_that_changed_places_both_keep_their_entries(told_m: float) -> None:
    """The master cannot tell which was away. Both wait until a person removes them."""
    area = two_restarted(told_m=told_m)

    assert area.settles() == (area.order, [])


def test_of_trains_that_changed_places_the_recently_heard_one_is_in_its_place() -> None:
    area = two_restarted(told_m=700.0)
    area.receives_former_report(6, age_ns=10_000_000_001)
    area.receives_former_report(1, age_ns=10_000_000_000)

    order, gone = area.settles()

    assert [(entry.train, entry.boot) for entry in order] == [(6, 1), (1, 2)]
    assert gone == []


@pytest.mark.parametrize("told_m", [688.9, 200.0])
def test_no_train_passed_one_that_came_back_elsewhere(told_m: float) -> None:
    """The train that it was ahead of may still be where it was, and keeps its place on the
    roster."""
    area = OneArea((6, 700.0), (1, 650.0), counted=(Counted(0.0, 3000.0, True, 32),))
    area.unregistered = (StandingTrain(told_m, told_m + 84.0, 16),)
    area.on_message(restarted(told_m, train=6, standstill=False))
    area.on_message(BEYOND)
    area.reserved_m = {6: told_m + 84.0}

    order, _ = area.settles()

    assert (1, 1) in [(entry.train, entry.boot) for entry in order]


def test_a_train_need_not_wait_for_one_behind_it_that_came_back_farther_back() -> None:
    area = OneArea((1, 900.0), (2, 700.0))
    area.on_message(restarted(900.0))
    area.on_message(restarted(200.0, train=2))

    order, _ = area.settles()

    assert [(entry.train, entry.boot) for entry in order] == [(1, 2)]


@pytest.mark.parametrize(
    ("restarted_m", "found"),
    [
        ((1084.0, 1090.0), RestartPlace.IN_PLACE),
        ((1083.9, 1090.0), RestartPlace.UNSURE),
        ((990.0, 999.9), RestartPlace.UNSURE),
    ],
)
def test_the_report_of_a_restarted_train_ahead_gives_its_place(
    restarted_m: tuple[float, float], found: RestartPlace
) -> None:
    """The train stands from 1000 m to 1084 m."""
    former = Former(
        TrainRecord(1, 900.0, 0, boot=1),
        (),
        [Neighbour(950.0, heard=True, restarted_m=restarted_m)],
    )

    def judged(evidence: RestartEvidence) -> RestartPlace:
        return whereabouts(former, report_at(1000.0), evidence, behind_rear_m=7.0)

    assert judged(RestartEvidence(sieved=False, left=False, recent=False)) is found
    assert judged(RestartEvidence(sieved=True, left=False, recent=False)) is found
    assert judged(RestartEvidence(sieved=False, left=True, recent=False)) is found
    assert judged(RestartEvidence(sieved=False, left=False, recent=True)) is RestartPlace.IN_PLACE
