"""Computes everything that `vobc design-curve` shows, for table, figure and JSON."""

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from metro_hil.energy.running_curve import table_one
from metro_hil.energy.running_curve.design import (
    Design,
    Hop,
    InfeasibleError,
    RunningCurve,
    design,
    whole_net,
)
from metro_hil.energy.running_curve.literal import (
    Literal,
    literal_design,
    x_that_the_table_implies_s,
)
from metro_hil.energy.running_curve.net import Net
from metro_hil.energy.running_curve.optimum import NotSolvedError, Optimum, optimise
from metro_hil.energy.running_curve.trace import CurveTrace, trace
from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import Numbers, RunningTrain
from plant_emulator.power.box import J_PER_KWH

OPTIMUM_CELL_M: Final = 5.0
GRID_RATIO: Final = 0.01
"""Energy by which the wider cells of the optimum may differ from those of the designed curve."""
CONVENTIONAL_WEIGHT: Final = 100.0
SWEEP: Final = tuple(float(weight) for weight in np.linspace(0.0, 30.0, 121))


@dataclass(frozen=True, slots=True)
class DesignRequest:
    hop: Hop
    coarse: HopTrack
    """The same track in fewer cells, for the optimum."""
    time_s: float
    weight_factor: float
    use_ratio: float
    optimal: bool
    literal: bool

    @property
    def train(self) -> RunningTrain:
        return self.hop.train

    @property
    def track(self) -> HopTrack:
        return self.hop.track


@dataclass(frozen=True, slots=True)
class DesignAnswer:
    asked: DesignRequest
    designed: Design
    run: CurveTrace
    optimum: Optimum | None
    above_ratio: float | None
    """Excess of the designed run's J over the optimum's, relative to the size of the latter."""
    literal: Literal | None


def answer(asked: DesignRequest) -> DesignAnswer:
    """Design a running curve.

    Raises SettingsError if no run fulfils the task, NotSolvedError if the optimum that was asked
    for does not pass its checks.
    """
    train, track = asked.train, asked.track
    designed = design(asked.hop, asked.time_s, asked.weight_factor)
    optimum = above_ratio = None
    if asked.optimal:
        run = trace(train, track, designed.curve)
        begin = np.interp(asked.coarse.at_m, run.at_m, run.square_m2_per_s2)
        time_s = max(asked.time_s, designed.curve.time_s)
        optimum = optimise(train, asked.coarse, time_s, asked.use_ratio, begin)
        above_j = designed.curve.total_j(asked.use_ratio) - optimum.cost_j
        if above_j < -GRID_RATIO * designed.curve.acceleration_j:
            raise NotSolvedError(
                f"its best run takes {-above_j / 1.0e6:.2f} MJ more than the designed curve"
            )
        above_ratio = above_j / abs(optimum.cost_j)
    printed = None
    if asked.literal:
        printed = literal_design(asked.hop, asked.time_s, asked.weight_factor)
    return DesignAnswer(
        asked, designed, trace(train, track, designed.curve), optimum, above_ratio, printed
    )


def sweep_of(net: Net, time_s: float) -> tuple[Numbers, Numbers]:
    """Return acceleration energy and power limit for each weight of SWEEP, from the net.

    Each way to gain speed has at most one power limit with which the run takes T.
    """
    fastest_s = float(np.min(net.time_s[:, -1]))
    energies_j, powers_w, times_s = [], [], []
    for row in range(len(net.notch_off_mps)):
        times = net.time_s[row]
        if times[-1] <= time_s <= times[0]:
            powers_w.append(float(np.interp(-time_s, -times, net.power_w)))
            energies_j.append(float(net.acceleration_j[row, -1]))
            times_s.append(float(times[-1]))
    if not times_s:
        nothing = np.full(len(SWEEP), np.nan)
        return nothing, nothing
    energies, powers, times = np.array(energies_j), np.array(powers_w), np.array(times_s)
    dearest_j = energies[int(np.argmin(times))]
    best = [int(np.argmin(energies / dearest_j + weight * times / fastest_s)) for weight in SWEEP]
    return energies[best], powers[best]


def net_of(asked: DesignRequest) -> Net:
    return whole_net(asked.train, asked.track)


def reference_curves(asked: DesignRequest) -> tuple[RunningCurve, RunningCurve]:
    """Return the curves <I> and <II>: with the greatest weight and with none.

    A long hop has no run with the greatest weight that takes so much time; then both are <II>.
    """
    economical = design(asked.hop, asked.time_s, 0.0).curve
    try:
        return design(asked.hop, asked.time_s, CONVENTIONAL_WEIGHT).curve, economical
    except InfeasibleError:
        return economical, economical


def as_document(found: DesignAnswer) -> dict[str, Any]:
    """Return request, train, design and comparisons for JSON."""
    asked, curve, choice = found.asked, found.designed.curve, found.designed.choice
    document: dict[str, Any] = {
        "train": asdict(asked.train),
        "time_s": asked.time_s,
        "weight_factor": asked.weight_factor,
        "use_ratio": asked.use_ratio,
        "length_m": asked.track.length_m,
        "curve": {
            **asdict(curve),
            **({} if asked.track.thrift is None else {"notch_off_mps": None, "hold_m": None}),
            "greatest_mps": float(np.max(found.run.speed_mps)),
            "power_per_motor_w": curve.power_w / asked.train.motors,
            "acceleration_kwh": curve.acceleration_j / J_PER_KWH,
            "regenerated_kwh": curve.regenerated_j / J_PER_KWH,
        },
        "x_s": choice.x_s,
        "cubic_x_s": choice.cubic_x_s,
        "fastest_s": choice.fastest_s,
        "late_s": found.designed.late_s,
        "profile": {
            "at_m": [round(float(value), 2) for value in found.run.at_m[::10]],
            "speed_mps": [round(float(value), 4) for value in found.run.speed_mps[::10]],
            "time_s": [round(float(value), 3) for value in found.run.time_s[::10]],
        },
    }
    if found.optimum is not None:
        best = found.optimum
        document["optimum"] = {
            "time_s": best.time_s,
            "cost_j": best.cost_j,
            "acceleration_j": best.acceleration_j,
            "regenerated_j": best.regenerated_j,
            "friction_j": best.friction_j,
            "above_ratio": found.above_ratio,
        }
    if found.literal is not None:
        document["literal"] = {
            **asdict(found.literal),
            "x_that_table_i_implies_s": [
                x_that_the_table_implies_s(table_one.TIME_S, row.braking_s)
                for row in table_one.TABLE_I
            ],
        }
    return document
