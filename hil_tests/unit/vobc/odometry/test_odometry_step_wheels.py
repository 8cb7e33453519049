"""Single samples, standstill and the exact ends of the position in one cycle of the odometer."""

import math
from typing import Any

import pytest

from can_dbc.nodes import Direction
from hil_tests.unit.vobc.odometry.odometry_desk import PULSE_M, Desk, near

LEAST_M, MOST_M = 0.01 / 1.05, 0.01 / 0.99
SCALE: dict[str, Any] = {"scale_error_low_ratio": -0.01, "scale_error_high_ratio": 0.05}


def going(step: int = 8, cycles: int = 60, **changes: Any) -> Any:
    """An odometer at 4 m/s, with 8 pulses in each 20 ms, seen by the radar."""
    made = Desk(**changes)
    made.cycles(cycles, step, step, radar_mps=step * 0.5)
    return made


# Samples.


def test_before_the_first_sample_the_odometer_is_unusable() -> None:
    new = Desk()
    assert not new.odometry.usable
    assert new.hear() is None
    assert not new.odometry.usable
    new.cycle(0)
    assert new.odometry.usable


def test_of_samples_too_close_to_the_next_only_the_last_counts() -> None:
    """Samples come 7.9 ms and later 10 ms before the next; travel counts from the first one
    used."""
    for apart_s, travel_m in ((0.0079, 0.0), (0.0081, 0.2)):
        made = Desk()
        told = made.cycle(0, 20, apart_s=apart_s, age_s=0.01)
        assert told.travel_m == pytest.approx(travel_m)
    three = Desk()
    told = three.cycle(0, 10, 10, ages_s=(0.0279, 0.02, 0.01))
    assert told.travel_m == pytest.approx(0.1)


def test_a_sample_of_an_instant_already_used_is_ignored() -> None:
    made = going()
    travel_m = made.cycle(8, 8).travel_m
    told = made.cycle(5, dt_s=0.0)

    assert told.travel_m == travel_m
    assert made.odometry.usable
    assert not told.slip


def test_single_pulses_add_up_to_distance() -> None:
    made = Desk()
    told = made.cycles(20, 1, 1)

    assert told.travel_m == pytest.approx(0.39)
    assert made.where.pulses == 39


@pytest.mark.parametrize("sign", [1, -1])
def test_pulses_against_their_direction_widen_the_position_by_twice_their_distance(
    sign: int,
) -> None:
    """The same distance in the other direction is as possible, on the side that the train may
    have come from."""
    made = going(sign * 8, **SCALE)
    where = made.where
    low_m, high_m = where.low_m, where.high_m
    way = Direction.REVERSE if sign > 0 else Direction.FORWARD
    made.cycle(sign * 8, sign * 8, way=way, radar_mps=sign * 4.0)

    ends_m = sorted((sign * 16 * where.scale.low_m, sign * 16 * where.scale.high_m))
    both_m = 32 * MOST_M
    assert where.low_m - low_m == pytest.approx(ends_m[0] - (both_m if sign > 0 else 0.0))
    assert where.high_m - high_m == pytest.approx(ends_m[1] + (both_m if sign < 0 else 0.0))


def test_speed_is_two_sided_while_pulses_and_direction_contradict_each_other() -> None:
    for sign, way in ((1, Direction.REVERSE), (-1, Direction.FORWARD)):
        made = Desk()
        for _ in range(5):
            told = made.cycle(sign * 8, sign * 8, way=way)
        window_s = 0.18
        most_mps = 73 * PULSE_M / (window_s - 0.001) + 1.5 * (window_s / 2 + 0.001)

        assert not made.ground.begun
        assert (told.speed_mps.low, told.speed_mps.high) == near(-most_mps, most_mps)


def test_a_scale_measured_by_one_axle_does_not_apply_to_the_other() -> None:
    made = going(**SCALE)
    scale = made.where.scale
    scale.low_m = scale.high_m = PULSE_M
    made.cycle(8, 8, radar_mps=4.0)
    assert (scale.low_m, scale.high_m) == (PULSE_M, PULSE_M)
    made.cycle(8, 8, radar_mps=4.0, healthy=(False, True))
    assert (scale.low_m, scale.high_m) == near(LEAST_M, MOST_M)


# Speed.


