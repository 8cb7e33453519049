"""Starts, signals and ends the processes of a case; none of them outlives the bench."""

import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

from metro_hil.model.subprocesses import Process
from metro_hil.realtime.commands import ControllerStart
from metro_hil.realtime.guard import ProcessGuard
from metro_hil.realtime.wires import Blocked


class CaseProcesses:
    """All processes of one case. `close` ends them, the last started first."""

    def __init__(self, folder: Path, meetings: Sequence[Path] = ()) -> None:
        """Start the guard that ends the processes if the bench is killed.

        Args:
            meetings: folders that the guard then removes, too.
        """
        self._folder = folder
        self._guard = ProcessGuard()
        for meeting in meetings:
            self._guard.clear(meeting)
        self._going: list[Process] = []

    def start(
        self, name: str, words: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> Process:
        """Start a process. Raises Blocked when there is no such program."""
        try:
            process = Process(name, words, self._folder / f"{name}.log", environment)
        except OSError as error:
            raise Blocked(f"{name}: {words[0]}: cannot be started: {error.strerror}") from error
        self._guard.watch(process.pid)
        self._going.append(process)
        return process

    def end(self, process: Process) -> int:
        """Ask the process to end and kill it if it does not; then kill all that it left behind."""
        if not process.ended:
            # A stopped process cannot react to the request to end.
            process.signal_group(signal.SIGCONT)
        code = process.end()
        process.signal_group(signal.SIGKILL)
        self._guard.forget(process.pid)
        if process in self._going:
            self._going.remove(process)
        return code

    def close(self) -> None:
        for process in reversed(self._going.copy()):
            self.end(process)
        self._guard.close()


class ControllerActor:
    """The controller's process, as the run and the faults of a scenario use it."""

    def __init__(self, cast: CaseProcesses, start: ControllerStart) -> None:
        """Start the controller. Raises Blocked."""
        self._cast, self._start = cast, start
        self._starts = 0
        self._process: Process | None = None
        self.paused = False
        self.start()

    def start(self) -> None:
        words = self._start.words(self._starts)
        self._starts += 1
        self._process = self._cast.start("controller", words, self._start.environment)
        self.paused = False

    def kill(self) -> None:
        """Kill the process as by kill -9, without an orderly end."""
        if self._process is not None:
            self._process.signal_group(signal.SIGKILL)
            self._cast.end(self._process)
            self._process = None

    def pause(self) -> None:
        if self._process is not None and not self.paused:
            self._process.signal_group(signal.SIGSTOP)
            self.paused = True

    def resume(self) -> None:
        if self._process is not None and self.paused:
            self._process.signal_group(signal.SIGCONT)
        self.paused = False

    def end(self) -> None:
        """End the process in good order, so that its last output can be received."""
        if self._process is not None:
            self._cast.end(self._process)
            self._process = None

    @property
    def there(self) -> bool:
        """Whether the bench started the process and has not killed it; it may have ended itself."""
        return self._process is not None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def ended_by(self) -> signal.Signals | int | None:
        """Signal or exit code of an end not caused by the bench; None while the process runs."""
        code = None if self._process is None else self._process.returncode
        if code is None or code >= 0:
            return code
        return signal.Signals(-code)

    def end_words(self) -> str:
        """Return how the process ended by itself, and its last line of output."""
        if self._process is None:
            return "there is none"
        said = self._process.last_words().splitlines()
        last = f": {said[-1]}" if said else ""
        return f"{self._process.end_words()}{last}"

    def last_words(self) -> str:
        return "" if self._process is None else self._process.last_words()
