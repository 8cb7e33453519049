"""ASAM MDF 4 bus logging: groups of CAN frames, in finished, unfinished or torn files."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog import kernel
from canlog.damage import Damages, LogError
from canlog.formats.identifiers import possible
from canlog.formats.mf4_blocks import VARIABLE, DataGroup, Field, Group, Mf4File, numbers_of
from canlog.formats.mf4_write import write
from canlog.frames import (
    BRS,
    CLASSIC_BYTES,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_BYTES,
    FD_LENGTHS,
    REMOTE,
    TX,
    Bytes,
    Frames,
    Ints,
    concat,
    widened,
)
from canlog.inflate import fastest
from canlog.options import ReadOptions
from canlog.source import opened

__all__ = ["read", "write"]

KINDS: Final = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
NS_PER_S: Final = 1_000_000_000
EXACT_NS: Final = 1 << 62
GATHERED: Final = 1 << 16
"""Maximum number of records that are taken together."""
LENGTH_BYTES: Final = 4
"""Size of the length field before a value of variable length."""
_LENGTHS: Final = np.array(FD_LENGTHS, np.uint8)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of all CAN groups, merged by their stamps; bus 1 is called `can1`.

    Stamps are often float64 seconds since the start: exact to a nanosecond for logs of up to 50
    days. A file that ends inside a record gives all complete records.

    Raises:
        LogError: for a file that is no MDF 4 file.
    """
    with opened(path, damages) as source:
        try:
            file = Mf4File(source.data, source.size, damages, fastest(options.inflater))
        except LogError as error:
            raise LogError(f"{path}: no usable MDF 4 file: {error}") from None
        readers = [_Reader(file, each, options, damages) for each in file.data_groups]
        yield from source.lean(merged([each.frames() for each in readers if each.holds_frames]))


