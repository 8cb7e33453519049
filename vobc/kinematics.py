"""Braking curves and what a gradient does to a train: pure functions of plain numbers."""

import math
from typing import Final

GRAVITY_MPS2: Final = 9.81


def gradient_accel_mps2(gradient_permille: float, *, rotating_mass_ratio: float = 0.0) -> float:
    """What gravity adds to the acceleration of a rolling train: positive where the track falls.

    Rotating parts add to the inertia but not to the weight, so they dampen the effect.
    """
    return -GRAVITY_MPS2 * gradient_permille / 1000.0 / (1.0 + rotating_mass_ratio)


def stopping_distance_m(
    speed_mps: float, *, decel_mps2: float, reaction_s: float = 0.0, target_mps: float = 0.0
) -> float:
    """What a train needs to slow down to `target_mps`: it runs on, then brakes steadily.

    d = v * t + (v**2 - v_target**2) / (2 * a)
    """
    assert decel_mps2 > 0.0
    assert reaction_s >= 0.0
    lost = max(0.0, speed_mps**2 - target_mps**2)
    return speed_mps * reaction_s + lost / (2.0 * decel_mps2)


def permitted_speed_mps(
    distance_m: float, *, decel_mps2: float, reaction_s: float, target_mps: float = 0.0
) -> float:
    """Highest speed from which the train still slows to `target_mps` within `distance_m`.

    The train is taken to run on for `reaction_s` before the brake bites and then to lose
    `decel_mps2` steadily: the inverse of `stopping_distance_m`. A train already below the target
    needs no brake, hence the target is also the least value returned.

    Args:
        distance_m: to the danger point; negative once it is passed.
        decel_mps2: guaranteed on this gradient; positive.
        reaction_s: from decision to full braking; zero or more.
        target_mps: permitted at the danger point; zero or more.
    """
    assert decel_mps2 > 0.0
    assert reaction_s >= 0.0
    assert target_mps >= 0.0
    reach_m = max(0.0, distance_m)
    lost_mps = decel_mps2 * reaction_s
    square = lost_mps * lost_mps + target_mps * target_mps + 2.0 * decel_mps2 * reach_m
    return max(target_mps, math.sqrt(square) - lost_mps)
