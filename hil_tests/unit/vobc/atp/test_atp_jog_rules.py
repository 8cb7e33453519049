"""The rules of a jog, each at its threshold, with numbers that a float represents exactly."""

import math
from dataclasses import replace
from typing import Any, Final

import pytest

from can_dbc.vobc import Cause
from vobc.atp.jog import (
    JogFacts,
    JogGuard,
    JogState,
    JogVerdict,
    back_m,
    exceeded,
    mends_itself,
    moves,
    next_state,
    out_of_reach,
    overshot,
    stands_aligned,
    stands_off,
    stands_off_for_the_last_time,
    stands_wide,
)
from vobc.config import load_config

LIMITS: Final = replace(
    load_config("florence4").atp,
    door_window_m=0.25,
    jog_m=4.0,
    jog_mps=1.5,
    jog_attempts=2,
    overshoot_m=1.0,
    overshoot_mended_m=4.0,
)
MOVED_M: Final = 0.1
"""Least distance that counts as a movement, m; stated independently of the source."""
FINEST_M: Final = 0.1
TAG_READ_M: Final = 0.05


def off(best_m: float, half_m: float = 0.0, **changes: Any) -> JogFacts:
    """Facts of a train that stands `best_m` past its stop."""
    known: dict[str, Any] = {
        "limits": LIMITS,
        "low_m": best_m - half_m,
        "best_m": best_m,
        "high_m": best_m + half_m,
        "standstill": True,
        "moved_m": 0.0,
        "speed_high_mps": 0.0,
        "back_room_m": 10.0,
        "attempts": 0,
    }
    known["most_moved_m"] = abs(changes.get("moved_m", 0.0))
    return JogFacts(**{**known, **changes})


def window(window_m: float) -> Any:
    return replace(LIMITS, door_window_m=window_m)


# States of a standing train.


@pytest.mark.parametrize(
    ("low_m", "high_m", "aligned"),
    [
        (-0.25, 0.25, True),
        (math.nextafter(-0.25, -1.0), 0.25, False),
        (-0.25, math.nextafter(0.25, 1.0), False),
    ],
)
def test_the_edges_of_the_window_belong_to_it(low_m: float, high_m: float, aligned: bool) -> None:
    seen = off(0.0, low_m=low_m, high_m=high_m)

    assert seen.aligned is aligned
    assert stands_aligned(seen) is aligned
    assert stands_aligned(replace(seen, standstill=False)) is False


@pytest.mark.parametrize(
    ("best_m", "far"), [(4.0, False), (-4.0, False), (4.25, True), (-4.25, True), (0.0, False)]
)
def test_no_jog_begins_beyond_its_greatest_distance(best_m: float, far: bool) -> None:
    assert out_of_reach(off(best_m)) is far
    assert stands_off(off(best_m)) is (not far and best_m != 0.0)


@pytest.mark.parametrize(
    ("best_m", "worth"),
    [
        (math.nextafter(0.25, 1.0), True),
        (0.25, False),
        (0.0, False),
        (-0.25, False),
        (math.nextafter(-0.25, -1.0), True),
    ],
)
def test_a_wide_interval_justifies_a_jog_from_outside_the_window(
    best_m: float, worth: bool
) -> None:
    assert stands_off(off(best_m, half_m=0.5)) is worth


@pytest.mark.parametrize(
    ("tag_m", "worth"),
    [
        (-0.5, False),
        (-0.375, True),
        (0.0, True),
        (0.25 - TAG_READ_M, True),
        (math.nextafter(0.25 - TAG_READ_M, 1.0), False),
        (math.inf, False),
    ],
)
def test_a_wide_interval_justifies_a_jog_to_a_tag_that_the_train_may_not_have_passed(
    tag_m: float, worth: bool
) -> None:
    wide = off(0.125, half_m=0.5, tag_m=tag_m)

    assert wide.tag_ahead is worth
    assert stands_off(wide) is worth
    assert stands_wide(wide) is not worth


def test_a_jog_goes_to_a_tag_only_if_the_interval_does_not_fit_without_it() -> None:
    for half_m, to_tag in ((0.5, True), (0.15, False)):
        guard = JogGuard()
        guard.heads_for(STOP_M)
        verdict = guard.step(off(0.125, half_m=half_m, tag_m=0.0), standing=True)
        assert (verdict.permitted, verdict.to_tag) == (True, to_tag)


