"""Edges and durations that protection remembers: resets, brake unit, stop requests, clock,
distance."""

import math
from dataclasses import replace

import pytest

from can_dbc.brake import BrakeStatus
from can_dbc.cab import CabMode, Desk
from hil_tests.unit.vobc.atp.heard_rig import NO_ORDERS
from vobc.atp.emergencies import Reset
from vobc.atp.health import BrakeUnitWatch, Resets, StopWatch, clock_stepped
from vobc.atp.movement import Movement, Movements
from vobc.config import load_config
from vobc.vocabulary import Interval, Motion, Orders

CONFIG = load_config("florence4").atp
DT_S = 0.0625
"""A binary fraction of a second, so that sums of it are exact."""


def desk(*, reset: bool) -> Desk:
    return Desk(CabMode.AUTO, 0.0, True, True, False, reset, False, False)


def orders(releases: int, released_emergency: int = 1) -> Orders:
    return replace(NO_ORDERS, releases=releases, released_emergency=released_emergency)


def test_a_reset_at_the_desk_counts_once_and_when_newly_pressed() -> None:
    resets = Resets()
    presses = [True, True, False, True, True, False, False, True]

    given = [resets.step(desk(reset=pressed), None, 1) for pressed in presses]

    assert [bool(each & Reset.DESK) for each in given] == [
        False,
        False,
        False,
        True,
        False,
        False,
        False,
        True,
    ]


def test_a_reset_pressed_while_the_desk_was_silent_does_not_count() -> None:
    resets = Resets()
    resets.step(desk(reset=False), None, 1)

    assert resets.step(None, None, 1) == 0
    assert resets.step(desk(reset=True), None, 1) == 0


def test_an_increment_of_the_centres_count_is_one_reset_and_its_first_value_none() -> None:
    resets = Resets()
    counts = [7, 7, 8, 8, 10, 3, 3, 4]

    given = [resets.step(None, orders(count), 1) for count in counts]

    assert given == [0, 0, Reset.CENTRE, 0, Reset.CENTRE, 0, 0, Reset.CENTRE]


def test_a_reset_that_the_centre_gave_to_a_deaf_train_does_not_count() -> None:
    resets = Resets()
    resets.step(None, orders(1), 1)
    resets.step(None, None, 1)

    assert resets.step(None, orders(2), 1) == 0
    assert resets.step(None, orders(2), 1) == 0
    assert resets.step(None, orders(3), 1) == Reset.CENTRE


@pytest.mark.parametrize(("named", "given"), [(3, 0), (4, Reset.CENTRE), (5, 0)])
def test_a_reset_of_the_centre_counts_for_the_emergency_that_it_names(
    named: int, given: int
) -> None:
    resets = Resets()
    resets.step(None, orders(1, 3), 4)

    assert resets.step(None, orders(2, named), 4) == given
    assert resets.step(None, orders(2, 4), 4) == 0


def test_both_may_reset_in_one_cycle() -> None:
    resets = Resets()
    resets.step(desk(reset=False), orders(0), 1)

    assert resets.step(desk(reset=True), orders(1), 1) == Reset.DESK | Reset.CENTRE


APPLIED = BrakeStatus(1.2, 300.0, True, False, False, True)
RELEASED = BrakeStatus(0.0, 0.0, False, False, True, True)


def test_a_brake_unit_has_time_to_release_before_its_report_counts() -> None:
    watch = BrakeUnitWatch(CONFIG)
    cycles = round(CONFIG.brake_unit_s / DT_S)

    early = [watch.step(APPLIED, released=True, dt_s=DT_S) for _ in range(cycles)]

    assert not any(early)
    assert watch.step(APPLIED, released=True, dt_s=DT_S)


def test_a_brake_unit_that_has_released_may_not_apply_again_by_itself() -> None:
    watch = BrakeUnitWatch(CONFIG)
    watch.step(APPLIED, released=True, dt_s=DT_S)
    assert not watch.step(RELEASED, released=True, dt_s=DT_S)

    assert watch.step(APPLIED, released=True, dt_s=DT_S)


