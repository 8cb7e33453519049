"""Ends the processes of a case when the bench has ended in any way and cannot do it itself.

A process beside the bench reads from a pipe which processes the bench has started. The pipe ends
with the bench. The guard then kills all processes that still run, with all their children. SIGKILL
also ends a process that SIGSTOP has stopped, which no gentler signal does.

The guard runs as a script: it needs only the standard library, and has to start at once.
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
    """Read `+PID` and `-PID` from standard input: a process group that runs, or has ended.

    `=FOLDER` names a folder to remove, too. `.` cancels all folders: the bench removes them itself.
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
        """Watch a process group: it does not outlive the bench."""
        self._tell(f"+{pid}\n")

    def forget(self, pid: int) -> None:
        """Stop watching a process group that has ended; its number may be used again."""
        self._tell(f"-{pid}\n")

    def clear(self, folder: Path) -> None:
        """Remove the folder if the bench is killed; otherwise the bench removes it itself."""
        self._tell(f"={folder}\n")

    def close(self) -> None:
        """End the guard; it kills the groups that it still watches."""
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
        # A person may have ended the guard; the case goes on without it.
        with contextlib.suppress(OSError):
            self._process.stdin.write(line)
            self._process.stdin.flush()


if __name__ == "__main__":
    sys.exit(main())
