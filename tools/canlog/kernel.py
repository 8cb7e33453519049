"""The compiled kernel for text and BLF objects; without a C compiler numpy does the same work.

Each version of `kernel.c` is compiled once into the user's cache. Tests compare the columns of both
ways. CANLOG_KERNEL=off switches the kernel off.
"""

import ctypes
import functools
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np

from canlog.frames import Frames, blank
from canlog.line_block import LineBlock
from canlog.shelf import Room, in_memory
from firmware_py.native import build

FLAGS: Final = ("-O3", "-shared", "-fPIC", "-std=c11", "-ffp-contract=off")
"""Compiler flags. Without contraction, a product and a sum round twice, as in Python."""
STEM: Final = "kernel"
NAME_BYTES: Final = 64
WORD_BYTES: Final = 8
NAMES_MAX: Final = 256
USUAL_LINE: Final = 24
"""Assumed minimum bytes of a line with a frame; shorter lines cause a second pass with more
rows.
"""
SWITCH: Final = "CANLOG_KERNEL"
BLF_OBJECT_BYTES: Final = 48
"""Minimum size in bytes of a BLF object with a classic frame."""
BYTE_MAX: Final = 0xFF
NO_GROUP: Final = 0xFFFF
SLOTS: Final = 1 << 17


@functools.cache
def library() -> Any:
    """The loaded kernel; None if it is not available."""
    if os.environ.get(SWITCH, "") == "off" or not np.little_endian:
        return None
    source = (resources.files("canlog") / f"{STEM}.c").read_bytes()
    try:
        return _declared(ctypes.CDLL(str(build.library(STEM, {f"{STEM}.c": source}, FLAGS))))
    except (OSError, build.BuildError):
        return None


def _declared(found: Any) -> Any:
    found.canlog_candump.restype = found.canlog_blf.restype = ctypes.c_int64
    found.canlog_text.restype = ctypes.c_int64
    number, place = ctypes.c_int64, ctypes.c_void_p
    found.canlog_candump.argtypes = [ctypes.c_char_p, *[number] * 3, *[place] * 11]
    found.canlog_text.argtypes = [
        *[ctypes.c_char_p, number, ctypes.c_char_p],
        *[number] * 2,
        *[place] * 11,
    ]
    found.canlog_blf.argtypes = [ctypes.c_char_p, number, place, number, place]
    found.canlog_records.restype = number
    found.canlog_records.argtypes = [ctypes.c_char_p, number, *[place] * 4]
    found.canlog_number.restype = number
    found.canlog_number.argtypes = [*[place] * 3, number, place, number, *[place] * 3]
    whole = ctypes.c_int
    found.canlog_integers.restype = found.canlog_doubles.restype = None
    found.canlog_group.restype = None
    found.canlog_group.argtypes = [place, number, *[place] * 7]
    found.canlog_order.restype = None
    found.canlog_order.argtypes = [place, number, number, place, place]
    found.canlog_integers.argtypes = [
        *[place, number, whole, whole, whole, ctypes.c_uint64, ctypes.c_uint64, place]
    ]
    found.canlog_doubles.argtypes = [
        *[place, number, whole, whole, whole, ctypes.c_double, ctypes.c_double, place]
    ]
    return found


def parse_candump(text: bytes, channels: list[str], width: int) -> LineBlock | None:
    """Parse candump lines like `parse_block`; None without a kernel."""
    return _parsed(text, channels, width, None)


def parse_text(text: bytes, channels: list[str], width: int, columns: bytes) -> LineBlock | None:
    """Parse ASC with hexadecimal numbers, or TRC with these columns; None without a kernel.

    Stamps of the frames count from the start of the log.
    """
    return _parsed(text, channels, width, columns)


def _parsed(
    text: bytes, channels: list[str], width: int, columns: bytes | None
) -> LineBlock | None:
    kernel = library()
    if kernel is None or any(len(name.encode()) >= NAME_BYTES for name in channels):
        return None
    names, sizes, known = _names(channels)
    rows, most = -1, len(text) // USUAL_LINE + 1
    while rows < 0:
        made = blank(most, width=width)
        odd, told = np.empty((most, 4), np.int64), np.zeros(2, np.int64)
        given = (
            width, most, *_places(made), names.ctypes.data, sizes.ctypes.data,
            ctypes.byref(known), odd.ctypes.data, told.ctypes.data,
        )  # fmt: skip
        if columns is None:
            rows = kernel.canlog_candump(text, len(text), *given)
        else:
            rows = kernel.canlog_text(text, len(text), columns, *given)
        # Each line takes at least one byte and its end.
        most = len(text) // 2 + 1
    for at in range(len(channels), known.value):
        name = bytes(names[at, : sizes[at]])
        channels.append(name.decode("ascii", "backslashreplace"))
    odd = odd[: told[0]]
    frames = made[:rows]
    frames = Frames(
        frames.at_ns, frames.identifier, frames.flags, frames.channel, frames.length, frames.data,
        tuple(channels),
    )  # fmt: skip
    return LineBlock(frames, odd[:, 0], odd[:, 1], odd[:, 2], odd[:, 3], int(told[1]))


