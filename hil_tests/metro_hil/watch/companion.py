"""The page beside a run of `vobc run --watch`: a process of its own, which only reads the logs."""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from firmware_py.interrupts import Interrupts

LOG: Final = "page.log"
"""The file in the run folder that takes what the process says on standard error."""
END_S: Final = 5.0
"""Time that the page's process has to end before it is killed."""


class WatchPage:
    """Serves the page of a run folder for as long as the `with` block lasts.

    A page that cannot be served never fails the run.
    """

    def __init__(self, folder: Path, *may: str) -> None:
        """Start the process. Raises OSError if its log cannot be written.

        Args:
            may: what viewers may do: `desk` and `faults` for a train, `commands` for a line.
        """
        log = folder / LOG
        command = [sys.executable, "-m", "metro_hil.watch", str(folder), str(os.getpid()), *may]
        with log.open("ab") as errors:
            # It has its own session, so that Ctrl-C reaches only the run, which ends the page last.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
                text=True,
            )
        assert self._process.stdout is not None
        self.line = self._process.stdout.readline().strip()
        """What to print for the user: the address, or why there is no page."""
        if not self.line:
            self.line = f"page: none; {log} says why"

    @property
    def serves(self) -> bool:
        return self._process.poll() is None

    def stay(self, say: Callable[[str], object]) -> None:
        """Serve the report until Ctrl-C or the end of the process.

        Without a terminal no person could give the Ctrl-C, so it returns at once.
        """
        if not (self.serves and sys.stdout.isatty() and sys.stdin.isatty()):
            return
        say(f"{self.line} has the report now; Ctrl-C ends")
        interrupts = Interrupts()
        with interrupts.caught():
            while self.serves and not interrupts.asked:
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(0.2)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