@pytest.mark.parametrize(
    ("window_m", "worth"), [(0.25 + FINEST_M, True), (0.249 + FINEST_M, False)]
)
@pytest.mark.parametrize("best_m", [-0.125, 0.125, 0.375])
def test_inside_the_window_a_jog_needs_an_interval_that_fits_with_a_tenth_to_spare(
    best_m: float, window_m: float, worth: bool
) -> None:
    """Half of the whole interval counts, wherever in it the estimate lies."""
    seen = off(best_m, low_m=-0.125, high_m=0.375, limits=window(window_m))

    assert not seen.aligned
    assert stands_off(seen) is (worth or best_m > window_m)


def test_past_the_stop_an_interval_that_reaches_out_behind_justifies_no_jog() -> None:
    seen = off(0.125, low_m=-0.375, high_m=0.125)

    assert not seen.aligned
    assert stands_off(seen) is False


@pytest.mark.parametrize(("attempts", "last"), [(1, False), (2, True), (3, True)])
def test_the_attempt_limit_counts_the_last_attempt(attempts: int, last: bool) -> None:
    assert stands_off_for_the_last_time(off(0.5, attempts=attempts)) is last
    assert stands_off_for_the_last_time(off(0.0, attempts=attempts)) is False


def test_a_train_at_rest_that_no_jog_would_help_counts_as_stopped_wide() -> None:
    assert stands_wide(off(0.0)) is True
    assert stands_wide(off(0.125, half_m=0.5)) is True
    assert stands_wide(off(0.5)) is False
    assert stands_wide(off(0.0, standstill=False)) is False


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_ten_centimetres_are_no_movement_and_more_is_one(side: float) -> None:
    assert moves(off(0.5, moved_m=side * MOVED_M)) is False
    assert moves(off(0.5, moved_m=side * math.nextafter(MOVED_M, 1.0))) is True


# The table.

ALIGNED: Final = off(0.0)
OFF: Final = off(0.5)
LAST: Final = off(0.5, attempts=2)
WIDE: Final = off(0.125, half_m=0.5)
FAR: Final = off(4.5)
HELD: Final = off(0.5, standstill=False, moved_m=0.05)
UNDER_WAY: Final = off(0.5, standstill=False, moved_m=0.5)
PASSING: Final = off(0.0, standstill=False, moved_m=0.5)
AWAY: Final = off(4.5, standstill=False, moved_m=5.0)
NONE, READY, RUNS, USED_UP = (
    JogState.NONE,
    JogState.READY,
    JogState.UNDER_WAY,
    JogState.USED_UP,
)


@pytest.mark.parametrize(
    ("state", "after"),
    [
        (NONE, (NONE, READY, USED_UP, NONE, NONE, NONE, NONE, NONE, NONE)),
        (READY, (NONE, READY, READY, NONE, NONE, READY, RUNS, RUNS, NONE)),
        (RUNS, (NONE, READY, USED_UP, NONE, NONE, RUNS, RUNS, RUNS, NONE)),
        (USED_UP, (NONE, USED_UP, USED_UP, USED_UP, NONE, USED_UP, USED_UP, USED_UP, NONE)),
    ],
)
def test_where_each_state_leads(state: JogState, after: tuple[JogState, ...]) -> None:
    sights = (ALIGNED, OFF, LAST, WIDE, FAR, HELD, UNDER_WAY, PASSING, AWAY)

    assert tuple(next_state(state, seen) for seen in sights) == after


# Conditions that stop a jog.


@pytest.mark.parametrize(
    ("changes", "stopped"),
    [
        ({}, False),
        ({"speed_high_mps": 1.5}, False),
        ({"speed_high_mps": math.nextafter(1.5, 2.0)}, True),
        ({"moved_m": 4.0}, False),
        ({"moved_m": -4.0}, False),
        ({"moved_m": math.nextafter(4.0, 5.0)}, True),
        ({"moved_m": -math.nextafter(4.0, 5.0)}, True),
        # The greatest possible distance counts when it exceeds the likeliest one.
        ({"moved_m": -1.0, "most_moved_m": 4.0}, False),
        ({"moved_m": -1.0, "most_moved_m": math.nextafter(4.0, 5.0)}, True),
        ({"moved_m": -0.5, "back_room_m": 0.0}, False),
        ({"moved_m": -0.5, "back_room_m": -0.001}, True),
        ({"moved_m": -MOVED_M, "back_room_m": -0.001}, False),
        ({"moved_m": 0.0, "back_room_m": -0.001}, False),
        ({"moved_m": 0.5, "back_room_m": -math.inf}, False),
    ],
)
def test_an_attempt_is_limited_in_speed_distance_and_rear_protection(
    changes: dict[str, float], stopped: bool
) -> None:
    assert exceeded(RUNS, off(0.5, standstill=False, **changes)) is stopped


