"""Watchdogs: one that is told the time and tells of silence, one that ends a process that hangs."""

import signal
from collections.abc import Callable


class Watchdog:
    """Tells when something that should happen again and again has been silent for too long.

    It has no thread of its own: whoever calls `check` must not depend on what is watched.
    """

    def __init__(self, limit_ns: int, on_bite: Callable[[int], None], start_ns: int) -> None:
        """Args:
        limit_ns: silence of exactly this length is still allowed.
        on_bite: told the silence in ns, once for each time the limit is passed.
        """
        if limit_ns <= 0:
            raise ValueError(f"limit_ns {limit_ns} is not positive")
        self._limit_ns = limit_ns
        self._on_bite = on_bite
        self._kicked_ns = start_ns
        self._bitten = False
        self.bites = 0

    def kick(self, now_ns: int) -> None:
        """The watched one lives."""
        self._kicked_ns = now_ns
        self._bitten = False

    def silent_ns(self, now_ns: int) -> int:
        return now_ns - self._kicked_ns

    def check(self, now_ns: int) -> bool:
        """Whether the limit is kept; bites at the first check after it was passed."""
        silent_ns = now_ns - self._kicked_ns
        if silent_ns <= self._limit_ns:
            return True
        if not self._bitten:
            self._bitten = True
            self.bites += 1
            self._on_bite(silent_ns)
        return False


class ProcessWatchdog:
    """Ends this process when it is not kicked in time, whatever it hangs in.

    The kernel's timer sends SIGALRM, whose default action needs no Python, so neither a loop that
    never ends nor a call that never returns escapes it. Whoever listens notices the silence.
    One for each process; it counts real time, a stopped process included.
    """

    def __init__(self, limit_s: float) -> None:
        if not limit_s > 0.0:
            raise ValueError(f"limit_s {limit_s} is not positive")
        self._limit_s = limit_s

    def kick(self) -> None:
        """The process lives; the first kick starts the timer."""
        signal.setitimer(signal.ITIMER_REAL, self._limit_s)

    def stop(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
