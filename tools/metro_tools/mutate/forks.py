"""Child processes with a time limit that report a short text."""

import json
import os
import resource
import select
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TextIO

from metro_tools.mutate.result import KILLED, SURVIVED, TIMED_OUT

EXIT_KILLED: Final = 1
EXIT_ANEW: Final = 77
"""Exit code of a mutant that cannot be swapped into loaded code; it needs a fresh process."""
CPU_FACTOR: Final = 5.0
CPU_FLOOR_S: Final = 2.0
"""Factor and minimum of the time limit against the tests' normal time. A mutant that exceeds it
counts as detected."""
WALL_FACTOR: Final = 5.0
MEMORY_BYTES: Final = 4 << 30
HEARD_BYTES: Final = 1 << 16


class Pool:
    """Runs up to `jobs` children at a time; `ended` receives the name, exit code and report of
    each.
    """

    def __init__(self, jobs: int, ended: Callable[[tuple[str, int], int, str], None]) -> None:
        self._jobs, self._ended = jobs, ended
        self._running: dict[TextIO, _Child] = {}

    def start(self, name: tuple[str, int], run: Callable[[TextIO], int], limit_s: float) -> None:
        """Wait for a free place and start a child.

        `limit_s` is the processor time that `run` needs without a mutant.
        """
        while len(self._running) >= self._jobs:
            self._reap()
        pid, pipe = fork(run, limit_s)
        self._running[pipe] = _Child(name, pid)

    def drain(self) -> None:
        while self._running:
            self._reap()

    def _reap(self) -> None:
        """Read the reports of all children once: a child blocks when its pipe is full."""
        ready, _, _ = select.select(list(self._running), [], [])
        for pipe in ready:
            child = self._running[pipe]
            heard = os.read(pipe.fileno(), HEARD_BYTES)
            if heard:
                child.told += heard
                continue
            del self._running[pipe]
            pipe.close()
            _, status = os.waitpid(child.pid, 0)
            self._ended(child.name, os.waitstatus_to_exitcode(status), child.told.decode())


@dataclass(slots=True)
class _Child:
    name: tuple[str, int]
    pid: int
    told: bytes = b""


def result_of(code: int) -> str:
    """Return the result of a mutant whose tests ended with this exit code."""
    if code in (-signal.SIGPROF, -signal.SIGALRM):
        return TIMED_OUT
    return KILLED if code else SURVIVED


def fork(run: Callable[[TextIO], int], limit_s: float = 0.0) -> tuple[int, TextIO]:
    """Start a child that runs `run`, and return its process id and its report; without a limit it
    may run for ever.
    """
    read_fd, write_fd = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        os.close(write_fd)
        return pid, os.fdopen(read_fd, encoding="utf-8")
    status = EXIT_KILLED
    try:
        os.close(read_fd)
        if limit_s:
            limit(limit_s)
        with os.fdopen(write_fd, "w", encoding="utf-8") as told:
            status = run(told)
    except SystemExit:
        status = EXIT_KILLED
    finally:
        os._exit(status)


def write_line(report: TextIO, **entry: object) -> None:
    report.write(json.dumps(entry) + "\n")
    report.flush()


def cpu_s() -> float:
    """Processor time of this process so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def limit(tests_s: float) -> None:
    """Let the kernel end this process after a time limit.

    Processor time counts, so a busy machine does not matter. `tests_s` is the time needed without a
    mutant.
    """
    limit_s = CPU_FLOOR_S + CPU_FACTOR * tests_s
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, limit_s)
    signal.setitimer(signal.ITIMER_REAL, WALL_FACTOR * limit_s)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
