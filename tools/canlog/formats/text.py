"""What readers of text formats share: whole lines in, blocks of frames out, the rest counted."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from canlog.damage import Damages, shown
from canlog.frames import Frames
from canlog.options import ReadOptions
from canlog.rows import Rows
from canlog.source import lines_blocks

NS_PER_S: Final = 1_000_000_000
JUNK: Final = "junk line"
TORN: Final = "torn line"
OTHER: Final = "line that is no frame"
"""Something the format knows beside frames, such as a comment or a statistic."""

Take = Callable[[str, Rows], str | None]
"""Adds the frame of a line; JUNK, OTHER, or None when all is well."""


def read_lines(
    path: Path, options: ReadOptions, damages: Damages, take: Take, *, encoding: str = "cp1252"
) -> Iterator[Frames]:
    """Blocks of the frames of a text log."""
    rows = Rows()
    for text, number in lines_blocks(path, damages):
        lines = text.decode(encoding, "replace").split("\n")
        # A file may end without the end of its last line; a frame there may lack its last bytes.
        torn = lines.pop()
        for at, line in enumerate(lines):
            line = line.strip()
            fault = take(line, rows) if line else None
            if fault is not None:
                damages.add(fault, "line", number + at, shown(line))
            if len(rows) >= options.block_frames:
                yield rows.take()
        if torn.strip():
            before = len(rows)
            probe = Rows()
            if take(torn.strip(), probe) != OTHER or len(probe):
                damages.add(TORN, "line", number + len(lines), shown(torn))
            assert len(rows) == before
        if len(rows):
            yield rows.take()


def stamp_ns(text: str, digits: int = 9) -> int | None:
    """A decimal number of seconds, or with 6 digits of milliseconds, as exact nanoseconds."""
    whole, _, fraction = text.partition(".")
    sign = -1 if whole.startswith("-") else 1
    if len(whole) > 12 or not text.isascii() or (fraction and not fraction.isdigit()):
        return None
    try:
        past = int(whole or "0") * int(10**digits)
        return past + sign * int(fraction[:digits].ljust(digits, "0") or 0)
    except ValueError:
        return None


def hex_bytes(texts: list[str], base: int = 16) -> bytes | None:
    """Bytes written one by one; None when one of them is none."""
    try:
        return bytes([int(text, base) for text in texts])
    except ValueError:
        return None


def date_ns(year: int, month: int, day: int, clock: str) -> int | None:
    """Nanoseconds since 1970 of a date and `hh:mm:ss.fraction`."""
    try:
        at = np.datetime64(f"{year:04d}-{month:02d}-{day:02d}T{clock}", "ns")
    except ValueError:
        return None
    return int(at.astype(np.int64))


def first_ns_of(frames: Frames) -> int:
    """The whole millisecond in which a log begins that is written with stamps since its start."""
    first_ns = int(frames.at_ns[0])
    return first_ns - first_ns % 1_000_000


def hex_rows(frames: Frames, separator: str = "") -> list[str]:
    """The data of each frame in hexadecimal, those of remote frames left out by whoever asks."""
    width = frames.data.shape[1]
    whole = np.ascontiguousarray(frames.data).tobytes()
    text = (whole.hex(separator) if separator else whole.hex()).upper()
    step = 2 + len(separator)
    row = width * step
    return [
        text[at * row : at * row + max(0, length * step - len(separator))]
        for at, length in enumerate(frames.length.tolist())
    ]
