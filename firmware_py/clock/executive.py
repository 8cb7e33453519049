"""The cyclic executive: tasks released on a fixed grid of instants, and the one loop that waits.

Overrun policy: a task that has begun is always finished. A run that exceeds its budget is counted
as an overrun, without other effects. When a task begins so late that further releases of it are
already past, those are skipped and counted as slips. The task can read their number, and its next
release is the next instant of the unchanged grid. So lateness never accumulates, no release runs
twice, and a task that is too slow for its period runs as often as possible.
"""

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.clock.clock import Clock, LockstepClock
from firmware_py.histogram import Histogram

NS_PER_MS: Final = 1_000_000
NS_TOLERANCE: Final = 1e-3
WOKEN_PERIOD_MS: Final = 3_600_000.0
"""Placeholder in reports for the period of a task without one."""

Run = Callable[[int], None]
Observer = Callable[[str, int, int], None]
"""Callback with the task's name, the begin of this run, and the duration of its last run."""


@dataclass(frozen=True, slots=True)
class Task:
    """One entry of a task table.

    Raises ValueError when a time is not a whole number of nanoseconds, because tasks of the same
    rate would drift apart on a rounded grid.
    """

    name: str
    period_ms: float
    run: Run
    """Called with the instant at which the run begins, at or after the release."""
    offset_ms: float = 0.0
    """First release, counted from the start of the executive."""
    budget_ms: float | None = None
    """A longer run counts as an overrun; None disables this supervision."""

    def __post_init__(self) -> None:
        if self.period_ns <= 0:
            raise ValueError(f"task {self.name}: period_ms {self.period_ms} is not positive")
        if self.offset_ns < 0:
            raise ValueError(f"task {self.name}: offset_ms {self.offset_ms} is negative")
        if self.budget_ns is not None and self.budget_ns <= 0:
            raise ValueError(f"task {self.name}: budget_ms {self.budget_ms} is not positive")

    @property
    def period_ns(self) -> int:
        return _whole_ns(self.name, "period_ms", self.period_ms)

    @property
    def offset_ns(self) -> int:
        return _whole_ns(self.name, "offset_ms", self.offset_ms)

    @property
    def budget_ns(self) -> int | None:
        if self.budget_ms is None:
            return None
        return _whole_ns(self.name, "budget_ms", self.budget_ms)


@dataclass(frozen=True, slots=True)
class TaskReport:
    """Statistics of one task. In virtual time lateness and execution time are always zero."""

    name: str
    period_ms: float
    releases: int
    """Number of runs begun, without skipped releases."""
    slips: int
    """Number of releases skipped because they were past when an earlier one began."""
    overruns: int
    """Number of runs that took longer than their budget."""
    lateness_us_p50: float
    lateness_us_p99: float
    lateness_us_max: float
    execution_us_p50: float
    execution_us_p99: float
    execution_us_max: float


