"""Decides at each step of the plant which faults begin and which end."""

from collections.abc import Callable, Sequence
from typing import Final

from firmware_py.expression import Expression
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.truth import Truth

LATEST_S: Final = 1.0e9

Listener = Callable[[FaultPlan, bool, int], None]
"""Callback with the fault, whether it is active from now on, and the instant."""


class Schedule:
    """Decides from the truth alone, so that the same run has the same faults on every bench."""

    def __init__(self, plans: Sequence[FaultPlan]) -> None:
        self._timers = [_Timer(plan) for plan in plans]
        self._listeners: list[Listener] = []

    def plan(self, plans: Sequence[FaultPlan]) -> None:
        """Replace all planned faults; none of the old ones may be active."""
        assert not self.active
        self._timers = [_Timer(plan) for plan in plans]

    def add(self, plan: FaultPlan) -> None:
        """Plan one more fault; its index is the number of faults before it."""
        assert plan.index == len(self._timers)
        self._timers.append(_Timer(plan))

    def end(self, index: int, end_s: float) -> None:
        """Let a fault end at an instant, as if its window ended there."""
        self._timers[index].end(end_s)

    def listen(self, listener: Listener) -> None:
        self._listeners.append(listener)

    def step(self, truth: Truth, now_ns: int) -> None:
        """Notify the listeners of every change, in the order of the scenario."""
        for timer in self._timers:
            if timer.done:
                continue
            active = timer.wants(truth)
            if active is not timer.active:
                timer.change(active, truth.t_s)
                for listener in self._listeners:
                    listener(timer.plan, active, now_ns)

    def finish(self, now_ns: int) -> None:
        """End all active faults, because the train goes on without this schedule."""
        for timer in self._timers:
            if timer.active:
                timer.active, timer.done = False, True
                for listener in self._listeners:
                    listener(timer.plan, False, now_ns)

    @property
    def active(self) -> tuple[FaultPlan, ...]:
        return tuple(timer.plan for timer in self._timers if timer.active)

    @property
    def pending(self) -> bool:
        """Whether a fault will begin or end by time alone; conditions do not count, because they
        may never hold.
        """
        return any(timer.pending for timer in self._timers)

    @property
    def plans(self) -> tuple[FaultPlan, ...]:
        """All planned faults, in the order of the scenario."""
        return tuple(timer.plan for timer in self._timers)

    @property
    def never_began(self) -> tuple[FaultPlan, ...]:
        """Faults that have not begun: their time or condition has not come.

        The run says nothing about them.
        """
        return tuple(timer.plan for timer in self._timers if not timer.begun)


class _Timer:
    __slots__ = ("_end_s", "_ends", "_last_s", "_starts", "active", "begun", "done", "plan")

    def __init__(self, plan: FaultPlan) -> None:
        self.plan = plan
        self.active = False
        self.begun = 0
        self.done = False
        self._starts = plan.window.begins()
        self._ends = plan.window.ends()
        end_s = plan.window.end_s
        self._last_s = LATEST_S if end_s is None else end_s
        """End of the window."""
        self._end_s = LATEST_S
        """End of the present action."""

    @property
    def pending(self) -> bool:
        if self.active:
            return self._end_s < LATEST_S
        return not self.begun and self._starts is None

    def wants(self, truth: Truth) -> bool:
        if self.active:
            return truth.t_s < self._end_s and not _holds(self._ends, truth, by_default=False)
        if truth.t_s < self.plan.window.start_s or truth.t_s >= self._last_s:
            return False
        return _holds(self._starts, truth, by_default=True)

    def end(self, end_s: float) -> None:
        self._last_s = end_s
        self._end_s = min(self._end_s, end_s)

    def change(self, active: bool, t_s: float) -> None:
        window = self.plan.window
        self.active = active
        if active:
            self.begun += 1
            self._end_s = self._last_s
            if window.duration_s is not None:
                self._end_s = min(self._end_s, t_s + window.duration_s)
        else:
            self.done = not window.repeat


def _holds(condition: Expression | None, truth: Truth, *, by_default: bool) -> bool:
    """Evaluate a condition; a division by zero counts as not holding."""
    if condition is None:
        return by_default
    try:
        return bool(condition(truth))
    except ZeroDivisionError:
        return False