class _Reader:
    """Reads the records of one data group, and the frames in them."""

    def __init__(
        self, file: Mf4File, data: DataGroup, options: ReadOptions, damages: Damages
    ) -> None:
        self._file, self._data, self._options, self._damages = file, data, options, damages
        self._kinds = {group.record_id: kind for group in data.groups if (kind := _kind(group))}
        for group in data.groups:
            if group.record_id not in self._kinds and not group.is_variable and group.count:
                damages.skip(_name(group), group.count)

    @property
    def holds_frames(self) -> bool:
        return bool(self._kinds) and bool(self._data.data_link)

    def frames(self) -> Iterator[Frames]:
        if not self._data.id_bytes and len(self._data.groups) == 1:
            yield from self._sorted(self._data.groups[0])
        else:
            yield from self._unsorted()

    def _sorted(self, group: Group) -> Iterator[Frames]:
        """Yield the frames of records of one layout that follow each other."""
        if not group.size:
            return
        done, limit = 0, None if self._file.cycles_open else group.count
        values = self._values_of(group)
        rest = b""
        for content in _gathered(
            self._file.content(self._data.data_link),
            group.size * min(self._options.block_frames, GATHERED),
        ):
            content = rest + content if rest else content
            count = len(content) // group.size
            if limit is not None:
                count = min(count, limit - done)
            if count:
                records = np.frombuffer(content, np.uint8, count * group.size)
                yield self._frames(group, records.reshape(count, group.size), values)
            done += count
            rest = bytes(content[count * group.size :])
        self._report_missing(group, done, len(rest) if limit is None else 0)

    def _report_missing(self, group: Group, done: int, rest: int) -> None:
        """Report the records that a torn file lacks."""
        if not self._file.cycles_open and done < group.count:
            words = f"{done} of {group.count} records of {_name(group)} found"
            self._damages.add("torn file", "frame", done + 1, words, group.count - done)
        elif rest:
            words = f"{rest} of {group.size} bytes of the last record of {_name(group)}"
            self._damages.add("torn file", "frame", done + 1, words)

    def _values_of(self, group: Group) -> "_Values | None":
        """Return the data of variable length if they lie in a block of their own."""
        name = _kind(group) or ""
        field = group.fields.get(f"{name}.DataBytes")
        if field is None or field.kind != VARIABLE:
            return None
        values = _Values()
        values.add_content(b"".join(self._file.content(field.data_link)))
        return values

    def _unsorted(self) -> Iterator[Frames]:
        """Yield the frames of records of several layouts, each preceded by its group number."""
        by_id = {group.record_id: group for group in self._data.groups}
        values = {group.at: _Values() for group in self._data.groups if group.is_variable}
        done = dict.fromkeys(by_id, 0)
        waiting: dict[int, Any] = {}
        rest = b""
        pieces = self._file.content(self._data.data_link)
        for content in _gathered(pieces, 32 * min(self._options.block_frames, GATHERED)):
            content = rest + bytes(content) if rest else bytes(content)
            stop, places, numbers = _walk(content, self._data.id_bytes, by_id)
            broken = stop < 0
            if broken:
                words = "of no group of the file; the records after it are lost"
                self._damages.add("broken record", "frame", sum(done.values()) + len(places), words)
                stop = len(content)
            rest = content[stop:]
            text = np.frombuffer(content, np.uint8)
            for number, group in by_id.items():
                mine = places[numbers == number]
                done[number] += len(mine)
                if group.is_variable:
                    values[group.at].add_records(text, mine)
                elif number in self._kinds and len(mine):
                    records = np.lib.stride_tricks.sliding_window_view(text, group.size)[mine]
                    waiting[number] = np.concatenate([waiting.get(number, records[:0]), records])
            blocks = self._ready_blocks(by_id, waiting, values)
            if blocks:
                joined = concat(blocks)
                yield joined[np.argsort(joined.at_ns, kind="stable")]
            if broken:
                return
        lost = sum(len(records) for records in waiting.values())
        if rest or lost:
            words = f"{len(rest)} bytes after the last complete record"
            self._damages.add("torn file", "frame", sum(done.values()) + 1, words, max(lost, 1))
        if not self._file.cycles_open and not rest:
            for number in self._kinds:
                self._report_missing(by_id[number], done[number], 0)

    def _ready_blocks(
        self, by_id: Mapping[int, Group], waiting: dict[int, Any], values: "Mapping[int, _Values]"
    ) -> list[Frames]:
        """Take the records out of `waiting` whose data of variable length has been read."""
        blocks = []
        for number, records in waiting.items():
            group = by_id[number]
            found = values.get(_variable_link(group))
            ready = found.ready(_offsets(group, records)) if found else len(records)
            if ready:
                blocks.append(self._frames(group, records[:ready], found))
            waiting[number] = records[ready:]
        return blocks

    def _frames(self, group: Group, records: Any, values: "_Values | None") -> Frames:
        name = _kind(group)
        assert name is not None
        return possible(_frames(group, records, name, self._file.start_ns, self._damages, values),
                        self._damages)  # fmt: skip


def _kind(group: Group) -> str | None:
    return next(
        (name for name in KINDS if f"{name}.ID" in group.fields or name in group.fields), None
    )


def _name(group: Group) -> str:
    """Name of a group: that of its first channel that is not a clock."""
    return next((name.partition(".")[0] for name in group.fields if name), "group without channels")


def _gathered(pieces: Iterable[bytes | bytearray], least: int) -> Iterator[bytes | bytearray]:
    """Join pieces until they hold at least this many bytes."""
    parts: list[bytes | bytearray] = []
    size = 0
    for piece in pieces:
        parts.append(piece)
        size += len(piece)
        if size >= least:
            yield parts[0] if len(parts) == 1 else b"".join(parts)
            parts, size = [], 0
    if parts:
        yield parts[0] if len(parts) == 1 else b"".join(parts)


