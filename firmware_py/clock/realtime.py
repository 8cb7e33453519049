"""Real-time settings that a process requests from its host, and measurements of the host's
interference.

No function here raises for a refused setting: it is reported with the reason, and the run
continues.
"""

import contextlib
import ctypes
import errno
import gc
import os
import resource
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PR_SET_PDEATHSIG: Final = 1
PR_SET_TIMERSLACK: Final = 29
MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2
MCL_ONFAULT: Final = 4
NS_PER_S: Final = 1_000_000_000
STEAL_COLUMN: Final = 8
"""Column of the line "cpu" in /proc/stat; the label is column 0."""
PROC_STAT: Final = Path("/proc/stat")
PM_QOS: Final = Path("/dev/cpu_dma_latency")
CPU_INFO: Final = Path("/proc/cpuinfo")
IDLE_DRIVER: Final = Path("/sys/devices/system/cpu/cpuidle/current_driver")
GUESTS_IDLE_DRIVER: Final = "haltpoll"


@dataclass(frozen=True, slots=True)
class Measure:
    """One setting requested from the host."""

    name: str
    granted: bool
    detail: str
    """What exactly was granted, or why not."""


@dataclass(frozen=True, slots=True)
class RealtimeReport:
    """Requested settings and their results, in the order of the requests."""

    measures: tuple[Measure, ...]

    @property
    def granted(self) -> tuple[str, ...]:
        return tuple(measure.name for measure in self.measures if measure.granted)

    def lines(self) -> list[str]:
        """Return one sentence for each setting, for people."""
        return [
            f"{measure.name}: {'' if measure.granted else 'not granted, '}{measure.detail}"
            for measure in self.measures
        ]


def enter_realtime(priority: int) -> RealtimeReport:
    """Request all settings that keep the calling thread's wake-ups punctual.

    Call it last at start-up.

    Args:
        priority: SCHED_FIFO priority, 1..99; threads created later inherit it.
    """
    return RealtimeReport(
        (
            _measure("SCHED_FIFO", lambda: _take_fifo(priority)),
            _measure("memory lock", _lock_memory),
            _measure("garbage collector", _still_collector),
            _measure("timer slack", _least_timer_slack),
            _measure("processor wake-up latency", _keep_processor_awake),
        )
    )


def collect_garbage(now_ns: int) -> None:
    """Collect garbage in idle time, because `enter_realtime` stops the collector.

    Only reference cycles need it. The loops of this program create none, but libraries and raised
    exceptions may. Objects from before the freeze are skipped, so one collection costs some
    microseconds instead of several milliseconds.
    """
    gc.collect()


def die_with_parent(parent_pid: int) -> bool:
    """Make the kernel send SIGTERM to this process when the thread that started it ends.

    Args:
        parent_pid: the expected parent; if that process has already ended, the signal comes at
            once.

    Returns whether the host supports this; otherwise the child has to notice by itself.
    """
    try:
        _prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    except OSError:
        return False
    if os.getppid() != parent_pid:
        os.kill(os.getpid(), signal.SIGTERM)
    return True


