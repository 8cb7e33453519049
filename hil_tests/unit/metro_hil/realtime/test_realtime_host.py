"""The host's disturbances of a run, from the kernel's statistics."""

import os
from pathlib import Path

import pytest

from metro_hil.realtime import host
from metro_hil.realtime.host import EVERYDAY_NS, HostRecord, at_priority

MS = 1_000_000
CONTROLLER, HUB = 41, 42


class Kernel:
    """A folder like /proc: run time, waiting time and number of runs of each process."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def says(self, pid: int, *, ran_ms: int, waited_ms: float, times: int) -> None:
        folder = self._root / str(pid)
        folder.mkdir(exist_ok=True)
        text = f"{ran_ms * MS} {round(waited_ms * MS)} {times}\n"
        (folder / "schedstat").write_text(text, encoding="ascii")


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    root = tmp_path / "proc"
    root.mkdir()
    monkeypatch.setattr(host, "PROC", root)
    return Kernel(root)


@pytest.fixture
def record(tmp_path: Path) -> HostRecord:
    return HostRecord(tmp_path / "host.csv", steal=lambda: 0)


def test_one_long_wait_counts_and_many_short_ones_do_not(
    kernel: Kernel, record: HostRecord
) -> None:
    """A hub that forwards 2000 frames waits a little for each."""
    for pid in (CONTROLLER, HUB):
        kernel.says(pid, ran_ms=0, waited_ms=0.0, times=0)
    record.sample(1.0, CONTROLLER, [HUB], excused=False)
    kernel.says(CONTROLLER, ran_ms=40, waited_ms=80.0, times=20)
    kernel.says(HUB, ran_ms=100, waited_ms=2000 * EVERYDAY_NS / MS, times=2000)
    record.sample(2.0, CONTROLLER, [HUB], excused=False)

    assert record.waited[-1][1] == pytest.approx(0.078)
    assert record.carriers_waited[-1] == (2.0, 0.0)


def test_the_statistics_restart_with_a_restarted_process(
    kernel: Kernel, record: HostRecord
) -> None:
    kernel.says(CONTROLLER, ran_ms=0, waited_ms=0.0, times=0)
    record.sample(1.0, CONTROLLER, excused=False)
    kernel.says(HUB, ran_ms=0, waited_ms=900.0, times=1)
    record.sample(2.0, HUB, excused=False)

    assert record.waited[-1] == (2.0, 0.0)


@pytest.mark.parametrize(("ran_ms", "stalled_s"), [(10, 0.89), (900, 0.0)])
def test_a_delayed_bench_is_a_stall_unless_the_controller_used_the_time(
    kernel: Kernel, record: HostRecord, ran_ms: int, stalled_s: float
) -> None:
    kernel.says(CONTROLLER, ran_ms=0, waited_ms=0.0, times=0)
    record.sample(1.0, CONTROLLER, excused=False)
    record.bench_late(900 * MS)
    kernel.says(CONTROLLER, ran_ms=ran_ms, waited_ms=0.0, times=1)
    record.sample(2.0, CONTROLLER, excused=False)

    assert record.stalled[-1][1] == pytest.approx(stalled_s)


def test_missing_kernel_statistics_give_no_disturbance(kernel: Kernel, record: HostRecord) -> None:
    record.sample(1.0, CONTROLLER, [HUB], excused=False)

    assert record.waited == record.carriers_waited == [(1.0, 0.0)]


def test_the_benchs_priority_ends_with_the_run() -> None:
    before = os.sched_getscheduler(0)
    with pytest.raises(KeyError), at_priority(20):
        raise KeyError

    assert os.sched_getscheduler(0) == before