@pytest.mark.parametrize("state", [NONE, READY])
def test_the_limits_of_an_attempt_count_only_during_one(state: JogState) -> None:
    seen = off(0.5, speed_high_mps=9.0, moved_m=-9.0, back_room_m=-1.0)

    assert exceeded(state, seen) is False


def test_after_the_last_attempt_any_movement_is_too_much() -> None:
    assert exceeded(USED_UP, off(0.5, moved_m=MOVED_M, speed_high_mps=9.0)) is False
    assert exceeded(USED_UP, off(0.5, moved_m=-0.125)) is True


@pytest.mark.parametrize(
    ("state", "low_m", "began_m", "standing", "past"),
    [
        (NONE, 1.0, 0.0, False, False),
        (NONE, math.nextafter(1.0, 2.0), 9.0, False, True),
        (NONE, 2.0, 9.0, True, False),
        # A jog that began within the overshoot limit and has now run past it.
        (RUNS, 2.0, 1.0, False, True),
        (RUNS, 2.0, math.nextafter(1.0, 2.0), False, False),
        (RUNS, 1.0, -3.0, False, False),
    ],
)
def test_a_moving_train_overshoots_when_its_whole_interval_is_past_the_limit(
    state: JogState, low_m: float, began_m: float, standing: bool, past: bool
) -> None:
    seen = off(low_m + 0.5, half_m=0.5, low_m=low_m, standstill=False)

    assert overshot(state, seen, began_m=began_m, standing=standing) is past


@pytest.mark.parametrize(
    ("low_m", "high_m", "mended"),
    [
        (0.0, 4.0, False),
        (0.001, 4.0, True),
        (0.001, math.nextafter(4.0, 5.0), False),
        (-1.0, 3.0, False),
    ],
)
def test_an_overshoot_releases_itself_if_the_whole_interval_is_within_reach(
    low_m: float, high_m: float, mended: bool
) -> None:
    assert mends_itself(off(1.0, low_m=low_m, high_m=high_m)) is mended


@pytest.mark.parametrize(
    ("best_m", "room_m", "back"),
    [
        (-0.5, 10.0, 0.0),
        (0.0, 10.0, 0.0),
        (0.5, 10.0, 0.75),
        (0.5, 0.625, 0.625),
        (0.5, 0.0, 0.0),
        (0.5, -math.inf, 0.0),
    ],
)
def test_a_jog_goes_back_to_the_far_edge_of_the_window_within_the_protected_rear(
    best_m: float, room_m: float, back: float
) -> None:
    assert back_m(off(best_m, back_room_m=room_m)) == back


# The guard with its memory.

STOP_M: Final = 1500.0


def ready() -> JogGuard:
    """A guard whose train stands half a metre past the stop."""
    guard = JogGuard()
    guard.heads_for(STOP_M)
    guard.step(OFF, standing=True)
    return guard


def test_a_train_that_has_not_stopped_yet_needs_no_jog() -> None:
    guard = JogGuard()

    assert guard.state is NONE
    assert guard.attempts == 0
    assert JogVerdict() == JogVerdict(
        permitted=False,
        to_tag=False,
        back_m=0.0,
        attempts=0,
        emergency=Cause.NONE,
        self_release=False,
        used_up=False,
        out_of_reach=False,
    )


def test_a_jog_is_permitted_until_it_ends() -> None:
    guard = ready()

    verdict = guard.step(replace(UNDER_WAY, moved_m=-0.25, best_m=0.25), standing=False)

    assert (verdict.permitted, verdict.back_m, verdict.attempts) == (True, 0.5, 1)
    assert verdict.emergency is Cause.NONE
    after = guard.step(replace(ALIGNED, attempts=1), standing=True)
    assert (after.permitted, after.back_m, after.attempts) == (False, 0.0, 1)


@pytest.mark.parametrize(
    ("best_m", "room_m", "permitted"),
    [
        (0.5, 0.5, True),
        (0.5, math.nextafter(0.5, 0.0), False),
        (-0.5, -math.inf, True),
    ],
)
def test_a_jog_back_is_permitted_if_its_whole_distance_is_protected(
    best_m: float, room_m: float, permitted: bool
) -> None:
    guard = JogGuard()
    guard.heads_for(STOP_M)

    assert guard.step(off(best_m, back_room_m=room_m), standing=True).permitted is permitted


