"""Detection of slip and slide, its duration, and which measurements count meanwhile."""

import math
from typing import Any

import pytest

from can_dbc.nodes import Direction
from hil_tests.unit.vobc.odometry.odometry_desk import Desk, near
from vobc.odometry.localisation import Localisation
from vobc.odometry.tracking import SpeedTrack


def going(step: int = 8, cycles: int = 60, **changes: Any) -> Any:
    """An odometer at 4 m/s, with 8 pulses in each 20 ms, seen by the radar."""
    made = Desk(**changes)
    made.cycles(cycles, step, step, radar_mps=step * 0.5)
    return made


def drifting() -> Any:
    """An odometer whose wheels slowly departed from the speed over ground: they slip without a
    jump."""
    made = going()
    for step in (8, 9, 9, 9, 9, 10, 10, 10, 10, 11, 11, 11):
        told = made.cycle(step, step, radar_mps=4.0)
    assert told.slip
    return made


def spinning(**changes: Any) -> Any:
    """An odometer whose wheels jumped from 4 m/s to 8 m/s."""
    made = going(**changes)
    made.cycles(4, 16, 16, radar_mps=4.0)
    return made


def both_ends(interval: Any) -> tuple[float, float]:
    return interval.low, interval.high


# What a slip is.


def test_wheels_that_leave_the_ground_slowly_slip_but_may_still_be_right() -> None:
    made = drifting()
    told = made.cycle(11, 11, radar_mps=4.0)
    low, _, high = made.wheels()

    assert told.slip
    assert low > made.ground.high_mps
    assert both_ends(told.speed_mps) == near(made.ground.low_mps, high)
    assert told.speed_mps.best == pytest.approx(made.ground.best_mps)


def test_wheels_that_jump_off_the_ground_speed_no_longer_count() -> None:
    made = spinning()
    told = made.cycle(16, 16, radar_mps=4.0)

    assert told.slip
    assert both_ends(told.speed_mps) == near(3.9, 4.1)
    assert told.speed_mps.best == pytest.approx(4.0)


@pytest.mark.parametrize(("before_s", "out"), [(0.6, True), (0.601, False), (0.5, True)])
def test_a_jump_counts_as_slip_for_six_tenths_of_a_second(before_s: float, *, out: bool) -> None:
    """The test runs at small clock values, where differences are exact."""
    made = going(cycles=12)
    made.over_ground(9.0, 9.1)
    made.odometry._jumped_s = (made.now_ns + 40_000_000) * 1e-9 - before_s
    told = made.cycle(tacho_age_s=0.04)

    assert told.slip
    assert (told.speed_mps.low > 8.0) is out


@pytest.mark.parametrize(("before_s", "out"), [(0.6, False), (0.601, True), (0.1, False)])
def test_a_jump_of_differing_axles_proves_nothing_because_a_tacho_may_be_broken(
    monkeypatch: pytest.MonkeyPatch, before_s: float, *, out: bool
) -> None:
    """The test runs at small clock values, where differences are exact."""
    made = going(cycles=12)
    made.over_ground(9.0, 9.1)
    made.odometry._differed_s = (made.now_ns + 40_000_000) * 1e-9 - before_s
    monkeypatch.setattr(SpeedTrack, "jumped", lambda *_: True)
    told = made.cycle(tacho_age_s=0.04)

    assert told.slip
    assert (told.speed_mps.low > 8.0) is out


def test_a_stopped_axle_beside_a_rolling_one_keeps_both_bounds() -> None:
    """The radar shows 4.5 m/s and the rolling axle 4 m/s; no evidence decides which is wrong."""
    made = going()
    made.cycles(10, 8, 8, radar_mps=4.5)
    told = made.cycle(0, 0, steps_b=(8, 8), radar_mps=4.5)
    for _ in range(5):
        told = made.cycle(0, 0, steps_b=(8, 8), radar_mps=4.5)

    assert told.slip
    assert not made.odometry._wheels_out


