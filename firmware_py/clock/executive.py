"""The cyclic executive: tasks released on a fixed grid of instants, and the one loop that waits.

The overrun policy. A task that was begun is always finished. A run that takes longer than its
budget is counted as an overrun and changes nothing else. When a task is begun so late that further
releases of it are already past, those are skipped and counted as slips, the task can read how many,
and the next release is the next instant of the unchanged grid. So lateness never adds up, no
release runs twice, and a task that is too slow for its period runs as often as it can.
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
"""Stands in the reports for the period of a task that has none."""

Run = Callable[[int], None]
Observer = Callable[[str, int, int], None]
"""Told name, instant of the beginning, and how long the run of the same task before it took."""


@dataclass(frozen=True, slots=True)
class Task:
    """One line of a task table.

    Raises ValueError when a time is not a whole number of nanoseconds: on a rounded grid two tasks
    of the same rate would drift apart.
    """

    name: str
    period_ms: float
    run: Run
    """Is told the instant at which it is begun, at or after the release."""
    offset_ms: float = 0.0
    """First release, counted from the start of the executive."""
    budget_ms: float | None = None
    """A run that takes longer counts as an overrun; None supervises nothing."""

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
    """What one task did so far. In virtual time nothing is ever late and nothing takes time."""

    name: str
    period_ms: float
    releases: int
    """Begun, so without the skipped ones."""
    slips: int
    """Releases that were skipped because they were past when an earlier one was begun."""
    overruns: int
    """Runs that took longer than their budget."""
    lateness_us_p50: float
    lateness_us_p99: float
    lateness_us_max: float
    execution_us_p50: float
    execution_us_p99: float
    execution_us_max: float


class Executive:
    """The task table of one device. Holds no clock and never waits."""

    def __init__(self, tasks: Iterable[Task], start_ns: int) -> None:
        """Tasks that are released at the same instant run in the order given here.

        Raises:
            ValueError: for an empty table or a name that occurs twice.
        """
        self._slots = [_Slot(task, start_ns) for task in tasks]
        self._by_name = {slot.task.name: slot for slot in self._slots}
        if not self._slots:
            raise ValueError("an executive needs at least one task")
        if len(self._by_name) != len(self._slots):
            raise ValueError("two tasks of one executive have the same name")

    @classmethod
    def woken(cls, name: str, run: Callable[[int], int], first_ns: int) -> "Executive":
        """One task without a period: each run answers the instant at which it wants to run next.

        An instant that is not ahead means at once. Such a task has no slips.
        """
        executive = cls([Task(name, WOKEN_PERIOD_MS, _no_run)], first_ns)
        slot = executive._slots[0]

        def run_and_ask(now_ns: int) -> None:
            slot.next_ns = run(now_ns)

        slot.run, slot.woken = run_and_ask, True
        return executive

    def observe(self, began: Observer, ended: Callable[[], None]) -> None:
        """Tell of each run, before it begins and when it is over, however it ends."""
        for slot in self._slots:
            slot.run = _observed(slot, slot.run, began, ended)

    def run_next(self, now_ns: int, execution_ns: int | None = None) -> str | None:
        """Run only the task that `run` would begin first, if it is due; answers which.

        Args:
            execution_ns: how long the run before it took, for a rhythm that is run again.
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
        """Move the whole grid to another start, as long as nothing was released.

        For a process that has work to do between making its tables and running them; otherwise the
        first releases would be late before anything began.
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
        """What `run_due` would run, in that order. Changes nothing."""
        return [slot.task for slot in self._due_slots(now_ns)]

    def run_due(self, now_ns: int) -> int:
        """Run every task with a release at or before now, once each; answers how many ran."""
        slots = self._due_slots(now_ns)
        for slot in slots:
            slot.begin(now_ns)
            slot.run(now_ns)
        return len(slots)

    def slips_before(self, name: str) -> int:
        """Releases of the task skipped directly before the one that runs now or ran last."""
        return self._by_name[name].slips_before

    def lateness_ns(self, name: str) -> int:
        """From the release to the beginning of the run of the task that runs now or ran last."""
        return self._by_name[name].lateness_ns

    def execution_ns(self, name: str) -> int:
        """How long the last run of the task took that is over; 0 before the first."""
        return self._by_name[name].execution_ns

    def report(self) -> tuple[TaskReport, ...]:
        """One entry for each task, in the order of the table."""
        return tuple(slot.report() for slot in self._slots)

    def _due_slots(self, now_ns: int) -> list["_Slot"]:
        # The sort is stable, so the order of the table decides among equal releases.
        due = [slot for slot in self._slots if slot.next_ns <= now_ns]
        return sorted(due, key=lambda slot: slot.next_ns)


def run(executives: Sequence[Executive], clock: Clock, until: Callable[[int], bool]) -> None:
    """Run every release at its instant until `until(now_ns)` says so.

    The earliest release comes first; among equal ones the order of the executives and then of their
    tables decides. `until` is asked before each release, when its instant has come; the releases
    that it stops are still ahead, so a run in two pieces equals one in a single piece. An exception
    of a task or of `until` ends the loop and passes through.
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
    """A task with the instant of its next release and what it did so far."""

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
        """Each run says itself when the next one is."""
        self.begun = 0
        self.slips = 0
        self.slips_before = 0
        self.overruns = 0
        self.lateness_ns = 0
        self.execution_ns = 0
        self.lateness_us = Histogram()
        self.execution_us = Histogram()

    def begin(self, now_ns: int) -> None:
        """Account for the release that is begun now and find the next one, ahead of now."""
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
    """As `_run_timed`, without measuring what virtual time makes zero."""
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
    """Stands in the table of an executive whose task is told later."""


def _whole_ns(task: str, key: str, value_ms: float) -> int:
    value_ns = value_ms * NS_PER_MS
    if not abs(value_ns) < float(1 << 62):
        raise ValueError(f"task {task}: {key} {value_ms} is not a time")
    whole_ns = round(value_ns)
    if abs(value_ns - whole_ns) > NS_TOLERANCE:
        raise ValueError(f"task {task}: {key} {value_ms} is not a whole number of nanoseconds")
    return whole_ns
