"""Reads the block structure of an MDF 4 file: record groups, their fields and their bytes."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.damage import Damages, LogError
from canlog.inflate import INFLATED_MAX, rescued

HEADER_AT: Final = 64
HEAD_BYTES: Final = 24
LINKS_MAX: Final = 1 << 16
BLOCKS_MAX: Final = 1 << 20
"""Maximum length of a chain of blocks; a longer one must be a cycle."""
PIECE_BYTES: Final = 1 << 22
UNFINISHED: Final = b"UnFinMF"
CYCLES_OPEN, LENGTH_OPEN = 0x1, 0x4
"""Flags of an unfinished file: what its writer had not yet filled in."""
VLSD_GROUP: Final = 0x1
FIXED, VARIABLE, MASTER, VIRTUAL_MASTER = 0, 1, 2, 3
LINEAR: Final = 1
DEFLATE, TRANSPOSED = 0, 1
WORD_BITS: Final = 64


@dataclass(frozen=True, slots=True)
class Mf4Block:
    """A block without its data: its place and its links."""

    at: int
    kind: bytes
    size: int
    links: tuple[int, ...]

    @property
    def body(self) -> int:
        return self.at + HEAD_BYTES + 8 * len(self.links)


@dataclass(frozen=True, slots=True)
class Field:
    """Position of one channel in the record of its group."""

    kind: int
    """FIXED, VARIABLE, MASTER or VIRTUAL_MASTER, with the numbers of the format."""
    data_type: int
    bit: int
    byte: int
    bits: int
    step_s: float
    """For a clock: seconds per count."""
    zero_s: float
    data_link: int
    """For a VARIABLE field: link to the block with its values."""


@dataclass(frozen=True, slots=True)
class Group:
    """Records of one layout."""

    at: int
    record_id: int
    count: int
    """Number of records that the file claims; it may be wrong in an unfinished file."""
    flags: int
    size: int
    """Bytes of a record after its group number."""
    fields: dict[str, Field]

    @property
    def is_variable(self) -> bool:
        return bool(self.flags & VLSD_GROUP)


@dataclass(frozen=True, slots=True)
class DataGroup:
    """Groups that share one stream of records."""

    id_bytes: int
    data_link: int
    groups: tuple[Group, ...]


class Mf4File:
    """An open file. Broken links end a chain and are counted as damage."""

    def __init__(self, data: Any, size: int, damages: Damages, inflate: Any) -> None:
        """Raises LogError for data that is no MDF 4 file."""
        self.data, self.size = data, size
        self._damages, self._inflate = damages, inflate
        if size < HEADER_AT + HEAD_BYTES:
            raise LogError("it ends inside its head")
        flags = int.from_bytes(data[60:62], "little") if data[:7] == UNFINISHED else 0
        self.cycles_open = bool(flags & CYCLES_OPEN)
        self._length_open = bool(flags & LENGTH_OPEN)
        self.unfinished = data[:7] == UNFINISHED
        header = self.block(HEADER_AT, b"##HD")
        if header is None or not header.links:
            raise LogError("it has no header block")
        self._header = header

    @property
    def start_ns(self) -> int:
        """Start of the measurement, in UTC if the file knows its time zone."""
        start_ns: int = struct.unpack("<Q", self.data[self._header.body : self._header.body + 8])[0]
        return start_ns if start_ns < 1 << 63 else 0

    @property
    def data_groups(self) -> Iterator[DataGroup]:
        for block in self._chain(self._header.links[0], b"##DG"):
            id_bytes = self.data[block.body]
            if len(block.links) < 3 or id_bytes > 8:
                continue
            groups = tuple(self._group(each) for each in self._chain(block.links[1], b"##CG"))
            yield DataGroup(id_bytes, block.links[2], groups)

    def block(self, at: int, *kinds: bytes) -> Mf4Block | None:
        """Return the block that a link leads to; None if it is missing or of another kind."""
        if at == 0 and HEADER_AT:
            return None
        if at < HEADER_AT or at + HEAD_BYTES > self.size:
            self._damages.add("broken link", "byte", at, "it leads beyond the end of the file")
            return None
        kind, size, count = struct.unpack("<4s4xQQ", self.data[at : at + HEAD_BYTES])
        if kind not in kinds:
            self._damages.add(
                "broken link", "byte", at, f"no block {kinds[0].decode()} begins there"
            )
            return None
        links_end = at + HEAD_BYTES + 8 * count
        if count > LINKS_MAX or links_end > self.size:
            self._damages.add("broken block", "byte", at, f"{count} links")
            return None
        links = struct.unpack(f"<{count}Q", self.data[at + HEAD_BYTES : links_end])
        return Mf4Block(at, kind, size, links)

    def _chain(self, at: int, kind: bytes) -> Iterator[Mf4Block]:
        """Yield a chain of blocks in which the first link of each leads to the next."""
        seen: set[int] = set()
        while at and at not in seen and len(seen) < BLOCKS_MAX:
            seen.add(at)
            block = self.block(at, kind)
            if block is None or not block.links:
                return
            yield block
            at = block.links[0]

    def _group(self, block: Mf4Block) -> Group:
        body = self.data[block.body : block.body + 32].ljust(32, b"\0")
        record_id, count, flags, size, unused = struct.unpack("<QQH6xII", body)
        fields: dict[str, Field] = {}
        if not flags & VLSD_GROUP:
            self._add_fields(block.links[1] if len(block.links) > 1 else 0, fields)
        return Group(block.at, record_id, count, flags, size + unused, fields)

    def _add_fields(self, at: int, fields: dict[str, Field], depth: int = 0) -> None:
        """Add channels by name, including the parts of composed channels."""
        for block in self._chain(at, b"##CN"):
            body = self.data[block.body : block.body + 24].ljust(24, b"\0")
            kind, _sync, data_type, bit, byte, bits = struct.unpack("<BBBBII12x", body)
            if len(block.links) < 8:
                continue
            scale, offset = self._conversion(block.links[4])
            name = self._text(block.links[2])
            if kind in (MASTER, VIRTUAL_MASTER):
                name = ""
            field = Field(kind, data_type, bit, byte, bits, scale, offset, block.links[5])
            fields.setdefault(name, field)
            composed = block.links[1]
            if composed and depth < 4 and self.data[composed : composed + 4] == b"##CN":
                self._add_fields(composed, fields, depth + 1)

    def _conversion(self, at: int) -> tuple[float, float]:
        """Return factor and offset of a linear conversion; 1 and 0 for any other."""
        block = self.block(at, b"##CC") if at else None
        if block is None:
            return 1.0, 0.0
        body = self.data[block.body : block.body + 40]
        if len(body) < 40 or body[0] != LINEAR:
            return 1.0, 0.0
        offset, scale = struct.unpack("<dd", body[24:40])
        return scale, offset

    def _text(self, at: int) -> str:
        block = self.block(at, b"##TX", b"##MD") if at else None
        if block is None:
            return ""
        end = min(block.at + block.size, self.size)
        raw: bytes = self.data[block.body : end]
        return raw.split(b"\0")[0].decode("utf-8", "replace")

    def content(self, at: int) -> Iterator[bytes | bytearray]:
        """Yield the bytes behind a data link in pieces, up to the first missing one."""
        block = self.block(at, b"##DT", b"##DZ", b"##DL", b"##HL", b"##SD") if at else None
        seen: set[int] = set()
        while block is not None and block.at not in seen:
            seen.add(block.at)
            if block.kind in (b"##DT", b"##SD"):
                yield from self._plain(block)
                return
            if block.kind == b"##DZ":
                yield self._unpacked(block)
                return
            if block.kind == b"##HL":
                block = self.block(block.links[0], b"##DL") if block.links else None
                continue
            for link in block.links[1:]:
                piece = self.block(link, b"##DT", b"##DZ", b"##SD") if link else None
                if piece is None:
                    # Records after a gap would be read from a wrong place.
                    return
                if piece.kind == b"##DZ":
                    yield self._unpacked(piece)
                else:
                    yield from self._plain(piece)
            following = block.links[0] if block.links else 0
            block = self.block(following, b"##DL") if following else None

    def _plain(self, block: Mf4Block) -> Iterator[bytes]:
        end = block.at + block.size
        if end > self.size or (self._length_open and block.size <= HEAD_BYTES):
            end = self.size
        for at in range(block.body, end, PIECE_BYTES):
            yield self.data[at : min(at + PIECE_BYTES, end)]

    def _unpacked(self, block: Mf4Block) -> bytes | bytearray:
        head = self.data[block.body : block.body + 24].ljust(24, b"\0")
        method, columns, size, packed_size = struct.unpack("<2xBxIQQ", head)
        first = block.body + 24
        packed = self.data[first : min(first + packed_size, self.size)]
        content, fault = self._inflated(packed, method, size)
        if fault:
            self._damages.add("corrupt block", "byte", block.at, fault)
        if method % 2 == TRANSPOSED and columns > 1:
            return b"" if fault else _untransposed(content, columns)
        return content

    def _inflated(self, packed: Any, method: int, size: int) -> tuple[bytes | bytearray, str]:
        if size > INFLATED_MAX:
            return b"", f"claims {size} bytes"
        if method not in (DEFLATE, TRANSPOSED):
            return b"", f"unknown compression {method}"
        try:
            content: bytes | bytearray = self._inflate(packed, size)
        except Exception:
            # Each library raises its own error; the standard library finds out what is wrong.
            content, fault = rescued(packed)
            return content, fault or f"{len(content)} bytes instead of {size}"
        return content, "" if len(content) == size else f"{len(content)} bytes instead of {size}"


def _untransposed(content: bytes | bytearray, columns: int) -> bytes:
    """Undo the transposition in which the first bytes of all records come first, then the second
    ones.
    """
    rows = len(content) // columns
    whole = np.frombuffer(content, np.uint8, rows * columns).reshape(columns, rows)
    return whole.T.tobytes() + bytes(content[rows * columns :])


def numbers_of(records: Any, field: Field) -> Any:
    """(n,): an unsigned or float channel of (n, size) records, without its conversion."""
    first, size = field.byte, (field.bit + field.bits + 7) // 8
    if field.bits == 0 or first + size > records.shape[1] or size > 9:
        return np.zeros(len(records), np.uint64)
    part = records[:, first : first + size]
    big = field.data_type in (1, 3, 5)
    if field.data_type in (4, 5):
        kind = f"{'>' if big else '<'}f{size}"
        return np.ascontiguousarray(part).view(kind)[:, 0].astype(np.float64)
    if size == 1:
        return part[:, 0] >> np.uint8(field.bit) & np.uint8((1 << field.bits) - 1)
    if field.bit == 0 and field.bits in (16, 32, 64):
        kind = f"{'>' if big else '<'}u{size}"
        return np.ascontiguousarray(part).view(kind)[:, 0]
    value = np.zeros(len(records), np.uint64)
    for column in range(min(size, 8)):
        shift = 8 * (size - 1 - column if big else column)
        value |= part[:, column].astype(np.uint64) << np.uint64(shift)
    value >>= np.uint64(field.bit)
    mask = (1 << field.bits) - 1 if field.bits < WORD_BITS else (1 << WORD_BITS) - 1
    return value & np.uint64(mask)
