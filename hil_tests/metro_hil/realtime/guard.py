"""Ends what a case started when the bench can no longer do it, however it was ended.

A process beside the bench that reads from a pipe which processes the bench has started. The pipe
ends with the bench; what was not ended by then is killed, with all that it started in its turn. A
process that stands still by SIGSTOP dies of that, too, which no gentler signal could do.

Run as a script: it needs nothing but the standard library, and has to be there at once.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

CLOSE_S: Final = 5.0


def main() -> int:
    """Lines `+PID` and `-PID` on standard input: a process group that is there, and one no more.

    `=FOLDER` is to be removed, too, and `.` takes that back for all: the bench does it itself.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    groups: dict[int, None] = {}
    folders: list[str] = []
    for line in sys.stdin:
        mark, rest = line[0], line[1:].rstrip("\n")
        if mark == "+":
            groups[int(rest)] = None
        elif mark == "-":
            groups.pop(int(rest), None)
        elif mark == "=":
            folders.append(rest)
        else:
            folders.clear()
    for pid in groups:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
    return 0


class ProcessGuard:
    """The bench's end of the pipe."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(Path(__file__).resolve())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
            text=True,
        )

    def watch(self, pid: int) -> None:
        """From now on this process group does not outlive the bench."""
        self._tell(f"+{pid}\n")

    def forget(self, pid: int) -> None:
        """It has ended, and its number may become another's."""
        self._tell(f"-{pid}\n")

    def clear(self, folder: Path) -> None:
        """It does not outlive the bench either; a bench that ends by itself has to remove it."""
        self._tell(f"={folder}\n")

    def close(self) -> None:
        """Kills what is still watched."""
        self._tell(".\n")
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _tell(self, line: str) -> None:
        assert self._process.stdin is not None
        # A guard that somebody ended cannot be told any more; the case goes on without.
        with contextlib.suppress(OSError):
            self._process.stdin.write(line)
            self._process.stdin.flush()


if __name__ == "__main__":
    sys.exit(main())
