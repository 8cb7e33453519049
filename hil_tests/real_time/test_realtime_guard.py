"""No process of a case outlives the bench, not even a stopped one."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from hil_tests.real_time.process_rig import PATIENCE_S, alive, until_gone
from metro_hil.realtime.actors import CaseProcesses, ControllerActor
from metro_hil.realtime.commands import ControllerStart

BENCH = """
import signal, sys
from pathlib import Path
from hil_tests.real_time.process_rig import PATIENCE_S, alive, until_gone
from metro_hil.realtime.actors import CaseProcesses
meeting = Path("meeting")
(meeting / "sockets").mkdir(parents=True)
cast = CaseProcesses(Path(sys.argv[1]), [meeting.resolve()])
shell = cast.start("family", ["sh", "-c", "sleep 600 & echo $! >child; exec sleep 600"])
still = cast.start("still", ["sleep", "600"])
still.signal_group(signal.SIGSTOP)
print(shell.pid, still.pid, flush=True)
sys.stdin.read()
"""


def test_a_killed_bench_leaves_no_process_child_or_folder(
    tmp_path: Path,
) -> None:
    bench = subprocess.Popen(
        [sys.executable, "-c", BENCH, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    assert bench.stdout is not None
    pids = [int(word) for word in bench.stdout.readline().split()]
    end = time.monotonic() + PATIENCE_S
    while not (tmp_path / "child").exists() and time.monotonic() < end:
        time.sleep(0.05)
    pids.append(int((tmp_path / "child").read_text()))
    assert all(alive(pid) for pid in pids)

    assert (tmp_path / "meeting/sockets").is_dir()

    bench.kill()
    bench.communicate()

    assert until_gone(pids) == []
    end = time.monotonic() + PATIENCE_S
    while (tmp_path / "meeting").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not (tmp_path / "meeting").exists()


def test_a_stopped_controller_and_its_children_are_ended_in_order(
    tmp_path: Path,
) -> None:
    words = ("sh", "-c", f"sleep 600 & echo $! >{tmp_path}/child; wait")
    cast = CaseProcesses(tmp_path)
    controller = ControllerActor(cast, ControllerStart(words, words, os.environ))
    end = time.monotonic() + PATIENCE_S
    while not (tmp_path / "child").exists() and time.monotonic() < end:
        time.sleep(0.05)
    pids = [controller.pid or 0, int((tmp_path / "child").read_text())]

    controller.pause()
    controller.end()
    cast.close()

    assert until_gone(pids) == []


def test_the_end_of_a_controller_is_reported_with_signal_and_last_output(tmp_path: Path) -> None:
    words = ("sh", "-c", "echo no axle counted >&2; kill -SEGV $$")
    cast = CaseProcesses(tmp_path)

    controller = ControllerActor(cast, ControllerStart(words, words, os.environ))
    end = time.monotonic() + PATIENCE_S
    while controller.ended_by is None and time.monotonic() < end:
        time.sleep(0.05)

    assert controller.ended_by is signal.SIGSEGV
    assert controller.end_words() == "by SIGSEGV: no axle counted"
    controller.end()
    cast.close()
