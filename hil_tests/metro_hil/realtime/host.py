"""What the host took from a run while it went on, second by second."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from firmware_py.realtime import steal_ns
from firmware_py.recorder import LineLog

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


class HostRecord:
    """Sampled once a second."""

    def __init__(self, path: Path, steal: Callable[[], int | None] = steal_ns) -> None:
        """Raises RecorderError."""
        self._log = LineLog(path, COLUMNS)
        self._read = steal
        self._first_ns = self._last_ns = steal()
        self._delays_ns: dict[int, int] = {}
        """How long each process has waited up to now, by its id."""
        self._bench_late_ns = 0
        self._truth_late_ns = 0
        self.stolen: list[tuple[float, float]] = []
        """End of each second in the plant's time, and the seconds of processor time stolen."""
        self.waited: list[tuple[float, float]] = []
        """End of each second, and how long the controller was ready and got no processor."""
        self.carriers_waited: list[tuple[float, float]] = []
        """The same of the bus's or the gateway's process, of the one that waited the longest."""
        self.truth_late: list[tuple[float, float]] = []
        """Instants of truth that was sent late by the plant, and by how much."""

    def bench_late(self, late_ns: int) -> None:
        """The bench itself looked at its wires so late."""
        self._bench_late_ns = max(self._bench_late_ns, late_ns)

    def truth(self, t_s: float, late_ns: int) -> None:
        """One sample of truth was sent so long after the instant that it tells of."""
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
        """Args:
        controller: its process id, None when it is not ours or not there.
        carriers: process ids of what carries frames between controller and train.
        excused: a fault of the scenario held the controller up within this second.
        """
        stolen_ns, stolen_s = self._read(), 0.0
        if stolen_ns is not None and self._last_ns is not None:
            stolen_s = (stolen_ns - self._last_ns) / NS_PER_S
        self._last_ns = stolen_ns
        waited_s = 0.0 if controller is None else self._waited_s(controller)
        carried_s = max(map(self._waited_s, carriers), default=0.0)
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

    def _waited_s(self, pid: int) -> float:
        """Since the last call for this process; 0 the first time, or where nobody says."""
        delay_ns = run_delay_ns(pid)
        if delay_ns is None:
            return 0.0
        before_ns = self._delays_ns.get(pid, delay_ns)
        self._delays_ns[pid] = delay_ns
        return (delay_ns - before_ns) / NS_PER_S

    @property
    def steal_s(self) -> float | None:
        """Over the whole run; None where the kernel does not say."""
        last_ns = self._read()
        if last_ns is None or self._first_ns is None:
            return None
        return (last_ns - self._first_ns) / NS_PER_S

    def close(self) -> None:
        self._log.close()


@contextmanager
def at_priority(priority: int) -> Iterator[None]:
    """Run the calling thread with SCHED_FIFO, where the rights allow it; its children without.

    Only ten messages fit into the plant's feed: a bench that waits for a busy machine goes blind.
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


def run_delay_ns(pid: int) -> int | None:
    """How long a process's first thread was ready to run and got no processor, since it began.

    None where the kernel does not say.
    """
    try:
        fields = (PROC / str(pid) / "schedstat").read_text(encoding="ascii").split()
        return int(fields[1])
    except (OSError, ValueError, IndexError):
        return None
