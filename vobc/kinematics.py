"""Braking curves and the effect of gradients: pure functions of plain numbers."""

import math
from dataclasses import dataclass
from typing import Final

GRAVITY_MPS2: Final = 9.81


def gradient_accel_mps2(gradient_permille: float, *, rotating_mass_ratio: float = 0.0) -> float:
    """Acceleration that gravity adds to a rolling train: positive where the track falls.

    Rotating parts add to the inertia but not to the weight, so they reduce the effect.
    """
    return -GRAVITY_MPS2 * gradient_permille / 1000.0 / (1.0 + rotating_mass_ratio)


def stopping_distance_m(
    speed_mps: float, *, decel_mps2: float, reaction_s: float = 0.0, target_mps: float = 0.0
) -> float:
    """Distance that a train needs to slow down to `target_mps`: it runs on, then brakes steadily.

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

    The function is the inverse of `stopping_distance_m`. The train runs on for `reaction_s` before
    the brake acts, then decelerates by `decel_mps2`. A train below the target speed needs no brake,
    so the result is never less than the target.

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


@dataclass(frozen=True, slots=True)
class ReactionTimes:
    """Delay between a brake command and the brake effort, in two parts."""

    before_cut_s: float
    """t1 of [Lin]: the train goes on as before."""
    build_up_s: float
    """t2 of [Lin]: traction is cut, and the brake has not built up yet."""


SERVICE_FROM_TRACTION: Final = ReactionTimes(before_cut_s=0.95, build_up_s=1.05)
SERVICE_FROM_COAST_OR_BRAKE: Final = ReactionTimes(before_cut_s=0.2, build_up_s=1.05)
EMERGENCY: Final = ReactionTimes(before_cut_s=0.3, build_up_s=1.05)
"""[Lin] names the two times without figures. These values follow from the interface standard
between train control and vehicles."""


def v_top_mps(
    distance_m: float,
    *,
    decel_mps2: float,
    accel_mps2: float,
    reaction: ReactionTimes,
    target_mps: float = 0.0,
) -> float:
    """Highest present speed from which braking in three stages still ends at the target, after
    [Lin].

    It is the root of W = 0, equation (2). The kinetic energy now and the work of traction in t1
    equal the work of the brake and the energy left at the target. With v1 the speed after t1,

        v1 = -b*(t1 + t2) + sqrt(b**2*(t1 + t2)**2 + 2*b*(d + a*t1**2/2) + v_c**2)
        v_top = v1 - a*t1

    [Lin] switches between the speeds of the place and of the target by the sign of W. At the root
    the two are equal. The result is at least 0. The caller handles a train slower than the target,
    which needs no brake.

    Args:
        distance_m: to the target; negative once it is passed.
        decel_mps2: b, of the brake and a climb together (b' of [Lin]); positive.
        accel_mps2: a, of traction in t1; 0 for a train that coasts, negative for one that brakes.
        reaction: t1 and t2, by the state that the train is in.
        target_mps: v_c; zero or more.
    """
    assert decel_mps2 > 0.0
    assert target_mps >= 0.0
    before_s, both_s = reaction.before_cut_s, reaction.before_cut_s + reaction.build_up_s
    lost_mps = decel_mps2 * both_s
    reach_m = distance_m + 0.5 * accel_mps2 * before_s * before_s
    square = lost_mps * lost_mps + 2.0 * decel_mps2 * reach_m + target_mps * target_mps
    if square <= 0.0:
        return 0.0
    return max(0.0, math.sqrt(square) - lost_mps - accel_mps2 * before_s)