def _places(made: Frames) -> list[int]:
    columns = (made.at_ns, made.identifier, made.flags, made.channel, made.length, made.data)
    return [int(column.ctypes.data) for column in columns]


def _names(channels: list[str]) -> tuple[Any, Any, Any]:
    """Return the table of names that the kernel searches and extends."""
    names = np.zeros((NAMES_MAX, NAME_BYTES), np.uint8)
    sizes = np.zeros(NAMES_MAX, np.int32)
    for at, name in enumerate(channels):
        # A name that is not ASCII was decoded with escapes, so it never equals bytes of a log.
        raw = name.encode("ascii", "replace")
        names[at, : len(raw)], sizes[at] = np.frombuffer(raw, np.uint8), len(raw)
    return names, sizes, ctypes.c_int32(len(channels))


def records(content: bytes, id_bytes: int, sizes: dict[int, int]) -> tuple[int, Any, Any] | None:
    """Walk the records of several MDF groups.

    Args:
        sizes: bytes of the records of each group, -1 if each record gives its own.

    Returns:
        Where the first incomplete record begins, -1 after one of an unknown group; the places
        of the records after their group numbers; and those numbers. None without a kernel or
        for group numbers of more than one byte.
    """
    kernel = library()
    if kernel is None or id_bytes != 1 or any(number > BYTE_MAX for number in sizes):
        return None
    table = np.full(BYTE_MAX + 1, -2, np.int64)
    for number, size in sizes.items():
        table[number] = size
    least = 1 + min((size if size >= 0 else 4 for size in sizes.values()), default=0)
    most = len(content) // max(least, 1) + 1
    places, numbers = np.empty(most, np.int64), np.empty(most, np.uint8)
    stop = np.zeros(1, np.int64)
    count = kernel.canlog_records(
        content, len(content), table.ctypes.data, places.ctypes.data, numbers.ctypes.data,
        stop.ctypes.data,
    )  # fmt: skip
    return int(stop[0]), places[:count], numbers[:count]


class _Taken(ctypes.Structure):
    """The structure of the same name in kernel.c."""

    _fields_ = (
        *[(name, ctypes.c_int64) for name in ("start_ns", "most", "rows", "skipped")],
        *[(name, ctypes.c_void_p) for name in ("at_ns", "data", "identifier")],
        *[(name, ctypes.c_void_p) for name in ("channel", "flags", "length")],
    )


def _columns(most: int, kinds: Sequence[Any]) -> list[Any]:
    """Return empty columns, the widest first, in one allocation, which is faster."""
    room = np.empty(most * sum(np.dtype(kind).itemsize for kind in kinds), np.uint8)
    found, at = [], 0
    for kind in kinds:
        stop = at + most * np.dtype(kind).itemsize
        found.append(room[at:stop].view(kind))
        at = stop
    return found


class BlfTaker:
    """Takes containers of classic data frames in order into columns."""

    def __init__(self, start_ns: int, most: int) -> None:
        """Make room for up to `most` frames. The kernel must be available."""
        self._take = library().canlog_blf
        self._columns = _columns(
            most, (np.int64, np.uint64, np.uint32, np.uint16, np.uint8, np.uint8)
        )
        places = (column.ctypes.data for column in self._columns)
        self._state = _Taken(start_ns, most, 0, 0, *places)
        self._where = ctypes.byref(self._state)

    @property
    def skipped(self) -> int:
        """Number of objects that are not CAN frames."""
        return int(self._state.skipped)

    @property
    def room(self) -> int:
        """Bytes of content that fit in any case."""
        return int(self._state.most - self._state.rows - 1) * BLF_OBJECT_BYTES

    def take(self, rest: bytes, content: bytes | bytearray) -> int:
        """Take the objects of a container.

        It returns where the first incomplete object of `content` begins. If the container holds
        other frames or damage, or if there is no room, it takes nothing and returns -1.

        Args:
            rest: the beginning of an object in which the container before ended.
            content: content of the next container.
        """
        size = len(content)
        given: Any = content
        if isinstance(content, bytearray):
            given = (ctypes.c_char * size).from_buffer(content)
        return int(self._take(rest, len(rest), given, size, self._where))

    def frames(self) -> tuple[Frames, Any] | None:
        """Return the taken frames and the channel number of each; None if there are none."""
        rows = int(self._state.rows)
        if not rows:
            return None
        at_ns, data, identifier, channel, flags, length = (each[:rows] for each in self._columns)
        words = data.view(np.uint8).reshape(-1, 8)
        made = Frames(at_ns, identifier, flags, np.zeros(0, np.uint8), length, words)
        return made, channel


