"""Choice of a notch by the time in which it catches the reference ([Wu 2022], equations 1, 2).

Decelerations are magnitudes, so a traction notch has a negative one. The error is the train's speed
minus that of the reference.
"""

import math
from collections.abc import Sequence


def run_time_s(distance_m: float, *, speed_mps: float, target_mps: float) -> float:
    """Time to the target at constant deceleration: t_ract = 2 * (S_t - S) / (v + v_t)."""
    both_mps = speed_mps + target_mps
    if distance_m <= 0.0 or both_mps <= 0.0:
        return 0.0
    return 2.0 * distance_m / both_mps


def catch_s(
    error_mps: float, decel_mps2: float, *, reference_mps2: float, guard_mps2: float
) -> float:
    """t_catch = error / (b - a_ref). It is infinite if the notch keeps or widens the error.

    Args:
        reference_mps2: deceleration of the reference.
        guard_mps2: least difference to the reference's deceleration. Below it the quotient is
            noise.
    """
    gain_mps2 = decel_mps2 - reference_mps2
    if abs(gain_mps2) < guard_mps2 or gain_mps2 * error_mps <= 0.0:
        return math.inf
    return error_mps / gain_mps2


def gentlest(
    error_mps: float,
    decels_mps2: Sequence[float],
    *,
    reference_mps2: float,
    within_s: float,
    guard_mps2: float,
) -> int | None:
    """Index of the notch with the longest catch time up to `within_s`. None: no notch is fast
    enough.

    The rule is the same on both sides of the reference. For a train that is too slow the paper
    prints "greater than", with which no notch ever catches the reference; see `last_too_late`.
    """
    best: int | None = None
    best_s = 0.0
    for index, decel_mps2 in enumerate(decels_mps2):
        time_s = catch_s(
            error_mps, decel_mps2, reference_mps2=reference_mps2, guard_mps2=guard_mps2
        )
        if best_s < time_s <= within_s:
            best, best_s = index, time_s
    return best


def last_too_late(
    error_mps: float,
    decels_mps2: Sequence[float],
    *,
    reference_mps2: float,
    within_s: float,
    guard_mps2: float,
) -> int | None:
    """Choice as printed: index of the notch with the longest catch time above `within_s`."""
    best: int | None = None
    best_s = within_s
    for index, decel_mps2 in enumerate(decels_mps2):
        time_s = catch_s(
            error_mps, decel_mps2, reference_mps2=reference_mps2, guard_mps2=guard_mps2
        )
        if best_s < time_s < math.inf:
            best, best_s = index, time_s
    return best
