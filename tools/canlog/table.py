"""All frames of one message as columns of physical values, decoded on demand."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, Final

import numpy as np

from canlog import kernel
from canlog.arrow_columns import arrow_column, arrow_names
from canlog.bus_model import LogPart
from canlog.database import MessageSpec
from canlog.frames import CLASSIC_BYTES, FD_BYTES, Bools, Frames, Ints, concat, renumbered, widened
from canlog.plan import Column, DecodingPlan, Payloads, Raws, signed_raw
from canlog.shelf import Room, in_memory

SHORT: Final = 2048
"""Limit below which a key is an 11-bit identifier, which is looked up."""


class Table:
    """`n` frames of one message. `table["speed_mps"]` is a column (n,) of physical values.

    Integers stay integers. If a frame is too short for a signal, or a multiplexer selects others,
    `valid` is false and the value is NaN, or 0 for an integer.
    """

    def __init__(
        self, plan: DecodingPlan, at_ns: Ints, rows: Callable[[], Ints], payloads: Payloads
    ) -> None:
        self.spec: MessageSpec = plan.spec
        self.at_ns = at_ns
        """(n,) int64 stamps."""
        self._rows = rows
        self.payloads = payloads
        self._plan = plan
        self._columns: dict[str, Column] = {}
        self._block: Column | None = None
        self._valid: dict[str, Bools] = {}

    def __len__(self) -> int:
        return len(self.at_ns)

    @property
    def rows(self) -> Ints:
        """(n,) indices of these frames in the log."""
        return self._rows()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, in order of their bits."""
        return tuple(self._plan.cuts)

    @property
    def units(self) -> Mapping[str, str]:
        return {signal.name: signal.unit for signal in self.spec.signals}

    @property
    def choices(self) -> Mapping[str, Mapping[int, str]]:
        """Value tables, by raw value, of the signals that have one."""
        return {signal.name: signal.choices for signal in self.spec.signals if signal.choices}

    def __contains__(self, name: object) -> bool:
        return name in self._plan.cuts

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> Column:
        """(n,) physical values. Raises LogError for a name that the message does not have."""
        found = self._columns.get(name)
        if found is None:
            self.spec.signal(name)
            found = self._plan.physical(name, self.payloads, self._room(name))
            absent = self._plan.valid(name, self.payloads)
            if absent is not None:
                found = np.where(absent, found, _nothing(found))
            self._columns[name] = found
        return found

    def _room(self, name: str) -> Column:
        """Return a signal's share of one allocation for all columns, which costs fewer page
        faults.
        """
        if self._block is None:
            self._block = np.empty((len(self._plan.cuts), len(self)), np.uint64)
        room: Column = self._block[self.names.index(name)]
        return room

    def valid(self, name: str) -> Bools:
        """(n,) whether the frame carries the signal."""
        found = self._valid.get(name)
        if found is None:
            self.spec.signal(name)
            found = self._plan.valid(name, self.payloads)
            found = self._valid[name] = np.ones(len(self), np.bool_) if found is None else found
        return found

    def raw(self, name: str) -> Column:
        """(n,) raw value: int64 for a signed signal, uint64 for others."""
        spec = self.spec.signal(name)
        bits: Raws = self._plan.raw(name, self.payloads)
        return signed_raw(spec, bits)

    def labels(self, name: str) -> "list[str | None]":
        """Names from a signal's value table; None if the table has none or the frame lacks the
        signal.
        """
        choices = self.spec.signal(name).choices
        pairs = zip(self.raw(name).tolist(), self.valid(name).tolist(), strict=True)
        return [choices.get(raw) if valid else None for raw, valid in pairs]

    @property
    def undefined(self) -> Bools:
        """(n,) frames with a multiplexer value that the DBC file does not define."""
        found = self._plan.undefined(self.payloads)
        return np.zeros(len(self), np.bool_) if found is None else found

    def arrow(self, part: LogPart | None = None) -> Any:
        """Return a pyarrow.Table: `at_ns`, then each signal, null if a frame lacks it.

        Metadata of fields and schema hold units, value tables and the message's name. Integers of
        more than 64 bits become text.

        Args:
            part: adds columns with its channel and, in J1939, its addresses after the stamps.
        """
        import pyarrow as pa

        fields, columns = [pa.field("at_ns", pa.int64())], [arrow_column(self.at_ns)]
        for name, value in ({} if part is None else part.columns).items():
            columns.append(arrow_names(np.zeros(len(self)), [value]))
            fields.append(pa.field(name, columns[-1].type))
        for signal in self.spec.signals:
            column = arrow_column(exported(self[signal.name]), self.valid(signal.name))
            told = {"unit": signal.unit, **{f"value {r}": n for r, n in signal.choices.items()}}
            fields.append(pa.field(signal.name, column.type, metadata=told))
            columns.append(column)
        schema = pa.schema(fields, metadata={"message": self.spec.name})
        return pa.Table.from_arrays(columns, schema=schema)


