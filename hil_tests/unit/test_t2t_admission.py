"""What trains mean to others while they have no place on the roster."""

from dataclasses import replace

import pytest

from firmware_py.trackdb.areas import Area
from vobc.t2t.admission import kept_free, may_explain
from vobc.t2t.authority import Bar, Stretch
from vobc.t2t.vocabulary import T2tConfig
from zenoh_config.t2t import TrainReport

AREA = Area(1, 1000.0, 2000.0)
CONFIG = T2tConfig(rollback_m=2.0, jog_m=5.0)


def report(rear_m: float, front_m: float, *, train: int = 3, localised: bool = True) -> TrainReport:
    head = (train, 65_535, 1, 0, 1, 1, 0)
    place = (localised, front_m - 1.0, front_m, rear_m, rear_m, 0.0, True, *[front_m] * 3)
    return TrainReport(*head, *place, 0, 0, False, 0, 0, 16, False, 0)


def test_nobody_comes_nearer_to_it_than_to_a_train_that_may_set_back() -> None:
    standing = report(1500.0, 1585.0)

    assert kept_free([(standing, 7)], {1, 2}, CONFIG) == [Stretch(1493.0, 1585.0, Bar.CLOSING)]


@pytest.mark.parametrize(
    ("told", "roster"), [(report(1500.0, 1585.0), {3}), (report(0.0, 9.0, localised=False), {1})]
)
def test_a_train_of_the_roster_or_a_lost_one_bars_nothing_by_its_report(
    told: TrainReport, roster: set[int]
) -> None:
    assert kept_free([(told, 7)], roster, CONFIG) == []


@pytest.mark.parametrize(
    ("rear_m", "front_m", "explains"),
    [
        (1500.0, 1585.0, False),
        (1999.9, 2085.0, False),
        (2000.0, 2085.0, True),
        (915.0, 1000.1, False),
        (915.0, 1000.0, True),
    ],
)
def test_who_has_no_place_on_the_roster_explains_axles_from_outside_of_the_area_only(
    rear_m: float, front_m: float, explains: bool
) -> None:
    told = report(rear_m, front_m)

    assert may_explain(told, {1, 2}, AREA) is explains
    assert may_explain(told, {1, 2, 3}, AREA)
    assert not may_explain(replace(told, localised=False), {1, 2, 3}, AREA)
