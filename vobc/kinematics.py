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
    return worst_case_speed_mps(
        distance_m,
        decel_mps2=decel_mps2,
        runaway_mps2=0.0,
        runaway_s=0.0,
        coasting_mps2=0.0,
        coasting_s=reaction_s,
        target_mps=target_mps,
    )


def worst_case_speed_mps(
    distance_m: float,
    *,
    decel_mps2: float,
    runaway_mps2: float,
    runaway_s: float,
    coasting_mps2: float,
    coasting_s: float,
    target_mps: float = 0.0,
    margin_s: float = 0.0,
) -> float:
    """Highest speed from which a train stops in time although everything goes wrong first.

    The safe braking model of IEEE 1474 in closed form. From the speed v the train

    1. runs on at v for `margin_s` (time in which somebody may still act);
    2. gains `runaway_mps2` for `runaway_s` (traction at full power until it is cut);
    3. gains `coasting_mps2` for `coasting_s` (downhill, until the brake has built up);
    4. loses `decel_mps2` down to `target_mps`.

    With w the speed gained in 2 and 3, T = runaway_s + coasting_s, and k the distance that the gain
    alone covers, it needs d = v * (margin_s + T) + k + ((v + w)**2 - v_target**2) / (2 * a).
    The positive root of that is the answer; the target is the least value returned.
    """
    assert decel_mps2 > 0.0
    assert runaway_mps2 >= 0.0
    assert coasting_mps2 >= 0.0
    assert target_mps >= 0.0
    assert min(runaway_s, coasting_s, margin_s) >= 0.0
    runaway_gain_mps = runaway_mps2 * runaway_s
    gain_mps = runaway_gain_mps + coasting_mps2 * coasting_s
    gained_m = runaway_gain_mps * (0.5 * runaway_s + coasting_s)
    gained_m += 0.5 * coasting_mps2 * coasting_s * coasting_s
    # The equation in u = v + w:  u**2 + 2*lost*u = v_target**2 + 2*a*(d - k + w*(margin + T)).
    run_on_s = margin_s + runaway_s + coasting_s
    lost_mps = decel_mps2 * run_on_s
    reach_m = distance_m - gained_m + gain_mps * run_on_s
    under_root = lost_mps * lost_mps + target_mps * target_mps + 2.0 * decel_mps2 * reach_m
    if under_root <= 0.0:
        return target_mps
    return max(target_mps, math.sqrt(under_root) - lost_mps - gain_mps)
