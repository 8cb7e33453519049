"""Moves departures of a service so that accelerating trains meet braking ones.

The search moves seconds between the runs before and after one station. So the trains pass that
station earlier or later, and nothing else changes: trip times, headway and dwells stay. Each
proposal is judged on the whole network with the same dwells; the result is judged with other ones.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.energy.line.service import ServiceLine

STEPS_S: Final = (4.0, 2.0, 1.0)
REACH_S: Final = 12.0
"""Greatest change of one running time."""
TRAINING_SEEDS: Final = (7001, 7002, 7003, 7004)
TRAINING_STEP_S: Final = 4.0


@dataclass(frozen=True, slots=True)
class FoundRuns:
    runs_s: tuple[float, ...]
    tried: int


def find_meetings(
    service: ServiceLine,
    begin_s: Sequence[float],
    *,
    seed: int,
    budget: int,
    told: Callable[[int, float], None] = lambda tried, kwh: None,
) -> FoundRuns:
    """Search from the running times `begin_s`; equal arguments give equal running times.

    Args:
        told: receives the number of tries and the least energy of a train so far, in kWh.
    """
    best_s = [round(run_s, 1) for run_s in begin_s]
    least_kwh, tried = _cost_kwh(service, best_s), 1
    generator = np.random.default_rng(seed)
    moves = [
        (before, sign)
        for hops in service.trips(best_s)
        for before in hops[:-1]
        for sign in (-1.0, 1.0)
    ]
    for step_s in STEPS_S:
        better = True
        while better and tried < budget:
            better = False
            for number in generator.permutation(len(moves)):
                before, sign = moves[number]
                trial_s = list(best_s)
                trial_s[before] = round(trial_s[before] + sign * step_s, 1)
                trial_s[before + 1] = round(trial_s[before + 1] - sign * step_s, 1)
                if tried >= budget or not _permitted(service, trial_s, begin_s, before):
                    continue
                tried += 1
                cost_kwh = _cost_kwh(service, trial_s)
                if cost_kwh < least_kwh:
                    best_s, least_kwh, better = trial_s, cost_kwh, True
                told(tried, least_kwh)
    return FoundRuns(tuple(best_s), tried)


def _permitted(
    service: ServiceLine, trial_s: Sequence[float], begin_s: Sequence[float], before: int
) -> bool:
    return all(
        abs(trial_s[hop] - begin_s[hop]) <= REACH_S
        and service.profile(hop, trial_s[hop]) is not None
        for hop in (before, before + 1)
    )


def _cost_kwh(service: ServiceLine, runs_s: Sequence[float]) -> float:
    """Energy of a train. Traction that low voltage denies counts as if it were drawn twice."""
    found = [service.simulate(runs_s, seed=s, step_s=TRAINING_STEP_S) for s in TRAINING_SEEDS]
    return float(np.mean([each.actual_kwh + 2.0 * each.unserved_kwh for each in found]))