def exported(column: Column) -> Any:
    """Return a column that other programs can read: long integers as hexadecimal text."""
    if column.dtype.kind != "O":
        return column
    return np.array([hex(value) for value in column.tolist()], str)


def table_of(
    spec: MessageSpec,
    data: Sequence[bytes],
    at_ns: Sequence[int] | None = None,
    rows: Sequence[int] | None = None,
) -> Table:
    """Make a table of single payloads, such as those that an event names.

    Args:
        at_ns: their stamps; 0 by default.
        rows: their frames in the log.
    """
    longest = max((len(each) for each in data), default=0)
    width = CLASSIC_BYTES if longest <= CLASSIC_BYTES else max(longest, FD_BYTES)
    joined = b"".join(each.ljust(width, b"\0") for each in data)
    length = np.array([len(each) for each in data], np.uint16)
    payloads = Payloads(np.frombuffer(joined, np.uint8).reshape(-1, width), length)
    stamps = np.zeros(len(data), np.int64) if at_ns is None else np.array(at_ns, np.int64)
    places = np.arange(len(data)) if rows is None else np.array(rows, np.int64)
    return Table(DecodingPlan(spec), stamps, lambda: places, payloads)


def merged(tables: Sequence[Table]) -> Table:
    """Join tables of one message in order of time."""
    if len(tables) == 1:
        return tables[0]
    at_ns = np.concatenate([each.at_ns for each in tables])
    order = np.argsort(at_ns, kind="stable")
    width = max(each.payloads.width for each in tables)
    data = np.concatenate([widened(each.payloads.data, width) for each in tables])
    length = np.concatenate([each.payloads.length.astype(np.uint16) for each in tables])
    return Table(
        DecodingPlan(tables[0].spec),
        at_ns[order],
        lambda: np.concatenate([each.rows for each in tables])[order],
        Payloads(data[order], length[order]),
    )


def _nothing(column: Column) -> Any:
    if column.dtype.kind == "O":
        return 0
    return np.nan if column.dtype.kind == "f" else column.dtype.type(0)


Spans = dict[int, tuple[int, int]]
"""Range of the sorted frames for each place: the channel index above 32 bits of key."""
CHANNEL_SHIFT: Final = 32
KEY_MASK: Final = (1 << CHANNEL_SHIFT) - 1