def test_a_brake_unit_that_never_reported_has_not_released() -> None:
    watch = BrakeUnitWatch(CONFIG)
    assert not watch.step(None, released=True, dt_s=DT_S)

    assert not watch.step(APPLIED, released=True, dt_s=DT_S)


def test_a_requested_brake_is_no_fault_and_restarts_the_release_time() -> None:
    watch = BrakeUnitWatch(CONFIG)
    for _ in range(100):
        watch.step(RELEASED, released=True, dt_s=DT_S)

    assert not watch.step(APPLIED, released=False, dt_s=DT_S)
    assert not watch.step(APPLIED, released=True, dt_s=DT_S)


def test_after_a_requested_brake_the_unit_has_its_whole_release_time_again() -> None:
    watch = BrakeUnitWatch(CONFIG)
    cycles = round(CONFIG.brake_unit_s / DT_S)
    for _ in range(cycles):
        watch.step(APPLIED, released=True, dt_s=DT_S)
    assert watch.step(APPLIED, released=False, dt_s=DT_S) is False

    again = [watch.step(APPLIED, released=True, dt_s=DT_S) for _ in range(cycles + 1)]

    assert again == [False] * cycles + [True]


def test_protection_remembers_a_release_across_a_silence_of_the_unit() -> None:
    watch = BrakeUnitWatch(CONFIG)
    assert watch.step(RELEASED, released=True, dt_s=DT_S) is False
    assert watch.step(None, released=True, dt_s=DT_S) is False

    assert watch.step(APPLIED, released=True, dt_s=DT_S)


def test_a_stop_request_allows_time_to_begin_and_then_a_falling_speed() -> None:
    watch = StopWatch(CONFIG)
    patient = round(CONFIG.stop_patience_s / DT_S)

    limits = [
        watch.stop_by_mps(True, speed_mps=9.0 if cycle else 10.0, dt_s=DT_S)
        for cycle in range(patient + 32)
    ]

    assert limits[: patient - 1] == [math.inf] * (patient - 1)
    assert limits[patient - 1] == 10.0
    assert limits[-1] == pytest.approx(10.0 - CONFIG.stop_decel_mps2 * 32 * DT_S)


def test_a_stop_request_never_goes_below_zero_and_ends_with_its_cause() -> None:
    watch = StopWatch(CONFIG)
    for _ in range(1000):
        last_mps = watch.stop_by_mps(True, speed_mps=1.0, dt_s=DT_S)

    assert last_mps == 0.0
    assert watch.stop_by_mps(False, speed_mps=1.0, dt_s=DT_S) == math.inf
    patient = round(CONFIG.stop_patience_s / DT_S)
    again = [watch.stop_by_mps(True, speed_mps=7.0, dt_s=DT_S) for _ in range(patient)]
    assert again == [math.inf] * (patient - 1) + [7.0]


@pytest.mark.parametrize(
    ("dt_s", "overruns", "stepped"),
    [
        (0.05, 0, False),
        (0.15, 2, False),
        (0.299, 0, False),
        (0.301, 0, True),
        (0.401, 2, True),
        (0.399, 2, False),
        (5.05, 100, False),
        (0.001, 0, False),
        (0.0, 0, True),
        (-0.05, 0, True),
        (0.05, 6, True),
        (math.nan, 0, True),
        (math.inf, 0, True),
    ],
)
def test_time_has_to_pass_as_cycles_and_missed_cycles_explain(
    dt_s: float, overruns: int, stepped: bool
) -> None:
    assert clock_stepped(dt_s, overruns, cycle_s=0.05, tolerance_s=0.25) is stepped


