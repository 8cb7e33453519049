"""The shortest run, against a linear programme over jerks in small steps that uses no formula."""

import numpy as np
import pytest
from scipy.optimize import linprog

from metro_hil.metrics.fastest_run import fastest_run_s

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
    time_s = fastest_run_s(distance_m, accel_mps2=0.8, jerk_mps3=0.6, limit_mps=limit_mps)

    reached_m = farthest_m(time_s, accel_mps2=0.8, jerk_mps3=0.6, limit_mps=limit_mps)

    assert reached_m == pytest.approx(distance_m, rel=5e-3)


def test_a_zero_distance_is_refused() -> None:
    with pytest.raises(ValueError, match="distance_m 0"):
        fastest_run_s(0.0, accel_mps2=0.8, jerk_mps3=0.6, limit_mps=20.0)
