"""The controller and the plant as processes of their own: started, watched and ended."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

TAIL_LINES = 12
END_TIMEOUT_S = 5.0


class ChildError(Exception):
    """A child that ended by itself; the text holds its last words."""


class Process:
    """One process with a log of what it says, the first of a process group of its own."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Raises OSError when there is no such program, or the log cannot be written."""
        self.name = name
        self._log = log
        self._output = log.open("ab")
        # A session of its own, so that Ctrl-C reaches only the bench, which ends its children in
        # the right order.
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=None if environment is None else dict(environment),
            )
        except OSError:
            self._output.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    @property
    def returncode(self) -> int | None:
        return self._process.poll()

    def end_words(self) -> str:
        """How it ended: its exit code, or the signal that ended it."""
        code = self.returncode
        if code is None:
            return "still running"
        if code < 0:
            return f"by {signal.Signals(-code).name}"
        return f"exit code {code}"

    def last_words(self) -> str:
        """The end of what it said; empty when it said nothing."""
        try:
            text = self._log.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            return f"{self._log}: {error.strerror}"
        return "\n".join(text.strip().splitlines()[-TAIL_LINES:])

    def end(self) -> int:
        """Ask it to end, wait, and kill it if it does not; returns its exit code."""
        if not self.ended:
            self._process.send_signal(signal.SIGTERM)
        try:
            code = self._process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        self._output.close()
        return code

    def signal_group(self, number: signal.Signals) -> None:
        """To the process and to all that it started and that stayed in its group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)


class Child(Process):
    """A program of ours. It never outlives the bench."""

    def __init__(self, name: str, module: str, arguments: Sequence[str], log: Path) -> None:
        # The child itself asks the kernel to end it when the bench dies.
        words = [sys.executable, "-m", module, *arguments, "--parent", str(os.getpid())]
        super().__init__(name, words, log)
