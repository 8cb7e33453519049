"""`canlog browse` on a real pseudo-terminal, with a log and with a live bus."""

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import tempfile
import termios
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import pytest

from firmware_py.buses import open_can
from firmware_py.buses.embedded import start_hub
from firmware_py.clock.clock import NS_PER_S, WallClock
from hil_tests.unit.canlog import canlog_rig as rig

BUS: Final = "browse0"
ROWS: Final = 30
COLUMNS: Final = 110
PATIENCE_S: Final = 60
DRAWN: Final = re.compile(r"\x1b\[(\d+);1H(.*?)\x1b\[K", re.DOTALL)
CODES: Final = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Screen:
    """A terminal of 30 lines by 110 columns as its user sees it."""

    def __init__(self, words: Sequence[str]) -> None:
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        self.before = termios.tcgetattr(theirs)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "canlog.command", *words],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env={**os.environ, "PYTHONUTF8": "1", "TERM": "xterm-256color"},
        )
        self._theirs = theirs
        self.sent = ""
        self._clock = WallClock()

    def press(self, keys: str) -> None:
        os.write(self._ours, keys.encode())

    @property
    def lines(self) -> list[str]:
        rows = {int(row): CODES.sub("", text) for row, text in DRAWN.findall(self.sent)}
        return [rows.get(row, "") for row in range(1, ROWS + 1)]

    def wait(self, text: str) -> list[str]:
        """Wait until the text is on the screen."""
        end_ns = self._clock.now_ns() + PATIENCE_S * NS_PER_S
        while not any(text in row for row in self.lines):
            if self._clock.now_ns() > end_ns or not self._hear():
                raise AssertionError(f"{text!r} never came:\n" + "\n".join(self.lines))
        return self.lines

    def _hear(self) -> bool:
        ready, _, _ = select.select([self._ours], [], [], 0.2)
        if ready:
            try:
                piece = os.read(self._ours, 1 << 16)
            except OSError:
                return False
            self.sent += piece.decode("utf-8", "replace")
        return bool(ready) or self.process.poll() is None

    def end(self) -> str:
        """Require exit code 0 and return the output after the screen was restored."""
        assert self.process.wait(PATIENCE_S) == 0
        while select.select([self._ours], [], [], 0.1)[0] and self._hear():
            pass
        return self.sent.rpartition("\x1b[?1049l")[2]

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._ours)
        os.close(self._theirs)


@contextmanager
def opened(*words: str) -> Iterator[Screen]:
    screen = Screen(["browse", *words])
    try:
        yield screen
    finally:
        screen.close()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("terminal")
    dbc = folder / "bus.dbc"
    dbc.write_text(rig.EVERYTHING, encoding="ascii")
    path = rig.write_candump(folder / "random.log", rig.random_frames(10_000))
    return [str(path), "--dbc", str(dbc)]


@pytest.fixture
def free_bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An embedded bus for this test alone."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        hub = start_hub(BUS, bound=True)
        yield f"embedded:{BUS}"
        hub.stop()


def test_a_log_is_searched_played_bookmarked_and_closed(log: list[str]) -> None:
    with opened(*log) as screen:
        first = screen.wait("PLAIN")
        screen.press("/floats\r")
        screen.wait("search: floats")
        screen.press("\x1b[B" + ">" + "b")
        marked = screen.wait("bookmark 1 at ")
        screen.press("\t\r")
        plot = screen.wait("-- FLOATS.single")
        screen.press("q")
        said = screen.end()
        after = termios.tcgetattr(screen._theirs)

        assert any("7 messages" in row or "8 messages" in row for row in first)
        assert sum("FLOATS" in row for row in marked) == 2
        assert sum(any(ord(sign) > 0x2800 for sign in row) for row in plot) >= 4
        assert re.search(r"bookmark \d+\.\d{6} s", said)
        assert after == screen.before


def test_a_live_bus_is_watched(free_bus: str) -> None:
    clock = WallClock()
    port = open_can(free_bus, clock=clock, node="sender")
    try:
        with opened("--follow", free_bus) as screen:
            screen.wait("live")
            for number in range(40):
                port.send(clock.now_ns(), 0x285, bytes([number, 0, 0, 2, 0, 0, 0]))
                clock.wait_until(clock.now_ns() + NS_PER_S // 100)
            row = next(row for row in screen.wait("DOPPLER") if "DOPPLER" in row)
            screen.press(" ")
            screen.wait("frozen")
            screen.press("q")
            screen.end()
    finally:
        port.close()

    assert "285" in row


def test_without_a_terminal_it_names_the_alternative(log: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "canlog.command", "browse", *log],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 2
    assert "canlog show" in done.stderr
    assert "Traceback" not in done.stderr
