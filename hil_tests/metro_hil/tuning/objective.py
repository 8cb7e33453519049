"""Cost of a set of runs: stopping error in centimetres, plus penalties in the same unit."""

import math
from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from metro_hil.model.case import CaseResult

CM_PER_M: Final = 100.0
TOLERANCE_CM: Final = 10.0
OUTSIDE_RATIO: Final = 5.0
"""Weight of each centimetre beyond the tolerance."""
NOT_ARRIVED_CM: Final = 200.0
"""Cost of a run that misses its stop, or stands there with doors shut."""
JERK_MPS3: Final = 0.75
JERK_CM_PER_MPS3: Final = 20.0
"""Cost of felt jerk above `JERK_MPS3`, for each m/s³."""
NOTCH_CHANGES: Final = 15.0
NOTCH_CM: Final = 0.5
"""Cost of each change of notch in a braking beyond `NOTCH_CHANGES`, for notched control."""
SLOW_CM_PER_S: Final = 0.1
"""Cost of each second that a run takes longer than with the initial settings; a faster run gains
nothing."""
EMERGENCY_CM: Final = 100.0
REFUSED_CM: Final = 1.0e6
"""Cost of settings that do not fit together, and of points that were not run."""


class RunFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of a set of runs."""

    runs: int
    stops_missed: int
    """Number of runs whose stop was missed or did not end with open doors."""
    error_mean_m: float | None
    error_worst_m: float | None
    run_time_mean_s: float | None
    jerk_max_mps3: float
    accel_max_mps2: float
    emergencies: int
    notch_changes: int | None = None
    """Most changes in one braking; None without notches."""


def figures_of(results: Sequence[CaseResult], *, notches: bool) -> RunFigures:
    """Figures of the results.

    Args:
        notches: whether notches drive the train; without them every cycle changes the command.
    """
    errors_m = _known(results, "stop_error_worst_m")
    changes = _known(results, "notch_changes_max_count") if notches else []
    return RunFigures(
        runs=len(results),
        stops_missed=sum(map(_missed, results)),
        error_mean_m=_mean(_known(results, "stop_error_mean_m")),
        error_worst_m=max(errors_m, default=None),
        run_time_mean_s=_mean(_run_times_s(results)),
        jerk_max_mps3=max(_known(results, "jerk_max_mps3"), default=0.0),
        accel_max_mps2=max(_known(results, "accel_max_mps2"), default=0.0),
        emergencies=round(math.fsum(_known(results, "emergency_count"))),
        notch_changes=round(max(changes)) if changes else None,
    )


def cost_cm(results: Sequence[CaseResult], usual_s: float | None, *, notches: bool) -> float:
    """Mean cost of the runs, in cm; less is better.

    Args:
        usual_s: mean running time with the initial settings; None for no comparison.
        notches: whether notches drive the train.
    """
    costs = [_cost_of_run(result, usual_s) for result in results]
    if notches:
        changes = _known(results, "notch_changes_max_count")
        costs += [NOTCH_CM * max(0.0, each - NOTCH_CHANGES) for each in changes]
    return math.fsum(costs) / len(results)


def _cost_of_run(result: CaseResult, usual_s: float | None) -> float:
    measures = result.measures
    cost = NOT_ARRIVED_CM if _missed(result) else 0.0
    error_cm = (measures.get("stop_error_mean_m") or 0.0) * CM_PER_M
    cost += error_cm + OUTSIDE_RATIO * max(0.0, error_cm - TOLERANCE_CM)
    cost += JERK_CM_PER_MPS3 * max(0.0, (measures.get("jerk_max_mps3") or 0.0) - JERK_MPS3)
    cost += EMERGENCY_CM * (measures.get("emergency_count") or 0.0)
    if usual_s is not None:
        for run_s in _run_times_s([result]):
            cost += SLOW_CM_PER_S * max(0.0, run_s - usual_s)
    return cost


def _missed(result: CaseResult) -> bool:
    measures = result.measures
    return bool(measures.get("stops_missed_count")) or not measures.get("arrived_count")


def _run_times_s(results: Sequence[CaseResult]) -> list[float]:
    return _each(results, lambda name: name.startswith("stop_") and name.endswith("_run_s"))


def _known(results: Sequence[CaseResult], name: str) -> list[float]:
    return _each(results, lambda known: known == name)


def _each(results: Sequence[CaseResult], wanted: Callable[[str], bool]) -> list[float]:
    return [
        value
        for result in results
        for name, value in sorted(result.measures.items())
        if wanted(name) and value is not None
    ]


def _mean(values: Sequence[float]) -> float | None:
    return math.fsum(values) / len(values) if values else None
