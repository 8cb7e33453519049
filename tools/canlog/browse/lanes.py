"""Frames by message, of a log or a live bus, for looking at any instant."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.bus_model import CHANNEL_SIGN
from canlog.database import Bus, MessageSpec
from canlog.frames import (
    ERROR,
    EXTENDED,
    FD_BYTES,
    KEY_EXTENDED,
    NOT_DATA,
    Bytes,
    Frames,
    Ints,
)
from canlog.plan import DecodingPlan, Payloads
from canlog.rows import from_rows
from canlog.table import CHANNEL_SHIFT, KEY_MASK, Table, table_of
from canlog.transport.messages import Messages, TransportStatus, incomplete_text
from canlog.transport.names import FAULTS, fault_text, uds_text
from canlog.transport.reassembly import Reassembler, is_part, options_for
from canlog.transport.senders import by_sender, message_key, sender_name, sender_spec
from canlog.views.packed import ordered

KEPT_MAX: Final = 1 << 16
"""Frames kept per message of a live bus; when it is full, the older half is dropped."""
RATE_NS: Final = 1_000_000_000
"""Period over which a frame rate is counted."""
LONG: Final = 1 << 48
"""Added to the key of a lane of reassembled messages."""
ERRORS: Final = -1
"""Key of the lane of error frames."""


class Lane:
    """Frames of one message, in order of time."""

    of_frames = True
    """Whether its rows are frames; those of others consist of several frames."""

    def __init__(self, key: int, name: str, spec: MessageSpec | None) -> None:
        self.key = key
        self.name = name
        self.spec = spec
        self.dropped = 0
        """Number of older frames that were dropped."""
        self._n = 0
        self._at_ns: Ints = np.zeros(64, np.int64)
        self._length: Bytes = np.zeros(64, np.uint8)
        self._data: Bytes = np.zeros((64, 8), np.uint8)

    @classmethod
    def whole(
        cls, key: int, name: str, spec: MessageSpec | None, at_ns: Ints, length: Bytes, data: Bytes
    ) -> "Lane":
        """Return a lane made of columns that are complete and in order of time."""
        lane = cls(key, name, spec)
        lane._at_ns, lane._length, lane._data, lane._n = at_ns, length, data, len(at_ns)
        return lane

    def __len__(self) -> int:
        return self._n

    @property
    def at_ns(self) -> Ints:
        return self._at_ns[: self._n]

    def add(self, at_ns: int, data: bytes) -> None:
        """Append the next frame of a live bus."""
        if len(data) > self._data.shape[1]:
            wide = np.zeros((len(self._data), FD_BYTES), np.uint8)
            wide[:, : self._data.shape[1]] = self._data
            self._data = wide
        if self._n == len(self._at_ns):
            self._make_room()
        self._at_ns[self._n] = at_ns
        self._length[self._n] = len(data)
        self._data[self._n] = 0
        self._data[self._n, : len(data)] = np.frombuffer(data, np.uint8)
        self._n += 1

    def _make_room(self) -> None:
        first = self._n // 2 if self._n >= KEPT_MAX else 0
        size = self._n if first else 2 * self._n
        for name in ("_at_ns", "_length", "_data"):
            old = getattr(self, name)
            new = np.zeros((size, *old.shape[1:]), old.dtype)
            new[: self._n - first] = old[first : self._n]
            setattr(self, name, new)
        self._n -= first
        self.dropped += first

    def row_at(self, at_ns: int) -> int:
        """Index of the last frame at or before an instant; -1 before the first frame."""
        return int(np.searchsorted(self.at_ns, at_ns, "right")) - 1

    def payload(self, row: int) -> bytes:
        return self._data[row, : int(self._length[row])].tobytes()

    def changed(self, row: int) -> tuple[bool, ...]:
        """For each byte, whether it differs from the same byte of the frame before."""
        mine = self.payload(row)
        if row == 0:
            return (False,) * len(mine)
        before = self.payload(row - 1)
        return tuple(at >= len(before) or byte != before[at] for at, byte in enumerate(mine))

    def rate_hz(self, at_ns: int) -> float:
        """Frames per second over the last second before an instant, or over what there is of it."""
        row = self.row_at(at_ns)
        first = int(np.searchsorted(self.at_ns, at_ns - RATE_NS, "right"))
        count = row + 1 - first
        if count < 2:
            return float(count)
        span_ns = int(self._at_ns[row] - self._at_ns[first])
        return (count - 1) * 1e9 / span_ns if span_ns else float(count)

    def told(self, row: int) -> str:
        """Return what a message says beside its signals; nothing for a single frame."""
        del row
        return ""

    def table(self, first: int, stop: int) -> Table | None:
        """Return the decoded rows from `first` up to, but not including, `stop`; None for an
        unknown message.
        """
        if self.spec is None:
            return None
        rows = slice(max(0, first), max(0, stop))
        payloads = Payloads(self._data[: self._n][rows], self._length[: self._n][rows])
        at_ns, numbers = self.at_ns[rows], np.arange(self._n, dtype=np.int64)[rows]
        return Table(DecodingPlan(self.spec), at_ns, lambda: numbers, payloads)


class LongLane(Lane):
    """Messages of one sender, each reassembled from several frames; the last one gives its time."""

    of_frames = False

    def __init__(self, key: int, name: str, spec: MessageSpec | None, group: int) -> None:
        super().__init__(key, name, spec)
        self._group = group
        self._payloads: list[bytes] = []
        self._status: list[TransportStatus] = []

    def append(self, found: Messages, rows: Ints, *, live: bool) -> None:
        """Add messages: these rows of `found`, in order of time. A live lane keeps KEPT_MAX."""
        at_ns = np.concatenate([self.at_ns, found.at_ns[rows]])
        payloads = [*self._payloads, *(found.payload(at) for at in rows.tolist())]
        status = [*self._status, *(TransportStatus(int(each)) for each in found.status[rows])]
        # A sender may use both transport protocols of J1939 for one message.
        order = np.argsort(at_ns, kind="stable")
        first = max(0, len(order) - KEPT_MAX) if live else 0
        kept = order[first:].tolist()
        self._at_ns, self._n = at_ns[kept], len(kept)
        self._payloads, self._status = [payloads[at] for at in kept], [status[at] for at in kept]
        self.dropped += first

    def payload(self, row: int) -> bytes:
        return self._payloads[row]

    def told(self, row: int) -> str:
        """Return why the message is incomplete, or its service, or its trouble codes."""
        if self._status[row] != TransportStatus.WHOLE:
            return incomplete_text(self._status[row])
        if self._group < 0:
            return uds_text(self._payloads[row])
        return fault_text(self._payloads[row]) if self._group in FAULTS else ""

    def table(self, first: int, stop: int) -> Table | None:
        if self.spec is None:
            return None
        rows = slice(max(0, first), max(0, stop))
        return table_of(self.spec, self._payloads[rows], self.at_ns[rows].tolist())


@dataclass(slots=True)
class Lanes:
    """All messages of a log or live bus."""

    bus: Bus
    lanes: dict[int, Lane]
    """Lanes by message key; the channel number stands in the bits above the key.

    LONG is added for reassembled messages.
    """
    start_ns: int = 0
    end_ns: int = 0
    _reassembler: Reassembler | None = None

    def sorted(self) -> Sequence[Lane]:
        return [self.lanes[key] for key in sorted(self.lanes)]

    def feed(self, frames: Iterable[tuple[int, int, int, bytes]]) -> int:
        """Add frames of a live bus, each (at_ns, key, flags, data), and return their number."""
        count, parts = 0, []
        for at_ns, key, flags, data in frames:
            if is_part(key) and not flags & ERROR:
                extended = EXTENDED if key & KEY_EXTENDED else 0
                parts.append((at_ns, key & ~KEY_EXTENDED, flags | extended, "", data))
            lane_key = ERRORS if flags & ERROR else key
            lane = self.lanes.get(lane_key)
            if lane is None:
                lane = self.lanes[lane_key] = _lane(self.bus, lane_key, "")
            if not self.end_ns:
                self.start_ns = at_ns
            self.end_ns = max(self.end_ns, at_ns)
            lane.add(at_ns, data)
            count += 1
        if parts:
            if self._reassembler is None:
                self._reassembler = Reassembler(options_for(self.bus))
            _add_long(self, self._reassembler.feed(from_rows(parts)), [""], live=True)
        return count


def _lane(bus: Bus, key: int, channel: str) -> Lane:
    """Return an empty lane; its name starts with the channel if there is one."""
    if key == ERRORS:
        return Lane(key, "error frames", None)
    bus, plain = bus.on(channel), key & KEY_MASK
    name = f"{channel}{CHANNEL_SIGN}{bus.name_of(plain)}" if channel else bus.name_of(plain)
    return Lane(key, name, bus.spec_at(plain))


def lanes_of(frames: Frames, bus: Bus) -> Lanes:
    """Return the lanes of a whole log.

    Remote frames carry no data and make no lane. All error frames share one lane.
    """
    in_order = ordered(frames)
    rows_of: dict[tuple[int, str], list[Ints]] = {}
    for group in in_order.groups:
        if group.flags & ERROR:
            rows_of.setdefault((ERRORS, ""), []).append(group.rows)
        elif not group.flags & NOT_DATA:
            number = frames.channels.index(group.channel) if group.channel else 0
            place = number << CHANNEL_SHIFT | group.key
            rows_of.setdefault((place, group.channel), []).append(group.rows)
    found = {}
    several = len({channel for _, channel in rows_of if channel}) > 1
    for (key, channel), pieces in rows_of.items():
        mine = in_order.frames[np.sort(np.concatenate(pieces))]
        empty = _lane(bus, key, channel if several else "")
        found[key] = Lane.whole(key, empty.name, empty.spec, mine.at_ns, mine.length, mine.data)
    stamps = in_order.frames.at_ns
    start_ns, end_ns = (int(stamps[0]), int(stamps[-1])) if len(stamps) else (0, 0)
    lanes = Lanes(bus, found, start_ns, end_ns)
    rows = [
        each.rows for each in in_order.groups if is_part(each.key) and not each.flags & NOT_DATA
    ]
    if rows:
        reassembler = Reassembler(options_for(bus))
        parts = reassembler.feed(in_order.frames[np.sort(np.concatenate(rows))])
        names = frames.channels if several else ("",) * len(frames.channels)
        _add_long(lanes, parts + reassembler.finish(), names, live=False)
    return lanes


def _add_long(
    lanes: Lanes, parts: Sequence[Messages], channels: Sequence[str], *, live: bool
) -> None:
    """Add reassembled messages to their lanes.

    Args:
        channels: what each channel is called in names of lanes; empty for the only one.
    """
    for found in parts:
        for (channel, key, group), rows in by_sender(found):
            number = found.channels.index(channel)
            shown = message_key(group, key) if group >= 0 else key
            place = LONG | number << CHANNEL_SHIFT | shown
            lane = lanes.lanes.get(place)
            if lane is None:
                name = sender_name(lanes.bus, channel, key, group)
                front = f"{channels[number]}{CHANNEL_SIGN}" if channels[number] else ""
                spec = sender_spec(lanes.bus, channel, group)
                lane = lanes.lanes[place] = LongLane(place, front + name, spec, group)
            assert isinstance(lane, LongLane)
            lane.append(found, rows, live=live)
