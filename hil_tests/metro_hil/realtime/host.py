"""Measures, second by second, what processor time the host withheld from a run."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.clock.realtime import steal_ns
from firmware_py.storage.recorder import LineLog

COLUMNS: Final = (
    "t_s",
    "steal_ms",
    "controller_waited_ms",
    "carriers_waited_ms",
    "bench_late_ms",
    "truth_late_ms",
)
NS_PER_S: Final = 1_000_000_000
PROC: Final = Path("/proc")
EVERYDAY_NS: Final = 100_000
"""Normal wait for a processor at each wake-up of a process; it is not counted as a delay."""


class HostRecord:
    """Takes one sample a second."""

    def __init__(self, path: Path, steal: Callable[[], int | None] = steal_ns) -> None:
        """Open the log of the samples. Raises RecorderError."""
        self._log = LineLog(path, COLUMNS)
        self._read = steal
        self._first_ns = self._last_ns = steal()
        self._before: dict[int, Scheduled] = {}
        """Processor time of each process at the last sample, by process id."""
        self._bench_late_ns = 0
        self._truth_late_ns = 0
        self.stolen: list[tuple[float, float]] = []
        """End of each second in the plant's time, and the seconds of processor time stolen."""
        self.waited: list[tuple[float, float]] = []
        """End of each second, and how long the controller was ready and got no processor."""
        self.carriers_waited: list[tuple[float, float]] = []
        """End of each second, and how long the bus or gateway process waited for a processor."""
        self.stalled: list[tuple[float, float]] = []
        """End of each second, and how long the bench was delayed while neither it nor the
        controller ran. Then hardly any process on this machine ran."""
        self.truth_late: list[tuple[float, float]] = []
        """Instants of truth that the plant sent late, and the lateness."""

    def bench_late(self, late_ns: int) -> None:
        """Note how late the bench itself read its wires."""
        self._bench_late_ns = max(self._bench_late_ns, late_ns)

    def truth(self, t_s: float, late_ns: int) -> None:
        """Note how long after its instant a sample of truth was sent."""
        self._truth_late_ns = max(self._truth_late_ns, late_ns)
        self.truth_late.append((t_s, late_ns / NS_PER_S))

    def sample(
        self,
        t_s: float,
        controller: int | None,
        carriers: Sequence[int] = (),
        *,
        excused: bool,
    ) -> None:
        """Record the past second.

        Args:
            controller: its process id; None if the bench did not start it or it does not run.
            carriers: ids of the processes that carry frames between controller and train.
            excused: a fault of the scenario delayed the controller within this second.
        """
        stolen_ns, stolen_s = self._read(), 0.0
        if stolen_ns is not None and self._last_ns is not None:
            stolen_s = (stolen_ns - self._last_ns) / NS_PER_S
        self._last_ns = stolen_ns
        waited_s, ran_s = (0.0, 0.0) if controller is None else self._got_s(controller)
        carried_s = max((self._got_s(pid)[0] for pid in carriers), default=0.0)
        _, own_s = self._got_s(os.getpid())
        self.stalled.append((t_s, max(0.0, self._bench_late_ns / NS_PER_S - ran_s - own_s)))
        self.stolen.append((t_s, stolen_s))
        self.waited.append((t_s, 0.0 if excused else waited_s))
        self.carriers_waited.append((t_s, carried_s))
        self._log.row(
            f"{t_s:.3f}",
            f"{1000.0 * stolen_s:.1f}",
            f"{1000.0 * waited_s:.1f}",
            f"{1000.0 * carried_s:.1f}",
            f"{self._bench_late_ns / 1e6:.1f}",
            f"{self._truth_late_ns / 1e6:.1f}",
        )
        self._bench_late_ns = self._truth_late_ns = 0

    def _got_s(self, pid: int) -> tuple[float, float]:
        """Return how long a process waited for a processor and ran since the last call."""
        now = scheduled(pid)
        if now is None:
            return 0.0, 0.0
        before = self._before.get(pid, now)
        self._before[pid] = now
        everyday_ns = EVERYDAY_NS * (now.times - before.times)
        waited_ns = max(0, now.waited_ns - before.waited_ns - everyday_ns)
        return waited_ns / NS_PER_S, (now.ran_ns - before.ran_ns) / NS_PER_S

    @property
    def steal_s(self) -> float | None:
        """Stolen time over the whole run; None if the kernel does not report it."""
        last_ns = self._read()
        if last_ns is None or self._first_ns is None:
            return None
        return (last_ns - self._first_ns) / NS_PER_S

    def close(self) -> None:
        self._log.close()


@contextmanager
def at_priority(priority: int) -> Iterator[None]:
    """Run the calling thread with SCHED_FIFO if permitted; its children run without it.

    The plant's feed holds only ten messages, so a bench that waits for a busy machine would miss
    truth.
    """
    before = (os.sched_getscheduler(0), os.sched_getparam(0))
    with suppress(OSError):
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    try:
        yield
    finally:
        with suppress(OSError):
            os.sched_setscheduler(0, *before)


class Scheduled(NamedTuple):
    """Processor time that the kernel gave the first thread of a process since its start."""

    ran_ns: int
    waited_ns: int
    """Time ready to run without a processor."""
    times: int
    """Number of times that the thread got a processor."""


def scheduled(pid: int) -> Scheduled | None:
    """Return the processor time of a process; None if the kernel does not report it."""
    try:
        fields = (PROC / str(pid) / "schedstat").read_text(encoding="ascii").split()
        return Scheduled(*map(int, fields[:3]))
    except (OSError, ValueError, TypeError):
        return None