def scaled(
    words: Any, bits: tuple[int, int, bool], scale: float, offset: float, out: Any
) -> Any | None:
    """Return (n,) raw * scale + offset of the signal with these bits; None without a kernel.

    Args:
        words: (n,) uint64.
        bits: number of bits to the right of the signal, its length, and whether it is signed.
        out: (n,) column to fill: int64 or uint64 for integer scales and offsets whose results
            fit, else float64.
    """
    kernel = library()
    if kernel is None or not words.flags.c_contiguous:
        return None
    if out.dtype.kind == "f":
        kernel.canlog_doubles(words.ctypes.data, len(words), *bits, scale, offset, out.ctypes.data)
    else:
        whole = (int(scale) % (1 << 64), int(offset) % (1 << 64))
        kernel.canlog_integers(words.ctypes.data, len(words), *bits, *whole, out.ctypes.data)
    return out


@dataclass(frozen=True, slots=True)
class Numbered:
    """The number of the channel and key of each frame of some blocks."""

    groups: tuple[Any, ...]
    """For each block (n,) uint16: index of the frame's key in `keys`, NO_GROUP for frames without
    data.
    """
    keys: Any
    """(k,) uint64, in order of first frames: the channel index above 32 bits of key."""
    counts: Any
    """(k,) int64: number of frames of each key."""

    @property
    def starts(self) -> Any:
        """(k,) int64: where each key begins when the frames are sorted by key."""
        return np.cumsum(self.counts) - self.counts

    def order(self, room: Room = in_memory) -> Any:
        """(n,) int64: the rows of all blocks sorted by key."""
        out = room(int(self.counts.sum()), np.int64)
        places, first = self.starts, 0
        for group in self.groups:
            library().canlog_order(
                group.ctypes.data, len(group), first, places.ctypes.data, out.ctypes.data
            )
            first += len(group)
        return out


def numbered(
    blocks: Sequence[Frames], channels: Sequence[Any], room: Room = in_memory
) -> Numbered | None:
    """Number the channels and keys of all frames; None without a kernel or with too many keys.

    Args:
        channels: (n,) uint8 for each block.
    """
    kernel = library()
    if kernel is None:
        return None
    keys, counts = np.empty(NO_GROUP, np.uint64), np.empty(NO_GROUP, np.int64)
    slots, groups, known = np.zeros(SLOTS, np.uint16), [], 0
    for block, channel in zip(blocks, channels, strict=True):
        identifier, flags, channel = (
            np.ascontiguousarray(column) for column in (block.identifier, block.flags, channel)
        )
        group = room(len(block), np.uint16)
        known = kernel.canlog_number(
            identifier.ctypes.data, flags.ctypes.data, channel.ctypes.data, len(block),
            group.ctypes.data, known,
            *(column.ctypes.data for column in (keys, counts, slots)),
        )  # fmt: skip
        if known < 0:
            return None
        groups.append(group)
    return Numbered(tuple(groups), keys[:known].copy(), counts[:known].copy())


def grouped(
    told: Numbered, blocks: Sequence[Frames], room: Room = in_memory
) -> tuple[Any, ...] | None:
    """Return stamps, data words and lengths of the frames sorted by key; None for longer data."""
    if any(block.data.shape[1] != WORD_BYTES for block in blocks):
        return None
    count = int(told.counts.sum())
    out = room(count, np.int64), room(count, np.uint64), room(count, np.uint8)
    places = told.starts
    for block, group in zip(blocks, told.groups, strict=True):
        columns = [np.ascontiguousarray(each) for each in (block.at_ns, block.data, block.length)]
        library().canlog_group(
            group.ctypes.data, len(group), places.ctypes.data,
            *(column.ctypes.data for column in (*columns, *out)),
        )  # fmt: skip
    return out
