"""How far the end of authority comes at least, behind trains that draw away, and others."""

from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.ato.model.receding_authority import (
    FASTEST_MPS,
    JUMP_M,
    LEAST_SPAN_S,
    STILL_S,
    RecedingEnd,
)
from vobc.ato.settings.ato import AuthorityStop

CYCLE_S = 0.05
EVERY = 4
"""Cycles from one authority to the next."""
SHAPE = AuthorityStop()
STEPS_M = 0.05
"""What the steps of `rest_m` are off by, and rounding."""
FAST_MPS = 40.0
"""Fast enough that its own way bounds nothing."""


def rest_m(speed_mps: float, accel_mps2: float = 0.0) -> float:
    """What a train still makes that goes over to the brake at its jerk, step by step."""
    way_m, dt_s, brakes_mps2 = 0.0, 0.01, -SHAPE.leader_decel_mps2
    while speed_mps > 0.0 and accel_mps2 > brakes_mps2:
        next_mps2 = max(brakes_mps2, accel_mps2 - SHAPE.leader_jerk_mps3 * dt_s)
        after_mps = speed_mps + (accel_mps2 + next_mps2) / 2.0 * dt_s
        way_m += (speed_mps + after_mps) / 2.0 * dt_s
        speed_mps, accel_mps2 = after_mps, next_mps2
    return way_m + max(0.0, speed_mps) ** 2 / (2.0 * SHAPE.leader_decel_mps2)


class Leader:
    """The train ahead; its rear is the end of authority."""

    def __init__(self, speed_mps: float = 0.0, rear_m: float = 500.0) -> None:
        self.speed_mps, self.rear_m, self.accel_mps2 = speed_mps, rear_m, 0.0

    def move(self, accel_mps2: float) -> None:
        self.accel_mps2 = accel_mps2
        after_mps = max(0.0, self.speed_mps + accel_mps2 * CYCLE_S)
        self.rear_m += (self.speed_mps + after_mps) / 2.0 * CYCLE_S
        self.speed_mps = after_mps

    def rest_m(self) -> float:
        """Where its rear comes to rest if it begins to brake now."""
        return self.rear_m + rest_m(self.speed_mps, self.accel_mps2)


def follow(
    leader: Leader, accels_mps2: list[float], *, speed_mps: float = FAST_MPS
) -> Iterator[tuple[float, float, float]]:
    """Every cycle: the end that was told, where it will be at least, where it truly will."""
    end = RecedingEnd(SHAPE)
    told_m = leader.rear_m
    for cycle, accel_mps2 in enumerate(accels_mps2):
        leader.move(accel_mps2)
        if cycle % EVERY == 0:
            told_m = leader.rear_m
        end.step(told_m, speed_mps=speed_mps, dt_s=CYCLE_S)
        yield told_m, end.at_least_m, leader.rest_m()


def test_an_end_that_stands_is_where_it_is() -> None:
    for told_m, at_least_m, _ in follow(Leader(), [0.0] * 100):
        assert at_least_m == told_m


def test_behind_a_train_that_sets_off_it_is_nearly_where_that_train_would_stop() -> None:
    *_, (told_m, at_least_m, stops_m) = follow(Leader(), [0.8] * 280)

    # Known late by an authority and by half the window over which its speed is taken.
    assert stops_m - 25.0 <= at_least_m <= stops_m
    assert at_least_m - told_m > 50.0


@settings(max_examples=200)
@given(speed_mps=st.floats(0.0, 20.0), accel_mps2=st.floats(0.0, 0.8))
def test_a_train_that_does_not_brake_stops_no_sooner(speed_mps: float, accel_mps2: float) -> None:
    for told_m, at_least_m, stops_m in follow(Leader(speed_mps), [accel_mps2] * 160):
        assert told_m <= at_least_m <= stops_m + STEPS_M


def test_how_much_faster_it_gets_is_known_before_long() -> None:
    """Of a train that draws away it is so much way more that the next one need not brake for it."""
    *_, (told_m, at_least_m, _) = follow(Leader(), [0.8] * 180)

    assert at_least_m - told_m > rest_m(0.8 * 9.0) + 5.0