def test_axles_that_disagree_slip_at_once_and_until_they_agreed_for_a_second() -> None:
    made = going()
    assert made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0).slip
    slips = [made.cycle(8, 8, radar_mps=4.0).slip for _ in range(30)]

    assert slips.index(False) in (23, 24, 25)
    assert not any(slips[slips.index(False) :])


def test_adhesion_is_lost_only_while_the_axles_leave_the_play_of_the_couplers() -> None:
    made = going()
    assert not made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0).adhesion_lost
    assert made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0).adhesion_lost
    told = made.cycle(8, 8, radar_mps=4.0)

    assert (told.slip, told.adhesion_lost) == (True, False)


def test_wheels_that_contradict_the_ground_have_lost_adhesion() -> None:
    made = going()
    told = [made.cycle(20, 20, radar_mps=4.0) for _ in range(20)]

    assert any(each.slip and each.adhesion_lost for each in told)


def test_pulses_against_their_direction_are_a_slip_though_the_axles_agree() -> None:
    made = going()
    told = made.cycle(8, 8, way=Direction.REVERSE, radar_mps=4.0)

    assert told.slip
    assert not made.odometry._axles_differ
    assert not made.odometry.usable


def test_wheels_grip_again_at_the_very_end_of_the_hold() -> None:
    for until, slip in ((0.0, False), (1e-9, True)):
        made = going()
        made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0)
        made.odometry._slip_until_s = (made.now_ns + 40_000_000) * 1e-9 + until

        assert made.cycle(8, 8, radar_mps=4.0).slip is slip


def test_before_the_speed_over_ground_is_known_nothing_slips() -> None:
    new = Desk()
    new.cycle(8, 8)
    told = new.cycle(8, 8, steps_b=(8, 30))

    assert new.odometry._axles_differ
    assert not told.slip


def test_axles_that_disagree_before_the_ground_speed_is_known_reset_the_scale_anchor() -> None:
    new = Desk()
    new.cycle(8, 8)
    assert new.where.scale._anchor is not None
    new.cycle(8, 8, steps_b=(8, 30))
    assert new.where.scale._anchor is None


# What is believed meanwhile.


@pytest.mark.parametrize("age_s", [0.0, 0.016])
def test_the_best_estimate_runs_smoothly_into_a_slip_and_out_of_it(age_s: float) -> None:
    """At 4 m/s the train runs 16 cm in each cycle, measured by the wheels or over ground."""
    made = Desk()
    made.cycles(60, 8, 8, radar_mps=4.0, age_s=age_s)
    before_m = made.cycle(8, 8, radar_mps=4.0, age_s=age_s).front_m.best
    slips = []
    for number in range(40):
        steps_b = (8, 18) if number == 3 else (8, 8)
        told = made.cycle(8, 8, steps_b=steps_b, radar_mps=4.0, age_s=age_s)
        slips.append(told.slip)

        assert told.front_m.best - before_m == pytest.approx(0.16, abs=0.012)
        before_m = told.front_m.best
    assert slips.count(True) > 20
    assert not slips[-1]


