"""Lower bound for a receding end of authority, behind departing trains and in other cases."""

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
"""Cycles between two authorities."""
SHAPE = AuthorityStop()
STEPS_M = 0.05
"""Tolerance for the step error of `rest_m` and for rounding, m."""
FAST_MPS = 40.0
"""Own speed that is high enough not to bound the result."""


def rest_m(speed_mps: float, accel_mps2: float = 0.0) -> float:
    """Stopping distance of a train that goes over to braking at its jerk limit, in small steps."""
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
        """Where the rear comes to rest if the train begins to brake now."""
        return self.rear_m + rest_m(self.speed_mps, self.accel_mps2)


def follow(
    leader: Leader, accels_mps2: list[float], *, speed_mps: float = FAST_MPS
) -> Iterator[tuple[float, float, float]]:
    """Yield in every cycle: the received end, its lower bound, and the leader's true stopping
    place."""
    end = RecedingEnd(SHAPE)
    told_m = leader.rear_m
    for cycle, accel_mps2 in enumerate(accels_mps2):
        leader.move(accel_mps2)
        if cycle % EVERY == 0:
            told_m = leader.rear_m
        end.step(told_m, speed_mps=speed_mps, dt_s=CYCLE_S)
        yield told_m, end.at_least_m, leader.rest_m()


def test_nothing_is_added_to_a_constant_end() -> None:
    for told_m, at_least_m, _ in follow(Leader(), [0.0] * 100):
        assert at_least_m == told_m


def test_behind_a_departing_train_the_bound_is_close_to_its_stopping_place() -> None:
    *_, (told_m, at_least_m, stops_m) = follow(Leader(), [0.8] * 280)

    # The speed lags by one authority and by half of the window over which it is measured.
    assert stops_m - 25.0 <= at_least_m <= stops_m
    assert at_least_m - told_m > 50.0


@settings(max_examples=200)
@given(speed_mps=st.floats(0.0, 20.0), accel_mps2=st.floats(0.0, 0.8))
def test_behind_a_train_that_does_not_brake_the_bound_is_never_too_far(
    speed_mps: float, accel_mps2: float
) -> None:
    for told_m, at_least_m, stops_m in follow(Leader(speed_mps), [accel_mps2] * 160):
        assert told_m <= at_least_m <= stops_m + STEPS_M


def test_the_acceleration_of_the_leader_shows_in_the_bound() -> None:
    """The bound behind an accelerating leader exceeds the one for the leader's delayed speed."""
    *_, (told_m, at_least_m, _) = follow(Leader(), [0.8] * 180)

    assert at_least_m - told_m > rest_m(0.8 * 9.0) + 5.0


def test_a_position_jump_at_a_tag_is_not_taken_for_speed() -> None:
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
def test_a_braking_leader_is_overestimated_only_for_a_moment(speed_mps: float, ran: int) -> None:
    """The mean speed over the last 1.6 s is 0.8 s old, so it is too high by at most 0.64 m/s."""
    leader = Leader(speed_mps)
    for cycle, (_, at_least_m, stops_m) in enumerate(follow(leader, [0.0] * ran + [-0.8] * 600)):
        over_m = at_least_m - stops_m
        assert over_m <= 0.8 * (leader.speed_mps + 1.0) + 1.5, cycle


def test_the_added_distance_is_bounded_by_the_own_speed() -> None:
    for told_m, at_least_m, _ in follow(Leader(15.0), [0.0] * 100, speed_mps=5.0):
        assert at_least_m - told_m <= 5.0 * SHAPE.closer_s + 1e-9


@pytest.mark.parametrize("speed_mps", [-0.3, 0.0])
def test_a_train_that_stands_or_rolls_back_adds_nothing(speed_mps: float) -> None:
    for told_m, at_least_m, _ in follow(Leader(15.0), [0.0] * 100, speed_mps=speed_mps):
        assert at_least_m == told_m


def added_m(ends_m: list[float], cycles: int = EVERY) -> float:
    """Distance added to the last of these ends, each received for `cycles` cycles."""
    end = RecedingEnd(SHAPE)
    for end_m in ends_m:
        for _ in range(cycles):
            end.step(end_m, speed_mps=FAST_MPS, dt_s=CYCLE_S)
    return end.at_least_m - ends_m[-1]


def leaving(count: int, by_m: float = 2.0) -> list[float]:
    return [500.0 + by_m * n for n in range(count)]


def test_nothing_is_added_before_the_end_has_moved_for_a_while() -> None:
    told = int(LEAST_SPAN_S / (EVERY * CYCLE_S)) + 1

    assert added_m(leaving(told)) == 0.0
    assert added_m(leaving(told + 1)) == pytest.approx(rest_m(10.0), abs=STEPS_M)


def test_an_end_that_stops_moving_counts_as_constant() -> None:
    cycles = round(STILL_S / CYCLE_S)
    moved = leaving(10)

    assert added_m(moved) > 0.0
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
def test_a_new_route_or_a_withdrawn_end_is_no_departing_train(by_m: float) -> None:
    moved = leaving(10)

    assert added_m(moved) > 0.0
    assert added_m([*moved, moved[-1] + by_m]) == 0.0
    assert added_m([*moved, moved[-1] + by_m, moved[-1] + by_m + 2.0]) == 0.0