class Executive:
    """The task table of one device. It has no clock and never waits."""

    def __init__(self, tasks: Iterable[Task], start_ns: int) -> None:
        """Tasks released at the same instant run in the order given here.

        Raises:
            ValueError: for an empty table or a duplicate name.
        """
        self._slots = [_Slot(task, start_ns) for task in tasks]
        self._by_name = {slot.task.name: slot for slot in self._slots}
        if not self._slots:
            raise ValueError("an executive needs at least one task")
        if len(self._by_name) != len(self._slots):
            raise ValueError("two tasks of one executive have the same name")

    @classmethod
    def woken(cls, name: str, run: Callable[[int], int], first_ns: int) -> "Executive":
        """Create an executive with one task without a period: each run returns the instant of the
        next one.

        An instant that is not in the future means at once. Such a task has no slips.
        """
        executive = cls([Task(name, WOKEN_PERIOD_MS, _no_run)], first_ns)
        slot = executive._slots[0]

        def run_and_ask(now_ns: int) -> None:
            slot.next_ns = run(now_ns)

        slot.run, slot.woken = run_and_ask, True
        return executive

    def observe(self, began: Observer, ended: Callable[[], None]) -> None:
        """Call `began` before each run and `ended` after it, even after an exception."""
        for slot in self._slots:
            slot.run = _observed(slot, slot.run, began, ended)

    def run_next(self, now_ns: int, execution_ns: int | None = None) -> str | None:
        """Run only the task that `run` would begin first, if it is due, and return its name.

        Args:
            execution_ns: duration of its last run, for the replay of a recorded schedule.
        """
        slot = min(self._slots, key=lambda each: each.next_ns)
        if slot.next_ns > now_ns:
            return None
        if execution_ns is not None:
            slot.execution_ns = execution_ns
        slot.begin(now_ns)
        slot.run(now_ns)
        return slot.task.name

    def start_at(self, start_ns: int) -> None:
        """Move the whole grid to another start, before any release.

        It serves a process that works between creating its tables and running them. Otherwise the
        first releases would already be late.
        """
        assert not any(slot.begun for slot in self._slots), "the executive runs already"
        for slot in self._slots:
            slot.next_ns = start_ns + slot.task.offset_ns

    @property
    def tasks(self) -> tuple[Task, ...]:
        return tuple(slot.task for slot in self._slots)

    def next_due_ns(self) -> int:
        return min(slot.next_ns for slot in self._slots)

    def due(self, now_ns: int) -> list[Task]:
        """Return the tasks that `run_due` would run, in that order, without running them."""
        return [slot.task for slot in self._due_slots(now_ns)]

    def run_due(self, now_ns: int) -> int:
        """Run every task with a release at or before now, once each; returns how many ran."""
        slots = self._due_slots(now_ns)
        for slot in slots:
            slot.begin(now_ns)
            slot.run(now_ns)
        return len(slots)

    def slips_before(self, name: str) -> int:
        """Number of releases skipped directly before the present or last run of the task."""
        return self._by_name[name].slips_before

    def lateness_ns(self, name: str) -> int:
        """Time from the release to the begin of the present or last run of the task."""
        return self._by_name[name].lateness_ns

    def execution_ns(self, name: str) -> int:
        """Duration of the last completed run of the task; 0 before the first."""
        return self._by_name[name].execution_ns

    def report(self) -> tuple[TaskReport, ...]:
        """Return one report for each task, in the order of the table."""
        return tuple(slot.report() for slot in self._slots)

    def _due_slots(self, now_ns: int) -> list["_Slot"]:
        # The sort is stable, so the order of the table decides between equal releases.
        due = [slot for slot in self._slots if slot.next_ns <= now_ns]
        return sorted(due, key=lambda slot: slot.next_ns)


def run(executives: Sequence[Executive], clock: Clock, until: Callable[[int], bool]) -> None:
    """Run every release at its instant until `until(now_ns)` returns True.

    The earliest release comes first; between equal ones the order of the executives and then of
    their tables decides. `until` is called before each release, at its instant. A release that it
    stops stays pending, so a run in two parts equals one in a single part. An exception of a task
    or of `until` ends the loop and propagates.
    """
    slots = [slot for executive in executives for slot in executive._slots]
    if not slots:
        raise ValueError("there is nothing to run")
    heap = [(slot.next_ns, order, slot) for order, slot in enumerate(slots)]
    heapq.heapify(heap)
    if isinstance(clock, LockstepClock):
        _run_lockstep(heap, clock, until)
    else:
        _run_timed(heap, clock, until)


