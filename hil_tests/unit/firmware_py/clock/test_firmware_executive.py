"""The cyclic executive, against an oracle that keeps a list of all releases."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import Executive, Task, TaskReport, run
from firmware_py.clock.watchdog import Watchdog
from firmware_py.histogram import Histogram

NS_PER_MS = 1_000_000
NS_PER_US = 1_000


class StopwatchClock:
    """A scripted real-time clock: waits, wake-up latency and work advance it."""

    def __init__(self, wake_ns: int = 0) -> None:
        self._now_ns = 0
        self._wake_ns = wake_ns

    @property
    def epoch_offset_ns(self) -> int:
        return 0

    def now_ns(self) -> int:
        return self._now_ns

    def epoch_ns(self) -> int:
        return self._now_ns

    def wait_until(self, instant_ns: int) -> None:
        if instant_ns > self._now_ns:
            self._now_ns = instant_ns + self._wake_ns

    def spend(self, work_ns: int) -> None:
        self._now_ns += work_ns


def until_ms(end_ms: float) -> Callable[[int], bool]:
    return lambda now_ns: now_ns >= end_ms * NS_PER_MS


def idle(now_ns: int) -> None:
    """A task without work."""


def report_of(executive: Executive, name: str) -> TaskReport:
    return next(report for report in executive.report() if report.name == name)


@dataclass(frozen=True)
class Plan:
    """A task of the tests: its grid and the duration of each of its runs."""

    period_ms: int
    offset_ms: int
    work_ms: tuple[int, ...]


@dataclass(frozen=True)
class Began:
    task: str
    at_ns: int
    slips: int


def rhythm_by_hand(plans: list[Plan], end_ms: int, wake_ns: int) -> list[Began]:
    """Keep a list of all releases and strike off those that are served or past."""
    # No work that begins before the end takes longer than a second.
    grids = [list(range(plan.offset_ms, end_ms + 1000, plan.period_ms)) for plan in plans]
    runs = [0] * len(plans)
    now_ns, began = 0, list[Began]()
    while True:
        order = min(range(len(plans)), key=lambda order: (grids[order][0], order))
        release_ns = grids[order][0] * NS_PER_MS
        if release_ns > now_ns:
            now_ns = release_ns + wake_ns
        if now_ns >= end_ms * NS_PER_MS:
            return began
        past = [release_ms for release_ms in grids[order] if release_ms * NS_PER_MS <= now_ns]
        del grids[order][: len(past)]
        began.append(Began(f"t{order}", now_ns, len(past) - 1))
        work_ms = plans[order].work_ms
        now_ns += work_ms[runs[order] % len(work_ms)] * NS_PER_MS
        runs[order] += 1


def played(
    plans: list[Plan], end_ms: int, clock: StopwatchClock | LockstepClock
) -> tuple[list[Began], Executive]:
    """Run the same plans with the executive."""
    began: list[Began] = []
    runs = [0] * len(plans)

    def task_of(order: int) -> Task:
        plan, name = plans[order], f"t{order}"

        def work(now_ns: int) -> None:
            began.append(Began(name, now_ns, executive.slips_before(name)))
            if isinstance(clock, StopwatchClock):
                clock.spend(plan.work_ms[runs[order] % len(plan.work_ms)] * NS_PER_MS)
            runs[order] += 1

        return Task(name, plan.period_ms, work, offset_ms=plan.offset_ms)

    executive = Executive([task_of(order) for order in range(len(plans))], start_ns=0)
    run([executive], clock, until_ms(end_ms))
    return began, executive


PLANS = st.lists(
    st.builds(
        Plan,
        period_ms=st.integers(1, 12),
        offset_ms=st.integers(0, 15),
        work_ms=st.lists(st.integers(0, 30), min_size=1, max_size=4).map(tuple),
    ),
    min_size=1,
    max_size=4,
)


@given(PLANS, st.integers(1, 80), st.sampled_from([0, 1, 300_000, 999_999]))
def test_runs_and_slips_are_those_of_the_grid(plans: list[Plan], end_ms: int, wake_ns: int) -> None:
    """The tasks overrun in every way; each release is served once, or skipped and counted."""
    began, executive = played(plans, end_ms, StopwatchClock(wake_ns))

    assert began == rhythm_by_hand(plans, end_ms, wake_ns)
    for order in range(len(plans)):
        own = [entry for entry in began if entry.task == f"t{order}"]
        report = report_of(executive, f"t{order}")
        assert report.releases == len(own)
        assert report.slips == sum(entry.slips for entry in own)


@given(PLANS, st.integers(1, 80))
def test_lockstep_keeps_the_schedule_of_an_infinitely_fast_host(
    plans: list[Plan], end_ms: int
) -> None:
    timeless = [Plan(plan.period_ms, plan.offset_ms, (0,)) for plan in plans]

    in_lockstep, _ = played(timeless, end_ms, LockstepClock())
    in_real_time, _ = played(timeless, end_ms, StopwatchClock())

    assert in_lockstep == in_real_time == rhythm_by_hand(timeless, end_ms, 0)


@pytest.mark.parametrize("clock", [LockstepClock(), StopwatchClock()])
def test_equal_instants_are_ordered_by_executive_and_then_by_table(
    clock: LockstepClock | StopwatchClock,
) -> None:
    order: list[str] = []

    def named(name: str) -> Task:
        return Task(name, 10, lambda now_ns: order.append(name))

    plant = Executive([named("step"), named("send")], 0)
    vobc = Executive([named("control"), named("report")], 0)
    run([plant, vobc], clock, until_ms(20))

    assert order == ["step", "send", "control", "report"] * 2


@given(st.lists(st.integers(0, 60), max_size=4), PLANS)
def test_a_run_in_pieces_equals_one_in_a_single_piece(
    cuts_ms: list[int], plans: list[Plan]
) -> None:
    whole, _ = played(plans, 60, LockstepClock())
    began: list[tuple[str, int]] = []

    def task_of(order: int, plan: Plan) -> Task:
        name = f"t{order}"
        return Task(
            name,
            plan.period_ms,
            lambda now_ns: began.append((name, now_ns)),
            offset_ms=plan.offset_ms,
        )

    executive = Executive([task_of(order, plan) for order, plan in enumerate(plans)], 0)
    clock = LockstepClock()
    for cut_ms in [*sorted(cuts_ms), 60]:
        run([executive], clock, until_ms(cut_ms))

    assert began == [(entry.task, entry.at_ns) for entry in whole]


def test_nothing_runs_at_or_after_the_end() -> None:
    seen: list[int] = []
    executive = Executive([Task("task", 10, seen.append)], 0)

    run([executive], LockstepClock(), until_ms(30))

    assert seen == [0, 10 * NS_PER_MS, 20 * NS_PER_MS]
    assert executive.next_due_ns() == 30 * NS_PER_MS


def test_a_task_that_requests_the_end_runs_last() -> None:
    """The next run of the executive serves other tasks that are due at the same instant."""
    order: list[str] = []

    def said(name: str) -> Callable[[int], None]:
        return lambda _: order.append(name)

    executive = Executive(
        [Task(name, 10, said(name)) for name in ("a", "b", "c")],
        0,
    )

    run([executive], LockstepClock(), lambda now_ns: "b" in order)

    assert order == ["a", "b"]
    assert [task.name for task in executive.due(0)] == ["c"]


def test_lateness_work_and_overruns_of_a_real_run_are_counted() -> None:
    """Every wake-up is 70 µs late; the work takes 1 ms, every fourth time 3 ms, with a budget of
    2 ms."""
    clock = StopwatchClock(wake_ns=70 * NS_PER_US)
    runs = 0

    def work(now_ns: int) -> None:
        nonlocal runs
        runs += 1
        clock.spend((3 if runs % 4 == 0 else 1) * NS_PER_MS)

    executive = Executive([Task("control", 50, work, budget_ms=2)], 0)
    run([executive], clock, until_ms(50 * 100))

    assert executive.report() == (
        TaskReport(
            name="control",
            period_ms=50,
            releases=100,
            slips=0,
            overruns=25,
            lateness_us_p50=70,
            # The first release is at the start itself, where the executive did not wait.
            lateness_us_p99=70,
            lateness_us_max=70,
            # 1000 shares its bucket with the values up to 1007.
            execution_us_p50=1007,
            execution_us_p99=3000,
            execution_us_max=3000,
        ),
    )
    assert executive.lateness_ns("control") == 70 * NS_PER_US
    assert executive.execution_ns("control") == 3 * NS_PER_MS


def test_work_of_exactly_the_budget_is_no_overrun() -> None:
    clock = StopwatchClock()
    executive = Executive([Task("a", 10, lambda now_ns: clock.spend(2_000_000), budget_ms=2)], 0)

    run([executive], clock, until_ms(50))

    assert executive.report()[0].overruns == 0


def test_a_stall_of_three_and_a_half_periods_is_three_slips_and_the_grid_stays() -> None:
    clock = StopwatchClock()
    seen: list[tuple[int, int]] = []

    def work(now_ns: int) -> None:
        seen.append((now_ns // NS_PER_MS, executive.slips_before("control")))
        clock.spend((175 if now_ns == 0 else 1) * NS_PER_MS)

    executive = Executive([Task("control", 50, work)], 0)
    run([executive], clock, until_ms(300))

    # The release at 50 begins at 175; those at 100 and 150 are skipped.
    assert seen == [(0, 0), (175, 2), (200, 0), (250, 0)]
    assert executive.report()[0].slips == 2


def test_in_virtual_time_nothing_is_late_and_nothing_takes_time() -> None:
    executive = Executive([Task("a", 10, idle, budget_ms=0.001), Task("b", 20, idle)], 0)

    run([executive], LockstepClock(), until_ms(100))

    a, b = executive.report()
    assert (a.releases, b.releases) == (10, 5)
    for report in (a, b):
        assert (report.slips, report.overruns) == (0, 0)
        assert report.lateness_us_max == report.lateness_us_p99 == report.lateness_us_p50 == 0
        assert report.execution_us_max == report.execution_us_p99 == report.execution_us_p50 == 0


def test_a_lockstep_clock_that_is_ahead_causes_slips() -> None:
    seen: list[int] = []
    executive = Executive([Task("late", 10, seen.append)], 0)

    run([executive], LockstepClock(35 * NS_PER_MS), until_ms(55))

    assert seen == [35 * NS_PER_MS, 40 * NS_PER_MS, 50 * NS_PER_MS]
    assert executive.report()[0].slips == 3


def test_a_failing_task_ends_the_loop_and_its_release_is_not_repeated() -> None:
    seen: list[int] = []

    def fail_once(now_ns: int) -> None:
        seen.append(now_ns // NS_PER_MS)
        if now_ns == 20 * NS_PER_MS:
            raise ArithmeticError("on purpose")

    executive, clock = Executive([Task("task", 10, fail_once)], 0), LockstepClock()
    with pytest.raises(ArithmeticError):
        run([executive], clock, until_ms(100))
    run([executive], clock, until_ms(50))

    assert seen == [0, 10, 20, 30, 40]


def test_at_a_given_time_every_due_task_runs_once() -> None:
    order: list[tuple[str, int]] = []
    executive = Executive(
        [
            Task("slow", 100, lambda now_ns: order.append(("slow", now_ns))),
            Task("fast", 10, lambda now_ns: order.append(("fast", now_ns)), offset_ms=-0.0),
            Task("later", 10, lambda now_ns: order.append(("later", now_ns)), offset_ms=5),
        ],
        start_ns=1000 * NS_PER_MS,
    )
    now_ns = 1027 * NS_PER_MS

    assert executive.next_due_ns() == 1000 * NS_PER_MS
    assert executive.run_due(999 * NS_PER_MS) == 0
    assert [task.name for task in executive.due(now_ns)] == ["slow", "fast", "later"]
    assert executive.run_due(now_ns) == 3
    assert executive.run_due(now_ns) == 0
    assert order == [("slow", now_ns), ("fast", now_ns), ("later", now_ns)]
    assert executive.slips_before("fast") == 2
    assert executive.slips_before("later") == 2
    assert executive.next_due_ns() == 1030 * NS_PER_MS


def test_the_grid_moves_to_a_later_start_only_before_the_first_release() -> None:
    seen: list[int] = []
    executive = Executive([Task("task", 10, seen.append, offset_ms=3)], 0)

    executive.start_at(70 * NS_PER_MS)
    run([executive], LockstepClock(), until_ms(90))

    assert seen == [73 * NS_PER_MS, 83 * NS_PER_MS]
    assert executive.report()[0].slips == 0
    with pytest.raises(AssertionError, match="runs already"):
        executive.start_at(0)


@pytest.mark.parametrize("period_ms", [20, 20.0, 0.1, 33.333333, 1e-6, 1000.0])
def test_a_period_is_a_whole_number_of_nanoseconds(period_ms: float) -> None:
    """The tenth release is ten whole periods away, whatever the float."""
    seen: list[int] = []
    executive = Executive([Task("task", period_ms, seen.append)], 0)

    run([executive], LockstepClock(), lambda now_ns: len(seen) == 11)

    assert seen == [k * seen[1] for k in range(11)]
    assert seen[1] == pytest.approx(period_ms * 1e6, abs=1e-3)


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("period_ms", 0, "not positive"),
        ("period_ms", -20, "not positive"),
        ("period_ms", 1000 / 60, "whole number of nanoseconds"),
        ("period_ms", 1e-7, "whole number of nanoseconds"),
        ("period_ms", float("nan"), "not a time"),
        ("period_ms", float("inf"), "not a time"),
        ("offset_ms", -1, "negative"),
        ("offset_ms", float("nan"), "not a time"),
        ("budget_ms", 0, "not positive"),
        ("budget_ms", float("inf"), "not a time"),
    ],
)
def test_an_impossible_time_is_refused_with_task_key_and_value(
    key: str, value: float, why: str
) -> None:
    times = {"period_ms": 10.0, key: value}

    with pytest.raises(ValueError, match=why) as caught:
        Task("control", run=idle, **times)

    for part in ("control", key, str(value)):
        assert part in str(caught.value)


def test_a_table_needs_tasks_and_names_that_differ() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Executive([], 0)
    with pytest.raises(ValueError, match="same name"):
        Executive([Task("a", 10, idle), Task("a", 20, idle)], 0)
    with pytest.raises(ValueError, match="nothing to run"):
        run([], LockstepClock(), until_ms(1))


@given(st.lists(st.integers(0, 2**42), max_size=200), st.floats(0.01, 100.0))
def test_a_percentile_is_never_too_low_and_at_most_a_64th_too_high(
    values: list[int], percent: float
) -> None:
    """The oracle is the sorted list: the least value that at least this percentage does not
    exceed."""
    histogram = Histogram()
    for value in values:
        histogram.add(value)

    found = histogram.percentile(percent)

    assert histogram.count == len(values)
    assert histogram.max == max(values, default=0)
    if not values:
        assert found == 0
        return
    exact = next(
        value
        for rank, value in enumerate(sorted(values), start=1)
        if rank * 100.0 >= len(values) * percent
    )
    assert found >= exact
    if exact < 2**40:
        assert found <= exact * (1 + 1 / 64)
    assert found <= max(values)


def test_an_hour_of_lateness_needs_no_more_memory_than_a_second() -> None:
    histogram = Histogram()
    for value in range(0, 2**20, 7):
        histogram.add(value)
    for shift in range(100):
        histogram.add(1 << shift)

    assert len(histogram._buckets) <= 64 * 35


def test_a_watchdog_fires_once_past_its_limit_and_again_after_a_kick() -> None:
    bites: list[int] = []
    watchdog = Watchdog(150, bites.append, start_ns=1000)

    checks = [watchdog.check(now_ns) for now_ns in (1000, 1149, 1150, 1151, 1400)]
    assert checks == [True, True, True, False, False]
    assert bites == [151]

    watchdog.kick(2000)
    assert watchdog.check(2150)
    assert watchdog.silent_ns(2150) == 150
    assert not watchdog.check(2151)
    assert bites == [151, 151]
    assert watchdog.bites == 2


def test_a_watchdog_fires_when_control_is_silent_for_three_cycles() -> None:
    """The control task stops after 200 ms; the watchdog task checks every 10 ms."""
    bitten_ms: list[float] = []
    clock = LockstepClock()
    watchdog = Watchdog(
        3 * 50 * NS_PER_MS, lambda silent_ns: bitten_ms.append(clock.now_ns() / NS_PER_MS), 0
    )

    def control(now_ns: int) -> None:
        if now_ns <= 200 * NS_PER_MS:
            watchdog.kick(now_ns)

    def watch(now_ns: int) -> None:
        watchdog.check(now_ns)

    run(
        [Executive([Task("control", 50, control), Task("watch", 10, watch)], 0)],
        clock,
        until_ms(1000),
    )

    assert bitten_ms == [360]


@pytest.mark.parametrize("limit_ns", [0, -5])
def test_a_watchdog_without_a_positive_limit_is_refused(limit_ns: int) -> None:
    with pytest.raises(ValueError, match="limit_ns"):
        Watchdog(limit_ns, idle, 0)
