"""Finds a timetable in which accelerating and braking trains meet, at unchanged trip times.

The search may change the departure from the far terminal relative to the near one, with the same
sum of both turnbacks. It may also change the split of the trip time into runs, and the hold speed
of each run. Trip time, headway, dwell and punctuality stay. Each proposal is judged on the whole
line with the same random dwells; the result is judged with other dwells elsewhere.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from metro_hil.energy.line.model import HOLD_AND_COAST, LineTrain, Supply, Timetable
from metro_hil.energy.line.regimes import LegRuns, Regime, least_traction
from metro_hil.energy.line.simulate import dwells_of, simulate

PHASE_REACH_S: Final = 16.0
"""Greatest shift of the phase; each turnback keeps its minimum even after the shortest dwells."""
SPLIT_REACH_S: Final = 9.0
TRAINING_SEEDS: Final = (7001, 7002)
PHASE: Final = 0
SPLITS: Final = (1, 2, 3, 4)
SPEEDS: Final = tuple(range(5, 11))
GENES: Final = 11
FIRST_STEPS: Final = (8.0, *(4.0,) * 4, *(3.0,) * 6)
SHRINK_RATIO: Final = 0.6


@dataclass(frozen=True, slots=True)
class FoundTimetable:
    timetable: Timetable
    start_kwh: float
    """Actual energy of a lap of the least-traction timetable, with the training dwells."""
    best_kwh: float
    tried: int


class TimetableSearch:
    """Coordinate search with random directions; equal arguments give equal timetables."""

    def __init__(
        self, train: LineTrain, supply: Supply, base: Timetable, *, seed: int, budget: int
    ) -> None:
        self._train, self._supply, self._base = train, supply, base
        self._runs = LegRuns(train)
        self._generator = np.random.default_rng(seed)
        self._budget = budget
        self._dwells = [dwells_of(one, 2) for one in TRAINING_SEEDS]
        self._known: dict[tuple[int, float], list[Regime]] = {}
        self.tried = 0

    def run(self, told: Callable[[int, float], None] = lambda tried, kwh: None) -> FoundTimetable:
        """Run the search; `told` receives the number of tries and the best value so far."""
        start = least_traction(self._runs, self._base)
        start_kwh = self._cost_kwh(start)
        genes = np.zeros(GENES)
        best, best_kwh = start, start_kwh
        steps = np.array(FIRST_STEPS)
        while self.tried < self._budget:
            better = False
            for gene in self._generator.permutation(GENES):
                for sign in self._generator.permutation([-1.0, 1.0]):
                    trial = genes.copy()
                    trial[gene] += sign * steps[gene]
                    timetable = self._timetable(trial)
                    if timetable is None or self.tried >= self._budget:
                        continue
                    cost_kwh = self._cost_kwh(timetable)
                    told(self.tried, min(cost_kwh, best_kwh))
                    if cost_kwh < best_kwh:
                        genes, best, best_kwh, better = trial, timetable, cost_kwh, True
                        break
            if not better:
                steps = steps * SHRINK_RATIO
                if steps[PHASE] < 0.4:
                    break
        return FoundTimetable(best, start_kwh, best_kwh, self.tried)

    def _cost_kwh(self, timetable: Timetable) -> float:
        self.tried += 1
        outcomes = [
            simulate(self._train, self._supply, timetable, HOLD_AND_COAST, dwells)
            for dwells in self._dwells
        ]
        cost_kwh = float(np.mean([outcome.actual_kwh for outcome in outcomes]))
        late = min(outcome.on_time_ratio for outcome in outcomes)
        # Penalise a timetable that trains cannot keep, however little energy it takes.
        return cost_kwh if late == 1.0 else cost_kwh * (2.0 - late)

    def _timetable(self, genes: np.ndarray) -> Timetable | None:
        """Return the timetable, or None if it is not permitted."""
        if abs(genes[PHASE]) > PHASE_REACH_S or np.any(np.abs(genes[1:5]) > SPLIT_REACH_S):
            return None
        runs_s = list(self._base.runs_s)
        one, two, three, four = (round(float(gene), 1) for gene in genes[1:5])
        runs_s[0] += one
        runs_s[1] += two
        runs_s[2] -= one + two
        runs_s[3] += three
        runs_s[4] += four
        runs_s[5] -= three + four
        holds, coasts = [], []
        for leg, run_s in enumerate(runs_s):
            regimes = self._regimes(leg, round(run_s, 1))
            if not regimes:
                return None
            least = min(range(len(regimes)), key=lambda index: regimes[index].traction_j)
            place = least + round(float(genes[SPEEDS[leg]]))
            regime = regimes[min(max(place, 0), len(regimes) - 1)]
            holds.append(regime.hold_mps)
            coasts.append(regime.coast_m)
        return replace(
            self._base,
            phase_s=self._base.phase_s + float(genes[PHASE]),
            runs_s=tuple(runs_s),
            hold_mps=tuple(holds),
            coast_m=tuple(coasts),
        )

    def _regimes(self, leg: int, run_s: float) -> list[Regime]:
        if (leg, run_s) not in self._known:
            self._known[leg, run_s] = self._runs.regimes(leg, run_s)
        return self._known[leg, run_s]
