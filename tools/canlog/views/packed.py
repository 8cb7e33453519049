"""Packs the frames of a log into one compressed block of bytes for the browser."""

import base64
import zlib
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canlog import kernel
from canlog.frames import ERROR, REMOTE, Frames, Ints
from canlog.shelf import Room, in_memory, in_pieces, rearranged

LEVEL: Final = 6
"""Level of deflate; a higher one gives a few percent for twice the time."""
NOT_DATA: Final = REMOTE | ERROR
LONG_NS: Final = (1 << 32) - 1
"""Marks a time step that does not fit into 32 bits; such steps are listed separately."""


class PackedBytes:
    """Named columns of bytes in one block."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._size = 0
        self.index: dict[str, list[Any]] = {}
        """Offset, number of items, and the browser's name of the type, by column name."""

    def add(self, name: str, column: "npt.NDArray[Any]") -> None:
        """Add one column.

        All first bytes of multi-byte items come first, then all second ones. This packs smooth
        columns several times smaller.
        """
        kind = _KINDS[column.dtype.name]
        plain = np.ascontiguousarray(column)
        width = plain.dtype.itemsize
        if width > 1:
            apart = plain.view(np.uint8).reshape(-1, width).T
            raw = np.ascontiguousarray(apart).tobytes()
        else:
            raw = plain.tobytes()
        self.index[name] = [self._size, plain.size, kind]
        self._pieces.append(raw)
        self._size += len(raw)

    def deflated(self) -> bytes:
        """Return raw deflate data, as DecompressionStream("deflate-raw") reads it."""
        packer = zlib.compressobj(LEVEL, zlib.DEFLATED, -15)
        return b"".join([*map(packer.compress, self._pieces), packer.flush()])

    def text(self) -> str:
        return base64.b64encode(self.deflated()).decode("ascii")


_KINDS: Final = {
    "uint8": "u1",
    "uint16": "u2",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}


@dataclass(frozen=True, slots=True, eq=False)
class KeyGroup:
    """Frames of one key on one channel; remote and error frames form separate groups."""

    key: int
    flags: int
    """REMOTE or ERROR if the group's frames are of that kind, else 0."""
    channel: str
    rows: Ints
    """Indices of the frames, in order of time."""


@dataclass(frozen=True, slots=True, eq=False)
class Ordered:
    """Frames in order of time, and the group of each."""

    frames: Frames
    groups: tuple[KeyGroup, ...]
    group: "npt.NDArray[np.uint16]"
    """(n,) index into `groups`."""
    order: Ints | None
    """(n,) row of each frame in the log; None if the order is that of the log."""

    def taken(self, column: "npt.NDArray[Any]") -> "npt.NDArray[Any]":
        """Return a column of the log in order of time."""
        return column if self.order is None else column[self.order]


def ordered(frames: Frames, room: Room = in_memory) -> Ordered:
    """Sort frames by time; frames with equal stamps keep log order. `room` allocates the
    columns.
    """
    by_time = None
    if not _in_order(frames):
        by_time = np.argsort(frames.at_ns, kind="stable")
        frames = rearranged(frames, by_time, room)
    seen = [np.unique(_kind(piece)) for _, piece in in_pieces(frames)]
    kinds = np.unique(np.concatenate([np.zeros(0, np.uint64), *seen]))
    assert len(kinds) <= 1 << 16
    numbers, counts = room(len(frames), np.uint16), np.zeros(len(kinds), np.int64)
    for at, piece in in_pieces(frames):
        mine = np.searchsorted(kinds, _kind(piece))
        numbers[at : at + len(piece)] = mine
        counts += np.bincount(mine, minlength=len(kinds))
    order = _sorted_rows(numbers, counts, room)
    groups = tuple(
        KeyGroup(each & 0xFFFFFFFF, each >> 32 & 0xFF, _channel(frames, each >> 40), rows)
        for each, rows in zip(kinds.tolist(), np.split(order, np.cumsum(counts)[:-1]), strict=True)
    )
    return Ordered(frames, groups, numbers, by_time)


def _in_order(frames: Frames) -> bool:
    last_ns = None
    for _, piece in in_pieces(frames):
        at_ns = piece.at_ns
        if (last_ns is not None and at_ns[0] < last_ns) or (np.diff(at_ns) < 0).any():
            return False
        last_ns = at_ns[-1]
    return True


def _kind(frames: Frames) -> Any:
    """(n,) uint64: key, kind (remote or error frame), and channel."""
    flags = (frames.flags & np.uint8(NOT_DATA)).astype(np.uint64)
    flags |= frames.channel.astype(np.uint64) << np.uint64(8)
    return frames.key.astype(np.uint64) | flags << np.uint64(32)


def _channel(frames: Frames, number: int) -> str:
    return frames.channels[number] if number < len(frames.channels) else ""


def _sorted_rows(numbers: Any, counts: Ints, room: Room) -> Ints:
    """(n,) rows of the first group, then of the second and so on, each rising."""
    if kernel.library() is None or len(counts) > kernel.NO_GROUP:
        found: Ints = np.argsort(numbers, kind="stable")
        return found
    rows: Ints = kernel.Numbered((numbers,), np.arange(len(counts)), counts).order(room)
    return rows


def add_frames(block: PackedBytes, log: Ordered, zero_ns: int) -> dict[str, Any]:
    """Add all frames to the block, and return what the page needs to read them."""
    frames = log.frames
    steps = np.diff(frames.at_ns, prepend=frames.at_ns[:1])
    long = np.flatnonzero(steps >= LONG_NS)
    block.add("step", np.minimum(steps, LONG_NS).astype(np.uint32))
    block.add("group", log.group)
    block.add("flags", frames.flags)
    block.add("channel", frames.channel)
    for number, group in enumerate(log.groups):
        lengths = frames.length[group.rows]
        data = frames.data[group.rows]
        width = 0 if group.flags & REMOTE else int(lengths.max(initial=0))
        if lengths.size and bool((lengths != lengths[0]).any()):
            block.add(f"length {number}", lengths)
        for byte in range(width):
            block.add(f"byte {number} {byte}", data[:, byte])
    return {
        "count": len(frames),
        "first": int(frames.at_ns[0]) - zero_ns if len(frames) else 0,
        "long": [[int(row), int(steps[row])] for row in long],
        "channels": list(frames.channels),
        "lengths": [int(frames.length[group.rows[0]]) for group in log.groups],
    }
