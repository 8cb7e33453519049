"""Reassembles J1939 transport and ISO-TP block by block; open messages wait for the next block."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.bus_model import Bus
from canlog.frames import KEY_EXTENDED, Bools, Bytes, Frames, Ints, concat, empty
from canlog.transport.messages import Messages, TransportKind, TransportStatus

NS_PER_MS: Final = 1_000_000
FIRST_GAP_NS: Final = 1250 * NS_PER_MS
"""J1939-21, T2 and T3: longest wait within a connection."""
PACKET_GAP_NS: Final = 750 * NS_PER_MS
"""J1939-21, T1: longest wait between packets of a broadcast."""
ISOTP_GAP_NS: Final = 1000 * NS_PER_MS
"""ISO 15765-2, N_Cr: longest wait for a consecutive frame."""
TP_CM, TP_DT = 0xEC, 0xEB
"""PDU formats of J1939: connection management and data transfer."""
ETP_CM, ETP_DT = 0xC8, 0xC7
"""The same of the extended transport protocol, for messages of more than 1,785 bytes."""
J1939_FORMATS: Final = (TP_CM, TP_DT, ETP_CM, ETP_DT)
RTS, CTS, ACKNOWLEDGED, BAM, ABORT = 16, 17, 19, 32, 255
ETP_RTS, ETP_CTS, ETP_OFFSET, ETP_ACKNOWLEDGED = 20, 21, 22, 23
CONTROLS: Final = (RTS, CTS, ACKNOWLEDGED, BAM, ABORT)
ETP_CONTROLS: Final = (ETP_RTS, ETP_CTS, ETP_OFFSET, ETP_ACKNOWLEDGED, ABORT)
PACKET_BYTES: Final = 7
SINGLE, FIRST, CONSECUTIVE = 0, 1, 2
DIAGNOSTIC_FORMATS: Final = (0xDA, 0xDB)
"""PDU formats of normal fixed addressing: to one node, to all."""
DIAGNOSTIC_IDS: Final = (0x700, 0x7FF)
OBD_IDS: Final = range(0x7DF, 0x7F0)
"""Identifiers that ISO 15765-4 reserves for diagnosis; a DBC file may define them, too."""
LENGTH_MAX: Final = 1 << 24
"""Length from which a first frame is taken as invalid."""
BAD: Final = -1


@dataclass(frozen=True, slots=True)
class TransportOptions:
    """Selects the frames of each protocol."""

    j1939: bool = True
    isotp: bool = True
    isotp_keys: tuple[int, ...] = ()
    """Keys that carry ISO-TP; empty for the usual diagnostic identifiers."""
    not_isotp: tuple[int, ...] = ()
    """Keys among the usual ones that carry other messages."""
    address_bytes: int = 0
    """Bytes of an extended address before the ISO-TP data of each frame."""


def options_for(bus: Bus) -> TransportOptions:
    """Return both protocols, without ISO-TP on identifiers that the DBC files define otherwise."""
    low, high = DIAGNOSTIC_IDS
    keys = {key for each in (bus, *bus.by_channel.values()) for key in each.by_key}
    defined = (key for key in keys if low <= key <= high and key not in OBD_IDS)
    return TransportOptions(not_isotp=tuple(sorted(defined)))


_Way = tuple[str, Callable[[Frames], Bools], "Callable[[Frames, Ints], _Segmented]"]
"""A protocol: its name, the filter for its frames, and its reassembly."""


class Reassembler:
    """Reassembles messages: feed it blocks of frames, and it returns completed messages."""

    def __init__(self, options: TransportOptions | None = None) -> None:
        self._options = options or TransportOptions()
        self._waiting: dict[str, tuple[Frames, Ints]] = {}
        self._seen = 0

    def feed(self, frames: Frames) -> list[Messages]:
        """Return the messages of the next block; open ones wait for the block after it."""
        first, self._seen = self._seen, self._seen + len(frames)
        return list(self._taken(frames, first, last=False))

    def finish(self) -> list[Messages]:
        """Return the messages that are still open at the end of the log."""
        return list(self._taken(empty(), self._seen, last=True))

    def _taken(self, frames: Frames, first: int, *, last: bool) -> Iterator[Messages]:
        ways: list[_Way] = []
        if self._options.j1939:
            ways.append(("j1939", is_j1939_transport, _J1939))
        if self._options.isotp:
            ways.append(("isotp", self._is_isotp, self._isotp))
        for name, chooses, made in ways:
            rows = np.flatnonzero(chooses(frames))
            mine, numbers = frames[rows], rows + first
            if name in self._waiting:
                before, before_rows = self._waiting.pop(name)
                mine = concat([before, mine]) if len(mine) else before
                numbers = np.concatenate([before_rows, numbers])
            if not len(mine):
                continue
            found, left = made(mine, numbers).messages(last=last)
            if left.any():
                self._waiting[name] = mine[left], numbers[left]
            if len(found):
                yield found

    def _is_isotp(self, frames: Frames) -> Bools:
        key, options = frames.key, self._options
        there: Bools = frames.is_data & (frames.length > options.address_bytes)
        if options.isotp_keys:
            there &= np.isin(key, np.array(options.isotp_keys, np.uint32))
            return there
        low, high = DIAGNOSTIC_IDS
        form = key >> np.uint32(16) & np.uint32(0xFF)
        fixed = (key >> np.uint32(31) != 0) & np.isin(form, DIAGNOSTIC_FORMATS)
        there &= ((key >= low) & (key <= high)) | fixed
        if options.not_isotp:
            there &= ~np.isin(key, np.array(options.not_isotp, np.uint32))
        return there

    def _isotp(self, frames: Frames, numbers: Ints) -> "_Segmented":
        return _IsoTp(frames, numbers, self._options.address_bytes)


def carries_parts(key: int) -> bool:
    """Whether frames of a key belong to the transport protocols of J1939."""
    return bool(key & KEY_EXTENDED) and key >> 16 & 0xFF in J1939_FORMATS


def is_part(key: int) -> bool:
    """Whether frames of a key may be parts of messages."""
    return carries_parts(key) or is_diagnostic(key)


def is_diagnostic(key: int) -> bool:
    """Whether frames of a key usually carry ISO-TP."""
    low, high = DIAGNOSTIC_IDS
    fixed = bool(key & KEY_EXTENDED) and key >> 16 & 0xFF in DIAGNOSTIC_FORMATS
    return fixed or low <= key <= high


def is_j1939_transport(frames: Frames) -> Bools:
    """(n,) frames of eight bytes of the transport protocol and the extended one."""
    form = frames.identifier >> np.uint32(16) & np.uint32(0xFF)
    found: Bools = frames.is_data & (frames.length == 8) & ((frames.flags & 1) != 0)
    found &= np.isin(form, J1939_FORMATS)
    return found


class _Segmented(ABC):
    """Frames of one protocol, sorted by session: starts, each followed by its segments."""

    any_order = False
    """Whether segments may come in any order."""

    def __init__(self, frames: Frames, numbers: Ints, session: Any) -> None:
        self.order = np.argsort(session, kind="stable")
        self.frames, self.numbers = frames[self.order], numbers[self.order]
        self.session = session[self.order]

    @abstractmethod
    def starts(self) -> Bools:
        """(n,) frames that begin a message."""

    @abstractmethod
    def part(self) -> tuple[Ints, Ints]:
        """(n,) where the message data begins and ends in each frame."""

    @abstractmethod
    def totals(self, starts: Ints) -> Ints:
        """Return the number of bytes that each start announces."""

    @abstractmethod
    def sequence(self) -> Ints:
        """(n,) number of each segment, BAD for other frames."""

    @abstractmethod
    def expected(self, position: Ints) -> Ints:
        """Return the number of the segment at a position, from 1."""

    @abstractmethod
    def columns(self, starts: Ints) -> tuple[Any, Ints, Bytes]:
        """Return key, group and kind of messages by their starts."""

    @abstractmethod
    def limit_ns(self, starts: Ints) -> Ints:
        """Return the longest wait for the next frame of each message."""

    def aborted(self, message: Ints, count: int) -> Bools:
        """Return which messages one side aborted."""
        del message
        return np.zeros(count, np.bool_)

    def repeats(self, rows: Ints, message: Ints) -> Ints:
        """Return the segments that repeat one of their message; the receiver ignores them.

        Args:
            rows: all segments of messages.
            message: (rows,) their messages.
        """
        del message
        return rows[:0]

    def needed_later(self) -> Bools:
        """(n,) frames without data that later segments of their message need."""
        return np.zeros(len(self.frames), np.bool_)

    def messages(self, *, last: bool) -> tuple[Messages, Bools]:
        """Return all completed messages, and which of the given frames wait for more."""
        is_start, sequence = self.starts(), self.sequence()
        starts = np.flatnonzero(is_start)
        message = np.cumsum(is_start) - 1
        # Segments before the first start of their session belong to a message that the log lacks.
        known = message >= 0
        known[known] = self.session[starts[message[known]]] == self.session[known]
        mine = known & (is_start | (sequence != BAD))
        segments = np.flatnonzero(mine & ~is_start)
        mine[self.repeats(segments, message[segments])] = False
        count = len(starts)
        low, high = self.part()
        sizes = np.where(mine, np.maximum(high - low, 0), 0)
        totals = self.totals(starts)
        before = np.cumsum(sizes) - sizes
        # Segments after the last byte belong to no message.
        rows = np.flatnonzero(mine)
        past = before[rows] - before[starts[message[rows]]]
        mine[rows] = is_start[rows] | (past < totals[message[rows]])
        sizes = np.where(mine, sizes, 0)
        used, owned = np.flatnonzero(mine), message[mine]
        got = np.bincount(owned, sizes[used], count).astype(np.int64)
        position = np.arange(len(used)) - np.searchsorted(owned, owned)
        wrong = (position > 0) & (sequence[used] != self.expected(position))
        stamps = self.frames.at_ns[used]
        gaps = np.diff(stamps, prepend=stamps[:1])
        late = (position > 0) & (gaps > self.limit_ns(starts)[owned])
        status = np.zeros(count, np.uint8)
        status[got < totals] = TransportStatus.UNFINISHED
        status[np.unique(owned[late])] = TransportStatus.TIMEOUT
        status[np.unique(owned[wrong])] = TransportStatus.WRONG_SEQUENCE
        status[self.aborted(message, count) & (got < totals)] = TransportStatus.ABORTED
        self.mend(status, used, owned, totals)
        open_ = np.zeros(count, np.bool_)
        if not last and count:
            final = np.ones(count, np.bool_)
            final[:-1] = self.session[starts[1:]] != self.session[starts[:-1]]
            open_ = final & (status == TransportStatus.UNFINISHED)
            if self.any_order:
                open_ |= final & (status == TransportStatus.WRONG_SEQUENCE) & (got < totals)
        left = np.zeros(len(self.frames), np.bool_)
        left[used[open_[owned]]] = True
        between = np.flatnonzero(known & self.needed_later())
        left[between[open_[message[between]]]] = True
        unsorted = np.zeros(len(self.frames), np.bool_)
        unsorted[self.order] = left
        return self._columns(starts, used, owned, totals, status, ~open_, low, sizes), unsorted

    @abstractmethod
    def mend(self, status: Bytes, used: Ints, owned: Ints, totals: Ints) -> None:
        """Repair, in place, messages with segments out of order that may still be complete."""

    def segments(self, used: Ints, owned: Ints, at: int) -> Ints:
        """Return the frames of one message in order of their data."""
        return used[np.searchsorted(owned, at) : np.searchsorted(owned, at, "right")]

    def _columns(
        self,
        starts: Ints,
        used: Ints,
        owned: Ints,
        totals: Ints,
        status: Bytes,
        kept: Bools,
        low: Ints,
        sizes: Ints,
    ) -> Messages:
        chosen = np.flatnonzero(kept)
        rows_kept = kept[owned]
        used, owned = used[rows_kept], owned[rows_kept]
        counts = np.bincount(owned, minlength=len(starts))[chosen]
        row_ends = np.cumsum(counts)
        whole = status[owned] == TransportStatus.WHOLE
        width = self.frames.data.shape[1]
        rows, column = used[whole], np.arange(width)
        spans = (column >= low[rows][:, None]) & (column < (low + sizes)[rows][:, None])
        flat = self.frames.data[rows][spans]
        # The last segment may have fill bytes after the last byte.
        lengths = np.where(status == TransportStatus.WHOLE, totals, 0)[chosen]
        held = np.bincount(owned[whole], sizes[rows], len(starts)).astype(np.int64)[chosen]
        offset = np.arange(len(flat)) - np.repeat(np.cumsum(held) - held, held)
        flat = flat[offset < np.repeat(lengths, held)]
        first, final = used[row_ends - counts], used[row_ends - 1]
        key, group, kind = self.columns(starts[chosen])
        return Messages(
            self.frames.at_ns[first],
            self.frames.at_ns[final],
            key,
            group,
            self.frames.channel[first],
            kind,
            status[chosen],
            flat,
            np.cumsum(lengths),
            self.numbers[used],
            row_ends,
            self.frames.channels,
        )


class _J1939(_Segmented):
    """Transport protocols of J1939-21, with sessions by channel, source and destination."""

    any_order = True

    def __init__(self, frames: Frames, numbers: Ints) -> None:
        identifier = frames.identifier
        form = identifier >> np.uint32(16) & np.uint32(0xFF)
        is_data = (form == TP_DT) | (form == ETP_DT)
        extended = (form == ETP_CM) | (form == ETP_DT)
        ends = identifier & np.uint32(0xFFFF)
        said = np.where(is_data, 0, frames.data[:, 0])
        known = np.where(extended, np.isin(said, ETP_CONTROLS), np.isin(said, CONTROLS))
        said = np.where(known, said, 0)
        # Frames of the receiver have source and destination swapped.
        back = np.isin(said, (CTS, ACKNOWLEDGED, ETP_CTS, ETP_ACKNOWLEDGED))
        swapped = ends >> np.uint32(8) | (ends & np.uint32(0xFF)) << np.uint32(8)
        if (said == ABORT).any():
            # Either side may abort: an abort belongs to the session that has data.
            with_data = np.unique(ends[is_data])
            back |= (said == ABORT) & ~np.isin(ends, with_data) & np.isin(swapped, with_data)
        session = np.where(back, swapped, ends).astype(np.int64)
        session |= frames.channel.astype(np.int64) << 16 | extended.astype(np.int64) << 24
        super().__init__(frames, numbers, session)
        self._control, self._is_data = said[self.order], is_data[self.order]
        self._sequence = self._numbered(extended[self.order])

    def _numbered(self, extended: Bools) -> Ints:
        """(n,) number of each packet in its message, from 1; BAD for other frames."""
        data = self.frames.data.astype(np.int64)
        found = np.where(self._is_data, data[:, 0], BAD)
        if not extended.any():
            return found
        at = np.arange(len(data))
        offset_at = np.maximum.accumulate(np.where(self._control == ETP_OFFSET, at, 0))
        offset = data[offset_at, 2] | data[offset_at, 3] << 8 | data[offset_at, 4] << 16
        # The sender gives an offset before each part; packets of the part count from it.
        given = offset_at > np.maximum.accumulate(np.where(self.starts(), at, 0))
        return np.where(extended & self._is_data, np.where(given, offset + found, BAD), found)

    def starts(self) -> Bools:
        found: Bools = np.isin(self._control, (BAM, RTS, ETP_RTS))
        return found

    def part(self) -> tuple[Ints, Ints]:
        low = np.ones(len(self.frames), np.int64)
        return low, np.where(self._is_data, 1 + PACKET_BYTES, 1)

    def totals(self, starts: Ints) -> Ints:
        data = self.frames.data[starts].astype(np.int64)
        short = data[:, 1] | data[:, 2] << 8
        return np.where(
            self._control[starts] == ETP_RTS, short | data[:, 3] << 16 | data[:, 4] << 24, short
        )

    def sequence(self) -> Ints:
        return self._sequence

    def expected(self, position: Ints) -> Ints:
        return position

    def limit_ns(self, starts: Ints) -> Ints:
        return np.where(self._control[starts] == BAM, PACKET_GAP_NS, FIRST_GAP_NS)

    def aborted(self, message: Ints, count: int) -> Bools:
        found = np.zeros(count, np.bool_)
        hit = message[(self._control == ABORT) & (message >= 0)]
        found[hit] = True
        return found

    def repeats(self, rows: Ints, message: Ints) -> Ints:
        """Return packets with number and data of an earlier one of their message."""
        number = self._sequence[rows]
        if ((message[1:] != message[:-1]) | (number[1:] > number[:-1])).all():
            return rows[:0]
        order = np.lexsort((number, message))
        data, number, message = self.frames.data[rows[order]], number[order], message[order]
        same = (message[1:] == message[:-1]) & (number[1:] == number[:-1])
        found: Ints = rows[order[1:][same & (data[1:] == data[:-1]).all(axis=1)]]
        return found

    def needed_later(self) -> Bools:
        found: Bools = self._control == ETP_OFFSET
        return found

    def mend(self, status: Bytes, used: Ints, owned: Ints, totals: Ints) -> None:
        """Accept packets in any order: sort each message's packets by their numbers."""
        for at in np.flatnonzero(status == TransportStatus.WRONG_SEQUENCE).tolist():
            rows = self.segments(used, owned, at)[1:]
            wanted = -(-int(totals[at]) // PACKET_BYTES)
            order = np.argsort(self._sequence[rows], kind="stable")
            if np.array_equal(self._sequence[rows][order], np.arange(1, wanted + 1)):
                self.frames.data[rows] = self.frames.data[rows[order]]
                status[at] = TransportStatus.WHOLE

    def columns(self, starts: Ints) -> tuple[Any, Ints, Bytes]:
        data, control = self.frames.data[starts].astype(np.int64), self._control[starts]
        group = data[:, 5] | data[:, 6] << 8 | data[:, 7] << 16
        kind = np.where(control == BAM, TransportKind.BROADCAST, TransportKind.CONNECTION)
        kind[control == ETP_RTS] = TransportKind.EXTENDED
        return self.frames.key[starts], group, kind.astype(np.uint8)


class _IsoTp(_Segmented):
    """ISO 15765-2, with sessions by channel and identifier."""

    def __init__(self, frames: Frames, numbers: Ints, address_bytes: int) -> None:
        session = frames.key.astype(np.int64) | frames.channel.astype(np.int64) << 32
        super().__init__(frames, numbers, session)
        self._at = address_bytes
        head = self._column(0)
        self._type, self._low = head >> 4, head & 15
        self._length = self.frames.length.astype(np.int64)
        self._escaped = (self._type == SINGLE) & (self._low == 0) & (self._length > 8)
        long = (self._low << 8 | self._column(1)) == 0
        self._wide = (self._type == FIRST) & long & (self._length >= address_bytes + 6)
        self._announced = self._totals()

    def _column(self, at: int) -> Ints:
        place = self._at + at
        if place >= self.frames.data.shape[1]:
            return np.zeros(len(self.frames), np.int64)
        return self.frames.data[:, place].astype(np.int64)

    def _totals(self) -> Ints:
        short = np.where(self._escaped, self._column(1), self._low)
        long = self._low << 8 | self._column(1)
        wide = (
            self._column(2) << 24 | self._column(3) << 16 | self._column(4) << 8 | self._column(5)
        )
        return np.where(self._type == SINGLE, short, np.where(self._wide, wide, long))

    def starts(self) -> Bools:
        room = self._length - self._at - np.where(self._escaped, 2, 1)
        single = (self._type == SINGLE) & (self._announced > 0) & (self._announced <= room)
        first = (self._type == FIRST) & (self._announced > room) & (self._announced < LENGTH_MAX)
        found: Bools = single | first
        return found

    def part(self) -> tuple[Ints, Ints]:
        low = np.where(self._type == SINGLE, np.where(self._escaped, 2, 1), 1)
        low = np.where(self._type == FIRST, np.where(self._wide, 6, 2), low) + self._at
        high = np.where(self._type == SINGLE, low + self._announced, self._length)
        return low, np.minimum(high, self._length)

    def totals(self, starts: Ints) -> Ints:
        return self._announced[starts]

    def sequence(self) -> Ints:
        return np.where(self._type == CONSECUTIVE, self._low, BAD)

    def expected(self, position: Ints) -> Ints:
        return position & 15

    def limit_ns(self, starts: Ints) -> Ints:
        return np.full(len(starts), ISOTP_GAP_NS)

    def mend(self, status: Bytes, used: Ints, owned: Ints, totals: Ints) -> None:
        """Do nothing: an ISO-TP receiver drops a message whose segments are out of order."""

    def columns(self, starts: Ints) -> tuple[Any, Ints, Bytes]:
        kind = np.where(self._type[starts] == SINGLE, TransportKind.SINGLE, TransportKind.SEGMENTED)
        return self.frames.key[starts], np.full(len(starts), -1), kind.astype(np.uint8)
