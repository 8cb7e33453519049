"""The SocketCAN port, on a kernel with vcan where available, and on a kernel without CAN."""

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_py.buses import BusError, open_can
from firmware_py.clock.clock import WallClock

CASES = (
    Path(__file__).with_name("buses_socketcan_cases.py"),
    Path(__file__).with_name("canlog_vcan_cases.py"),
)
ROOT = Path(__file__).resolve().parents[2]
PROBE = "vcanprobe0"
LIMIT_S = 300


def kernel_makes_vcan() -> bool:
    """Whether this process may create a vcan interface here, tested by creating one."""
    made = ["ip", "link", "add", "dev", PROBE, "type", "vcan"]
    try:
        if subprocess.run(made, capture_output=True, check=False).returncode != 0:
            return False
        subprocess.run(["ip", "link", "del", PROBE], check=True)
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def run_here(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )


@pytest.mark.guest
def test_every_case_holds_on_a_real_kernel_interface(request: pytest.FixtureRequest) -> None:
    run = run_here if kernel_makes_vcan() else request.getfixturevalue("guest").run

    done = run(sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *CASES)

    report = f"{done.stdout}\n{done.stderr}"
    assert done.returncode == 0, report
    text = "".join(path.read_text(encoding="utf-8") for path in CASES)
    cases = len(re.findall(r"^def test_", text, re.MULTILINE))
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None, report
    assert int(passed[1]) >= cases, report


def test_a_kernel_without_can_is_reported_with_the_remedies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The test simulates the answer of such a kernel."""

    def refuse(*_: object) -> None:
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refuse)

    with pytest.raises(BusError) as caught:
        open_can("socketcan:vcan0", clock=WallClock(), node="vobc")
    assert "this kernel has no SocketCAN" in str(caught.value)
    assert "embedded:vcan0" in str(caught.value)
    assert "vcan-guest" in str(caught.value)


def test_a_missing_right_to_open_the_socket_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(socket, "socket", refuse)

    with pytest.raises(
        BusError, match="permission denied for a CAN socket: Operation not permitted"
    ):
        open_can("socketcan:vcan0", clock=WallClock(), node="vobc")
