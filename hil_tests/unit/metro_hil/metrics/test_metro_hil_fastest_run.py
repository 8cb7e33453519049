"""The shortest run, against a linear programme over jerks in small steps that uses no formula."""

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog

from firmware_py.trackdb import load_line
from metro_hil.metrics.fastest_run import LimitedStretch, fastest_run_s, limited_stretches

STEPS = 120


def farthest_m(time_s: float, *, accel_mps2: float, jerk_mps3: float, limit_mps: float) -> float:
    """The greatest distance from rest to rest in this time, with constant jerk in each step."""
    step_s = time_s / STEPS
    accel = np.tril(np.ones((STEPS, STEPS))) * step_s
    before = accel - np.eye(STEPS) * step_s
    speed = np.tril(np.ones((STEPS, STEPS))) @ (before * step_s + np.eye(STEPS) * step_s**2 / 2.0)
    speed_before = np.vstack([np.zeros((1, STEPS)), speed[:-1]])
    travel = speed_before * step_s + before * step_s**2 / 2.0 + np.eye(STEPS) * step_s**3 / 6.0
    limits = [accel, -accel, speed, -speed]
    bounds = [accel_mps2, accel_mps2, limit_mps, 0.0]
    found = linprog(
        -travel.sum(axis=0),
        A_ub=np.vstack(limits),
        b_ub=np.repeat(bounds, STEPS),
        A_eq=np.vstack([accel[-1], speed[-1]]),
        b_eq=[0.0, 0.0],
        bounds=(-jerk_mps3, jerk_mps3),
    )
    assert found.success
    return float(-found.fun)


@pytest.mark.parametrize(
    ("distance_m", "limit_mps"),
    [(500.0, 70.0 / 3.6), (300.0, 30.0), (900.0, 15.0), (2.0, 30.0), (4.0, 1.0)],
    ids=["hop", "no limit", "limit", "jerk alone", "jerk and limit"],
)
def test_the_shortest_time_is_exact_for_its_distance(distance_m: float, limit_mps: float) -> None:
    way = [LimitedStretch(distance_m, limit_mps)]

    time_s = fastest_run_s(way, accel_mps2=0.8, jerk_mps3=0.6)

    reached_m = farthest_m(time_s, accel_mps2=0.8, jerk_mps3=0.6, limit_mps=limit_mps)
    assert reached_m == pytest.approx(distance_m, rel=5e-3)


def test_a_lower_limit_on_the_way_costs_its_two_ramps_and_the_slow_stretch() -> None:
    """Each ramp between 20 and 10 m/s takes 10 / 0.8 + 0.8 / 0.6 s at 15 m/s in the mean."""
    way = [LimitedStretch(1000.0, 20.0), LimitedStretch(300.0, 10.0), LimitedStretch(1000.0, 20.0)]
    whole_s = fastest_run_s([LimitedStretch(2300.0, 20.0)], accel_mps2=0.8, jerk_mps3=0.6)

    time_s = fastest_run_s(way, accel_mps2=0.8, jerk_mps3=0.6)

    ramp_s = 10.0 / 0.8 + 0.8 / 0.6
    lost_s = 300.0 / 10.0 - 300.0 / 20.0 + 2.0 * (ramp_s - 15.0 * ramp_s / 20.0)
    assert time_s == pytest.approx(whole_s + lost_s, abs=1e-6)


def test_a_limit_that_the_train_cannot_reach_changes_nothing() -> None:
    """50 m do not suffice for 30 m/s between two stretches at 5 m/s."""
    slow = LimitedStretch(200.0, 5.0)

    high_s = fastest_run_s([slow, LimitedStretch(50.0, 30.0), slow], accel_mps2=0.8, jerk_mps3=0.6)
    higher_s = fastest_run_s(
        [slow, LimitedStretch(50.0, 60.0), slow], accel_mps2=0.8, jerk_mps3=0.6
    )

    assert high_s == pytest.approx(higher_s, abs=1e-9)
    assert high_s < fastest_run_s([LimitedStretch(450.0, 5.0)], accel_mps2=0.8, jerk_mps3=0.6)


def test_the_way_is_divided_where_the_lowest_limit_under_the_train_changes() -> None:
    line = load_line("florence")

    way = limited_stretches(line, line.start_m, line.end_m, train_length_m=68.59)

    assert sum(one.length_m for one in way) == pytest.approx(line.end_m - line.start_m)
    assert all(a.limit_mps != b.limit_mps for a, b in itertools.pairwise(way))


def test_a_zero_distance_is_refused() -> None:
    with pytest.raises(ValueError, match=r"0\.0 is not positive"):
        fastest_run_s([LimitedStretch(0.0, 20.0)], accel_mps2=0.8, jerk_mps3=0.6)