def steal_ns() -> int | None:
    """Processor time that other guests of the same host took from this one since boot.

    It is the sum over all processors, usually in steps of 10 ms; None if the kernel does not report
    it.
    """
    try:
        first, _, _ = PROC_STAT.read_text(encoding="ascii").partition("\n")
        return int(first.split()[STEAL_COLUMN]) * (NS_PER_S // os.sysconf("SC_CLK_TCK"))
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def in_virtual_machine() -> bool:
    """Return whether the processor (x86) or the idle driver reports a virtual machine; False if
    neither does.
    """
    try:
        _, found, flags = CPU_INFO.read_text(encoding="utf-8").partition("\nflags")
        if found and "hypervisor" in flags.partition("\n")[0].split():
            return True
    except OSError:
        pass
    try:
        return IDLE_DRIVER.read_text(encoding="ascii").strip() == GUESTS_IDLE_DRIVER
    except OSError:
        return False


@dataclass(frozen=True, slots=True)
class HostSample:
    """Events of this process and its host since the last sample."""

    steal_ns: int | None
    preemptions: int
    """Number of times that the kernel preempted this process."""
    major_faults: int
    """Number of times that this process waited for a page from the disk."""
    runnable_mean: float | None
    """Load average of the last minute; None if unavailable."""


class HostLoad:
    """Attributes lateness: a late cycle with steal or preemption at the same time was caused by the
    host.
    """

    def __init__(self) -> None:
        self._steal_ns = steal_ns()
        self._preemptions, self._major_faults = _own_usage()

    def sample(self) -> HostSample:
        """Take a sample. It costs about 50 µs and is meant for once a second."""
        steal, (preemptions, major_faults) = steal_ns(), _own_usage()
        known = steal is not None and self._steal_ns is not None
        sample = HostSample(
            steal_ns=steal - self._steal_ns if known else None,  # type: ignore[operator]
            preemptions=preemptions - self._preemptions,
            major_faults=major_faults - self._major_faults,
            runnable_mean=_load_average(),
        )
        self._steal_ns = steal
        self._preemptions, self._major_faults = preemptions, major_faults
        return sample


def _measure(name: str, take: Callable[[], str]) -> Measure:
    try:
        return Measure(name, granted=True, detail=take())
    except OSError as error:
        return Measure(name, granted=False, detail=error.strerror or str(error))


def _take_fifo(priority: int) -> str:
    if not hasattr(os, "sched_setscheduler"):
        raise OSError(errno.ENOSYS, "this system has no SCHED_FIFO")
    least = os.sched_get_priority_min(os.SCHED_FIFO)
    most = os.sched_get_priority_max(os.SCHED_FIFO)
    if not least <= priority <= most:
        raise OSError(errno.EINVAL, f"priority {priority} is not in {least}..{most}")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError as error:
        allowed, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
        reason = f"{error.strerror}; RLIMIT_RTPRIO (ulimit -r) allows priority {allowed}"
        raise OSError(error.errno, reason) from error
    return f"priority {priority}"


def _lock_memory() -> str:
    """Lock the present memory, and future memory once it is touched.

    Under a finite limit only the present memory is locked. A lock on future memory would turn the
    first allocation beyond the limit into a MemoryError in the middle of a run.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    unlimited = limit == resource.RLIM_INFINITY or os.geteuid() == 0
    try:
        _mlockall(MCL_CURRENT)
    except OSError as error:
        words = "is unlimited" if limit == resource.RLIM_INFINITY else f"allows {limit} bytes"
        reason = f"{error.strerror}; RLIMIT_MEMLOCK (ulimit -l) {words}"
        raise OSError(error.errno, reason) from error
    if not unlimited:
        return f"present memory; RLIMIT_MEMLOCK (ulimit -l) of {limit} bytes forbids the future's"
    with contextlib.suppress(OSError):
        _mlockall(MCL_FUTURE | MCL_ONFAULT)
        return "present and future memory"
    return "present memory"


def _still_collector() -> str:
    """Freeze all objects, so that the collector never visits them again, and stop automatic
    collections.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    return f"{gc.get_freeze_count()} objects frozen, automatic collection off"


def _least_timer_slack() -> str:
    _prctl(PR_SET_TIMERSLACK, 1)
    return "1 ns"


_awake_file: int | None = None
"""The open file that keeps the request active."""


def _keep_processor_awake() -> str:
    """Forbid deep idle states, as cyclictest does, because waking from one takes up to 200 µs.

    Virtual machines are excluded. There an idle processor would poll, and the host would count that
    as work and take the processor away in return, on shared hosts for 100 ms at a time.
    """
    global _awake_file
    if in_virtual_machine():
        raise OSError(
            errno.EPERM,
            "left alone in a virtual machine: its host takes time from a guest that never idles",
        )
    if _awake_file is None:
        file = os.open(PM_QOS, os.O_WRONLY | os.O_CLOEXEC)
        try:
            os.write(file, (0).to_bytes(4, sys.byteorder))
        except OSError:
            os.close(file)
            raise
        _awake_file = file
    return "0 µs"


def _prctl(option: int, value: int) -> None:
    _call("prctl", option, value, 0, 0, 0)


def _mlockall(flags: int) -> None:
    _call("mlockall", flags)


def _call(name: str, *arguments: int) -> None:
    """Call a function of the C library that returns 0 or sets errno; raises OSError."""
    if not sys.platform.startswith("linux"):
        raise OSError(errno.ENOSYS, f"this system has no {name}")
    try:
        function = getattr(ctypes.CDLL(None, use_errno=True), name)
    except (OSError, AttributeError) as error:
        raise OSError(errno.ENOSYS, f"the C library has no {name}") from error
    if function(*(ctypes.c_ulong(argument) for argument in arguments)) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def _own_usage() -> tuple[int, int]:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_nivcsw, usage.ru_majflt


def _load_average() -> float | None:
    try:
        return os.getloadavg()[0]
    except OSError:
        return None
