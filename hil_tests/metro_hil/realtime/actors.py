"""The processes of a case: started, signalled and ended; none of them outlives the bench."""

import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

from metro_hil.model.subprocesses import Process
from metro_hil.realtime.commands import ControllerStart
from metro_hil.realtime.guard import ProcessGuard
from metro_hil.realtime.wires import Blocked


class CaseProcesses:
    """All processes of one case. Leaving it ends them, the last started first."""

    def __init__(self, folder: Path, meetings: Sequence[Path] = ()) -> None:
        """Args:
        meetings: folders that are removed with the processes when the bench is killed.
        """
        self._folder = folder
        self._guard = ProcessGuard()
        for meeting in meetings:
            self._guard.clear(meeting)
        self._going: list[Process] = []

    def start(
        self, name: str, words: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> Process:
        """Raises Blocked when there is no such program."""
        try:
            process = Process(name, words, self._folder / f"{name}.log", environment)
        except OSError as error:
            raise Blocked(f"{name}: {words[0]}: cannot be started: {error.strerror}") from error
        self._guard.watch(process.pid)
        self._going.append(process)
        return process

    def end(self, process: Process) -> int:
        """Ask it to end, kill it if it does not, and then all that it left behind."""
        if not process.ended:
            # A process that stands still hears no wish to end.
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
    """The controller's process, as the faults of a scenario and the run treat it."""

    def __init__(self, cast: CaseProcesses, start: ControllerStart) -> None:
        """Raises Blocked."""
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
        """As by kill -9: no last word."""
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
        """In good order, so that its last word can be heard."""
        if self._process is not None:
            self._cast.end(self._process)
            self._process = None

    @property
    def there(self) -> bool:
        """Started and not killed by the bench; it may have ended by itself."""
        return self._process is not None

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    @property
    def ended_by(self) -> signal.Signals | int | None:
        """The signal or exit code of an end that was not the bench's; None while it runs."""
        code = None if self._process is None else self._process.returncode
        if code is None or code >= 0:
            return code
        return signal.Signals(-code)

    def end_words(self) -> str:
        """How it ended by itself, and the last that it said."""
        if self._process is None:
            return "there is none"
        said = self._process.last_words().splitlines()
        last = f": {said[-1]}" if said else ""
        return f"{self._process.end_words()}{last}"

    def last_words(self) -> str:
        return "" if self._process is None else self._process.last_words()
