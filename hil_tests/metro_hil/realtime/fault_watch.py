"""Keeps track of which faults of a case have begun, are active and may still change."""

from collections.abc import Mapping, Sequence

from metro_hil.model.case import FaultResult
from plant_emulator.faults.plan import FaultPlan


class FaultWatch:
    """Receives every change of a fault, and reports which faults began."""

    def __init__(self, plans: Sequence[FaultPlan]) -> None:
        self._plans = {plan.index: plan for plan in plans}
        self._active: set[int] = set()
        self._begun: set[int] = set()

    def plan(self, index: int) -> FaultPlan | None:
        return self._plans.get(index)

    def change(self, plan: FaultPlan, active: bool) -> None:
        if active:
            self._active.add(plan.index)
            self._begun.add(plan.index)
        else:
            self._active.discard(plan.index)

    def results(self, touched: Mapping[int, int]) -> tuple[FaultResult, ...]:
        """Return what each fault did.

        Args:
            touched: counts by index from the devices that count; without one the count is unknown.
        """
        return tuple(
            FaultResult(kind=plan.kind.name, began=index in self._begun, touched=touched.get(index))
            for index, plan in self._plans.items()
        )

    @property
    def pending(self) -> bool:
        """Whether time alone will begin or end a fault; a condition may never come true."""
        return any(self._pending(plan) for plan in self._plans.values())

    def _pending(self, plan: FaultPlan) -> bool:
        window = plan.window
        if plan.index in self._active:
            return window.end_s is not None or window.duration_s is not None
        return plan.index not in self._begun and not window.when
