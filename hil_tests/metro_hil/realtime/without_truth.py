"""Judges a train without truth by its bus frames alone."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from metro_hil.model.case import MonitorResult, Verdict
from metro_hil.monitors import MonitorKind, MonitorPlan
from metro_hil.monitors.stl import Formula
from metro_hil.monitors.vocabulary import BOOLEANS, NAMES, SIGNALS, Origin

KNOWN: Final = frozenset(signal.name for signal in SIGNALS if signal.origin is Origin.BUS) | {"t_s"}
"""Signals that are the same with and without truth."""
DETAIL: Final = "needs the truth, which is unknown for this train"


def needs_truth(plan: MonitorPlan) -> bool:
    """Tell whether a monitor needs truth; without truth a measure is inconclusive by itself."""
    if plan.kind is MonitorKind.INVARIANT:
        return True
    if plan.kind is MonitorKind.STL:
        return not set(Formula(plan.text, NAMES, BOOLEANS).names) <= KNOWN
    return False


def with_unjudged(
    plans: Sequence[MonitorPlan], judged: Iterable[MonitorResult]
) -> tuple[MonitorResult, ...]:
    """Return the results in the order of the plans; what was not judged is inconclusive."""
    known: Mapping[str, MonitorResult] = {result.name: result for result in judged}
    return tuple(known.get(plan.name) or _unjudged(plan) for plan in plans)


def _unjudged(plan: MonitorPlan) -> MonitorResult:
    return MonitorResult(
        name=plan.name,
        verdict=Verdict.INCONCLUSIVE,
        margin=None,
        unit=plan.unit,
        detail=DETAIL,
        requirements=plan.requirements,
        asked=plan.asked,
        own=plan.own,
    )
