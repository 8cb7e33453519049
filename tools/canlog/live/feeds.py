"""Feeds of the live page: a run folder that grows, or a bus. A feed never waits."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from canlog.database import Bus
from canlog.formats.candump import whole_lines
from canlog.frames import ERROR, EXTENDED, REMOTE, Frames, blank, empty
from canlog.run import BUS_LOG, CONTROLLER, EVENTS, NS_PER_S
from canlog.views.happenings import Happening, happening_of
from firmware_py.ports import CanPort

RESULTS: Final = "results.json"
"""The file that a run writes last."""
READ_MAX: Final = 1 << 22
"""Most bytes that one call reads of a log, so that a long log does not hold up the viewers."""
QUIET_NS: Final = 10 * NS_PER_S
"""Age of the last line from which a run without results counts as over; runs write each second."""


@dataclass(frozen=True, slots=True, eq=False)
class News:
    """What a feed found since the last call."""

    frames: Frames
    happenings: tuple[Happening, ...] = ()
    remark: str = ""
    """What the user has to know, as a sentence; empty while all is well."""
    ended: bool = False
    """Whether nothing more will come."""


class Feed(Protocol):
    def poll(self, now_ns: int) -> News:
        """Return the news up to now, an instant of the wall clock in nanoseconds since 1970."""
        ...

    def close(self) -> None: ...


class FolderFeed:
    """Reads the frames and events of a run folder from its beginning, and follows its growth."""

    def __init__(self, folder: Path, bus: Bus) -> None:
        self._folder = folder
        self._log = Tail(folder / BUS_LOG)
        self._events = Tail(folder / EVENTS)
        keys = [spec.key for spec in bus.by_key.values() if spec.senders == (CONTROLLER,)]
        self._controller_keys = np.array(keys, np.uint32)
        self._channels: list[str] = []
        self._start_ns: int | None = None
        """Stamp of the controller's start; its events count from there."""
        self._waiting: list[dict[str, Any]] = []
        """Events that came before the first frame of the controller."""

    def poll(self, now_ns: int) -> News:
        over = (self._folder / RESULTS).is_file()
        text = self._log.read()
        frames = whole_lines(text, self._channels) if text else empty()
        if self._start_ns is None and len(frames):
            self._find_start(frames)
        happenings = self._happenings()
        if text:
            return News(frames, happenings)
        remark = "" if over else self._remark(now_ns)
        return News(frames, happenings, remark, ended=over or bool(remark))

    def close(self) -> None:
        self._log.close()
        self._events.close()

    def _find_start(self, frames: Frames) -> None:
        sent = np.flatnonzero(np.isin(frames.key, self._controller_keys) & frames.is_data)
        if len(sent):
            first_ns = int(frames.at_ns[sent[0]])
            # In virtual time the stamps already count from the start.
            self._start_ns = 0 if first_ns < NS_PER_S else first_ns

    def _happenings(self) -> tuple[Happening, ...]:
        for line in self._events.read().splitlines():
            try:
                table = json.loads(line)
            except ValueError:
                continue
            if isinstance(table, dict):
                self._waiting.append(table)
        if self._start_ns is None:
            return ()
        found = [happening_of(table, self._start_ns) for table in self._waiting]
        self._waiting.clear()
        return tuple(each for each in found if each is not None)

    def _remark(self, now_ns: int) -> str:
        """Return why a run that left no results is over; empty while it goes on."""
        if self._log.gone:
            return f"{self._log.path} is gone; the page shows what it had read."
        last_ns = self._log.changed_ns()
        if last_ns is not None and now_ns - last_ns > QUIET_NS:
            return (
                f"The run wrote nothing for {QUIET_NS // NS_PER_S} s and left no {RESULTS}:"
                " it was killed, or its disk is full."
            )
        return ""


class Tail:
    """A text file that another process extends by blocks of lines; it may not exist yet."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: Any = None
        self._rest = b""

    @property
    def gone(self) -> bool:
        return self._file is not None and not self.path.exists()

    def changed_ns(self) -> int | None:
        try:
            return self.path.stat().st_mtime_ns
        except OSError:
            return None

    def read(self) -> bytes:
        """Return the whole lines that were added since the last call."""
        if self._file is None:
            try:
                self._file = self.path.open("rb")
            except OSError:
                return b""
        text = self._rest + self._file.read(READ_MAX)
        end = text.rfind(b"\n") + 1
        self._rest = text[end:]
        return bytes(text[:end])

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


class BusFeed:
    """Receives the frames of a live bus. Its events are those on the bus."""

    def __init__(self, port: CanPort, name: str, offset_ns: int) -> None:
        """Args:
        offset_ns: what to add to the stamps of the port for nanoseconds since 1970.
        """
        self._port, self._name, self._offset_ns = port, name, offset_ns
        self._channels = (name.partition(":")[2] or name,)

    def poll(self, now_ns: int) -> News:
        received = self._port.receive(now_ns - self._offset_ns)
        alive = getattr(self._port, "alive", True)
        remark = "" if alive else f"The bus {self._name} went away; its last frames are shown."
        return News(_frames(received, self._offset_ns, self._channels), remark=remark)

    def close(self) -> None:
        self._port.close()


def _frames(received: Sequence[Any], offset_ns: int, channels: tuple[str, ...]) -> Frames:
    frames = blank(len(received), channels=channels)
    for row, frame in enumerate(received):
        frames.at_ns[row] = frame.stamp_ns + offset_ns
        frames.identifier[row] = frame.can_id
        frames.flags[row] = EXTENDED * frame.extended | REMOTE * frame.remote | ERROR * frame.error
        frames.length[row] = len(frame.data)
        frames.data[row, : len(frame.data)] = np.frombuffer(frame.data, np.uint8)
    return frames
