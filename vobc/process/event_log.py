"""Output of events: numbered, sent on the bus with a limit per cycle, and written to the
event log.
"""

import json
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from can_dbc.binding import Frame
from firmware_py.storage.recorder import LineFile
from vobc.vocabulary import Event, Source
from vobc.wire import Evidence, event_frame

FRAMES_PER_CYCLE: Final = 4
"""Greatest number of event frames per cycle, so that a burst of events never delays a command."""
WAITING_MAX: Final = 256
"""Greatest number of waiting events. In a flood the oldest are discarded, and their numbers are
missing on the bus."""
LINES_MAX: Final = 1024
EVENTS_LOG: Final = "events.jsonl"
"""File name in a run folder."""
NS_PER_S: Final = 1_000_000_000

Look = Callable[[Source, int], Evidence | None]


class EventLog(Protocol):
    """Receives the events of a run in order. It never waits for a disk."""

    def event(self, entry: dict[str, Any]) -> None: ...

    def flush(self) -> None: ...


class EventLines:
    """Writes `events.jsonl`: one JSON object for each event, as docs/guide/explain.md lists
    them.
    """

    def __init__(self, path: Path | str) -> None:
        """Raises RecorderError."""
        self.path = Path(path)
        self._file = LineFile(path)
        self._lines: list[str] = []

    @property
    def lost_lines(self) -> int:
        return self._file.lost_lines

    def event(self, entry: dict[str, Any]) -> None:
        self._lines.append(json.dumps(entry, ensure_ascii=False, allow_nan=False) + "\n")
        if len(self._lines) >= LINES_MAX:
            self.flush()

    def flush(self) -> None:
        """Pass everything to the operating system. This happens each second and on closing."""
        if self._lines:
            self._file.write(self._lines)
            self._lines = []

    def close(self) -> None:
        self.flush()
        self._file.close()


class EventQueue:
    """Numbers the events of a controller since its start and passes them on."""

    def __init__(self, log: EventLog | None, look: Look, start_ns: int) -> None:
        """`look` finds the last message of a source, given the number of the event."""
        self._log, self._look, self._start_ns = log, look, start_ns
        self._waiting: deque[Frame] = deque(maxlen=WAITING_MAX)
        self.told = 0

    def tell(self, now_ns: int, events: Iterable[Event]) -> None:
        """Add events in the cycle that decided them, while their sources are still the latest
        messages.
        """
        for event in events:
            self.told += 1
            self._waiting.append(event_frame(event, self.told))
            if self._log is not None:
                self._log.event(self._entry(now_ns, event))

    def due(self) -> Sequence[Frame]:
        """Event frames to send in this cycle."""
        waiting = self._waiting
        if not waiting:
            return ()
        return [waiting.popleft() for _ in range(min(len(waiting), FRAMES_PER_CYCLE))]

    def flush(self) -> None:
        if self._log is not None:
            self._log.flush()

    def _entry(self, now_ns: int, event: Event) -> dict[str, Any]:
        return {
            "t_s": self._seconds(now_ns),
            "number": self.told,
            "kind": event.kind.name,
            "words": event.words,
            "value": event.number,
            "sources": [self._source(source, event.number) for source in event.sources],
        }

    def _source(self, source: Source, number: int) -> dict[str, Any]:
        entry: dict[str, Any] = {"source": source.value}
        evidence = self._look(source, number)
        if evidence is not None:
            entry["id"] = evidence.number
            entry["payload"] = evidence.payload.hex()
            entry["heard_s"] = self._seconds(evidence.received_at_ns)
        return entry

    def _seconds(self, at_ns: int) -> float:
        return round((at_ns - self._start_ns) / NS_PER_S, 6)
