"""The clocks: instants never run backwards and waits never end early."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.clock import clock as clock_module
from firmware_py.clock.clock import LockstepClock, WallClock

NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000
YEAR_NS = 365 * 86_400 * NS_PER_S


class ScriptedTime:
    """Replaces the module `time` with scripted readings."""

    def __init__(self, monotonic_ns: list[int], time_ns: list[int]) -> None:
        self._monotonic, self._epoch = iter(monotonic_ns), iter(time_ns)

    def monotonic_ns(self) -> int:
        return next(self._monotonic)

    def time_ns(self) -> int:
        return next(self._epoch)


@pytest.mark.parametrize("spin_s", [0.0, 0.0005, 1.0])
def test_a_wait_never_ends_before_its_instant(spin_s: float) -> None:
    clock = WallClock(spin_s)

    for wait_ns in (0, 1, 1_000, 300_000, 2 * NS_PER_MS):
        instant_ns = clock.now_ns() + wait_ns
        clock.wait_until(instant_ns)

        assert clock.now_ns() >= instant_ns


def test_without_the_kernels_absolute_sleep_a_wait_takes_as_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(clock_module, "_absolute_sleep", lambda: None)
    clock = WallClock()
    instant_ns = clock.now_ns() + 2 * NS_PER_MS

    clock.wait_until(instant_ns)

    assert clock.now_ns() >= instant_ns


def test_on_another_system_there_is_no_absolute_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")

    assert clock_module._absolute_sleep() is None


def test_a_wait_for_the_past_does_not_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = WallClock(spin_s=0.001)
    monkeypatch.setattr(clock, "_sleep_until", lambda instant_ns: pytest.fail("it slept"))

    clock.wait_until(clock.now_ns() - 1)
    clock.wait_until(0)


@pytest.fixture
def alarms() -> Iterator[list[int]]:
    """The signals that this process received; the first one comes after 2 ms."""
    heard: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        heard.append(number)

    before = signal.signal(signal.SIGALRM, note)
    signal.setitimer(signal.ITIMER_REAL, 0.002, 0.002)
    yield heard
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def test_signals_are_handled_during_a_wait_and_do_not_shorten_it(alarms: list[int]) -> None:
    clock = WallClock()
    instant_ns = clock.now_ns() + 20 * NS_PER_MS

    clock.wait_until(instant_ns)

    assert clock.now_ns() >= instant_ns
    assert alarms


def test_an_interrupt_ends_a_wait_that_would_last_a_year() -> None:
    """Ctrl-C must not wait for the next release."""
    clock = WallClock()

    def raise_it(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, raise_it)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.005)
        with pytest.raises(KeyboardInterrupt):
            clock.wait_until(clock.now_ns() + YEAR_NS)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_two_threads_may_wait_on_one_clock() -> None:
    """Each thread has its own instant and is not woken by the other's."""
    clock = WallClock()
    start_ns = clock.now_ns()
    woken_ns: dict[int, int] = {}

    def wait(wait_ms: int) -> None:
        clock.wait_until(start_ns + wait_ms * NS_PER_MS)
        woken_ns[wait_ms] = clock.now_ns()

    threads = [threading.Thread(target=wait, args=(wait_ms,)) for wait_ms in (30, 10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    for wait_ms, instant_ns in woken_ns.items():
        assert instant_ns >= start_ns + wait_ms * NS_PER_MS


def test_a_corrected_time_of_day_does_not_jump_the_stamps(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = WallClock()
    honest_ns = time.time_ns
    before_ns = clock.epoch_ns()

    monkeypatch.setattr(time, "time_ns", lambda: honest_ns() + YEAR_NS)
    after_ns = clock.epoch_ns()

    assert before_ns <= after_ns < before_ns + YEAR_NS // 2
    instant_ns = clock.now_ns()
    assert clock.epoch_ns() - instant_ns - clock.epoch_offset_ns >= 0


def test_the_offset_comes_from_the_shortest_reading(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The third of five readings takes 2 ns, so the time of day belongs to the middle of it."""
    gaps_ns = [500, 90, 2, 40, 1_000_000]
    monotonic_ns = [
        reading for k, gap_ns in enumerate(gaps_ns) for reading in (k * 10_000, k * 10_000 + gap_ns)
    ]
    epoch_ns = [7_000_000 + k * 10_000 + k for k in range(5)]
    monkeypatch.setattr(clock_module, "time", ScriptedTime(monotonic_ns, epoch_ns))

    assert clock_module._epoch_offset_ns() == 7_000_002 - 1


@pytest.mark.parametrize("spin_s", [-0.001, float("nan")])
def test_a_spin_of_negative_length_is_refused(spin_s: float) -> None:
    with pytest.raises(ValueError, match="spin_s"):
        WallClock(spin_s)


@given(st.integers(-YEAR_NS, YEAR_NS), st.lists(st.integers(-YEAR_NS, YEAR_NS)))
def test_virtual_time_is_the_latest_requested_instant(
    start_ns: int, instants_ns: list[int]
) -> None:
    clock = LockstepClock(start_ns)
    seen_ns = [clock.now_ns()]
    for instant_ns in instants_ns:
        clock.wait_until(instant_ns)
        seen_ns.append(clock.now_ns())

    assert seen_ns == sorted(seen_ns)
    assert seen_ns[-1] == max([start_ns, *instants_ns])


def test_a_lockstep_log_is_stamped_with_the_time_since_start_by_default() -> None:
    plain, dated = LockstepClock(), LockstepClock(epoch_offset_ns=YEAR_NS)
    for clock in (plain, dated):
        clock.wait_until(5)

    assert (plain.epoch_ns(), plain.epoch_offset_ns) == (5, 0)
    assert (dated.epoch_ns(), dated.epoch_offset_ns) == (YEAR_NS + 5, YEAR_NS)
