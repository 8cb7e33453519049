"""Vector BLF: zlib containers of objects, read container by container with numpy."""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog import kernel
from canlog.damage import Damages, LogError
from canlog.formats.blf_objects import BASE, CONTAINER, SIGNATURE, columns, find
from canlog.formats.blf_write import write
from canlog.formats.identifiers import possible
from canlog.frames import Frames, widened
from canlog.inflate import INFLATED_MAX, fastest, rescued
from canlog.options import ReadOptions
from canlog.source import opened

__all__ = ["read", "write"]

FILE_HEAD: Final = 144
START_AT: Final = 40
"""Offset of the start time in the file head: eight 16-bit numbers."""
JOINED_BYTES: Final = 1 << 21
"""Minimum content, in bytes, that numpy parses at once."""
TAKEN_BYTES: Final = 1 << 23
"""Content, in bytes, that makes one block of frames."""
FOREIGN: Final = "object of no CAN frame"
"""Skipped objects: those of other buses, statistics, or the logging program."""
NS_PER_S: Final = 1_000_000_000
CHANNELS_MAX: Final = 256


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of a BLF file; channel 1 is called `can1`.

    The start of the log is taken as UTC, as python-can writes it, unless `options.utc_offset_s`
    gives the zone. A corrupt or torn container is counted; its readable part is used.

    Raises:
        LogError: for a file that cannot be read or does not begin like a BLF file.
    """
    with opened(path, damages) as file:
        if file.size < FILE_HEAD or file.data[:4] != b"LOGG":
            if file.size >= 4 and file.data[:4] == b"LOGG":
                damages.add("torn file", "byte", file.size, "it ends inside its head")
                return
            raise LogError(f"{path}: no BLF file: it does not begin with LOGG")
        start_ns = _start_ns(file.data) - options.utc_offset_s * NS_PER_S
        head = int.from_bytes(file.data[4:8], "little")
        first = head if FILE_HEAD <= head <= file.size else FILE_HEAD
        contents = _contents(file.data, first, damages, options)
        reader = _Reader(start_ns, damages, compiled=options.compiled)
        yield from file.lean(reader.frames(contents))


def _start_ns(data: Any) -> int:
    year, month, _weekday, day, hour, minute, second, ms = np.frombuffer(
        data[START_AT : START_AT + 16], "<u2"
    ).tolist()
    try:
        text = f"{year:04d}-{month:02d}-{day:02d}T{hour:02d}:{minute:02d}:{second:02d}.{ms:03d}"
        return int(np.datetime64(text, "ns").astype(np.int64))
    except ValueError:
        return 0


Content = tuple[bytes | bytearray, int, bool]
"""Bytes, their place in the file, and whether they continue the content before without a gap."""


def _contents(data: Any, first: int, damages: Damages, options: ReadOptions) -> Iterator[Content]:
    """Yield the contents of the containers in order, and objects outside containers unchanged."""
    inflate = fastest(options.inflater)
    at, end, whole = first, len(data), True
    while end - at >= BASE.itemsize:
        found = data.find(SIGNATURE, at, at + 8)
        if found < 0:
            found = data.find(SIGNATURE, at)
            damages.add("corrupt block", "byte", at, "no object begins here")
            whole = False
            if found < 0:
                return
        at = found
        size, kind = (int.from_bytes(data[at + i : at + i + 4], "little") for i in (8, 12))
        if end - at < BASE.itemsize:
            break
        if size < BASE.itemsize or (kind == CONTAINER and size < BASE.itemsize + 16):
            damages.add("corrupt block", "byte", at, f"an object of {size} bytes")
            at, whole = at + 4, False
            continue
        torn = size > end - at
        following = _container_after(data, at) if torn else -1
        stop = following if following >= 0 else min(at + size, end)
        if torn and following < 0:
            damages.add("torn file", "byte", at, f"{end - at} of {size} bytes of its last block")
        if kind == CONTAINER:
            content, fault = _content(data[at + BASE.itemsize : stop], inflate)
            yield content, at, whole
            whole = not fault
            if fault and not (torn and following < 0):
                damages.add("corrupt container", "byte", at, fault)
        else:
            yield data[at:stop], at, whole
            whole = not torn
        # Up to four fill bytes may follow; the search for the signature skips them.
        at = stop
    if 0 < end - at < BASE.itemsize and data[at:end].strip(b"\0"):
        damages.add("torn file", "byte", at, "it ends inside a block's head")


def _container_after(data: Any, at: int) -> int:
    """Find the next container after a block that claims to extend beyond the end of the file."""
    found = at
    while (found := data.find(SIGNATURE, found + 4)) >= 0:
        if int.from_bytes(data[found + 12 : found + 16], "little") == CONTAINER:
            return int(found)
    return -1


def _content(block: bytes, inflate: Any) -> tuple[bytes | bytearray, str]:
    """Return the content of a container, and its fault."""
    if len(block) < 16:
        return b"", "it ends inside its head"
    method, size = int.from_bytes(block[:2], "little"), int.from_bytes(block[8:12], "little")
    packed = memoryview(block)[16:]
    if method == 0:
        return bytes(packed[:size]), "" if len(
            packed
        ) >= size else "it is shorter than its size field"
    if method != 2:
        return b"", f"unknown compression {method}"
    if size > INFLATED_MAX:
        return rescued(packed)[0], f"claims {size} bytes"
    try:
        content: bytes | bytearray = inflate(packed, size)
    except Exception:
        # Each library raises its own error; the standard library finds out what is wrong.
        content, fault = rescued(packed)
        return content, fault or f"{len(content)} bytes instead of {size}"
    return content, "" if len(content) == size else f"{len(content)} bytes instead of {size}"


class _Joined:
    """Content that is parsed in one go, and the place of each part of it in the file."""

    def __init__(self) -> None:
        self._parts: list[bytes | bytearray] = []
        self._begins: list[int] = []
        self._places: list[int] = []
        self.size = 0

    def add(self, content: bytes | bytearray, place: int) -> None:
        if content:
            self._parts.append(content)
            self._begins.append(self.size)
            self._places.append(place)
            self.size += len(content)

    @property
    def buffer(self) -> bytes:
        return b"".join(self._parts)

    def place(self, spot: int) -> int:
        """Place in the file of the container that holds a byte of the buffer."""
        return self._places[max(bisect_right(self._begins, spot) - 1, 0)] if self._places else 0

    def left(self, rest: bytes) -> "_Joined":
        """Return the unparsed rest, which waits for the next container."""
        found = _Joined()
        found.add(rest, self.place(self.size - len(rest)))
        return found


class _Reader:
    """Reads objects container by container; an object may extend from one into the next.

    The kernel takes classic data frames as they come. All other content is gathered to a size that
    is worth parsing with numpy.
    """

    def __init__(self, start_ns: int, damages: Damages, *, compiled: bool) -> None:
        self._start_ns = start_ns
        self._damages = damages
        self._compiled = compiled and kernel.library() is not None
        self._names: list[str] = []
        self._joined = _Joined()
        self._taker: kernel.BlfTaker | None = None
        self._rest = b""
        """Bytes that the kernel left; `_joined` holds them, too."""

    def frames(self, contents: Iterator[Content]) -> Iterator[Frames]:
        for content, place, whole in contents:
            if not whole:
                yield from self.broken()
                # The first object may have begun in the lost part.
                content = content[max(content.find(SIGNATURE), 0) :]
            if self._compiled and self._joined.size == len(self._rest):
                if self._taker is not None and self._taker.room < len(content):
                    yield from self._taken()
                if self._take(content, place):
                    continue
                yield from self._taken()
            self._joined.add(content, place)
            if self._joined.size >= JOINED_BYTES:
                yield from self._take_joined()
        yield from self.end()

    def _take(self, content: bytes | bytearray, place: int) -> bool:
        """Let the kernel parse a container, and return whether it could."""
        if self._taker is None:
            most = max(TAKEN_BYTES, len(content)) // kernel.BLF_OBJECT_BYTES + 2
            self._taker = kernel.BlfTaker(self._start_ns, most)
        at = self._taker.take(self._rest, content)
        if at < 0:
            return False
        self._rest = bytes(content[at:])
        self._joined = _Joined()
        self._joined.add(self._rest, place)
        return True

    def _taken(self) -> Iterator[Frames]:
        """Yield what the kernel has parsed so far."""
        found = self._taker.frames() if self._taker is not None else None
        if self._taker is not None and self._taker.skipped:
            self._damages.skip(FOREIGN, self._taker.skipped)
        self._taker = None
        if found is not None:
            made, channel = found
            yield replace(
                made,
                channel=_channels(channel, self._names, self._damages),
                channels=tuple(self._names),
            )

    def _take_joined(self) -> Iterator[Frames]:
        joined = self._joined
        rest, made = _take(joined, self._start_ns, self._names, self._damages)
        self._rest = rest
        self._joined = joined.left(rest)
        if made is not None:
            yield made

    def broken(self) -> Iterator[Frames]:
        """Yield the frames before a gap in the file."""
        yield from self._taken()
        if self._joined.size:
            yield from self._take_joined()
        if self._rest.strip(b"\0"):
            words = "its block is followed by a broken one"
            self._damages.add("torn object", "byte", self._joined.place(0), words)
        self._joined, self._rest = _Joined(), b""

    def end(self) -> Iterator[Frames]:
        yield from self._taken()
        if self._joined.size:
            yield from self._take_joined()
        if self._rest.strip(b"\0"):
            words = f"{len(self._rest)} bytes at the end of the last block"
            self._damages.add("torn object", "byte", self._joined.place(0), words)


def _take(
    joined: _Joined, start_ns: int, names: list[str], damages: Damages
) -> tuple[bytes, Frames | None]:
    """Return the rest of the buffer, and the frames before it."""
    buffer = joined.buffer
    objects = find(buffer)
    for spot, words in objects.damage:
        damages.add("corrupt object", "byte", joined.place(spot), words)
    parts, cut, foreign = columns(buffer, objects)
    if foreign:
        damages.skip(FOREIGN, foreign)
    if len(cut):
        words = "a CAN object with an invalid header or size"
        damages.add("corrupt object", "byte", joined.place(int(cut[0])), words, len(cut))
    rest = buffer[objects.consumed :]
    count = sum(len(part.row) for part in parts)
    if not count:
        return rest, None
    width = max(part.data.shape[1] for part in parts)
    row = np.concatenate([part.row for part in parts])
    order = np.argsort(row, kind="stable") if len(parts) > 1 else slice(None)

    def of_all(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])[order]

    stamp_ns = of_all("stamp_ns")
    found = Frames(
        stamp_ns + start_ns,
        of_all("identifier").astype(np.uint32),
        of_all("flags").astype(np.uint8),
        _channels(of_all("channel"), names, damages),
        of_all("length").astype(np.uint8),
        np.concatenate([widened(part.data, width) for part in parts])[order],
        tuple(names),
    )
    bad = stamp_ns < 0
    if bad.any():
        damages.add("impossible stamp", "byte", joined.place(0), "left out", int(bad.sum()))
        found = found[~bad]
    found = possible(found, damages, joined.place(0))
    return rest, found if len(found) else None


def _channels(numbers: Any, names: list[str], damages: Damages) -> Any:
    """Return the index of each channel; new channels get a name."""
    numbers = numbers.astype(np.uint16, copy=False)
    least, most = int(numbers.min(initial=0xFFFF)), int(numbers.max(initial=0))
    if least >= most:
        return np.full(len(numbers), _index(most, names, damages), np.uint8)
    table = np.zeros(most + 1, np.uint8)
    seen = np.zeros(most + 1, np.bool_)
    seen[numbers] = True
    for number in np.flatnonzero(seen).tolist():
        table[number] = _index(number, names, damages)
    return table[numbers]


def _index(number: int, names: list[str], damages: Damages) -> int:
    name = f"can{number}"
    if name not in names:
        if len(names) == CHANNELS_MAX:
            words = f"channel {number} is reported as {names[-1]}"
            damages.add("too many channels", "byte", None, words)
            return CHANNELS_MAX - 1
        names.append(name)
    return names.index(name)
