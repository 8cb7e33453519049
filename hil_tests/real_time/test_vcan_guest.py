"""The guest behaves as its help documents, and its SocketCAN is a real one."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_tests.guest_rig import Guest
from hil_tests.real_time.process_rig import children

pytestmark = pytest.mark.guest

LAUNCHER = "tools/vcan-guest"
PATIENCE_S = 60.0

RECEIVER_IS_THERE = """
until grep -Eq '^ *vcan0 .*raw' /proc/net/can/rcvlist_all; do sleep 0.02; done
"""

PYTHON_CAN_ROUND_TRIP = """
import can

with can.Bus("vcan0", interface="socketcan") as one, can.Bus("vcan0", interface="socketcan") as two:
    for number in range(64):
        data = bytes(range(number % 9))
        sent = can.Message(arbitration_id=0x181 + number, data=data, is_extended_id=False)
        one.send(sent)
        heard = two.recv(5.0)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data)) == (sent.arbitration_id, bytes(sent.data))
print("heard all")
"""


def test_candump_receives_the_frames_of_cansend(guest: Guest) -> None:
    script = f"""
        candump -L -n 2 vcan0 >/tmp/heard & {RECEIVER_IS_THERE}
        cansend vcan0 101#0102A0; cansend vcan0 702#
        wait; cut -d' ' -f2- /tmp/heard
    """

    done = guest.run("bash", "-c", script)

    assert done.stdout.splitlines() == ["vcan0 101#0102A0", "vcan0 702#"]


def test_python_can_makes_the_round_trip(guest: Guest) -> None:
    done = guest.run(sys.executable, "-c", PYTHON_CAN_ROUND_TRIP)

    assert (done.returncode, done.stdout) == (0, "heard all\n"), done.stderr


def test_status_streams_directory_and_environment_of_the_command_are_preserved(
    guest: Guest, checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ODD", 'a "quoted" $value\nof two lines')
    script = 'printf "%s|%s" "$PWD" "$ODD"; printf complaint >&2; exit 7'

    done = guest.run("sh", "-c", script)

    assert done.returncode == 7
    assert done.stdout == f'{checkout}|a "quoted" $value\nof two lines'
    kernel, _, rest = done.stderr.partition("\n")
    assert kernel.startswith("vcan-guest: kernel ")
    assert rest == "complaint"


def test_writes_reach_the_host_only_in_permitted_folders(guest: Guest, tmp_path: Path) -> None:
    through, memory = tmp_path / "through", tmp_path / "memory"
    through.mkdir()
    memory.mkdir()
    script = f"echo kept >{through}/file; echo lost >{memory}/file; cat {memory}/file"

    done = guest.run("sh", "-c", script, options=["--write", str(through)])

    assert done.stdout == "lost\n"
    assert (through / "file").read_text() == "kept\n"
    assert not (memory / "file").exists()


def test_a_command_out_of_time_ends_with_124(guest: Guest) -> None:
    done = guest.run("sleep", "600", timeout_s=1)

    assert done.returncode == 124
    assert "--timeout" in done.stderr


def test_the_named_interfaces_are_up_and_no_others(guest: Guest) -> None:
    done = guest.run(
        "sh",
        "-c",
        "ls /sys/class/net; cat /sys/class/net/can*/type",
        options=["--vcan", "can7", "--vcan", "can8"],
    )

    assert done.stdout.split() == ["can7", "can8", "lo", "280", "280"]


@pytest.fixture
def sleeper(guest: Guest, checkout: Path) -> Iterator[subprocess.Popen[str]]:
    """A launcher whose long-running command reports its interruption."""
    program = (
        "import time\n"
        "print('on', flush=True)\n"
        "try:\n    time.sleep(600)\n"
        "except KeyboardInterrupt:\n    print('put away', flush=True)\n    raise SystemExit(3)\n"
    )
    process = subprocess.Popen(
        [str(checkout / LAUNCHER), sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        text=True,
        cwd=checkout,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "on\n"
    with process.stdout:
        yield process
        process.kill()
        process.wait()


def test_an_interrupted_command_ends_by_itself(sleeper: subprocess.Popen[str]) -> None:
    sleeper.send_signal(signal.SIGINT)

    output, _ = sleeper.communicate(timeout=PATIENCE_S)

    assert (output, sleeper.returncode) == ("put away\n", 3)


def test_a_killed_launcher_leaves_no_process(sleeper: subprocess.Popen[str]) -> None:
    before = set(Path("/tmp").glob("vcan-guest.*"))
    leaders = children(sleeper.pid)
    assert any(_session(leader) for leader in leaders)

    sleeper.kill()
    sleeper.wait()

    deadline_s = time.monotonic() + PATIENCE_S
    left = leaders
    while left and time.monotonic() < deadline_s:
        time.sleep(0.05)
        left = [process for leader in leaders for process in _session(leader)]
    assert left == []
    assert len(before & set(Path("/tmp").glob("vcan-guest.*"))) < len(before)


def _session(leader: int) -> list[int]:
    """The processes of a session except for zombies."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            state, _, _, session = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append(int(entry.name))
    return found


def test_vcan_creates_lists_and_removes_a_kernel_interface(guest: Guest) -> None:
    vcan = Path(sys.executable).with_name("vcan")
    script = f"""
        set -e
        {vcan} up
        {vcan} up
        cansend vcan0 101#00
        {vcan} status --json
        {vcan} down
        test ! -e /sys/class/net/vcan0
        {vcan} down
    """

    done = guest.run("bash", "-c", script, options=["--no-vcan"])

    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:3] == [
        "+ ip link add dev vcan0 type vcan",
        "+ ip link set dev vcan0 alias 'made by vcan up'",
        "+ ip link set dev vcan0 up",
    ]
    assert "already up" in lines[4]
    assert '"kind": "kernel vcan",' in done.stdout
    assert '"frames": 1,' in done.stdout
    assert "nothing to do" in lines[-1]


def test_vcan_does_not_touch_interfaces_that_it_did_not_create(guest: Guest) -> None:
    vcan = Path(sys.executable).with_name("vcan")

    done = guest.run("bash", "-c", f"{vcan} down; echo $?; test -e /sys/class/net/vcan0")

    assert done.stdout == "3\n"
    assert done.returncode == 0
    assert "ip link delete dev vcan0" in done.stderr


def test_a_guest_inside_a_guest_is_refused(guest: Guest, checkout: Path) -> None:
    done = guest.run(checkout / LAUNCHER, "true", options=["--no-vcan"])

    assert done.returncode == 125
    assert "guest already" in done.stderr


def test_a_wrong_interface_name_is_reported_before_the_boot(checkout: Path) -> None:
    done = subprocess.run(
        [str(checkout / LAUNCHER), "--vcan", "much_too_long_a_name", "true"],
        capture_output=True,
        text=True,
        env={**os.environ, "VCAN_GUEST": ""},
        check=False,
    )

    assert done.returncode == 125
    assert "15" in done.stderr
