"""Equation (1) of [Ninh] as printed, and its result.

The printed rule gives the brake exactly the time that is left, t_brake = t_brake(min) + (T - x).
But a train that brakes more gently also begins to brake earlier, where it would have coasted or
pulled. And the full brake from the new speed does not take t_brake(min). So the run misses T.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.energy.running_curve.design import (
    SECTIONS,
    Hop,
    RunningCurve,
    choose,
    design,
    pick,
    with_time,
)
from metro_hil.energy.running_curve.net import arrivals, departures, join
from metro_hil.energy.running_curve.table_one import TABLE_I

ROUNDS: Final = 3


@dataclass(frozen=True, slots=True)
class Literal:
    x_s: float
    """x from the cubic."""
    asked_braking_s: float
    """t_brake, the braking time from the rule."""
    curve: RunningCurve
    """Run with the power limit that gives this braking time."""
    late_s: float
    """Excess of this run over T; negative if it is early."""


def literal_design(hop: Hop, time_s: float, weight_factor: float) -> Literal:
    """Compute x from the cubic, the braking time from the printed rule, and the power limit."""
    train, track = hop.train, hop.track
    economical = design(hop, time_s, 0.0).curve
    choice = choose(hop, time_s, weight_factor)
    found = with_time(train, track, train.brake_power_w, choice.cubic_x_s)
    notch_off_mps, hold_m = choice.notch_off_mps, choice.hold_m
    if found is not None:
        notch_off_mps, hold_m = found.notch_off_mps, found.hold_m
    asked_s = economical.braking_s + (time_s - choice.cubic_x_s)
    first = departures(train, track, np.array([notch_off_mps]), np.array([hold_m]))
    low_w, high_w = 0.05 * train.brake_power_w, train.brake_power_w
    net = None
    for _ in range(ROUNDS):
        powers_w = np.linspace(low_w, high_w, SECTIONS)
        net = join(train, track, first, arrivals(train, track, powers_w))
        index = int(np.argmin(np.abs(net.braking_s[0] - asked_s)))
        low_w, high_w = powers_w[max(0, index - 1)], powers_w[min(SECTIONS - 1, index + 1)]
    assert net is not None
    curve = pick(net, 0, int(np.argmin(np.abs(net.braking_s[0] - asked_s))))
    return Literal(choice.cubic_x_s, asked_s, curve, curve.time_s - time_s)


def x_that_the_table_implies_s(time_s: float, braking_s: float) -> float:
    """Invert the printed rule: return x for a braking time of Table I."""
    return time_s - (braking_s - TABLE_I[0].braking_s)