@pytest.mark.parametrize(
    ("step", "low_m", "high_m"), [(2, LEAST_M, MOST_M), (0, MOST_M, MOST_M), (-2, MOST_M, LEAST_M)]
)
def test_a_single_slow_pulse_counts_with_the_largest_scale(
    step: int, low_m: float, high_m: float
) -> None:
    new = Desk(**SCALE)
    new.cycle(0)
    new.cycle(step, dt_s=2.0)
    low, _, high = new.wheels()
    change_mps = 1.5 * 1.001

    slow, fast = step - 1, step + 1
    assert low == pytest.approx(slow * low_m / (2.001 if slow > 0 else 1.999) - change_mps)
    assert high == pytest.approx(fast * high_m / (1.999 if fast > 0 else 2.001) + change_mps)


def test_the_likely_speed_is_that_of_the_wheels_between_its_bounds() -> None:
    made = going()
    told = made.cycle(8, 8)

    assert told.speed_mps.best == pytest.approx(4.0, abs=1e-3)
    assert told.accel_mps2 == pytest.approx(0.0, abs=1e-2)
    made.track.accel_pulses_per_s2 = 45.0
    told = made.cycle(dt_s=0.0)
    assert told.accel_mps2 == pytest.approx(45.0 * made.where.m_per_pulse)


@pytest.mark.parametrize(("later_s", "settled"), [(0.0, True), (1e-9, False)])
def test_a_wheel_that_stood_for_long_enough_has_settled(later_s: float, *, settled: bool) -> None:
    measured = Desk()
    measured.cycles(14, 0, 0)
    made = Desk(standing_s=measured.track.still_s + later_s)
    told = made.cycles(14, 0, 0)
    made.track.rate_pulses_per_s, made.track.accel_pulses_per_s2 = 1.0, 1.0
    again = made.cycle(dt_s=0.0)

    assert (told.standing, again.standing) == (settled, settled)
    assert again.speed_mps.best == pytest.approx(0.0 if settled else made.where.m_per_pulse)
    kept = (made.track.rate_pulses_per_s, made.track.accel_pulses_per_s2)
    assert kept == ((0.0, 0.0) if settled else (1.0, 1.0))


# Standstill.


def test_queued_samples_prove_no_standstill_early() -> None:
    """The first cycle receives 0.38 s of samples without a pulse; the two seconds count from the
    first sample."""
    new = Desk(start_s=100.0)
    told = [new.cycle(*[0] * 20)] + [new.cycle(0, 0) for _ in range(50)]

    assert told[0].speed_mps.high < 0.25 or not told[0].standstill
    proven = [motion.standstill for motion in told].index(True)
    assert proven * 0.04 == pytest.approx(2.0 - 0.38, abs=0.03)


def standing(**changes: Any) -> Any:
    made = Desk(**changes)
    made.cycles(60, 0, 0)
    return made


def test_standstill_needs_slow_fresh_consistent_and_gripping_wheels() -> None:
    assert standing().cycle(0, 0).standstill
    assert not standing().cycle(0, 0, healthy=(False, False)).standstill
    assert not standing().cycle(tacho_age_s=0.151).standstill
    slipping = standing()
    slipping.cycle(0, 0, steps_b=(0, 10))
    assert slipping.odometry._slip
    assert not slipping.cycle(0, 0).standstill
    for step in (9, -9):
        moving = standing()
        moving.over_ground(-0.9, 0.9)
        told = moving.cycle(step)
        assert (told.slip, told.standstill) == (False, False)


def test_standstill_is_proven_after_exactly_two_seconds() -> None:
    """The test runs at small clock values, where differences are exact."""
    for later_s, proven in ((0.0, True), (1e-9, False)):
        made = standing()
        made.odometry._fast_s = (made.now_ns + 40_000_000) * 1e-9 - 2.0 + later_s

        assert made.cycle(0, 0).standstill is proven


@pytest.mark.parametrize("step", [1, -1])
def test_wheels_are_slow_below_the_limit_either_way_and_not_at_it(step: int) -> None:
    """With one pulse in the window, the bound on its side is the further one."""
    measured = Desk()
    for _ in range(5):
        measured.cycle(0, 0)
    measured.cycle(0, step)
    low, _, high = measured.wheels()
    limit_mps = high if step > 0 else -low
    assert limit_mps > (-low if step > 0 else high)
    for most_mps, slow in ((limit_mps, False), (math.nextafter(limit_mps, 1.0), True)):
        made = Desk(zero_speed_mps=most_mps)
        for _ in range(5):
            made.cycle(0, 0)
        made.cycle(0, step)

        assert made.odometry._slow is slow


# The place.