def test_a_jog_forward_never_needs_room_behind() -> None:
    guard = JogGuard()
    guard.heads_for(STOP_M)
    wide = off(0.125, half_m=0.5, back_room_m=-math.inf, tag_m=0.0)

    at_rest = guard.step(wide, standing=True)
    assert (at_rest.permitted, at_rest.back_m) == (True, 0.0)
    under_way = replace(wide, standstill=False, best_m=0.25, moved_m=0.25)
    assert guard.step(under_way, standing=False).permitted
    stands = off(0.5, back_room_m=-math.inf, attempts=1)
    assert not guard.step(stands, standing=True).permitted


def test_a_jog_goes_to_a_tag_only_from_rest_and_only_if_one_is_ahead() -> None:
    guard = JogGuard()
    guard.heads_for(STOP_M)
    wide = off(0.5, half_m=0.6, back_room_m=-math.inf)
    passing = replace(wide, standstill=False, tag_m=0.0)

    assert not guard.step(passing, standing=False).to_tag
    verdict = guard.step(wide, standing=True)
    assert guard.state is READY
    assert (verdict.permitted, verdict.to_tag) == (False, False)


@pytest.mark.parametrize(("best_m", "permitted"), [(0.05, True), (0.051, False)])
def test_up_to_5_cm_past_the_stop_a_jog_forward_needs_no_room_behind(
    best_m: float, permitted: bool
) -> None:
    """The train rolls back by less than a movement before its jog begins."""
    guard = JogGuard()
    guard.heads_for(STOP_M)
    guard.step(off(0.14, half_m=0.15), standing=True)
    rolls = off(best_m, half_m=0.15, back_room_m=-math.inf, standstill=False, moved_m=best_m - 0.14)

    assert guard.step(rolls, standing=False).permitted is permitted


def test_a_jog_ends_without_a_target_stop_and_keeps_its_attempt_count() -> None:
    guard = ready()
    guard.step(UNDER_WAY, standing=False)

    assert guard.heads_for(None) is False
    assert (guard.state, guard.attempts) == (NONE, 1)
    assert guard.heads_for(STOP_M) is True
    assert guard.attempts == 1


def test_another_stop_ends_a_jog_and_clears_its_attempt_count() -> None:
    guard = ready()
    guard.step(UNDER_WAY, standing=False)

    assert guard.heads_for(STOP_M) is True
    assert (guard.state, guard.attempts) == (RUNS, 1)
    assert guard.heads_for(3000.0) is True
    assert (guard.state, guard.attempts) == (NONE, 0)


def test_without_any_attempt_a_train_that_moves_off_its_stop_is_stopped() -> None:
    """No attempt has begun because jogs are disabled. Past the limit the movement is an
    overshoot."""
    none = replace(LIMITS, jog_attempts=0, overshoot_m=0.75)
    guard = JogGuard()
    guard.heads_for(STOP_M)

    assert guard.step(replace(OFF, limits=none), standing=True).used_up
    moved = replace(UNDER_WAY, limits=none)
    assert guard.step(moved, standing=False).emergency is Cause.JOG_EXCEEDED
    gone = off(0.875, limits=none, standstill=False, moved_m=0.375)
    assert guard.step(gone, standing=False).emergency is Cause.OVERSHOT


def test_a_jog_begins_where_the_train_last_was_without_one() -> None:
    """The train stood after its last attempt, was moved on by 2 m, and goes back: this is no
    overshoot."""
    guard = ready()
    guard.step(UNDER_WAY, standing=False)
    guard.step(replace(ALIGNED, attempts=2), standing=True)
    guard.step(off(1.5, standstill=False, moved_m=1.5, attempts=2), standing=False)
    assert guard.step(off(2.0, attempts=2), standing=True).used_up

    moved = off(1.5, standstill=False, moved_m=-0.5, attempts=2)
    assert guard.step(moved, standing=False).emergency is Cause.JOG_EXCEEDED


@pytest.mark.parametrize(
    ("seen", "called"),
    [
        (off(4.0), False),
        (off(4.25), True),
        (off(-4.25), False),
        (off(4.25, standstill=False, moved_m=4.25), False),
    ],
)
def test_a_train_too_far_past_its_stop_calls_for_a_person(seen: JogFacts, called: bool) -> None:
    guard = JogGuard()
    guard.heads_for(STOP_M)

    assert guard.step(seen, standing=seen.standstill).out_of_reach is called
