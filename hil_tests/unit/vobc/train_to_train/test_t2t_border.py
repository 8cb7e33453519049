"""Authorities of two areas at their border: one, both, and an old one."""

import pytest

from hil_tests.unit.vobc.train_to_train.t2t_rig import MS
from hil_tests.unit.vobc.train_to_train.test_t2t_regressions import authority, own, train
from vobc.train_to_train.vocabulary import OwnTrain
from zenoh_config.t2t import AreaAuthority

BORDER_M = 2000.0
ROOM_M = 4.0 + 2.0 + 5.0
"""Room before the last axle of a shadow train, m: overhang, rollback and jog."""
BORDERS_M = (0.0, BORDER_M, 4000.0)


def end_m(
    at: OwnTrain,
    *heard: AreaAuthority,
    now_ms: int = 1100,
    borders_m: tuple[float, ...] = BORDERS_M,
) -> float | None:
    core = train(borders_m)
    core.step(1000 * MS, (), at)
    held = core.step(now_ms * MS, heard, at).authority
    return None if held is None else held.end_m


def test_an_authority_to_the_border_leaves_room_for_a_shadow_train_beyond_it() -> None:
    assert end_m(own(1500.0), authority(BORDER_M, 1)) == BORDER_M - ROOM_M


@pytest.mark.parametrize("end", [1989.1, 1995.0, 1999.9])
def test_an_authority_that_ends_close_to_the_border_leaves_that_room_too(end: float) -> None:
    """The authority may end there if the next area also grants, because it then knows of no
    train there."""
    assert end_m(own(1500.0), authority(end, 1)) == BORDER_M - ROOM_M
    assert end_m(own(1500.0), authority(end, 1), authority(3000.0, 1, area=2)) == end
    assert end_m(own(1500.0), authority(end, 1), borders_m=(0.0, BORDER_M)) == BORDER_M - ROOM_M


@pytest.mark.parametrize("short_m", [1200.0, 1988.9, 1989.0])
def test_an_authority_that_ends_farther_away_is_unchanged(short_m: float) -> None:
    assert end_m(own(1100.0), authority(short_m, 1)) == short_m


@pytest.mark.parametrize("far_m", [BORDER_M, 2000.1, 3000.0, 4000.0 - ROOM_M])
def test_an_authority_of_the_next_area_extends_over_the_border(far_m: float) -> None:
    assert end_m(own(1500.0), authority(BORDER_M, 1), authority(far_m, 1, area=2)) == far_m


def test_the_next_area_may_stop_it_before_the_border_too() -> None:
    assert end_m(own(1500.0), authority(BORDER_M, 1), authority(1980.0, 1, area=2)) == 1980.0


def test_the_end_of_the_line_is_treated_like_a_border() -> None:
    line_m = (0.0, BORDER_M)
    assert end_m(own(1500.0), authority(BORDER_M, 1), borders_m=line_m) == BORDER_M - ROOM_M
    assert end_m(own(1500.0), authority(1989.0, 1), borders_m=line_m) == 1989.0
    assert end_m(own(1500.0), authority(1988.9, 1), borders_m=line_m) == 1988.9


@pytest.mark.parametrize("front_m", [1989.1, 2000.0, 2050.0])
def test_a_train_nearer_to_the_end_of_the_line_stays_where_it_is(front_m: float) -> None:
    at, granted_m = own(front_m)._replace(front_min_m=front_m - 1.0), max(front_m, BORDER_M)
    assert end_m(at, authority(granted_m, 1), borders_m=(0.0, BORDER_M)) == front_m


@pytest.mark.parametrize(
    ("front_m", "told_m"), [(1989.0, 1989.0), (1993.0, 1993.0), (2000.0, 2000.0)]
)
def test_a_train_already_nearer_to_the_border_stays_where_it_is(
    front_m: float, told_m: float
) -> None:
    at = own(front_m)._replace(front_min_m=1980.0)
    assert end_m(at, authority(BORDER_M, 1)) == told_m


def test_a_train_that_may_be_over_the_border_is_held_at_it() -> None:
    at = own(2003.0)._replace(front_min_m=1990.0)
    assert end_m(at, authority(BORDER_M, 1)) == BORDER_M


@pytest.mark.parametrize(
    ("easy_m", "told_m"),
    [(1988.9, BORDER_M - ROOM_M), (1989.0, BORDER_M - ROOM_M), (1989.1, 3000.0)],
)
def test_an_ageing_authority_is_ignored_while_the_train_can_stop_easily_without_it(
    easy_m: float, told_m: float
) -> None:
    """The authority is 0.5 s old, half of its maximum age."""
    at = own(1500.0, speed_mps=15.0, reach_m=1900.0)._replace(easy_m=easy_m)
    here = authority(BORDER_M, 1, echo_ms=1400)
    there = authority(3000.0, 1, area=2, echo_ms=1000)
    assert end_m(at, here, there, now_ms=1500) == told_m
    assert end_m(at, here, there, now_ms=1499) == 3000.0


def test_an_expired_authority_extends_no_other() -> None:
    at = own(1500.0, speed_mps=15.0, reach_m=1900.0)._replace(easy_m=1995.0)
    there = authority(3000.0, 1, area=2, echo_ms=1000)
    core = train(BORDERS_M)
    core.step(1000 * MS, (), at)
    core.step(2000 * MS, (authority(BORDER_M, 1, echo_ms=2000), there), at)
    for now_ms, told_m in ((2000, 3000.0), (2001, BORDER_M - ROOM_M)):
        held = core.step(now_ms * MS, (), at).authority
        assert held is not None
        assert held.end_m == told_m
