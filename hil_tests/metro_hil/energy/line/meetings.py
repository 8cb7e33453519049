"""Moves departures of a service so that accelerating trains meet braking ones.

The search begins with the best of some timetables and makes the moves that the service proposes,
such as seconds between the runs before and after one station. Each proposal is judged on the whole
network with the same dwells; the result is judged with other ones.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from metro_hil.energy.line.service import DesignedService

STEPS_S: Final = (4.0, 2.0, 1.0)
TRAINING_SEEDS: Final = (7001, 7002, 7003, 7004)
TRAINING_STEP_S: Final = 4.0


@dataclass(frozen=True, slots=True)
class FoundTimes:
    times_s: tuple[float, ...]
    tried: int


def find_meetings(
    service: DesignedService,
    begin_s: Sequence[float],
    *,
    seed: int,
    budget: int,
    told: Callable[[int, float], None] = lambda tried, kwh: None,
) -> FoundTimes:
    """Search from the timetable `begin_s`; equal arguments give equal timetables.

    Args:
        told: receives the number of tries and the least energy of a train so far, in kWh.
    """
    best_s = [round(time_s, 1) for time_s in begin_s]
    least_kwh, tried = _cost_kwh(service, best_s), 1
    for start_s in service.starts(best_s):
        if tried >= budget:
            break
        tried += 1
        cost_kwh = _cost_kwh(service, start_s)
        if cost_kwh < least_kwh:
            best_s, least_kwh = start_s, cost_kwh
        told(tried, least_kwh)
    generator = np.random.default_rng(seed)
    moves = service.moves(best_s)
    for step_s in STEPS_S:
        better = True
        while better and tried < budget:
            better = False
            for number in generator.permutation(len(moves)):
                move = moves[number]
                trial_s = list(best_s)
                for index, factor in move.items():
                    trial_s[index] = round(trial_s[index] + factor * step_s, 1)
                if tried >= budget or not service.permits(trial_s, begin_s, move):
                    continue
                tried += 1
                cost_kwh = _cost_kwh(service, trial_s)
                if cost_kwh < least_kwh:
                    best_s, least_kwh, better = trial_s, cost_kwh, True
                told(tried, least_kwh)
    return FoundTimes(tuple(best_s), tried)


def _cost_kwh(service: DesignedService, times_s: Sequence[float]) -> float:
    """Energy of a train. Traction that low voltage denies counts as if it were drawn twice."""
    found = [service.simulate(times_s, seed=s, step_s=TRAINING_STEP_S) for s in TRAINING_SEEDS]
    return float(np.mean([each.actual_kwh + 2.0 * each.unserved_kwh for each in found]))
