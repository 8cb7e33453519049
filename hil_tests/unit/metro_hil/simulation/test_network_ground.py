"""True motion obeys the equations of motion, readings contain the truth, and the judge detects
violations."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from metro_hil.simulation.checker import Checker, Rules, ViolationError
from metro_hil.simulation.driving import braking_curve_mps, must_trip
from metro_hil.simulation.motion import BUILD_UP_NS, SimulatedMotion
from metro_hil.simulation.true_train import BrakeLoopGrant, TrueTrain

S = 1_000_000_000
RULES = Rules(age_max_ns=1 * S)


def train(address: int, front_m: float, speed_mps: float = 0.0) -> TrueTrain:
    motion = SimulatedMotion(0, front_m, emergency_mps2=1.0)
    motion.speed_mps = speed_mps
    return TrueTrain(address, motion, length_m=80.0, half_width_m=3.0)


def grant(
    end_m: float, *, term: int = 1, sequence: int = 1, issuer: int = 9, area: int = 1
) -> BrakeLoopGrant:
    return BrakeLoopGrant(end_m, term, sequence, issuer, area, 0)


def test_a_train_that_accelerates_covers_half_a_t_squared() -> None:
    motion = SimulatedMotion(0, 100.0, emergency_mps2=1.0)
    motion.demand(0, 0.8)
    for tick in range(1, 101):
        motion.advance(tick * S // 10)

    assert motion.speed_mps == pytest.approx(8.0)
    assert motion.front_m == pytest.approx(140.0)


@given(speed_mps=st.floats(0.5, 25.0), steps=st.integers(1, 500))
def test_an_emergency_stop_ends_at_the_predicted_place_for_any_step(
    speed_mps: float, steps: int
) -> None:
    motion = train(1, 0.0, speed_mps).motion
    foreseen_m = motion.farthest_m
    motion.apply_emergency(0)
    for step in range(1, steps + 1):
        motion.advance(60 * S * step // steps)

    by_hand_m = speed_mps * BUILD_UP_NS / S + speed_mps**2 / 2.0
    assert motion.speed_mps == 0.0
    assert motion.front_m == pytest.approx(by_hand_m)
    assert foreseen_m == pytest.approx(by_hand_m)


def test_forward_motion_reduces_the_distance_set_back() -> None:
    motion = SimulatedMotion(0, 100.0, emergency_mps2=1.0)
    motion.back_m = motion.jogged_m = 3.0
    motion.advance(10 * S)
    assert (motion.front_m, motion.jogged_m) == (97.0, 3.0)

    motion.demand(10 * S, 1.0)
    motion.advance(12 * S)
    assert (motion.front_m, motion.jogged_m) == (99.0, 1.0)
    motion.advance(13 * S)
    assert (motion.front_m, motion.jogged_m) == (101.5, 0.0)


def test_a_departing_train_does_not_set_back_any_further() -> None:
    motion = SimulatedMotion(0, 100.0, emergency_mps2=1.0)
    motion.back_m = motion.jogged_m = 4.0
    motion.advance(5 * S)
    motion.demand(5 * S, 1.0)
    motion.advance(6 * S)

    assert motion.jogged_m == pytest.approx(1.5)
    assert motion.rolled_m == pytest.approx(1.5)


def test_a_train_rolls_back_only_while_it_stands_and_counts_it() -> None:
    motion = SimulatedMotion(0, 100.0, emergency_mps2=1.0)
    motion.back_m = 1.5
    motion.advance(2 * S)
    assert motion.front_m == pytest.approx(99.2)
    motion.advance(20 * S)
    assert motion.front_m == pytest.approx(98.5)
    assert motion.rolled_m == pytest.approx(1.5)
    motion.demand(20 * S, 0.5)
    motion.advance(21 * S)
    assert motion.rolled_m == pytest.approx(1.25)
    motion.advance(23 * S)
    assert motion.rolled_m == 0.0


@given(front_m=st.floats(0.0, 20_000.0), on_m=st.floats(0.0, 500.0), address=st.integers(1, 50))
def test_readings_contain_the_truth_and_do_not_go_back(
    front_m: float, on_m: float, address: int
) -> None:
    one, two = train(address, front_m), train(address, front_m + on_m)

    for each in (one, two):
        reading = each.reading()
        assert reading.front_min_m <= each.front_m <= reading.front_max_m
        assert reading.rear_min_m <= each.rear_m
    assert two.reading().rear_min_m >= one.reading().rear_min_m - 1e-9


@given(speed_mps=st.floats(0.1, 25.0), end_m=st.floats(1.0, 600.0))
def test_a_train_supervised_every_cycle_stops_before_its_end(
    speed_mps: float, end_m: float
) -> None:
    """The train has any speed that supervision permits, and full traction until supervision
    trips."""
    if must_trip(0.0, speed_mps, end_m, accel_mps2=0.9):
        return
    motion = train(1, 0.0, speed_mps).motion
    motion.demand(0, 0.9)
    for tick in range(1, 2000):
        motion.advance(tick * S // 5)
        if must_trip(motion.front_m, motion.speed_mps, end_m, accel_mps2=motion.accel_mps2):
            motion.apply_emergency(tick * S // 5)
        if motion.emergency and motion.speed_mps == 0.0:
            break

    assert motion.speed_mps == 0.0
    assert motion.front_m <= end_m


def test_the_braking_curve_is_the_inverse_of_the_stopping_distance() -> None:
    for speed_mps in (1.0, 7.5, 20.0):
        way_m = speed_mps * 1.5 + speed_mps**2 / (2.0 * 0.9)
        assert braking_curve_mps(way_m, decel_mps2=0.9, reaction_s=1.5) == pytest.approx(speed_mps)


def checker(*trains: TrueTrain) -> Checker:
    return Checker(trains, RULES)


def broken(judge: Checker, address: int, new: BrakeLoopGrant, now_ns: int = 0) -> str:
    with pytest.raises(ViolationError) as error:
        judge.accepted(address, new, now_ns)
    return error.value.invariant


def test_authority_into_the_train_ahead_is_seen() -> None:
    judge = checker(train(1, 500.0), train(2, 900.0))

    judge.accepted(1, grant(800.0), 0)
    assert broken(judge, 1, grant(820.5, sequence=2)) == "21"


def test_authority_that_leaves_no_room_to_roll_back_is_seen() -> None:
    ahead = train(2, 900.0)
    judge = checker(train(1, 500.0), ahead)
    rear_m = ahead.rear_m

    judge.accepted(1, grant(rear_m - 2.0), 0)
    assert broken(judge, 1, grant(rear_m - 1.5, sequence=2)) == "22"


def test_a_leader_that_uses_its_rollback_room_breaks_no_rule() -> None:
    ahead = train(2, 900.0)
    judge = checker(train(1, 500.0), ahead)
    judge.accepted(1, grant(ahead.rear_m - 2.1), 0)

    ahead.motion.back_m = 2.0
    for tick in range(1, 60):
        ahead.motion.advance(tick * S // 10)
        judge.moved(ahead)

    assert ahead.motion.rolled_m == pytest.approx(2.0)


def test_a_second_issuer_in_a_term_is_seen_and_one_in_another_area_is_none() -> None:
    judge = checker(train(1, 500.0), train(2, 900.0))

    judge.accepted(2, grant(1000.0, issuer=9), 0)
    judge.accepted(2, grant(1100.0, issuer=8, area=2), 0)
    assert broken(judge, 1, grant(600.0, issuer=8)) == "19"


def test_a_term_that_falls_is_seen_across_a_restart() -> None:
    judge = checker(train(1, 500.0))
    judge.accepted(1, grant(600.0, term=5), 0)
    judge.gave_up(1)

    assert broken(judge, 1, grant(600.0, term=4, sequence=9)) == "20"


def test_an_authority_older_than_the_held_one_is_detected() -> None:
    judge = checker(train(1, 500.0))
    judge.accepted(1, grant(600.0, sequence=7), 0)

    assert broken(judge, 1, grant(650.0, sequence=6)) == "29"


def test_an_old_authority_is_detected() -> None:
    assert broken(checker(train(1, 500.0)), 1, grant(600.0), 1 * S + 1) == "24"


def test_a_train_that_brakes_without_authority_keeps_its_stopping_distance() -> None:
    """For a silent, dead or mute train the stopping distance is its reservation."""
    runaway = train(1, 500.0, speed_mps=20.0)
    judge = checker(runaway, train(2, 785.0))
    runaway.motion.apply_emergency(0)

    with pytest.raises(ViolationError, match="21"):
        judge.moved(runaway)


def test_a_train_beyond_its_authority_is_detected() -> None:
    runner = train(1, 500.0)
    judge = checker(runner)
    judge.accepted(1, grant(510.0), 0)
    runner.motion.speed_mps = 20.0
    runner.motion.advance(1 * S)

    with pytest.raises(ViolationError, match="24"):
        judge.moved(runner)


def test_a_train_with_a_shortened_authority_keeps_its_stopping_distance() -> None:
    runner = train(1, 500.0, speed_mps=20.0)
    judge = checker(runner)
    judge.accepted(1, grant(510.0), 0)
    runner.motion.apply_emergency(0)
    for tick in range(1, 300):
        runner.motion.advance(tick * S // 10)
        judge.moved(runner)

    assert runner.front_m > 700.0


def test_unjudged_authorities_are_still_counted() -> None:
    judge = Checker([train(1, 500.0)], Rules(age_max_ns=S, unjudged=frozenset({"20", "29"})))
    judge.accepted(1, grant(600.0, term=5), 0)
    judge.accepted(1, grant(600.0, term=4, sequence=6), 0)

    assert judge.looked["20 broken"] == 1
