"""Table I of [Ninh] as printed, with runs at the paper's own power limits beside it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.energy.running_curve.design import Hop, RunningCurve, curve_of, design, with_time
from metro_hil.energy.running_curve.track import HopTrack, level_track
from metro_hil.energy.running_curve.train import RunningTrain

TIME_S: Final = 72.5
LENGTH_M: Final = 1000.0
J_PER_MJ: Final = 1.0e6
W_PER_KW: Final = 1000.0
MOTORS: Final = 8


@dataclass(frozen=True, slots=True)
class PrintedRow:
    """One row; the paper gives the energies in kWh."""

    weight_factor: float
    acceleration_kwh: float
    regenerated_kwh: float
    total_kwh: float
    power_kw: float
    """Power of each motor."""
    braking_s: float


TABLE_I: Final = (
    PrintedRow(0.0, 23.42, 9.55, 13.87, 102.0, 17.8),
    PrintedRow(1.0, 24.12, 10.06, 14.06, 97.0, 19.12),
    PrintedRow(5.0, 28.41, 10.7, 17.71, 80.0, 26.02),
    PrintedRow(10.0, 30.34, 11.28, 19.06, 71.5, 29.41),
    PrintedRow(100.0, 30.78, 11.89, 18.89, 68.0, 31.12),
)


@dataclass(frozen=True, slots=True)
class TableOneRow:
    printed: PrintedRow
    curve: RunningCurve

    def regenerable_max_kwh(self) -> float:
        """Return the energy of the power limit over the braking time, which no brake exceeds."""
        return MOTORS * self.printed.power_kw * self.printed.braking_s / 3600.0


def rows(train: RunningTrain) -> list[TableOneRow]:
    """Return runs of 1 km in 72.5 s at the paper's power limits, or the fastest run.

    The fastest run stands for a power limit that is too low for 72.5 s.
    """
    track = level_track(train, LENGTH_M)
    return [
        TableOneRow(printed, _run(train, track, printed.power_kw * 1000.0 * MOTORS))
        for printed in TABLE_I
    ]


def designed_kw(hop: Hop) -> list[float]:
    """Return the power limit of a motor that the design chooses for each row's weight."""
    weights = [printed.weight_factor for printed in TABLE_I]
    return [design(hop, TIME_S, each).curve.power_w / W_PER_KW / MOTORS for each in weights]


def _run(train: RunningTrain, track: HopTrack, power_w: float) -> RunningCurve:
    found = with_time(train, track, power_w, TIME_S)
    if found is not None and found.hold_m == 0.0:
        return found
    # The paper's curves coast from the notch-off speed; none of them holds it.
    return curve_of(train, track, train.speed_max_mps, 0.0, power_w)


def deviation_ratio(table: Sequence[TableOneRow], *, unit_j: float) -> float:
    """Return the root mean square deviation over the 15 cells of energies and braking time.

    The printed energies are taken in units of `unit_j`.
    """
    errors = []
    for row in table:
        printed, curve = row.printed, row.curve
        errors.append(curve.acceleration_j / unit_j / printed.acceleration_kwh - 1.0)
        errors.append(curve.regenerated_j / unit_j / printed.regenerated_kwh - 1.0)
        errors.append(curve.braking_s / printed.braking_s - 1.0)
    return math.sqrt(float(np.mean(np.square(errors))))
