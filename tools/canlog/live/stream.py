"""The stream of the live page: what its frames look like as bytes, and the history for new viewers.

Version 1. The server sends text and binary messages over one WebSocket. A text message is a JSON
object: the first one is a `snapshot`, later ones are `news`. A binary message holds frames as
columns, in the byte order of the processor that browsers share: little-endian.
"""

import json
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from canlog.database import Bus
from canlog.frames import KEY_EXTENDED, NOT_DATA, Frames, concat, empty
from canlog.live.feeds import News
from canlog.views.facts import message_head
from canlog.views.happenings import event_head
from canlog.views.packed import KeyGroup
from canlog.views.span import EPOCH_FROM_NS

VERSION: Final = 1
HISTORY_FRAMES: Final = 1_000_000
"""Most frames that a new viewer gets: 48 minutes of the train's bus. Memory stays bounded."""
EVENTS_MAX: Final = 20_000
BLOCKS_JOINED: Final = 64
"""Number of small blocks of the history that are joined into one."""
HEAD_WORDS: Final = 4
"""Words of 32 bits before the columns: number of frames, bytes a frame, and two of padding."""


class History:
    """What a viewer who comes now has to get: messages, events, and frames up to a bound."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._numbers: dict[tuple[int, int], int] = {}
        self.heads: list[dict[str, Any]] = []
        """What the page needs to decode each message, in the order of their numbers."""
        self._names: set[str] = set()
        self._events: list[dict[str, Any]] = []
        self._blocks: list[Frames] = []
        self._small: list[Frames] = []
        self.zero_ns: int | None = None
        """Instant that counts as zero: the first frame, or 0 in virtual time."""
        self.remark, self.ended = "", False
        for key in bus.by_key:
            self._number(key, 0)

    def snapshot(self) -> list[str | bytes]:
        """Return the messages for a new viewer."""
        head = {
            "kind": "snapshot",
            "version": VERSION,
            "zero": None if self.zero_ns is None else str(self.zero_ns),
            "messages": self.heads,
            "events": self._events,
            "remark": self.remark,
            "ended": self.ended,
        }
        self._join()
        return [_text(head), *(self._packed(block) for block in self._blocks)]

    def take(self, news: News) -> list[str | bytes]:
        """Add the news, and return the messages that pass them on to the viewers."""
        told: dict[str, Any] = {}
        known = len(self.heads)
        if len(news.frames):
            if self.zero_ns is None:
                first_ns = int(news.frames.at_ns[0])
                self.zero_ns = 0 if first_ns < EPOCH_FROM_NS else first_ns
                told["zero"] = str(self.zero_ns)
            self._add(news.frames)
        binary = [self._packed(news.frames)] if len(news.frames) else []
        if len(self.heads) > known:
            told["messages"] = self.heads[known:]
        if news.happenings and self.zero_ns is not None:
            told["events"] = [event_head(each, self.zero_ns) for each in news.happenings]
            self._events += told["events"]
            del self._events[:-EVENTS_MAX]
        if (news.remark, news.ended) != (self.remark, self.ended):
            self.remark, self.ended = news.remark, news.ended
            told |= {"remark": self.remark, "ended": self.ended}
        return [*([_text({"kind": "news", **told})] if told else []), *binary]

    def _add(self, frames: Frames) -> None:
        self._small.append(frames)
        if len(self._small) >= BLOCKS_JOINED:
            self._join()

    def _join(self) -> None:
        """Join the small blocks, and drop the oldest frames beyond the bound."""
        if self._small:
            self._blocks.append(concat(self._small))
            self._small = []
        if len(self._blocks) >= BLOCKS_JOINED:
            self._blocks = [concat(self._blocks)]
        while sum(map(len, self._blocks)) > HISTORY_FRAMES:
            excess = sum(map(len, self._blocks)) - HISTORY_FRAMES
            first = self._blocks[0]
            self._blocks[:1] = [first[excess:]] if excess < len(first) else []

    def _packed(self, frames: Frames) -> bytes:
        assert self.zero_ns is not None
        kinds = frames.key.astype(np.uint64) << np.uint64(8) | (frames.flags & np.uint8(NOT_DATA))
        found, where = np.unique(kinds, return_inverse=True)
        numbers = [self._number(int(each) >> 8, int(each) & 0xFF) for each in found]
        return packed(frames, self.zero_ns, np.array(numbers, np.uint16)[where])

    def _number(self, key: int, flags: int) -> int:
        """Return the number of a message in the stream; a new one gets the next."""
        number = self._numbers.get((key, flags))
        if number is None:
            number = self._numbers[key, flags] = len(self.heads)
            spec = self._bus.spec_at(key) if not flags else None
            name = self._bus.name_of(key) if not flags else f"{KINDS[flags]} {_id_text(key)}"
            if name in self._names:
                name += f" {_id_text(key)}"
            self._names.add(name)
            group = KeyGroup(key, flags, "", empty().at_ns)
            self.heads.append(message_head(group, spec, name))
        return number


KINDS: Final = {2: "remote", 4: "error", 6: "error"}


def packed(frames: Frames, zero_ns: int, numbers: "np.ndarray[Any, np.dtype[np.uint16]]") -> bytes:
    """Return one binary message.

    Args:
        numbers: (n,) number of each frame's message.
    """
    width = frames.data.shape[1]
    head = np.array([len(frames), width, 0, 0], "<u4")
    assert len(head) == HEAD_WORDS
    columns: Sequence[Any] = (
        head,
        (frames.at_ns - zero_ns).astype("<f8"),
        numbers.astype("<u2"),
        frames.flags,
        frames.channel,
        frames.length,
        frames.data,
    )
    return b"".join(np.ascontiguousarray(each).tobytes() for each in columns)


def _id_text(key: int) -> str:
    return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"


def _text(table: dict[str, Any]) -> str:
    return json.dumps(table, ensure_ascii=False, separators=(",", ":"))
