"""Writes candump logs like `candump -l`, with nine digits where microseconds are too coarse."""

import gzip
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.damage import Damages
from canlog.formats.text import NS_PER_S, hex_rows
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, TX, Frames
from canlog.writing import lost
from firmware_py.storage.lines import ERROR_FLAG

NS_PER_US: Final = 1000
CLASSIC_MAX: Final = 8


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """Write all frames; a name ending in `.gz` or `.zst` compresses the file."""
    done = 0
    with text_file(path) as out:
        for frames in blocks:
            lost(losses, (frames.flags & TX) != 0, "direction", "Tx is not kept", done)
            early = frames.at_ns < 0
            lost(losses, early, "stamp", "before 1970; left out", done)
            blank = np.array([" " in name or not name for name in frames.channels], np.bool_)
            if blank.any():
                lost(losses, blank[frames.channel], "channel name", "blanks become _", done)
            kept = frames if not early.any() else frames[~early]
            out.write("".join(_lines(kept)).encode())
            done += len(frames)


def _lines(frames: Frames) -> Iterator[str]:
    fine = bool((frames.at_ns % NS_PER_US).any())
    names = [name.replace(" ", "_") or "_" for name in frames.channels]
    columns = zip(
        (frames.at_ns // NS_PER_S).tolist(),
        (frames.at_ns % NS_PER_S).tolist(),
        frames.channel.tolist(),
        frames.identifier.tolist(),
        frames.flags.tolist(),
        frames.length.tolist(),
        hex_rows(frames),
        strict=True,
    )
    for second, past_ns, channel, identifier, flags, length, data in columns:
        fraction = f"{past_ns:09d}" if fine else f"{past_ns // NS_PER_US:06d}"
        head = f"({second:010d}.{fraction}) {names[channel]} "
        if not flags & ~TX:
            yield f"{head}{identifier:03X}#{data}\n"
        else:
            yield f"{head}{_unusual(identifier, flags, length, data)}\n"


def _unusual(identifier: int, flags: int, length: int, data: str) -> str:
    if flags & ERROR:
        return f"{identifier | ERROR_FLAG:08X}#{data}"
    digits = f"{identifier:08X}" if flags & EXTENDED else f"{identifier:03X}"
    if flags & REMOTE:
        return f"{digits}#R{length}" if 0 < length <= CLASSIC_MAX else f"{digits}#R"
    if flags & FD:
        return f"{digits}##{bool(flags & BRS) | bool(flags & ESI) << 1:X}{data}"
    return f"{digits}#{data}"


@contextmanager
def text_file(path: Path) -> Iterator[Any]:
    """Open a file for bytes, compressed as its suffix says."""
    if path.suffix == ".gz":
        # Without name and time in the head, the same log gives the same bytes.
        with path.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as out:
            yield out
    elif path.suffix == ".zst":
        import pyarrow as pa

        with pa.OSFile(str(path), "wb") as raw, pa.CompressedOutputStream(raw, "zstd") as out:
            yield out
    else:
        with path.open("wb") as out:
            yield out
