"""Cases of `canlog replay` and `--follow` on a real kernel interface.

pytest does not collect this file by itself. `test_buses_socketcan.py` runs it where it runs its own
cases.
"""

import re
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Encoder
from canlog import read
from canlog.command import main
from canlog.damage import Damages
from canlog.formats.registry import named
from canlog.frames import EXTENDED, Frames
from canlog.rows import from_rows
from firmware_py.buses.interfaces import look_up

NAME = "vcanlog0"
SPEC = f"socketcan:{NAME}"
WAIT_S = 20.0
"""Timeout far above every duration here; only a loss reaches it, s."""
MS = 1_000_000
PAUSE_S = 0.01


@pytest.fixture(autouse=True, scope="module")
def interface() -> Iterator[None]:
    for words in (f"link add dev {NAME} type vcan", f"link set {NAME} up"):
        subprocess.run(["ip", *words.split()], check=True)
    yield
    if look_up(NAME) is not None:
        subprocess.run(["ip", "link", "del", NAME], check=True)


@contextmanager
def stranger() -> Iterator[can.BusABC]:
    with can.Bus(NAME, interface="socketcan", ignore_config=True) as bus:
        yield bus


@contextmanager
def repeating(work: Callable[[can.BusABC], None]) -> Iterator[None]:
    """Another program sends repeatedly meanwhile."""
    done = threading.Event()

    def run() -> None:
        with stranger() as bus:
            while not done.wait(PAUSE_S):
                work(bus)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join(WAIT_S)


def written(folder: Path, frames: Frames) -> Path:
    path = folder / "x.log"
    named("candump").write(path, [frames], Damages())
    return path


@pytest.mark.parametrize("speed", [1, 4])
def test_a_replay_sends_every_frame_and_never_early(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], speed: int
) -> None:
    """The test compares the kernel's stamps with those of the log."""
    at_ns = [1_700_000_000_000_000_000 + at * (3 + at % 5) * MS for at in range(60)]
    rows = [(each, 0x100 + at % 7, 0, "can1", bytes([at] * (at % 9)))
            for at, each in enumerate(sorted(at_ns))]  # fmt: skip
    path = written(tmp_path, from_rows(rows))

    with stranger() as bus:
        assert main(["replay", str(path), "--bus", SPEC, "--speed", str(speed)]) == 0
        heard = [bus.recv(WAIT_S) for _ in rows]

    said = re.search(r"60 frames sent, 0 .*late by at most (\d+\.\d+) ms", capsys.readouterr().out)
    assert said is not None
    late_s = float(said[1]) / 1000
    frames = read(path).frames
    for at, message in enumerate(heard):
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (rows[at][1], rows[at][4])
        due_s = int(frames.at_ns[at] - frames.at_ns[0]) / 1e9 / speed
        first = heard[0]
        assert first is not None
        assert message.timestamp - first.timestamp >= due_s - late_s - 1e-4


def test_frames_that_the_port_cannot_send_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(
        tmp_path, from_rows([(0, 0x1234567, EXTENDED, "c", b"\1"), (1, 0x123, 0, "c", b"\2")])
    )

    with stranger() as bus:
        assert main(["replay", str(path), "--bus", SPEC]) == 0
        heard = bus.recv(WAIT_S)

    assert heard is not None
    assert heard.arbitration_id == 0x123
    assert "1 frames that are no 11-bit data frames were left out" in capsys.readouterr().err


def test_a_followed_bus_is_decoded_and_judged(capsys: pytest.CaptureFixture[str]) -> None:
    encoder = Encoder()

    def brake(bus: can.BusABC) -> None:
        for identifier, data in encoder.encode(BrakeCommand(1.0, True, True)):
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x101, data=bytes(4), is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x1ABCDEF0, data=b"\1\2", is_extended_id=True))
        bus.send(can.Message(arbitration_id=0x104, is_remote_frame=True, is_extended_id=False))

    with repeating(brake):
        assert main(["show", "--follow", SPEC, "--limit", "12", "--color", "never"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 12
    said = "\n".join(lines)
    assert re.search(r"vcanlog0\s+101\s+BRAKE_CMD\s+service_decel_mps2 1\.000 m/s2", said)
    assert re.search(r"101\s+BRAKE_CMD .*REJECTED wrong length", said)
    assert re.search(r"1ABCDEF0\s+\?\s+\[2\] 01 02", said)
    assert "remote request" in said


def test_only_the_requested_messages_are_followed(capsys: pytest.CaptureFixture[str]) -> None:
    encoder = Encoder()

    def brake(bus: can.BusABC) -> None:
        for identifier, data in encoder.encode(BrakeCommand(1.0, True, True)):
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    with repeating(brake):
        words = ["--message", "BRAKE_CMD_INV", "--where", "service_decel_mps2 > 0.5"]
        assert main(["show", "--follow", SPEC, *words, "--limit", "3"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[2:4] for line in lines] == [["102", "BRAKE_CMD_INV"]] * 3
