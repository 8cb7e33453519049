"""Reads the bytes of a log in bounded pieces, plain or compressed, up to a torn or corrupt end."""

import codecs
import mmap
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeVar

from canlog.damage import Damages, LogError

Item = TypeVar("Item")
PIECE_BYTES: Final = 1 << 21
BITE_BYTES: Final = 1 << 14
LINE_MAX: Final = 1 << 16
"""Maximum length of a line; the content of a longer one is dropped and counted."""
GZIP: Final = b"\x1f\x8b"
ZSTD: Final = b"\x28\xb5\x2f\xfd"
UTF16_MARKS: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""First bytes of a text in UTF-16, as PowerShell writes it."""
_GZIP_WINDOW: Final = 31


def head_of(path: Path, count: int = 4096) -> bytes:
    """Return the first `count` uncompressed bytes, or fewer if the file is shorter. Raises
    LogError.
    """
    quiet = Damages()
    found = b""
    for piece in pieces(path, quiet, piece_bytes=count):
        found += piece
        if len(found) >= count:
            break
    return found[:count]


def pieces(path: Path, damages: Damages, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes]:
    """Yield the uncompressed content of a file, a few megabytes at a time; UTF-16 as UTF-8.

    Raises:
        LogError: if the file cannot be opened or read.
    """
    content = _plain_pieces(path, damages, piece_bytes)
    first = next(content, b"")
    if first[:2] not in UTF16_MARKS:
        yield first
        yield from content
        return
    decoder = codecs.getincrementaldecoder("utf-16")("replace")
    for piece in chain([first], content):
        yield decoder.decode(piece).encode()
    yield decoder.decode(b"", final=True).encode()


def _plain_pieces(path: Path, damages: Damages, piece_bytes: int) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            magic = file.read(4)
            file.seek(0)
            if magic.startswith(GZIP):
                yield from _gunzipped(file, damages, piece_bytes)
            elif magic == ZSTD:
                yield from _unzstd(path, damages, piece_bytes)
            else:
                while piece := file.read(piece_bytes):
                    yield piece
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


@dataclass(frozen=True, slots=True)
class Opened:
    """A whole file mapped into memory."""

    data: Any
    """Content that can be sliced and searched like bytes."""
    size: int

    def lean(self, blocks: Iterator[Item]) -> Iterator[Item]:
        """Yield the blocks, and after each one let go of the pages of the file in memory."""
        for block in blocks:
            yield block
            if isinstance(self.data, mmap.mmap):
                self.data.madvise(mmap.MADV_DONTNEED)


@contextmanager
def opened(path: Path, damages: Damages) -> Iterator[Opened]:
    """Map a file into memory; a compressed one is first unpacked to disk.

    Raises:
        LogError: if the file cannot be read.
    """
    try:
        with path.open("rb") as file, ExitStack() as stack:
            source: Any = file
            if file.read(4).startswith((GZIP, ZSTD)):
                source = stack.enter_context(tempfile.TemporaryFile())
                for piece in pieces(path, damages):
                    source.write(piece)
                source.flush()
            size = source.seek(0, 2)
            if not size:
                yield Opened(b"", 0)
                return
            mapped = mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ)
            stack.callback(mapped.close)
            yield Opened(mapped, size)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error


def _gunzipped(file: Any, damages: Damages, piece_bytes: int) -> Iterator[bytes]:
    """Yield the content member by member, up to the last whole byte of a torn or corrupt member."""
    read = file.read
    taken, waiting = 0, b""
    undo = zlib.decompressobj(_GZIP_WINDOW)
    fresh = True
    while waiting or (waiting := read(piece_bytes)):
        taken_before = taken
        size = len(waiting)
        try:
            out = undo.decompress(waiting, 8 * piece_bytes)
        except zlib.error as error:
            if fresh and not waiting.strip(b"\0"):
                waiting = b""
                continue
            damages.add("broken gzip stream", "byte", taken_before, str(error))
            return
        waiting = undo.unconsumed_tail or undo.unused_data
        taken += size - len(waiting)
        fresh = False
        if out:
            yield out
        if undo.eof:
            undo, fresh = zlib.decompressobj(_GZIP_WINDOW), True
    if not fresh:
        damages.add("torn gzip stream", "byte", taken, "the file ends inside it")


def _unzstd(path: Path, damages: Damages, piece_bytes: int) -> Iterator[bytes]:
    import pyarrow as pa

    given = 0
    with pa.OSFile(str(path)) as raw, pa.CompressedInputStream(raw, "zstd") as stream:
        while True:
            gathered = bytearray()
            try:
                # Read in small bites: a failing call loses what it has already unpacked.
                while len(gathered) < piece_bytes and (bite := stream.read(BITE_BYTES)):
                    gathered += bite
            except OSError as error:
                damages.add("broken zstd stream", "byte", given, str(error).splitlines()[0])
                if gathered:
                    yield bytes(gathered)
                return
            if not gathered:
                return
            given += len(gathered)
            yield bytes(gathered)


def text_blocks(path: Path, damages: Damages) -> Iterator[bytes]:
    """Yield blocks of whole lines of some megabytes; only the last line may lack its end."""
    rest, taken = b"", 0
    for piece in pieces(path, damages):
        cut = piece.rfind(b"\n") + 1
        taken += len(piece)
        if not cut:
            rest += piece
            if len(rest) > LINE_MAX:
                words = f"no end within {LINE_MAX} bytes"
                damages.add("endless line", "byte", taken - len(rest), words)
                rest = rest[:LINE_MAX]
            continue
        # A view is not a copy: each byte is copied once.
        yield b"".join((rest, memoryview(piece)[:cut]))
        rest = piece[cut:]
    if rest:
        yield rest


def lines_blocks(path: Path, damages: Damages) -> Iterator[tuple[bytes, int]]:
    """Yield the same blocks, each with the number of its first line, from 1."""
    number = 1
    for block in text_blocks(path, damages):
        yield block, number
        number += block.count(b"\n")