def alone(made: Any, low_m: float = 20.0, high_m: float = 21.0) -> None:
    """Leave the ends to the wheels: neither end over ground is further out."""
    where = made.where
    where.low_m, where.high_m = low_m, high_m
    where.ground_low_m, where.ground_high_m = low_m + 5.0, high_m - 5.0
    where.at_m = 20.5
    where._width_m = where._reach_m = 0.0


@pytest.mark.parametrize(
    ("ago_s", "low_s", "high_s"),
    [(0.02, 0.019, 0.021), (0.0, 0.0, 0.001), (0.1, 0.099, 0.101), (0.11, 0.0, 0.111)],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_ends_extrapolate_from_the_last_sample_and_from_an_old_one_only_outwards(
    ago_s: float, low_s: float, high_s: float, sign: int
) -> None:
    """The jitter is 1 ms either way; the test runs at small clock values, where 0.1 s is exact."""
    made = Desk()
    made.cycle(sign * 40, radar_mps=sign * 20.0)
    made.cycles(3, sign * 40, sign * 40, radar_mps=sign * 20.0)
    made.over_ground(sign * 20.0 - 0.1, sign * 20.0 + 0.1)
    alone(made)
    made.track.stamp_s = (made.now_ns + 40_000_000) * 1e-9 - ago_s
    told = made.cycle(tacho_age_s=9.0)
    speed = told.speed_mps

    assert speed.low * speed.high > 0.0
    low_m, high_m = (low_s, high_s) if sign > 0 else (high_s, low_s)
    assert told.front_m.low == pytest.approx(20.0 + speed.low * low_m)
    assert told.front_m.high == pytest.approx(21.0 + speed.high * high_m)


@pytest.mark.parametrize(
    ("low_mps", "high_mps"), [(0.5, 5.0), (-5.0, -0.5), (-3.0, 3.0), (-5.0, 0.5), (-0.5, 5.0)]
)
def test_an_end_that_moves_outwards_moves_for_longer_than_one_that_moves_inwards(
    low_mps: float, high_mps: float
) -> None:
    """The wheels are excluded and their sample is 20 ms old; only the ground determines the
    speed."""
    made = Desk()
    made.cycles(60, 8, 8, radar_mps=4.0, age_s=0.02)
    made.cycles(4, 16, 16, radar_mps=4.0, age_s=0.02)
    made.over_ground(low_mps, high_mps)
    where = made.where
    where.ground_low_m, where.ground_high_m = 20.0, 21.0
    where._width_m = where._reach_m = 0.0
    told = made.cycle(dt_s=0.0, tacho_age_s=9.0)

    assert (told.speed_mps.low, told.speed_mps.high) == near(low_mps, high_mps)
    # Back to the sample at the highest speed over ground, and on from there.
    low_m = 20.0 - max(0.0, high_mps) * 0.021 + low_mps * (0.019 if low_mps > 0.0 else 0.021)
    high_m = 21.0 - min(0.0, low_mps) * 0.021 + high_mps * (0.021 if high_mps > 0.0 else 0.019)
    assert told.front_m.low == pytest.approx(min(20.0, low_m))
    assert told.front_m.high == pytest.approx(max(21.0, high_m))


def test_the_best_estimate_extrapolates_the_filter_by_the_likely_speed() -> None:
    made = going()
    alone(made)
    made.track.at_pulses = made.odometry._pulses.count + 0.5 + 3.0
    told = made.cycle(tacho_age_s=0.04)
    best_mps = made.wheels()[1]

    assert told.front_m.best == pytest.approx(20.5 + 0.03 + 0.04 * best_mps)


@pytest.mark.parametrize(("at_m", "end"), [(15.0, "low"), (25.0, "high")])
def test_the_best_estimate_is_never_outside_the_ends(at_m: float, end: str) -> None:
    made = going()
    alone(made)
    made.where.at_m = at_m
    told = made.cycle(dt_s=0.0)

    assert told.front_m.best == getattr(told.front_m, end)
    assert told.front_m.low < told.front_m.high


def test_the_reported_position_gets_no_narrower_once_the_ground_speed_is_known() -> None:
    made = going()
    before = made.cycle(8, 8, radar_mps=4.0).front_m
    made.where.low_m += 0.2
    made.where.ground_low_m += 0.2
    after = made.cycle(8, 8, radar_mps=4.0).front_m
    assert after.high - after.low >= before.high - before.low
    new = Desk()
    before = new.cycle(8, 8).front_m
    new.where.low_m += 0.4
    new.where.high_m -= 0.4
    after = new.cycle(8, 8).front_m
    assert after.high - after.low < before.high - before.low
