"""Finds the hold speeds and coasting points with which a train keeps a running time."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from metro_hil.energy.line import kernel
from metro_hil.energy.line.model import HOLD_AND_COAST, LEGS, LineTrain, Timetable
from metro_hil.energy.line.simulate import STEP_S, legs_of, train_array

HALVINGS: Final = 14
SPEEDS: Final = 24
SLOWEST_MPS: Final = 11.0
TOLERANCE_S: Final = 0.35
"""Tolerance of a running time: two time steps, because a run ends on one."""
LOST_S: Final = 0.3
"""Allowance because a train on the whole line reacts one step later than a single train."""


@dataclass(frozen=True, slots=True)
class Regime:
    """One way to drive a leg in its time."""

    hold_mps: float
    coast_m: float
    time_s: float
    traction_j: float
    regenerated_j: float


class LegRuns:
    """Single runs of one train over the legs of the line, at full voltage."""

    def __init__(self, train: LineTrain) -> None:
        self._train = train_array(train)
        self._top_mps = train.speed_max_mps
        self._law = HOLD_AND_COAST.as_array()
        self.lengths_m = legs_of(Timetable())[2]
        self._state, self._power = np.zeros(kernel.STATE), np.zeros(5)

    def run(self, leg: int, hold_mps: float, coast_m: float) -> Regime:
        bounds = (float(self.lengths_m[leg]), hold_mps, coast_m)
        time_s, traction_j, regenerated_j = kernel.run_leg(
            STEP_S, self._train, self._law, bounds, self._state, self._power
        )
        return Regime(hold_mps, coast_m, time_s, traction_j, regenerated_j)

    def in_time(self, leg: int, hold_mps: float, time_s: float) -> Regime | None:
        """Return the run at this hold speed that takes `time_s`; None if there is none."""
        low_m, high_m = 0.0, float(self.lengths_m[leg])
        if self.run(leg, hold_mps, high_m).time_s > time_s:
            return None
        for _ in range(HALVINGS):
            middle_m = (low_m + high_m) / 2.0
            if self.run(leg, hold_mps, middle_m).time_s > time_s:
                low_m = middle_m
            else:
                high_m = middle_m
        found = self.run(leg, hold_mps, high_m)
        return found if found.time_s > time_s - TOLERANCE_S else None

    def speeds_mps(self) -> list[float]:
        return [float(speed) for speed in np.linspace(SLOWEST_MPS, self._top_mps, SPEEDS)]

    def regimes(self, leg: int, time_s: float) -> list[Regime]:
        """Return all runs of this time, in rising order of the hold speed."""
        found = [self.in_time(leg, speed, time_s - LOST_S) for speed in self.speeds_mps()]
        return [regime for regime in found if regime is not None]


def least_traction(runs: LegRuns, timetable: Timetable) -> Timetable:
    """Drive each leg with the least traction energy.

    Raises ValueError for a leg that no run completes in its time.
    """
    chosen = []
    for leg in range(LEGS):
        regimes = runs.regimes(leg, timetable.runs_s[leg])
        if not regimes:
            raise ValueError(f"leg {leg + 1}: no run takes {timetable.runs_s[leg]:g} s")
        chosen.append(min(regimes, key=lambda regime: regime.traction_j))
    return replace(
        timetable,
        hold_mps=tuple(regime.hold_mps for regime in chosen),
        coast_m=tuple(regime.coast_m for regime in chosen),
    )