def test_a_cycle_may_be_late_by_just_the_tolerance() -> None:
    """The test uses binary fractions, so that it meets the edge exactly."""
    edge_s = 0.0625 * 3 + 0.25

    assert clock_stepped(edge_s, 2, cycle_s=0.0625, tolerance_s=0.25) is False
    assert clock_stepped(edge_s + 2.0**-30, 2, cycle_s=0.0625, tolerance_s=0.25) is True


def motion(travel_m: float, *, standing: bool = False) -> Motion:
    at = Interval(0.0, 0.0, 0.0)
    return Motion(at, at, 0.0, travel_m, standing, standing, True, False, ())


def test_rollback_counts_from_the_foremost_position() -> None:
    movement = Movement()

    rolled = []
    for travel_m in (1.0, 3.0, 2.75, 2.5, 4.0, 3.5):
        movement.look(travel_m)
        rolled.append(movement.rollback_m)

    assert rolled == [0.0, 0.0, 0.25, 0.5, 0.0, 0.5]


def test_a_held_train_is_measured_in_both_directions_from_where_it_was_held() -> None:
    movement = Movement()
    movement.look(10.0)
    movement.restart(10.0)

    movement.look(10.5)
    ahead_m = movement.held_m
    movement.look(9.5)

    assert (ahead_m, movement.held_m, movement.rollback_m) == (0.5, 0.5, 1.0)
    movement.held_here(9.5)
    movement.look(9.5)
    assert movement.held_m == 0.0
    movement.restart(9.5)
    movement.look(9.5)
    assert movement.rollback_m == 0.0


def test_a_jog_is_measured_in_both_directions_and_may_go_back_as_far_as_granted() -> None:
    movement = Movement()
    movement.look(100.0)
    movement.jogs(motion(100.0, standing=True), 2.0)

    found = []
    for travel_m in (100.0, 99.0, 98.0, 97.5, 101.0):
        movement.look(travel_m)
        movement.jogs(motion(travel_m), 0.0)
        found.append((movement.jog_m, movement.behind_jog_m, movement.rollback_m))

    assert found == [
        (0.0, -2.0, 0.0),
        (1.0, -1.0, 0.0),
        (2.0, 0.0, 0.0),
        (2.5, 0.5, 0.0),
        (1.0, -3.0, 0.0),
    ]


def test_the_backward_distance_is_set_again_whenever_the_jogging_train_stands() -> None:
    movement = Movement()
    movement.jogs(motion(100.0, standing=True), 2.0)
    movement.jogs(motion(99.0, standing=True), 0.0)

    movement.look(98.5)

    assert movement.behind_jog_m == 0.5
    assert movement.jog_m == 1.5


def test_rolling_back_in_small_steps_gains_a_jogging_train_nothing() -> None:
    movement = Movement()
    movement.jogs(motion(100.0, standing=True), 0.0)

    behind = []
    for travel_m in (99.75, 99.5, 99.25):
        movement.look(travel_m)
        movement.jogs(motion(travel_m, standing=True), 0.0)
        behind.append(movement.behind_jog_m)

    assert behind == [0.25, 0.5, 0.75]


def test_a_moving_jogging_train_does_not_set_the_distance_again() -> None:
    movement = Movement()
    movement.jogs(motion(100.0, standing=True), 0.0)
    movement.jogs(motion(101.0), 0.0)

    movement.look(100.5)

    assert movement.behind_jog_m == -0.5


def test_rollback_before_a_jog_does_not_count_in_it() -> None:
    movement = Movement()
    movement.look(100.0)
    movement.look(99.75)
    movement.jogs(motion(99.75, standing=True), 1.0)

    movement.look(99.75)

    assert movement.rollback_m == 0.0


def distances_m(movement: Movement) -> tuple[float, ...]:
    return (movement.rollback_m, movement.held_m, movement.jog_m, movement.behind_jog_m)


