"""The speed reference over time: limits of acceleration and jerk, no overshoot, hand-over."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vobc.ato.motion.rate_limiter import RateLimiter

DT_S = 0.05


def follow(governor: RateLimiter, target_mps: float, seconds: float) -> list[tuple[float, float]]:
    path = []
    for _ in range(round(seconds / DT_S)):
        governor.step(target_mps, rise_mps2=0.8, fall_mps2=0.8)
        path.append((governor.speed_mps, governor.accel_mps2))
    return path


@settings(max_examples=50, deadline=None)
@given(from_mps=st.floats(0.0, 20.0), to_mps=st.floats(0.0, 20.0))
def test_the_reference_arrives_within_limits_and_without_overshoot(
    from_mps: float, to_mps: float
) -> None:
    governor = RateLimiter(0.6, 1.4, DT_S)
    governor.restart(from_mps, 0.0)

    path = follow(governor, to_mps, 60.0)

    assert path[-1][0] == pytest.approx(to_mps, abs=0.02)
    low_mps, high_mps = min(from_mps, to_mps), max(from_mps, to_mps)
    accel_before = 0.0
    for speed_mps, accel_mps2 in path:
        assert low_mps - 0.06 <= speed_mps <= high_mps + 0.06
        assert abs(accel_mps2) <= 0.8 + 1e-9
        assert abs(accel_mps2 - accel_before) <= 0.6 * DT_S + 1e-9
        accel_before = accel_mps2


def test_smoothing_makes_the_ramp_of_acceleration_gentler_than_the_jerk_limit() -> None:
    governor = RateLimiter(0.6, 1.4, DT_S)

    rises = [accel for _, accel in follow(governor, 20.0, 6.0)]

    # Without smoothing the acceleration is 0.8 after 1.33 s; the moving average is then just over
    # half of that.
    at_end_of_ramp, at_end_of_window = round(1.33 / DT_S), round((1.33 + 1.4) / DT_S)
    assert rises[at_end_of_ramp] < 0.45
    assert rises[at_end_of_window] == pytest.approx(0.8, abs=1e-6)


def test_a_reference_waits_for_a_train_that_cannot_follow() -> None:
    governor = RateLimiter(0.6, 1.4, DT_S)
    for _ in range(200):
        governor.step(20.0, rise_mps2=0.8, fall_mps2=0.8)
        governor.hold_back(0.5)

    assert governor.speed_mps == pytest.approx(0.5)


def test_restarting_continues_speed_and_acceleration() -> None:
    governor = RateLimiter(0.6, 1.4, DT_S)
    governor.restart(12.0, -0.4)

    governor.step(15.0, rise_mps2=0.8, fall_mps2=0.8)

    assert governor.speed_mps == pytest.approx(12.0 - 0.4 * DT_S, abs=0.01)
    assert governor.accel_mps2 == pytest.approx(-0.4, abs=0.05)


def test_missed_cycles_are_caught_up() -> None:
    once, twice = RateLimiter(0.6, 1.4, DT_S), RateLimiter(0.6, 1.4, DT_S)

    once.step(10.0, rise_mps2=0.8, fall_mps2=0.8, cycles=2)
    twice.step(10.0, rise_mps2=0.8, fall_mps2=0.8)
    twice.step(10.0, rise_mps2=0.8, fall_mps2=0.8)

    assert once.speed_mps == twice.speed_mps
