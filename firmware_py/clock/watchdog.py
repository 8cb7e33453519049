"""Watchdogs: one that compares supplied instants with a limit, and one that ends a hanging
process.
"""

import signal
from collections.abc import Callable


class Watchdog:
    """Reports when a repeated event has been missing for too long.

    It has no thread of its own. The caller of `check` must not depend on what is supervised.
    """

    def __init__(self, limit_ns: int, on_bite: Callable[[int], None], start_ns: int) -> None:
        """Args:
        limit_ns: largest permitted silence.
        on_bite: called with the silence in ns, once each time the limit is exceeded.
        """
        if limit_ns <= 0:
            raise ValueError(f"limit_ns {limit_ns} is not positive")
        self._limit_ns = limit_ns
        self._on_bite = on_bite
        self._kicked_ns = start_ns
        self._bitten = False
        self.bites = 0

    def kick(self, now_ns: int) -> None:
        """Record that the supervised event happened."""
        self._kicked_ns = now_ns
        self._bitten = False

    def silent_ns(self, now_ns: int) -> int:
        return now_ns - self._kicked_ns

    def check(self, now_ns: int) -> bool:
        """Return whether the limit is kept; call `on_bite` at the first check after it was
        exceeded.
        """
        silent_ns = now_ns - self._kicked_ns
        if silent_ns <= self._limit_ns:
            return True
        if not self._bitten:
            self._bitten = True
            self.bites += 1
            self._on_bite(silent_ns)
        return False


class ProcessWatchdog:
    """Ends this process when it is not kicked in time, wherever it hangs.

    The kernel's timer sends SIGALRM, whose default action needs no Python. So it also ends endless
    loops and calls that never return. The other nodes notice the silence. A process has only one
    such watchdog; it counts real time, even while the process is stopped.
    """

    def __init__(self, limit_s: float) -> None:
        if not limit_s > 0.0:
            raise ValueError(f"limit_s {limit_s} is not positive")
        self._limit_s = limit_s

    def kick(self) -> None:
        """Restart the timer; the first kick starts it."""
        signal.setitimer(signal.ITIMER_REAL, self._limit_s)

    def stop(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