def test_a_train_that_never_moved_has_zero_distances() -> None:
    movement = Movement()
    assert distances_m(movement) == (0.0, 0.0, 0.0, 0.0)

    movement.look(-0.25)

    assert distances_m(movement) == (0.25, 0.25, 0.0, 0.0)


def test_after_a_jog_rollback_counts_from_where_the_jog_ended() -> None:
    movement = Movement()
    movement.look(100.0)
    movement.jogs(motion(100.0, standing=True), 3.0)
    movement.look(98.0)
    movement.jogs_no_more(98.0)
    movement.jogs_no_more(97.9)

    movement.look(97.75)

    assert (movement.rollback_m, movement.jog_m, movement.behind_jog_m) == (0.25, 0.0, 0.0)


def test_a_nan_travel_makes_every_distance_nan() -> None:
    movement = Movement()
    movement.look(5.0)

    movement.look(math.nan)

    assert math.isnan(movement.rollback_m)
    assert math.isnan(movement.held_m)
    movement.look(5.0)
    assert movement.rollback_m == 0.0


def two_ways(counted_m: float, believed_m: float, *, standing: bool = False) -> Motion:
    return replace(motion(believed_m, standing=standing), pulses_m=counted_m)


WAYS = pytest.mark.parametrize("counts", [True, False], ids=["pulses", "belief"])


def on_way(counts: bool, at_m: float, other_m: float = 0.0, *, standing: bool = False) -> Motion:
    """One of the two measurements gives `at_m`, the other gives `other_m`."""
    ends_m = (at_m, other_m) if counts else (other_m, at_m)
    return two_ways(*ends_m, standing=standing)


@WAYS
def test_of_two_measurements_the_greater_rollback_counts(counts: bool) -> None:
    movements = Movements()
    movements.look(on_way(counts, 3.0, 5.0))
    movements.look(on_way(counts, 2.0, 4.75))

    assert movements.rollback_m == 1.0


@WAYS
def test_of_two_measurements_the_greater_movement_counts(counts: bool) -> None:
    movements = Movements()
    movements.look(on_way(counts, 10.0, 20.0))
    movements.restart(on_way(counts, 10.0, 20.0))
    movements.look(on_way(counts, 10.5, 20.25))
    ahead_m = movements.held_m
    movements.held_here(on_way(counts, 10.5, 20.25))
    movements.look(on_way(counts, 10.5, 20.25))

    assert (ahead_m, movements.held_m, movements.rollback_m) == (0.5, 0.0, 0.0)
    movements.look(on_way(counts, 9.75, 20.25))
    assert movements.rollback_m == 0.75
    movements.restart(on_way(counts, 9.75, 20.25))
    movements.look(on_way(counts, 9.75, 20.25))
    assert (movements.held_m, movements.rollback_m) == (0.0, 0.0)


@WAYS
def test_of_two_measurements_the_longer_jog_counts(counts: bool) -> None:
    movements = Movements()
    movements.look(on_way(counts, 100.0, 50.0))
    movements.jogs(on_way(counts, 100.0, 50.0, standing=True), 2.0)
    movements.look(on_way(counts, 97.5, 49.5))

    assert (movements.jog_m, movements.behind_jog_m, movements.rollback_m) == (2.5, 0.5, 0.0)
    movements.jogs(on_way(counts, 97.5, 49.5, standing=True), 1.0)
    movements.look(on_way(counts, 97.0, 49.5))
    assert (movements.jog_m, movements.behind_jog_m) == (3.0, 1.0)
    movements.jogs_no_more(on_way(counts, 97.0, 49.5))
    movements.look(on_way(counts, 96.5, 49.25))
    assert (movements.jog_m, movements.behind_jog_m, movements.rollback_m) == (0.0, 0.0, 0.5)


def test_before_the_first_step_no_distance_is_measured() -> None:
    movements = Movements()

    moved = (movements.rollback_m, movements.held_m, movements.jog_m, movements.behind_jog_m)
    assert moved == (0.0, 0.0, 0.0, 0.0)
