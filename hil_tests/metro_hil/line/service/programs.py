"""Starts, finds and ends programs that outlive the command which started them."""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from firmware_py.clock.clock import WallClock
from firmware_py.storage.whole_file import write_whole
from metro_hil.line.service.plan import LineProgram

END_S: Final = 5.0
"""Time for a program to end in good order before it is killed."""
POLL_NS: Final = 20_000_000
NS_PER_S: Final = 1_000_000_000
TAIL_LINES: Final = 3
STATE: Final = 0
START_TICKS: Final = 19
"""Columns of /proc/PID/stat after the name of the program."""


class ProgramFiles:
    """Files of one program below the run folder: its process id, its output, its logs."""

    def __init__(self, folder: Path, program: LineProgram) -> None:
        self.program = program
        self._base = folder / program.name

    @property
    def output(self) -> Path:
        return self._base.with_name(f"{self._base.name}.log")

    @property
    def _pid(self) -> Path:
        return self._base.with_name(f"{self._base.name}.pid")

    def start(self) -> None:
        """Start the program in a session of its own. Raises OSError."""
        self._base.parent.mkdir(parents=True, exist_ok=True)
        words = [sys.executable, "-m", self.program.module, *self.program.arguments]
        if self.program.logs:
            words += ["--out", str(self._free_folder())]
        with self.output.open("ab") as output:
            process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        # The program goes on after this command, so no one waits for it here.
        process.returncode = 0
        write_whole(self._pid, f"{process.pid} {_started(process.pid)}\n")

    def pid(self) -> int | None:
        """Return the process id while the program runs.

        Another process may have got the number since; its start time tells it apart.
        """
        try:
            number, started = self._pid.read_text(encoding="ascii").split()
        except (OSError, ValueError):
            return None
        pid = int(number) if number.isdecimal() else 0
        return pid if pid and started and _started(pid) == started else None

    def signal(self, number: signal.Signals) -> None:
        pid = self.pid()
        if pid is not None:
            # It may end between the two calls.
            try:
                os.kill(pid, number)
            except ProcessLookupError:
                return

    def last_words(self) -> str:
        """Return the last lines of the output in one line."""
        try:
            text = self.output.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return "; ".join(text.strip().splitlines()[-TAIL_LINES:])

    def _free_folder(self) -> Path:
        number, free = 1, self._base
        while free.exists():
            number += 1
            free = self._base.with_name(f"{self._base.name}_{number}")
        return free


def end_all(files: Sequence[ProgramFiles], clock: WallClock) -> int:
    """End the programs together and return how many ran. Kill those that do not end."""
    running = [each for each in files if each.pid() is not None]
    for number in (signal.SIGTERM, signal.SIGKILL):
        for each in running:
            # A stopped program cannot react to the request to end.
            each.signal(signal.SIGCONT)
            each.signal(number)
        until_ns = clock.now_ns() + round(END_S * NS_PER_S)
        while clock.now_ns() < until_ns and any(each.pid() is not None for each in running):
            clock.wait_until(clock.now_ns() + POLL_NS)
    return len(running)


def _started(pid: int) -> str:
    """Return the start time of a process in clock ticks; empty if it has ended."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    columns = text.rpartition(")")[2].split()
    return "" if columns[STATE] in "ZX" else columns[START_TICKS]
