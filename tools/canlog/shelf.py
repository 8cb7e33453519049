"""Keeps columns in unnamed files instead of memory, for logs larger than memory.

The operating system writes to disk what does not fit into memory, and removes the files when the
program ends. They are in the folder for temporary files; TMPDIR chooses another one.
"""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

import numpy as np

from canlog.damage import LogError
from canlog.frames import CLASSIC_BYTES, Frames, Ints, empty, renumbered, widened

Room = Callable[[int, Any], Any]
"""Allocates a column of the given number of items of a type."""
ON_DISK_BYTES: Final = 1 << 24
"""Size from which a column is kept on disk."""
PIECE: Final = 1 << 18
"""Frames that are processed at once."""


def in_memory(count: int, kind: Any) -> Any:
    return np.empty(count, kind)


def on_disk(count: int, kind: Any) -> Any:
    """Allocate a column on disk if it is large. Raises LogError if there is no room."""
    size = count * np.dtype(kind).itemsize
    if size < ON_DISK_BYTES:
        return np.empty(count, kind)
    try:
        with tempfile.TemporaryFile(prefix="canlog-") as file:
            file.truncate(size)
            return np.memmap(file, kind, "r+", shape=(count,)).view(np.ndarray)
    except OSError as error:
        raise _full(error) from error


def _full(error: OSError) -> LogError:
    folder = tempfile.gettempdir()
    return LogError(f"{folder}: no room for the columns of the log: {error.strerror}")


def shelved(blocks: Iterable[Frames]) -> Frames:
    """Join all blocks like `concat`, but in files. Raises LogError."""
    try:
        writer = _Writer()
    except OSError as error:
        raise _full(error) from error
    for block in blocks:
        try:
            writer.add(block)
        except OSError as error:
            raise _full(error) from error
    return writer.frames()


def in_pieces(frames: Frames) -> Iterator[tuple[int, Frames]]:
    """Yield the frames in pieces, each with its first row."""
    for at in range(0, len(frames), PIECE):
        yield at, frames[at : at + PIECE]


def rearranged(frames: Frames, order: Ints, room: Room) -> Frames:
    """Return the frames in another order."""

    def taken(column: Any) -> Any:
        found = room(column.size, column.dtype).reshape(column.shape)
        for at in range(0, len(order), PIECE):
            rows = order[at : at + PIECE]
            found[at : at + len(rows)] = column[rows]
        return found

    columns = (frames.at_ns, frames.identifier, frames.flags, frames.channel, frames.length)
    at_ns, identifier, flags, channel, length = map(taken, columns)
    data = taken(frames.data)
    return Frames(at_ns, identifier, flags, channel, length, data, frames.channels)


class _Writer:
    def __init__(self) -> None:
        kinds = (np.int64, np.uint32, np.uint8, np.uint8, np.uint8)
        self._columns = [(tempfile.TemporaryFile(prefix="canlog-"), kind) for kind in kinds]  # noqa: SIM115
        self._data = tempfile.TemporaryFile(prefix="canlog-")  # noqa: SIM115
        self._width = CLASSIC_BYTES
        self._count = 0
        self._channels: list[str] = []

    def add(self, block: Frames) -> None:
        for name in block.channels:
            if name not in self._channels:
                self._channels.append(name)
        if block.data.shape[1] > self._width:
            self._widen(block.data.shape[1])
        channel = renumbered(block, self._channels)
        columns = (block.at_ns, block.identifier, block.flags, channel, block.length)
        for (file, kind), column in zip(self._columns, columns, strict=True):
            file.write(np.ascontiguousarray(column, kind).tobytes())
        self._data.write(widened(block.data, self._width).tobytes())
        self._count += len(block)

    def _widen(self, width: int) -> None:
        wide = tempfile.TemporaryFile(prefix="canlog-")  # noqa: SIM115
        self._data.seek(0)
        while piece := self._data.read(PIECE * self._width):
            rows = np.frombuffer(piece, np.uint8).reshape(-1, self._width)
            wide.write(widened(rows, width).tobytes())
        self._data.close()
        self._data, self._width = wide, width

    def frames(self) -> Frames:
        if not self._count:
            return empty(tuple(self._channels))
        at_ns, identifier, flags, channel, length = (
            _mapped(file, kind) for file, kind in self._columns
        )
        data = _mapped(self._data, np.uint8).reshape(-1, self._width)
        names = tuple(self._channels)
        return Frames(at_ns, identifier, flags, channel, length, data, names)


def _mapped(file: Any, kind: Any) -> Any:
    file.flush()
    with file:
        return np.memmap(file, kind, "r").view(np.ndarray)
