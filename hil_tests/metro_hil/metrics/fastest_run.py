"""The shortest time between two stops that limits of speed, acceleration and jerk allow.

It is the reference for a run: without control law, brake delay or resistance.
"""

import math


def fastest_run_s(
    distance_m: float, *, accel_mps2: float, jerk_mps3: float, limit_mps: float
) -> float:
    """Time of the run whose jerk is at its limit wherever no other limit applies.

    The speed is symmetric in time. Its two ramps to the peak v and back together take v * T(v)
    metres, where T(v) = v / a + a / j, or 2 * sqrt(v / j) while v is below a**2 / j. The train runs
    the remaining distance at the speed limit.

    Raises:
        ValueError: a distance or a limit is not positive.
    """
    values = {
        "distance_m": distance_m,
        "accel_mps2": accel_mps2,
        "jerk_mps3": jerk_mps3,
        "limit_mps": limit_mps,
    }
    for name, value in values.items():
        if value <= 0.0:
            raise ValueError(f"{name} {value} is not positive")
    least_mps = accel_mps2**2 / jerk_mps3
    if least_mps * 2.0 * accel_mps2 / jerk_mps3 >= distance_m:
        # v * 2 * sqrt(v / j) = d: the limit of acceleration is never reached.
        peak_mps = (distance_m**2 * jerk_mps3 / 4.0) ** (1.0 / 3.0)
    else:
        # v**2 / a + v * a / j = d.
        half_mps = accel_mps2**2 / (2.0 * jerk_mps3)
        peak_mps = math.sqrt(half_mps**2 + accel_mps2 * distance_m) - half_mps
    if peak_mps <= limit_mps:
        return 2.0 * _ramp_s(peak_mps, accel_mps2, jerk_mps3)
    ramp_s = _ramp_s(limit_mps, accel_mps2, jerk_mps3)
    return 2.0 * ramp_s + (distance_m - limit_mps * ramp_s) / limit_mps


def _ramp_s(change_mps: float, accel_mps2: float, jerk_mps3: float) -> float:
    if change_mps >= accel_mps2**2 / jerk_mps3:
        return change_mps / accel_mps2 + accel_mps2 / jerk_mps3
    return 2.0 * math.sqrt(change_mps / jerk_mps3)
