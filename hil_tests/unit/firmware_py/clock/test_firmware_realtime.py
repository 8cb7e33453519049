"""Real-time measures of the host: none raises, every refusal has its reason, and steal is
counted."""

import errno
import gc
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from firmware_py.clock import realtime
from firmware_py.clock.realtime import (
    HostLoad,
    HostSample,
    collect_garbage,
    die_with_parent,
    steal_ns,
)

NS_PER_S = 1_000_000_000
TIMEOUT_S = 60
MEASURES = [
    "SCHED_FIFO",
    "memory lock",
    "garbage collector",
    "timer slack",
    "processor wake-up latency",
]


@pytest.fixture
def bare_metal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(realtime, "CPU_INFO", tmp_path / "no cpuinfo")
    monkeypatch.setattr(realtime, "IDLE_DRIVER", tmp_path / "no driver")


@pytest.fixture
def thawed() -> Any:
    """Restore the garbage collector of the test process afterwards."""
    yield
    gc.enable()
    gc.unfreeze()


def refuse(code: int) -> Any:
    def call(*arguments: object) -> None:
        raise OSError(code, os.strerror(code))

    return call


def run_python(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


def test_entering_real_time_reports_every_measure_truthfully() -> None:
    """The test runs in its own process; this host decides which measures are granted."""
    done = run_python("""
import gc, json, os
from firmware_py.clock.realtime import enter_realtime
report = enter_realtime(3)
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(json.dumps({
    "measures": [[m.name, m.granted, m.detail] for m in report.measures],
    "granted": report.granted,
    "lines": report.lines(),
    "policy": [os.sched_getscheduler(0) == os.SCHED_FIFO, os.sched_getparam(0).sched_priority],
    "locked_kb": int(status["VmLck"].split()[0]),
    "collector": [gc.isenabled(), gc.get_freeze_count() > 1000],
    "slack_ns": open("/proc/self/timerslack_ns").read().strip(),
}))
""")

    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [name for name, _, _ in told["measures"]] == MEASURES
    granted = {name: given for name, given, _ in told["measures"]}
    assert told["granted"] == [name for name in MEASURES if granted[name]]
    assert told["policy"] == ([True, 3] if granted["SCHED_FIFO"] else [False, 0])
    assert (told["locked_kb"] > 0) == granted["memory lock"]
    assert granted["garbage collector"]
    assert told["collector"] == [False, True]
    # Threads with a real-time policy have no slack, and the kernel then reports 0.
    assert not granted["timer slack"] or told["slack_ns"] in ("0", "1")
    for name, given, detail in told["measures"]:
        assert detail
        assert f"{name}: {'' if given else 'not granted, '}{detail}" in told["lines"]


@pytest.mark.usefixtures("thawed", "bare_metal")
def test_a_host_that_refuses_everything_is_reported_with_its_reasons(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", refuse(errno.EPERM))
    monkeypatch.setattr(realtime, "_mlockall", refuse(errno.ENOMEM))
    monkeypatch.setattr(realtime, "_prctl", refuse(errno.EINVAL))
    monkeypatch.setattr(realtime, "PM_QOS", tmp_path / "none")
    monkeypatch.setattr(realtime, "_awake_file", None)
    limits = {resource.RLIMIT_RTPRIO: (7, 7), resource.RLIMIT_MEMLOCK: (8192, 8192)}
    monkeypatch.setattr(resource, "getrlimit", limits.__getitem__)

    report = realtime.enter_realtime(80)

    assert report.granted == ("garbage collector",)
    details = {measure.name: measure.detail for measure in report.measures}
    assert details["SCHED_FIFO"] == (
        "Operation not permitted; RLIMIT_RTPRIO (ulimit -r) allows priority 7"
    )
    assert details["memory lock"] == (
        "Cannot allocate memory; RLIMIT_MEMLOCK (ulimit -l) allows 8192 bytes"
    )
    assert details["timer slack"] == "Invalid argument"
    assert details["processor wake-up latency"] == "No such file or directory"
    assert "SCHED_FIFO: not granted, Operation not permitted" in report.lines()[0]


@pytest.mark.parametrize(
    ("cpu_info", "idle_driver", "virtual"),
    [
        ("vendor_id : X\nflags\t: fpu hypervisor lm\n", "acpi_idle\n", True),
        ("vendor_id : X\nflags\t: fpu lm\n", "haltpoll\n", True),
        ("vendor_id : X\nflags\t: fpu lm\nname : hypervisor\n", "acpi_idle\n", False),
        ("processor : 0\n", None, False),
        (None, "haltpoll\n", True),
        (None, None, False),
    ],
)
def test_a_virtual_machine_is_recognised_by_its_processor_or_its_idle_driver(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    cpu_info: str | None,
    idle_driver: str | None,
    virtual: bool,
) -> None:
    for name, words in (("CPU_INFO", cpu_info), ("IDLE_DRIVER", idle_driver)):
        path = tmp_path / name
        monkeypatch.setattr(realtime, name, path)
        if words is not None:
            path.write_text(words)

    assert realtime.in_virtual_machine() is virtual


@pytest.mark.usefixtures("thawed")
@pytest.mark.parametrize("virtual", [True, False])
def test_idle_processors_are_kept_awake_on_bare_metal_only(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, virtual: bool
) -> None:
    request = tmp_path / "cpu_dma_latency"
    request.write_bytes(b"")
    monkeypatch.setattr(realtime, "PM_QOS", request)
    monkeypatch.setattr(realtime, "_awake_file", None)
    monkeypatch.setattr(realtime, "in_virtual_machine", lambda: virtual)
    for name in ("_mlockall", "_prctl"):
        monkeypatch.setattr(realtime, name, refuse(errno.EPERM))
    monkeypatch.setattr(os, "sched_setscheduler", refuse(errno.EPERM))

    *_, measure = realtime.enter_realtime(80).measures
    if realtime._awake_file is not None:
        os.close(realtime._awake_file)

    assert measure.granted is not virtual
    assert request.read_bytes() == (b"" if virtual else bytes(4))
    assert ("virtual machine" in measure.detail) is virtual


@pytest.mark.usefixtures("thawed", "bare_metal")
def test_a_system_without_any_measure_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_setscheduler")
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setattr(realtime, "PM_QOS", Path("/no/such/device"))
    monkeypatch.setattr(realtime, "_awake_file", None)

    report = realtime.enter_realtime(80)

    assert report.granted == ("garbage collector",)
    assert report.measures[0].detail == "this system has no SCHED_FIFO"
    assert "this system has no mlockall" in report.measures[1].detail


@pytest.mark.parametrize("priority", [0, 100, -1, 10**30])
def test_a_priority_that_does_not_exist_is_named(priority: int) -> None:
    with pytest.raises(OSError, match=rf"priority {priority} is not in 1\.\.99"):
        realtime._take_fifo(priority)


@pytest.mark.parametrize(
    ("limit", "user", "locked"),
    [
        (resource.RLIM_INFINITY, 1000, [1, 6]),
        (64 * 2**20, 0, [1, 6]),
        (64 * 2**20, 1000, [1]),
    ],
)
def test_the_future_is_locked_only_where_no_limit_can_kill_the_run(
    limit: int, user: int, locked: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Flag 1 locks the present mappings, 2 the future ones, and 4 delays the lock to the first
    access."""
    asked: list[int] = []
    monkeypatch.setattr(realtime, "_mlockall", asked.append)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit, limit))
    monkeypatch.setattr(os, "geteuid", lambda: user)

    detail = realtime._lock_memory()

    assert asked == locked
    assert ("future memory" in detail) == (6 in locked)


@pytest.mark.usefixtures("thawed")
def test_garbage_cycles_are_collected_in_the_slack_although_the_collector_is_off() -> None:
    class Ring:
        alive = 0

        def __init__(self) -> None:
            self.me = self
            Ring.alive += 1

        def __del__(self) -> None:
            Ring.alive -= 1

    gc.disable()
    for _ in range(50):
        Ring()
    assert Ring.alive == 50

    collect_garbage(0)

    assert Ring.alive == 0


STAT = "cpu  10 20 30 40 50 60 70 {steal} 90 100\ncpu0 1 2 3 4 5 6 7 8 9 10\nintr 5\n"


def test_steal_is_the_eighth_number_of_the_first_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stat = tmp_path / "stat"
    stat.write_text(STAT.format(steal=250))
    monkeypatch.setattr(realtime, "PROC_STAT", stat)
    monkeypatch.setattr(os, "sysconf", {"SC_CLK_TCK": 100}.__getitem__)

    assert steal_ns() == 2_500_000_000


@pytest.mark.parametrize("text", [None, "", "cpu 1 2 3\n", "cpu a b c d e f g h\n", "\xff\n"])
def test_steal_is_unknown_where_the_kernel_does_not_report_it(
    text: str | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stat = tmp_path / "stat"
    if text is not None:
        stat.write_text(text, encoding="latin-1")
    monkeypatch.setattr(realtime, "PROC_STAT", stat)

    assert steal_ns() is None
    assert HostLoad().sample().steal_ns is None


def test_a_host_sample_holds_the_difference_to_the_last_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steals = iter([5 * NS_PER_S, 7 * NS_PER_S, None, 9 * NS_PER_S, 9 * NS_PER_S])
    usages = iter([(10, 1), (14, 1), (14, 3), (15, 3), (15, 3)])
    monkeypatch.setattr(realtime, "steal_ns", lambda: next(steals))
    monkeypatch.setattr(realtime, "_own_usage", lambda: next(usages))
    monkeypatch.setattr(os, "getloadavg", lambda: (0.5, 1.0, 2.0))

    load = HostLoad()

    assert [load.sample() for _ in range(4)] == [
        HostSample(2 * NS_PER_S, preemptions=4, major_faults=0, runnable_mean=0.5),
        HostSample(None, preemptions=0, major_faults=2, runnable_mean=0.5),
        HostSample(None, preemptions=1, major_faults=0, runnable_mean=0.5),
        HostSample(0, preemptions=0, major_faults=0, runnable_mean=0.5),
    ]


def test_a_child_ends_with_its_parent() -> None:
    """The parent is killed without notice; the end of the child closes the pipe that it holds."""
    child = (
        "import signal, sys; from firmware_py.clock.realtime import die_with_parent; "
        "assert die_with_parent(int(sys.argv[1])); print('guarded', flush=True); "
        "signal.pause()"
    )
    parent = (
        "import os, signal, subprocess, sys; "
        f"subprocess.Popen([sys.executable, '-c', {child!r}, str(os.getpid())]); "
        "signal.pause()"
    )

    with subprocess.Popen(
        [sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "guarded\n"
        process.send_signal(signal.SIGKILL)
        # The pipe ends when its last holder, the child, is gone.
        rest, _ = process.communicate(timeout=TIMEOUT_S)

    assert rest == ""


def test_a_child_whose_parent_is_gone_already_ends_at_once() -> None:
    done = run_python(
        "from firmware_py.clock.realtime import die_with_parent as die; die(2**30); print('on')"
    )

    assert done.returncode == -signal.SIGTERM


def test_a_host_that_cannot_guard_a_child_reports_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "_prctl", refuse(errno.ENOSYS))

    assert not die_with_parent(os.getppid())