def _walk(content: bytes, id_bytes: int, groups: dict[int, Group]) -> tuple[int, Any, Any]:
    """Find the records in a piece of content.

    It returns where the first incomplete record begins, or -1 after a record of an unknown group.
    It also returns the place of each record after its group number, and that number.
    """
    sizes = {number: -1 if each.is_variable else each.size for number, each in groups.items()}
    found = kernel.records(content, id_bytes, sizes)
    if found is not None:
        return found
    places, numbers, at, end = [], [], 0, len(content)
    while at + id_bytes <= end:
        number = int.from_bytes(content[at : at + id_bytes], "little")
        size = sizes.get(number)
        if size is None:
            at = -1
            break
        first = at + id_bytes
        if size < 0:
            size = LENGTH_BYTES + int.from_bytes(content[first : first + LENGTH_BYTES], "little")
            if first + LENGTH_BYTES > end:
                break
        if first + size > end:
            break
        places.append(first)
        numbers.append(number)
        at = first + size
    return at, np.array(places, np.int64), np.array(numbers, np.int64)


class _Values:
    """Values of variable length, addressed by their offset in a stream of lengths and bytes."""

    def __init__(self) -> None:
        self._text = np.zeros(0, np.uint8)
        self._begin = 0
        """Offset of `_text` in the stream; the values before it have been used."""

    def add_content(self, content: bytes) -> None:
        self._text = np.concatenate([self._text, np.frombuffer(content, np.uint8)])

    def add_records(self, text: Bytes, places: Ints) -> None:
        """Append length and bytes of the records at these places of a text."""
        if not len(places):
            return
        padded = np.concatenate([text, np.zeros(LENGTH_BYTES, np.uint8)])
        heads = np.lib.stride_tricks.sliding_window_view(padded, LENGTH_BYTES)[places]
        sizes = np.ascontiguousarray(heads).view("<u4")[:, 0].astype(np.int64) + LENGTH_BYTES
        starts = np.cumsum(sizes) - sizes
        index = np.repeat(places - starts, sizes) + np.arange(int(sizes.sum()))
        self._text = np.concatenate([self._text, text[index]])

    def ready(self, offsets: Any) -> int:
        """Return how many of these values, from the first on, have been read."""
        there = offsets.astype(np.int64) < self._begin + len(self._text)
        return len(there) if there.all() else int(there.argmin())

    def take(self, offsets: Any) -> tuple[Bytes, Any]:
        """Return (n, 8) or (n, 64) bytes, and the length of each value."""
        at = offsets.astype(np.int64) - self._begin
        at = np.clip(at, 0, len(self._text))
        padded = np.concatenate([self._text, np.zeros(LENGTH_BYTES + FD_BYTES, np.uint8)])
        heads = np.lib.stride_tricks.sliding_window_view(padded, LENGTH_BYTES)[at]
        sizes = np.minimum(np.ascontiguousarray(heads).view("<u4")[:, 0], FD_BYTES)
        width = CLASSIC_BYTES if int(sizes.max(initial=0)) <= CLASSIC_BYTES else FD_BYTES
        data = np.lib.stride_tricks.sliding_window_view(padded, width)[at + LENGTH_BYTES].copy()
        if len(at):
            # Values are used in order, so those before the last one are not needed again.
            cut = int(at.max())
            self._text, self._begin = self._text[cut:], self._begin + cut
        return data, sizes.astype(np.uint8)


def _variable_link(group: Group) -> int:
    name = _kind(group)
    field = group.fields.get(f"{name}.DataBytes")
    return field.data_link if field is not None and field.kind == VARIABLE else 0


def _offsets(group: Group, records: Any) -> Any:
    return numbers_of(records, group.fields[f"{_kind(group)}.DataBytes"])


