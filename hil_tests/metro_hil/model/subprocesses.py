"""Starts, watches and ends controller and plant as separate processes."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from metro_hil.model.case import PlantSpec

TAIL_LINES = 12
END_TIMEOUT_S = 5.0


class ChildError(Exception):
    """A child process ended by itself; the text holds the last lines of its output."""


def with_own_python(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which `python` is the Python of the bench.

    So a controller in Python finds the packages of the bench, whether or not the user activated
    the virtual environment.
    """
    folder = str(Path(sys.executable).parent)
    return {**environment, "PATH": os.pathsep.join([folder, environment.get("PATH", os.defpath)])}


def plant_module(plant: PlantSpec) -> tuple[str, ...]:
    """The module that serves a plant in real time, with its first arguments."""
    if plant.kind == PlantSpec().kind:
        return ("plant_emulator",)
    return "metro_hil.foreign_plant.realtime", msgspec.json.encode(plant).decode()


class Process:
    """One process, first of its own process group, with a log of its output."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        log: Path,
        environment: Mapping[str, str] | None = None,
        *,
        takes_orders: bool = False,
    ) -> None:
        """Start the process. Raises OSError if the program is missing or the log cannot be written.

        Args:
            takes_orders: the process reads orders from its standard input.
        """
        self.name = name
        self._log = log
        self._output = log.open("ab")
        # The process has its own session, so that Ctrl-C reaches only the bench, which ends its
        # children in the right order.
        try:
            self._process = subprocess.Popen(
                list(command),
                bufsize=0,
                stdin=subprocess.PIPE if takes_orders else subprocess.DEVNULL,
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
        """How the process ended: its exit code, or the signal that ended it."""
        code = self.returncode
        if code is None:
            return "still running"
        if code < 0:
            return f"by {signal.Signals(-code).name}"
        return f"exit code {code}"

    def failure_words(self) -> str:
        """How the process ended; after a failure with the last line of its output."""
        lines = self.last_words().splitlines() if (self.returncode or 0) > 0 else []
        return ": ".join([self.end_words(), *lines[-1:]])

    def last_words(self) -> str:
        """The last lines of its output; empty if there was none."""
        try:
            text = self._log.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            return f"{self._log}: {error.strerror}"
        return "\n".join(text.strip().splitlines()[-TAIL_LINES:])

    def order(self, text: str) -> None:
        """Send one line to the standard input of a process that takes orders."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(f"{text}\n".encode())

    def end(self) -> int:
        """Ask the process to end, wait, kill it if it does not end; return its exit code."""
        if self._process.stdin is not None:
            self._process.stdin.close()
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
        """Send a signal to the process and all its descendants in the same group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)


class Child(Process):
    """A program of this project, which never outlives the bench."""

    def __init__(
        self,
        name: str,
        module: str,
        arguments: Sequence[str],
        log: Path,
        *,
        takes_orders: bool = False,
    ) -> None:
        # The child asks the kernel to end it when the bench dies.
        words = [sys.executable, "-m", module, *arguments, "--parent", str(os.getpid())]
        super().__init__(name, words, log, takes_orders=takes_orders)
