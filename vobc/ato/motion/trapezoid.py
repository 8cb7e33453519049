"""Trapezoidal acceleration: times, distances and speeds under limits of acceleration and jerk."""

import math


def ramp_s(change_mps: float, *, accel_mps2: float, jerk_mps3: float) -> float:
    """Shortest time for a speed change that begins and ends without acceleration.

    From a change of A**2 / J on the acceleration reaches its limit, and T = dv / A + A / J. Below,
    it is a triangle, and T = 2 * sqrt(dv / J).
    """
    assert accel_mps2 > 0.0
    assert jerk_mps3 > 0.0
    size_mps = abs(change_mps)
    if size_mps >= accel_mps2 * accel_mps2 / jerk_mps3:
        return size_mps / accel_mps2 + accel_mps2 / jerk_mps3
    return 2.0 * math.sqrt(size_mps / jerk_mps3)


def ramp_m(from_mps: float, to_mps: float, *, accel_mps2: float, jerk_mps3: float) -> float:
    """Distance of that change: (v0 + v1) * T / 2, as the speed is symmetric about its middle."""
    duration_s = ramp_s(to_mps - from_mps, accel_mps2=accel_mps2, jerk_mps3=jerk_mps3)
    return (from_mps + to_mps) * duration_s / 2.0


def swing(
    speed_mps: float, *, from_mps2: float, to_mps2: float, jerk_mps3: float
) -> tuple[float, float]:
    """Speed after, and distance during, a linear change of acceleration at the jerk limit.

    The function does not stop the train at zero speed. The caller uses it only for a moving train.
    """
    assert jerk_mps3 > 0.0
    duration_s = abs(to_mps2 - from_mps2) / jerk_mps3
    change_mps = (from_mps2 + to_mps2) * duration_s / 2.0
    travel_m = speed_mps * duration_s + (2.0 * from_mps2 + to_mps2) * duration_s**2 / 6.0
    return speed_mps + change_mps, travel_m