def _frames(
    group: Group,
    records: Any,
    name: str,
    start_ns: int,
    damages: Damages,
    values: _Values | None,
) -> Frames:
    n = len(records)

    def field(of: str) -> Any:
        found = group.fields.get(f"{name}.{of}")
        return np.zeros(n, np.uint8) if found is None else numbers_of(records, found)

    identifier = field("ID").astype(np.uint32)
    flags = np.full(n, KINDS[name], np.uint8)
    extended = (field("IDE") != 0) | ((identifier & np.uint32(0x8000_0000)) != 0)
    for bit, on in (
        (EXTENDED, extended), (FD, field("EDL") != 0), (BRS, field("BRS") != 0),
        (ESI, field("ESI") != 0), (TX, field("Dir") != 0),
    ):  # fmt: skip
        flags |= on * np.uint8(bit)
    data, sizes = _data(group, name, records, values)
    code = np.minimum(field("DLC"), 15).astype(np.uint8)
    told = f"{name}.DataLength" in group.fields and KINDS[name] != REMOTE
    length = field("DataLength").astype(np.uint8) if told else sizes
    if length is None or KINDS[name] == REMOTE:
        length = np.where((flags & FD) != 0, _LENGTHS[code], np.minimum(code, 8)).astype(np.uint8)
    length = np.minimum(length, data.shape[1])
    data = np.where(np.arange(data.shape[1]) < length[:, None], data, 0).astype(np.uint8)
    bus = field("BusChannel").astype(np.uint8)
    numbers = np.unique(bus)
    return Frames(
        _stamps_ns(group.fields.get(""), records, damages, name) + start_ns,
        identifier & np.uint32(0x7FFF_FFFF),
        flags,
        np.searchsorted(numbers, bus).astype(np.uint8),
        length.astype(np.uint8),
        data,
        tuple(f"can{number}" for number in numbers.tolist()),
    )


def _data(group: Group, name: str, records: Any, values: _Values | None) -> tuple[Bytes, Any]:
    """Return (n, 8) or (n, 64) data, and the lengths of values that have their own."""
    found = group.fields.get(f"{name}.DataBytes")
    if found is None:
        return np.zeros((len(records), CLASSIC_BYTES), np.uint8), None
    if found.kind == VARIABLE:
        return (
            values.take(numbers_of(records, found)) if values is not None else _data_none(records)
        )
    size = min(found.bits // 8, FD_BYTES, max(records.shape[1] - found.byte, 0))
    data = records[:, found.byte : found.byte + size]
    return widened(data, CLASSIC_BYTES if size <= CLASSIC_BYTES else FD_BYTES), None


def _data_none(records: Any) -> tuple[Bytes, Any]:
    return np.zeros((len(records), CLASSIC_BYTES), np.uint8), np.zeros(len(records), np.uint8)


def _stamps_ns(field: Field | None, records: Any, damages: Damages, name: str) -> Ints:
    """(n,) nanoseconds since the start of the log."""
    if field is None:
        damages.add("no stamps", "frame", None, f"{name}: its group has no clock; all are at 0")
        return np.zeros(len(records), np.int64)
    raw = numbers_of(records, field)
    step_ns = field.step_s * NS_PER_S
    whole = raw.dtype.kind != "f" and abs(step_ns - round(step_ns)) < 1e-6 and round(step_ns) > 0
    if whole and (not len(raw) or int(raw.max()) < EXACT_NS // round(step_ns)):
        exact: Ints = raw.astype(np.int64) * round(step_ns) + round(field.zero_s * NS_PER_S)
        return exact
    at_ns = np.rint((raw * field.step_s + field.zero_s) * NS_PER_S)
    if not (np.abs(at_ns) < EXACT_NS).all():
        damages.add("impossible stamp", "frame", None, f"{name}: no number; taken as the start")
        at_ns = np.where(np.abs(at_ns) < EXACT_NS, at_ns, 0.0)
    rounded: Ints = at_ns.astype(np.int64)
    return rounded


def merged(sources: Iterable[Iterator[Frames]]) -> Iterator[Frames]:
    """Merge blocks of several sources, each in order, by their stamps."""
    waiting: list[tuple[Frames, Iterator[Frames]]] = []
    for source in sources:
        first = next(source, None)
        if first is not None:
            waiting.append((first, source))
    while waiting:
        if len(waiting) == 1:
            block, source = waiting.pop()
            yield block
            yield from source
            return
        # Up to the earliest end of a block, all frames are available.
        limit_ns = min(int(block.at_ns[-1]) for block, _ in waiting)
        taken: list[Frames] = []
        left: list[tuple[Frames, Iterator[Frames]]] = []
        for block, source in waiting:
            cut = int(np.searchsorted(block.at_ns, limit_ns, "right"))
            taken.append(block[:cut])
            rest = block[cut:] if cut < len(block) else next(source, None)
            if rest is not None:
                left.append((rest, source))
        joined = concat(taken)
        yield joined[np.argsort(joined.at_ns, kind="stable")]
        waiting = left
