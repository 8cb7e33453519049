"""One designed run from start to end, node by node, for figures and files."""

from dataclasses import dataclass

import numpy as np

from metro_hil.energy.running_curve.design import RunningCurve
from metro_hil.energy.running_curve.net import arrivals, departures
from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import Numbers, RunningTrain


@dataclass(frozen=True, slots=True)
class CurveTrace:
    """Arrays (cells + 1,)."""

    at_m: Numbers
    speed_mps: Numbers
    time_s: Numbers
    power_w: Numbers
    """Power at the wheel; negative while the electric brake regenerates."""

    @property
    def square_m2_per_s2(self) -> Numbers:
        return self.speed_mps**2


def trace(train: RunningTrain, track: HopTrack, curve: RunningCurve) -> CurveTrace:
    """Take the lower speed of both halves at each node, and the power at the wheel there."""
    first = departures(train, track, np.array([curve.notch_off_mps]), np.array([curve.hold_m]))
    second = arrivals(train, track, np.array([curve.power_w]))
    gaining, braking = first.square_m2_per_s2[:, 0], second.square_m2_per_s2[:, 0]
    square = np.minimum(gaining, braking)
    speed_mps = np.sqrt(square)
    pair = np.maximum(speed_mps[1:] + speed_mps[:-1], 1e-6)
    time_s = np.concatenate([[0.0], np.cumsum(2.0 * track.cell_m / pair)])
    gained_j = first.traction_j[:, 0] - first.regained_j[:, 0]
    lost_j = -second.regained_j[:, 0]
    work_j = np.where(braking[1:] <= gaining[1:], -np.diff(lost_j), np.diff(gained_j))
    power_w = np.concatenate([[0.0], work_j / track.cell_m * pair / 2.0])
    return CurveTrace(track.at_m, speed_mps, time_s, power_w)