class _Slot:
    """A task with its next release and its statistics."""

    __slots__ = (
        "begun",
        "budget_ns",
        "execution_ns",
        "execution_us",
        "lateness_ns",
        "lateness_us",
        "next_ns",
        "overruns",
        "period_ns",
        "run",
        "slips",
        "slips_before",
        "task",
        "woken",
    )

    def __init__(self, task: Task, start_ns: int) -> None:
        self.task = task
        self.run = task.run
        self.period_ns = task.period_ns
        self.budget_ns = task.budget_ns
        self.next_ns = start_ns + task.offset_ns
        self.woken = False
        """Each run sets the next release itself."""
        self.begun = 0
        self.slips = 0
        self.slips_before = 0
        self.overruns = 0
        self.lateness_ns = 0
        self.execution_ns = 0
        self.lateness_us = Histogram()
        self.execution_us = Histogram()

    def begin(self, now_ns: int) -> None:
        """Account for the release that begins now, and set the next one after now."""
        lateness_ns = now_ns - self.next_ns
        assert lateness_ns >= 0, "the clock woke too early"
        missed = lateness_ns // self.period_ns
        self.lateness_ns = lateness_ns
        self.slips_before = missed
        self.slips += missed
        self.begun += 1
        self.next_ns += (missed + 1) * self.period_ns

    def end(self, execution_ns: int) -> None:
        self.execution_ns = execution_ns
        self.lateness_us.add(self.lateness_ns // 1000)
        self.execution_us.add(execution_ns // 1000)
        if self.budget_ns is not None and execution_ns > self.budget_ns:
            self.overruns += 1

    def report(self) -> TaskReport:
        return TaskReport(
            name=self.task.name,
            period_ms=self.task.period_ms,
            releases=self.begun,
            slips=self.slips,
            overruns=self.overruns,
            lateness_us_p50=self.lateness_us.percentile(50.0),
            lateness_us_p99=self.lateness_us.percentile(99.0),
            lateness_us_max=self.lateness_us.max,
            execution_us_p50=self.execution_us.percentile(50.0),
            execution_us_p99=self.execution_us.percentile(99.0),
            execution_us_max=self.execution_us.max,
        )


_Heap = list[tuple[int, int, _Slot]]


def _run_timed(heap: _Heap, clock: Clock, until: Callable[[int], bool]) -> None:
    now, wait_until = clock.now_ns, clock.wait_until
    while True:
        release_ns, order, slot = heap[0]
        wait_until(release_ns)
        begin_ns = now()
        if until(begin_ns):
            return
        slot.begin(begin_ns)
        if not slot.woken:
            heapq.heapreplace(heap, (slot.next_ns, order, slot))
        slot.run(begin_ns)
        slot.end(now() - begin_ns)
        if slot.woken:
            heapq.heapreplace(heap, (slot.next_ns, order, slot))


def _run_lockstep(heap: _Heap, clock: LockstepClock, until: Callable[[int], bool]) -> None:
    """Do the same as `_run_timed` without measuring times that are zero in virtual time."""
    now_ns, replace = clock.now_ns(), heapq.heapreplace
    while True:
        release_ns, order, slot = heap[0]
        if release_ns > now_ns:
            clock.wait_until(release_ns)
            now_ns = release_ns
        if until(now_ns):
            return
        if slot.woken:
            slot.begun += 1
            slot.run(now_ns)
            replace(heap, (slot.next_ns, order, slot))
            continue
        if release_ns == now_ns:
            slot.begun += 1
            slot.slips_before = 0
            slot.next_ns = release_ns = release_ns + slot.period_ns
        else:
            slot.begin(now_ns)
            release_ns = slot.next_ns
        replace(heap, (release_ns, order, slot))
        slot.run(now_ns)


def _observed(slot: _Slot, run: Run, began: Observer, ended: Callable[[], None]) -> Run:
    def run_observed(now_ns: int) -> None:
        began(slot.task.name, now_ns, slot.execution_ns)
        try:
            run(now_ns)
        finally:
            ended()

    return run_observed


def _no_run(now_ns: int) -> None:
    """Placeholder in the table of an executive whose task is set later."""


def _whole_ns(task: str, key: str, value_ms: float) -> int:
    value_ns = value_ms * NS_PER_MS
    if not abs(value_ns) < float(1 << 62):
        raise ValueError(f"task {task}: {key} {value_ms} is not a time")
    whole_ns = round(value_ns)
    if abs(value_ns - whole_ns) > NS_TOLERANCE:
        raise ValueError(f"task {task}: {key} {value_ms} is not a whole number of nanoseconds")
    return whole_ns
