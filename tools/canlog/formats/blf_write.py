"""Writes BLF: objects of one size for each kind of frame, in containers of 128 KiB."""

import struct
import zlib
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from canlog.damage import Damages
from canlog.formats.blf_objects import (
    BASE,
    CAN_ERROR_EXT,
    CAN_FD,
    CAN_MESSAGE,
    CONTAINER,
    EXTENDED_BIT,
    LAYOUTS,
    STAMPS,
)
from canlog.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    TX,
    Frames,
    widened,
)
from canlog.writing import Numbers, lost

FILE_HEAD: Final = struct.Struct("<4sLBBBBBBBBQQLL8H8H")
FILE_HEAD_BYTES: Final = 144
CONTAINER_BYTES: Final = 128 * 1024
NS_PER_MS: Final = 1_000_000
UNIT_NS: Final = 2
_CODES: Final = np.array(
    [min(c for c, n in enumerate(FD_LENGTHS) if n >= k) for k in range(65)], np.uint8
)


class _File:
    """Writes containers to a file, and finally the head that describes them."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._waiting = bytearray()
        self.count = 0
        self.content = FILE_HEAD_BYTES
        file.write(bytes(FILE_HEAD_BYTES))

    def objects(self, packed: bytes, count: int) -> None:
        self._waiting += packed
        self.count += count
        while len(self._waiting) >= CONTAINER_BYTES:
            self._container(bytes(self._waiting[:CONTAINER_BYTES]))
            del self._waiting[:CONTAINER_BYTES]

    def _container(self, content: bytes) -> None:
        packed = zlib.compress(content)
        size = BASE.itemsize + 16 + len(packed)
        self._file.write(struct.pack("<4sHHLL", b"LOBJ", BASE.itemsize, 1, size, CONTAINER))
        self._file.write(struct.pack("<H6xL4x", 2, len(content)) + packed + bytes(size % 4))
        self.content += 32 + len(content)

    def close(self, start_ns: int, stop_ns: int) -> None:
        if self._waiting:
            self._container(bytes(self._waiting))
        size = self._file.tell()
        self._file.seek(0)
        fixed = (
            b"LOGG",
            FILE_HEAD_BYTES,
            5,
            0,
            0,
            0,
            2,
            6,
            8,
            1,
            size,
            self.content,
            self.count,
            0,
        )
        self._file.write(FILE_HEAD.pack(*fixed, *_system_time(start_ns), *_system_time(stop_ns)))


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """Write all frames, stamped in nanoseconds since the whole millisecond of the first one.

    A frame earlier than the first one gets the stamp of the start and is counted as a loss.
    """
    numbers = Numbers(losses)
    start_ns: int | None = None
    stop_ns, done = 0, 0
    with path.open("wb") as raw:
        file = _File(raw)
        for frames in blocks:
            if not len(frames):
                continue
            if start_ns is None:
                first_ns = int(frames.at_ns[0])
                start_ns = first_ns - first_ns % NS_PER_MS
            past_ns = frames.at_ns - start_ns
            lost(losses, past_ns < 0, "stamp", "before the start of the log", done)
            channel = numbers.of(frames)
            _write_block(file, frames, np.maximum(past_ns, 0), channel)
            stop_ns = max(stop_ns, int(frames.at_ns.max()))
            done += len(frames)
        file.close(start_ns or 0, stop_ns)


def _write_block(file: _File, frames: Frames, past_ns: Any, channel: Any) -> None:
    """Write runs of objects of one kind, so that the order stays."""
    kind = np.where((frames.flags & FD) != 0, CAN_FD, CAN_MESSAGE)
    kind = np.where((frames.flags & ERROR) != 0, CAN_ERROR_EXT, kind)
    cuts = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(frames)]
    for first, last in pairwise(cuts):
        rows = slice(first, last)
        packed = _packed(int(kind[first]), frames[rows], past_ns[rows], channel[rows])
        file.objects(packed, last - first)


def _packed(kind: int, frames: Frames, past_ns: Any, channel: Any) -> bytes:
    """Return objects of one kind as bytes."""
    layout = np.dtype([*BASE.descr, *STAMPS, *LAYOUTS[kind]])
    told = np.zeros(len(frames), layout)
    told["signature"], told["head"], told["version"] = b"LOBJ", 32, 1
    told["size"], told["kind"] = layout.itemsize, kind
    told["unit"], told["stamp"] = UNIT_NS, past_ns
    told["channel"] = channel
    extended = (frames.flags & EXTENDED) != 0
    told["id"] = frames.identifier | np.where(extended, EXTENDED_BIT, 0).astype(np.uint32)
    remote = (frames.flags & REMOTE) != 0
    if kind == CAN_FD:
        told["flags"] = remote * 0x80 | ((frames.flags & TX) != 0)
        fd = ((frames.flags & BRS) != 0) * 2 | ((frames.flags & ESI) != 0) * 4 | 1
        told["fd"], told["length"] = fd, frames.length
        told["dlc"], told["data"] = _CODES[frames.length], widened(frames.data, 64)
        return told.tobytes()
    told["dlc"] = frames.length
    told["data"] = np.ascontiguousarray(frames.data[:, :8]).view("<u8")[:, 0]
    if kind == CAN_MESSAGE:
        told["flags"] = remote * 0x80 | ((frames.flags & TX) != 0)
    return told.tobytes()


def _system_time(at_ns: int) -> tuple[int, ...]:
    """Year, month, day of the week, day, hour, minute, second, millisecond in UTC."""
    day = np.datetime64(at_ns // 86_400_000_000_000, "D")
    text = str(day)
    ms = at_ns // NS_PER_MS % 86_400_000
    weekday = (at_ns // 86_400_000_000_000 + 4) % 7
    year, month, number = (int(part) for part in text.split("-"))
    clock = (ms // 3_600_000, ms // 60_000 % 60, ms // 1000 % 60, ms % 1000)
    return year, month, weekday, number, *clock