def test_while_wheels_slip_place_and_travel_follow_the_ground(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    followed: list[tuple[float, float]] = []
    honest = Localisation.follow_ground

    def follow(self: Localisation, likely_m: float, spread_m: float) -> None:
        followed.append((likely_m, spread_m))
        honest(self, likely_m, spread_m)

    monkeypatch.setattr(Localisation, "follow_ground", follow)
    made = spinning()
    before = made.cycle(16, 16, radar_mps=4.0)
    at_m, pulses = made.where.at_m, made.where.pulses
    followed.clear()
    told = made.cycle(16, 16, radar_mps=4.0)

    assert followed == [near(0.16, 0.1 * 0.04)]
    assert told.travel_m - before.travel_m == pytest.approx(0.16)
    counted_m = (made.where.pulses - pulses) * made.where.m_per_pulse
    assert told.pulses_m - before.pulses_m == pytest.approx(counted_m)
    assert counted_m == pytest.approx(0.32, rel=0.02)
    assert made.where.at_m - at_m == pytest.approx(0.16)
    assert told.front_m.best == pytest.approx(made.where.at_m)


def test_a_wheel_that_is_locked_does_not_make_the_train_stand() -> None:
    made = going()
    for _ in range(20):
        told = made.cycle(0, 0, radar_mps=4.0)

    assert made.track.still_s > 0.5
    assert told.slip
    assert not told.standing
    assert not told.standstill
    assert told.speed_mps.best == pytest.approx(4.0)


@pytest.mark.parametrize("age_s", [0.0, 0.016])
def test_excluded_wheels_take_their_position_from_the_ground(
    age_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The position counts at the last sample, whose instant is known within a millisecond."""
    trusted: list[tuple[float, float, float]] = []
    monkeypatch.setattr(Localisation, "trust_ground", lambda self, *told: trusted.append(told))
    made = Desk()
    made.cycles(60, 8, 8, radar_mps=4.0, age_s=age_s)
    assert trusted == []
    made.cycles(5, 16, 16, radar_mps=4.0, age_s=age_s)
    trusted.clear()
    made.cycle(16, 16, radar_mps=4.0, age_s=age_s)

    assert trusted == [near(3.9, 4.1, age_s + 0.001)]


def test_a_sample_from_the_future_is_no_older_than_its_jitter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trusted: list[float] = []
    monkeypatch.setattr(
        Localisation, "trust_ground", lambda self, low, high, age_s: trusted.append(age_s)
    )
    made = spinning()
    made.track.stamp_s += 0.5
    made.cycle(radar_mps=4.0)

    assert trusted[-1] == pytest.approx(0.001)


def test_wheels_that_grip_again_count_again() -> None:
    made = spinning()
    assert made.odometry._wheels_out
    for _ in range(40):
        told = made.cycle(8, 8, radar_mps=4.0)

    assert not told.slip
    low, _, high = made.wheels()
    assert both_ends(told.speed_mps) == near(low, high)
    assert low < made.ground.low_mps
    assert not made.odometry._wheels_out


def test_wheels_are_excluded_only_while_they_slip(monkeypatch: pytest.MonkeyPatch) -> None:
    """This also holds when a jump was detected in the meantime."""
    trusted: list[tuple[float, float, float]] = []
    monkeypatch.setattr(Localisation, "trust_ground", lambda self, *told: trusted.append(told))
    made = going()
    made.odometry._jumped_s = made.now_s
    made.cycle(8, 8, radar_mps=4.0)
    assert not made.odometry._wheels_out
    assert not made.cycle(8, 8, radar_mps=4.0).slip
    assert trusted == []


# Speed, while both may be right.


@pytest.mark.parametrize(
    ("low_mps", "high_mps"), [(3.4, 4.6), (3.99, 4.01), (3.0, 4.0), (4.0, 5.0)]
)
def test_the_reported_speed_covers_wheels_and_ground(low_mps: float, high_mps: float) -> None:
    made = going()
    made.over_ground(low_mps, high_mps)
    told = made.cycle(dt_s=0.0)
    low, best, high = made.wheels()

    assert both_ends(told.speed_mps) == near(min(low, low_mps), max(high, high_mps))
    assert told.speed_mps.best == pytest.approx(best)
    assert best == pytest.approx(4.0, abs=0.01)
    assert not math.isinf(told.front_m.high)


@pytest.mark.parametrize("age_s", [0.0, 0.03])
def test_at_the_end_of_a_slip_wheels_and_ground_are_reconciled_at_the_age_of_the_sample(
    monkeypatch: pytest.MonkeyPatch, age_s: float
) -> None:
    made = Desk()
    made.cycles(60, 8, 8, radar_mps=4.0, age_s=age_s)
    made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0, age_s=age_s)
    made.odometry._slip_until_s = made.now_s
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(Localisation, "reconcile", lambda _, *told: calls.append(told))
    made.cycles(2, 8, 8, radar_mps=4.0, age_s=age_s)

    ((wheels, ground, since_s),) = calls
    assert both_ends(ground) == near(3.9, 4.1)
    assert wheels.low < 3.9
    assert since_s == pytest.approx(age_s)