def test_a_place_found_at_a_tag_is_no_speed() -> None:
    end = RecedingEnd(SHAPE)
    reckoned_m = []
    for n in range(20):
        jolt_m = 1.5 if n >= 12 else 0.0
        for _ in range(EVERY):
            end.step(500.0 + 2.0 * n + jolt_m, speed_mps=FAST_MPS, dt_s=CYCLE_S)
        reckoned_m.append(end.at_least_m - 500.0 - 2.0 * n - jolt_m)

    assert reckoned_m[8:] == pytest.approx([rest_m(10.0)] * 12, abs=STEPS_M)


@settings(max_examples=200)
@given(speed_mps=st.floats(2.0, 20.0), ran=st.integers(20, 200))
def test_a_train_that_brakes_in_service_is_believed_too_fast_for_a_moment_only(
    speed_mps: float, ran: int
) -> None:
    """The mean speed of the last 1.6 s is 0.8 s old, so by up to 0.64 m/s too high."""
    leader = Leader(speed_mps)
    for cycle, (_, at_least_m, stops_m) in enumerate(follow(leader, [0.0] * ran + [-0.8] * 600)):
        over_m = at_least_m - stops_m
        assert over_m <= 0.8 * (leader.speed_mps + 1.0) + 1.5, cycle


def test_no_more_is_reckoned_with_than_the_train_makes_itself_in_a_moment() -> None:
    for told_m, at_least_m, _ in follow(Leader(15.0), [0.0] * 100, speed_mps=5.0):
        assert at_least_m - told_m <= 5.0 * SHAPE.closer_s + 1e-9


@pytest.mark.parametrize("speed_mps", [-0.3, 0.0])
def test_a_train_that_stands_or_rolls_back_reckons_with_nothing(speed_mps: float) -> None:
    for told_m, at_least_m, _ in follow(Leader(15.0), [0.0] * 100, speed_mps=speed_mps):
        assert at_least_m == told_m


def reckons_after(ends_m: list[float], cycles: int = EVERY) -> float:
    """What is added to the last of these ends, each told for so many cycles."""
    end = RecedingEnd(SHAPE)
    for end_m in ends_m:
        for _ in range(cycles):
            end.step(end_m, speed_mps=FAST_MPS, dt_s=CYCLE_S)
    return end.at_least_m - ends_m[-1]


def leaving(count: int, by_m: float = 2.0) -> list[float]:
    return [500.0 + by_m * n for n in range(count)]


def test_nothing_is_said_before_it_was_seen_moving_for_a_while() -> None:
    told = int(LEAST_SPAN_S / (EVERY * CYCLE_S)) + 1

    assert reckons_after(leaving(told)) == 0.0
    assert reckons_after(leaving(told + 1)) == pytest.approx(rest_m(10.0), abs=STEPS_M)


def test_an_end_that_stops_moving_stands() -> None:
    cycles = round(STILL_S / CYCLE_S)
    moved = leaving(10)

    assert reckons_after(moved) > 0.0
    end = RecedingEnd(SHAPE)
    for end_m in moved:
        for _ in range(EVERY):
            end.step(end_m, speed_mps=FAST_MPS, dt_s=CYCLE_S)
    still = []
    for _ in range(cycles + 1):
        end.step(moved[-1], speed_mps=FAST_MPS, dt_s=CYCLE_S)
        still.append(end.at_least_m > moved[-1])
    assert still[0]
    assert not still[-1]


@pytest.mark.parametrize("by_m", [FASTEST_MPS * EVERY * CYCLE_S + JUMP_M + 0.1, 400.0, -0.1, -50.0])
def test_a_route_that_is_set_or_an_end_taken_back_is_no_train_that_draws_away(by_m: float) -> None:
    moved = leaving(10)

    assert reckons_after(moved) > 0.0
    assert reckons_after([*moved, moved[-1] + by_m]) == 0.0
    assert reckons_after([*moved, moved[-1] + by_m, moved[-1] + by_m + 2.0]) == 0.0
