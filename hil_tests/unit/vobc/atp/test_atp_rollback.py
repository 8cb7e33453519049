"""Rollback: the room that is left, against a train that rolls in small steps of time."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import GradientSection, LineMap, load_line
from vobc.atp import Protection
from vobc.atp.rollback import LEAST_M, RollbackWatch
from vobc.config import load_config
from vobc.vocabulary import Interval, Motion

CONFIG = load_config("florence4").atp
CYCLE_S = 0.05
LENGTH_M = 68.59
COUNTED = 1.0 / 0.99
"""Greatest true distance of one counted metre: the tachos count up to 1 % too little."""
FRONT_M = 2000.0
STEP_S = 0.001


def climb(permille: float, limit_m: float = 2.0) -> LineMap:
    """A line with one climb from 1000 m to 3000 m."""
    sections = (GradientSection(1000.0, 3000.0, permille),)
    return replace(load_line("florence"), gradients=sections, rollback_m=limit_m)


def watch(line: LineMap) -> RollbackWatch:
    return RollbackWatch(
        CONFIG, line, train_length_m=LENGTH_M, cycle_s=CYCLE_S, true_per_counted=COUNTED
    )


def rolling(speed_mps: float, front_m: float = FRONT_M, *, localised: bool = True) -> Motion:
    return Motion(
        front_m=Interval(front_m - 1.0, front_m, front_m + 1.0),
        speed_mps=Interval(-speed_mps, -speed_mps, -speed_mps),
        accel_mps2=0.0,
        travel_m=0.0,
        standing=False,
        standstill=False,
        localised=localised,
        slip=False,
        accepted_tag_ids=(),
    )


def true_rollback_m(line: LineMap, permille: float) -> float:
    """Replay the worst train. It rolls from rest and is counted too little. As many cycles are
    missed as are tolerated, and its brake is as slow and weak as declared.
    """
    guard, climb_mps2 = watch(line), 9.81 * permille / 1000.0
    rolled_m = speed_mps = t_s = 0.0
    braked_s = math.inf
    look_s = 0.0
    while True:
        if t_s >= look_s and braked_s == math.inf:
            look_s = t_s + CYCLE_S * (1 + CONFIG.overruns_max)
            counted_m = rolled_m / COUNTED
            distance = counted_m >= CONFIG.rollback_m
            if distance or not guard.room_m(counted_m, rolling(speed_mps)) > 0.0:
                braked_s = t_s + CONFIG.sensing_s + CONFIG.traction_cut_s + CONFIG.brake_build_up_s
        brakes = t_s >= braked_s
        accel_mps2 = climb_mps2 - (CONFIG.guaranteed_decel_mps2 if brakes else 0.0)
        if brakes and speed_mps + accel_mps2 * STEP_S <= 0.0:
            return rolled_m
        rolled_m += speed_mps * STEP_S
        speed_mps += accel_mps2 * STEP_S
        t_s += STEP_S


def test_without_a_scale_protection_takes_each_counted_metre_for_a_true_one() -> None:
    line = climb(20.0)
    exact = RollbackWatch(
        CONFIG, line, train_length_m=LENGTH_M, cycle_s=CYCLE_S, true_per_counted=1.0
    )

    watched = Protection(CONFIG, line, train_length_m=LENGTH_M, cycle_s=CYCLE_S)._rollback

    assert watched.room_m(1.0, rolling(0.2)) == exact.room_m(1.0, rolling(0.2))
    assert watched.room_m(1.0, rolling(0.2)) != watch(line).room_m(1.0, rolling(0.2))


@pytest.mark.parametrize("permille", [5.0, 20.0, 30.0, 40.0, 45.0])
def test_the_worst_train_stays_within_the_limit_of_an_accepted_climb(permille: float) -> None:
    line = climb(permille)

    assert watch(line).least_m() <= line.rollback_m
    assert true_rollback_m(line, permille) <= line.rollback_m


@pytest.mark.parametrize(("permille", "limit_m"), [(60.0, 3.5), (50.0, 2.5)])
def test_a_steeper_climb_needs_a_greater_limit(permille: float, limit_m: float) -> None:
    """The wayside has to keep more track free behind each train."""
    assert not watch(climb(permille)).least_m() <= 2.0
    line = climb(permille, limit_m)

    assert watch(line).least_m() <= limit_m
    assert true_rollback_m(line, permille) <= limit_m


def test_the_distance_alone_does_not_keep_the_limit() -> None:
    """This is the mistake that the room corrects: 0.5 m on 45 ‰ becomes more than 2 m."""
    braked_m = CONFIG.rollback_m * COUNTED
    reached_m = braked_m + watch(climb(45.0)).run_m(
        math.sqrt(2.0 * 9.81 * 0.045 * braked_m), climb_mps2=9.81 * 0.045
    )

    assert reached_m > 2.0


@given(st.floats(0.0, 3.0), st.floats(0.0, 0.9))
def test_the_run_equals_a_replayed_motion(speed_mps: float, climb_mps2: float) -> None:
    guard = watch(climb(0.0))
    reaction_s = CONFIG.runaway_s(CYCLE_S) + CONFIG.brake_build_up_s

    way_m = (speed_mps + 0.5 * climb_mps2 * reaction_s) * reaction_s
    reached_mps = speed_mps + climb_mps2 * reaction_s
    braked_s = reached_mps / (CONFIG.guaranteed_decel_mps2 - climb_mps2)
    way_m += 0.5 * reached_mps * braked_s

    assert guard.run_m(speed_mps, climb_mps2=climb_mps2) == pytest.approx(way_m)


def test_no_brake_holds_a_train_on_a_climb_as_strong_as_itself() -> None:
    assert watch(climb(0.0)).run_m(0.0, climb_mps2=CONFIG.guaranteed_decel_mps2) == math.inf


def test_the_give_of_a_standing_train_is_no_rollback() -> None:
    guard = watch(climb(45.0))

    assert guard.room_m(math.nextafter(LEAST_M, 0.0), rolling(1.0)) == math.inf
    assert guard.room_m(LEAST_M, rolling(1.0)) < 0.0


def test_the_steepest_climb_under_the_train_counts_and_anywhere_without_place() -> None:
    guard = watch(climb(45.0))
    here, beyond = rolling(0.3), rolling(0.3, 4000.0)

    assert guard.room_m(0.2, beyond) > guard.room_m(0.2, here)
    assert guard.room_m(0.2, replace(beyond, localised=False)) == guard.room_m(0.2, here)
    # The rear is still on the climb.
    reaching = rolling(0.3, 3000.0 + LENGTH_M)
    assert guard.room_m(0.2, reaching) == guard.room_m(0.2, here)


def test_the_fastest_speed_back_and_the_foremost_front_count() -> None:
    """The climb begins at 1000 m."""
    guard = watch(climb(45.0))
    wide = replace(rolling(0.5), speed_mps=Interval(-0.5, 0.0, 0.5))
    level, near = rolling(0.5, 990.0), rolling(0.5, 999.5)

    assert guard.room_m(0.2, wide) == guard.room_m(0.2, rolling(0.5))
    assert guard.room_m(0.2, near) == guard.room_m(0.2, rolling(0.5)) < guard.room_m(0.2, level)


def test_a_train_that_moves_forwards_has_no_speed_back() -> None:
    guard = watch(climb(30.0))

    assert guard.room_m(0.2, rolling(-5.0)) == guard.room_m(0.2, rolling(0.0))


@pytest.mark.parametrize("counted_m", [0.2, math.nan])
@pytest.mark.parametrize("speed_mps", [0.2, math.nan])
def test_a_number_that_is_none_leaves_no_room(counted_m: float, speed_mps: float) -> None:
    room_m = watch(climb(45.0)).room_m(counted_m, rolling(speed_mps))

    if math.isnan(counted_m) or math.isnan(speed_mps):
        assert not room_m > 0.0
    else:
        assert room_m > 0.0
