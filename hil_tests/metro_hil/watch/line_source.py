"""What the page of a line receives: messages of a live radio, or those of a run folder's log."""

import csv
import json
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from canlog.live.feeds import QUIET_NS, RESULTS, Tail
from firmware_py.ports import RadioMessage

NS_PER_S: Final = 1_000_000_000
STEP_NS: Final = 100_000_000
"""Time of a log between two states of its line."""
STEPS_MAX: Final = 50
"""Most states that one call reads of a log, so that a long log does not hold up the viewers."""
LINE_LOG: Final = "line.log"
STORY: Final = "story.txt"


class Step(NamedTuple):
    """What came up to an instant."""

    now_ns: int
    messages: Sequence[RadioMessage] = ()
    notes: Sequence[tuple[float, str]] = ()
    """Lines of the event log of a run, with their seconds."""


class Results(NamedTuple):
    text: str = ""
    """How the run ended; empty while it goes on."""
    trains: Sequence[Any] = ()
    """What the run measured of each train, as in results.json."""


class LineSource(Protocol):
    @property
    def connected(self) -> bool:
        """Whether there is a session with the line."""
        ...

    @property
    def remark(self) -> str:
        """What the user has to know, as a sentence; empty while all is well."""
        ...

    @property
    def results(self) -> Results:
        """Results of the run."""
        ...

    def steps(self) -> Iterator[Step]:
        """Return what came since the last call, in order."""
        ...

    def shown_s(self, now_ns: int) -> float:
        """Return the time that the page shows for an instant."""
        ...


class LinePort(Protocol):
    """What the page needs of a radio session."""

    @property
    def connected(self) -> bool: ...

    def receive(self, now_ns: int) -> Sequence[RadioMessage]: ...


class LineClock(Protocol):
    def now_ns(self) -> int: ...

    def epoch_ns(self) -> int: ...


class RadioSource:
    """A session on the radio of a line. Its times are those of the day."""

    remark = ""
    results = Results()

    def __init__(self, port: LinePort, clock: LineClock) -> None:
        self._port, self._clock = port, clock

    @property
    def connected(self) -> bool:
        return self._port.connected

    def steps(self) -> Iterator[Step]:
        now_ns = self._clock.now_ns()
        yield Step(now_ns, self._port.receive(now_ns))

    def shown_s(self, now_ns: int) -> float:
        return (self._clock.epoch_ns() - self._clock.now_ns() + now_ns) / NS_PER_S


class FolderSource:
    """Reads the radio log and the event log of a line's run from their beginning as they grow.

    Its times are seconds of the run, from the first message on, as in the event log.
    """

    connected = True

    def __init__(self, folder: Path, clock: LineClock, *, real_time: bool, doubt: str = "") -> None:
        """Args:
        real_time: whether messages that do not come grow old by the clock, as a silent train's do.
        doubt: why a finished run may be shown differently from what it was.
        """
        self._folder, self._clock = folder, clock
        self._real_time, self._doubt = real_time, doubt
        self._log, self._story = Tail(folder / LINE_LOG), Tail(folder / STORY)
        self._waiting: deque[RadioMessage] = deque()
        self._notes: deque[tuple[float, str]] = deque()
        self._zero_ns: int | None = None
        """Stamp of the first message."""
        self._last_ns = self._now_ns = 0
        """Stamp of the last message, and the present instant, by the clock of the log."""
        self._read_ns = clock.now_ns()
        """Instant at which the last message was read, by the clock of this process."""
        self._damaged = 0
        self.remark, self.results = "", Results()

    def steps(self) -> Iterator[Step]:
        # The results are written last, so what is read after them is complete.
        results = self.results if self.results.text else _results(self._folder / RESULTS)
        more = not self._waiting and self._read()
        for _ in range(STEPS_MAX):
            if not self._waiting:
                break
            yield self._step()
        if not (self._waiting or more):
            self.results = results
            self.remark = self._remark()
            yield self._last_step()

    def shown_s(self, now_ns: int) -> float:
        return 0.0 if self._zero_ns is None else (now_ns - self._zero_ns) / NS_PER_S

    def _read(self) -> bool:
        """Read what was added to the files; return whether the log grew."""
        text = self._log.read().decode("ascii", "replace")
        for line in text.splitlines():
            message = _message(line)
            if message is not None:
                self._waiting.append(message)
                self._read_ns = self._clock.now_ns()
                self._zero_ns = message.stamp_ns if self._zero_ns is None else self._zero_ns
            elif not line.startswith("t_s,"):
                self._damaged += 1
        for line in self._story.read().decode("utf-8", "replace").splitlines():
            at_s, _, text = line.strip().partition(" s  ")
            try:
                self._notes.append((float(at_s), text))
            except ValueError:
                self._damaged += 1
        return bool(text)

    def _step(self) -> Step:
        """Return the messages up to the next state."""
        end_ns = max(self._now_ns, self._waiting[0].stamp_ns) + STEP_NS
        taken = []
        while self._waiting and self._waiting[0].stamp_ns < end_ns:
            taken.append(self._waiting.popleft())
        self._last_ns = taken[-1].stamp_ns
        self._now_ns = max(self._now_ns, self._last_ns)
        return Step(self._now_ns, taken, self._due(self.shown_s(self._now_ns)))

    def _last_step(self) -> Step:
        """Return the present instant, when all that was written is read."""
        if self._real_time and not self.results.text and self._zero_ns is not None:
            passed_ns = self._clock.now_ns() - self._read_ns
            self._now_ns = max(self._now_ns, self._last_ns + passed_ns)
        return Step(self._now_ns, (), self._due(float("inf")))

    def _due(self, until_s: float) -> list[tuple[float, str]]:
        found = []
        while self._notes and self._notes[0][0] <= until_s:
            found.append(self._notes.popleft())
        return found

    def _remark(self) -> str:
        """Return what is wrong with the files; empty if nothing is."""
        if self._damaged:
            lines = f"{self._log.path}: {self._damaged} damaged lines are left out."
            return f"{lines} {self._doubt}".rstrip()
        if self.results.text:
            return self._doubt
        if self._log.gone:
            return f"{self._log.path} is gone; the page shows what it had read."
        last_ns = self._log.changed_ns()
        if last_ns is None or self._clock.epoch_ns() - last_ns <= QUIET_NS:
            return ""
        return (
            f"The run wrote nothing for {QUIET_NS // NS_PER_S} s and left no {RESULTS}: it was"
            " killed, its disk is full, or its wayside is down."
        )


def _message(line: str) -> RadioMessage | None:
    """Return the message of a line of the log; None for any other text."""
    try:
        at, _, key, payload = next(csv.reader([line]))
        return RadioMessage(round(float(at) * NS_PER_S), key, bytes.fromhex(payload))
    except (ValueError, OverflowError, csv.Error):
        return None


def _results(path: Path) -> Results:
    try:
        told = json.loads(path.read_bytes())
        words = f"The run has ended: {told['verdict']}, {told['exit_reason']}"
        why = [*told.get("complaints", ()), *told.get("doubts", ())]
        return Results("; ".join([words, *map(str, why)]), told["trains"])
    except FileNotFoundError:
        return Results()
    except (OSError, ValueError, KeyError, TypeError) as error:
        return Results(f"The run has ended, but {path} cannot be read: {error}")
