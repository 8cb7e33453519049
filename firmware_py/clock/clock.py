"""The clocks: the only module of the project that reads time or waits for it."""

import ctypes
import errno
import sys
import time
from collections.abc import Callable
from typing import Final, Protocol

NS_PER_S: Final = 1_000_000_000
OFFSET_TRIES: Final = 5
TIMER_ABSTIME: Final = 1
REALTIME_SPIN_S: Final = 200e-6
"""Time at the end of a wait that is spent polling. It covers the wake-up latency of most hosts, for
0.4 % of a processor at a period of 50 ms."""
CLOCK_MONOTONIC: Final = 1


class Clock(Protocol):
    """Instants are whole nanoseconds that never run backwards. Their zero has no meaning."""

    @property
    def epoch_offset_ns(self) -> int:
        """Difference from an instant to nanoseconds since 1970; constant for the life of the
        clock.
        """
        ...

    def now_ns(self) -> int: ...

    def epoch_ns(self) -> int:
        """The present instant in nanoseconds since 1970, for the stamps of logs."""
        ...

    def wait_until(self, instant_ns: int) -> None:
        """Return as soon as possible at or after the instant; at once if it is past."""
        ...


class WallClock:
    """Real time from CLOCK_MONOTONIC, which cannot be set and is the same for all processes of this
    machine.

    The offset to the time of day is read once. A later correction of the time of day changes
    neither the schedule nor the distance between two stamps of a log.
    """

    def __init__(self, spin_s: float = 0.0) -> None:
        """Args:
        spin_s: length of the last part of every wait, which polls the clock without sleeping. It
            costs that share of a processor and removes the wake-up latency from the lateness.
        """
        if not spin_s >= 0.0:
            raise ValueError(f"spin_s {spin_s} is negative")
        self._spin_ns = round(spin_s * NS_PER_S)
        self._epoch_offset_ns = _epoch_offset_ns()
        self._sleep_until = _absolute_sleep() or _relative_sleep

    @property
    def epoch_offset_ns(self) -> int:
        return self._epoch_offset_ns

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def epoch_ns(self) -> int:
        return time.monotonic_ns() + self._epoch_offset_ns

    def wait_until(self, instant_ns: int) -> None:
        sleep_end_ns = instant_ns - self._spin_ns
        if time.monotonic_ns() < sleep_end_ns:
            self._sleep_until(sleep_end_ns)
        while time.monotonic_ns() < instant_ns:
            pass


class LockstepClock:
    """Virtual time: it stands still until a caller waits, and then jumps to the awaited instant."""

    def __init__(self, start_ns: int = 0, epoch_offset_ns: int = 0) -> None:
        """With the default offset a log of the run is stamped with the time since its start."""
        self._now_ns = start_ns
        self._epoch_offset_ns = epoch_offset_ns

    @property
    def epoch_offset_ns(self) -> int:
        return self._epoch_offset_ns

    def now_ns(self) -> int:
        return self._now_ns

    def epoch_ns(self) -> int:
        return self._now_ns + self._epoch_offset_ns

    def wait_until(self, instant_ns: int) -> None:
        if instant_ns > self._now_ns:
            self._now_ns = instant_ns


def _epoch_offset_ns() -> int:
    """Time of day minus monotonic time, from the attempt with the shortest reading time."""
    best_gap_ns, best_offset_ns = sys.maxsize, 0
    for _ in range(OFFSET_TRIES):
        before_ns = time.monotonic_ns()
        epoch_ns = time.time_ns()
        gap_ns = time.monotonic_ns() - before_ns
        if gap_ns < best_gap_ns:
            best_gap_ns, best_offset_ns = gap_ns, epoch_ns - before_ns - gap_ns // 2
    return best_offset_ns


def _relative_sleep(instant_ns: int) -> None:
    while (left_ns := instant_ns - time.monotonic_ns()) > 0:
        time.sleep(left_ns / NS_PER_S)


class _Timespec(ctypes.Structure):
    _fields_ = [("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long)]


def _absolute_sleep() -> Callable[[int], None] | None:
    """Return the kernel's absolute sleep, so that a delay before the call does not extend the
    sleep.

    Returns None where it is unavailable. A signal ends the kernel's sleep. Python then runs the
    signal handler, which may raise; otherwise the sleep to the same instant continues.
    """
    if not sys.platform.startswith("linux"):
        return None
    try:
        nanosleep = ctypes.CDLL(None).clock_nanosleep
    except (OSError, AttributeError):
        return None
    nanosleep.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
    nanosleep.restype = ctypes.c_int

    def sleep_until(instant_ns: int) -> None:
        reference = ctypes.byref(_Timespec(*divmod(instant_ns, NS_PER_S)))
        while (code := nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, reference, None)) == errno.EINTR:
            pass
        if code:
            _relative_sleep(instant_ns)

    return sleep_until