class Groups:
    """Sorts frames once by message and channel."""

    def __init__(self, frames: Frames | Sequence[Frames], room: Room = in_memory) -> None:
        """Sort the frames of one or several blocks of one log; `room` allocates the columns."""
        self._blocks = (frames,) if isinstance(frames, Frames) else tuple(frames)
        self._room = room
        names = list(dict.fromkeys(name for block in self._blocks for name in block.channels))
        self.channels = tuple(names)
        channels = [renumbered(block, names) for block in self._blocks]
        self._told = kernel.numbered(self._blocks, channels, room)
        self._columns: tuple[Any, ...] | None = None
        self._order: Ints | None = None
        self._chosen: dict[tuple[int, ...], Ints] = {}
        if self._told is None:
            place = self.frames.key.astype(np.uint64)
            place |= np.concatenate([*channels, np.zeros(0, np.uint8)]).astype(
                np.uint64
            ) << np.uint64(CHANNEL_SHIFT)
            rows = np.flatnonzero(self.frames.is_data)
            self._order = rows[np.argsort(_numbers(place[rows]), kind="stable")]
            self._spans = _spans(place[self._order])
            return
        starts = self._told.starts
        places, ends = self._told.keys.tolist(), (starts + self._told.counts).tolist()
        spans = sorted(zip(places, starts.tolist(), ends, strict=True))
        self._spans = {place: (start, end) for place, start, end in spans}
        self._columns = kernel.grouped(self._told, self._blocks, room)

    @cached_property
    def frames(self) -> Frames:
        return concat(self._blocks)

    @cached_property
    def keys(self) -> tuple[int, ...]:
        """Keys of all data frames, sorted, on any channel."""
        return tuple(sorted({place & KEY_MASK for place in self._spans}))

    @cached_property
    def places(self) -> tuple[tuple[int, str], ...]:
        """Key and channel of all data frames, sorted by key."""
        found = [(place & KEY_MASK, place >> CHANNEL_SHIFT) for place in self._spans]
        return tuple((key, self.channels[channel]) for key, channel in sorted(found))

    def _places(self, keys: Sequence[int], channel: str | None) -> tuple[int, ...]:
        numbers = range(len(self.channels))
        if channel is not None:
            numbers = range(0)
            if channel in self.channels:
                at = self.channels.index(channel)
                numbers = range(at, at + 1)
        places = (number << CHANNEL_SHIFT | key for number in numbers for key in keys)
        return tuple(place for place in places if place in self._spans)

    def _index(self, places: tuple[int, ...]) -> "slice | Ints":
        """Return the positions of the frames of some places among the sorted ones, in log order."""
        if len(places) < 2:
            return slice(*self._spans[places[0]]) if places else slice(0, 0)
        found = self._chosen.get(places)
        if found is None:
            spans = [np.arange(*self._spans[place], dtype=np.int64) for place in places]
            index = np.concatenate(spans)
            found = self._chosen[places] = index[np.argsort(self._sorted_rows[index])]
        return found

    @property
    def _sorted_rows(self) -> Ints:
        if self._order is None:
            assert self._told is not None
            self._order = self._told.order(self._room)
        return self._order

    def rows(self, *keys: int, channel: str | None = None) -> Ints:
        """Indices of the data frames with one of these keys, rising; None means any channel."""
        return self._sorted_rows[self._index(self._places(keys, channel))]

    def count(self, *keys: int, channel: str | None = None) -> int:
        """Number of data frames with one of these keys."""
        spans = (self._spans[place] for place in self._places(keys, channel))
        return sum(stop - start for start, stop in spans)

    def at_ns(self, *keys: int, channel: str | None = None) -> Ints:
        """(n,) stamps of the data frames with one of these keys."""
        index = self._index(self._places(keys, channel))
        if self._columns is None:
            return self.frames.at_ns[self._sorted_rows[index]]
        stamps: Ints = self._columns[0][index]
        return stamps

    def payloads(self, *keys: int, channel: str | None = None) -> Payloads:
        """Data of the frames with one of these keys."""
        index = self._index(self._places(keys, channel))
        if self._columns is None:
            rows = self._sorted_rows[index]
            return Payloads(taken(self.frames, rows), self.frames.length[rows])
        words, length = self._columns[1][index], self._columns[2][index]
        return Payloads(words.view(np.uint8).reshape(-1, 8), length)

    def table(
        self, spec: MessageSpec, channel: str | None = None, keys: Sequence[int] = ()
    ) -> Table:
        """Return the frames of a message.

        Args:
            channel: take only this channel; None for all.
            keys: keys of the message, if they are not only its own.
        """
        mine = tuple(keys) or (spec.key,)
        rows = partial(self.rows, *mine, channel=channel)
        payloads = self.payloads(*mine, channel=channel)
        return Table(DecodingPlan(spec), self.at_ns(*mine, channel=channel), rows, payloads)


def taken(frames: Frames, rows: Ints) -> Any:
    """Return rows of the data, copied as 64-bit words if possible, which is many times faster."""
    data = frames.data
    if data.shape[1] == 8 and data.flags.c_contiguous:
        return data.view(np.uint64)[:, 0][rows].view(np.uint8).reshape(-1, 8)
    return data[rows]


def _spans(key: Any) -> Spans:
    """Return the range of rows of each key; the keys are sorted."""
    cuts = [0, *(np.flatnonzero(np.diff(key)) + 1).tolist(), len(key)]
    return {int(key[start]): (start, stop) for start, stop in pairwise(cuts) if stop > start}


def _numbers(key: Any) -> Any:
    """(n,) numbers that sort like the keys: 16 bits if possible, which numpy sorts fastest."""
    if not len(key) or int(key.max()) < SHORT:
        return key.astype(np.uint16)
    short = key < np.uint64(SHORT)
    long = np.flatnonzero(~short)
    known = np.unique(key[long])
    if len(known) + SHORT > 1 << 16:
        return key
    number = np.where(short, key, 0).astype(np.uint16)
    number[long] = np.searchsorted(known, key[long]).astype(np.uint16) + np.uint16(SHORT)
    return number
