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
"""Something the format knows beside frames, such as a statistic; it is skipped, not damage."""
NO_DATE: Final = "no date"
"""The kind of damage of a log whose stamps cannot be told as dates."""
UTF8_MARK: Final = b"\xef\xbb\xbf"

Take = Callable[[str, Rows], str | None]
"""Adds the frame of a line; JUNK, OTHER, or None when all is well."""


def decoded(text: bytes) -> str:
    """UTF-8 where it is that, else Latin-1, which keeps every byte."""
    text = text.removeprefix(UTF8_MARK)
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def read_lines(
    path: Path,
    options: ReadOptions,
    damages: Damages,
    take: Take,
    is_whole: Callable[[str], bool] = lambda line: False,
) -> Iterator[Frames]:
    """Blocks of the frames of a text log.

    Args:
        is_whole: whether a last line without its end is a whole frame all the same, by its own
            count of data bytes; `take` has accepted it.
    """
    rows = Rows()
    for text, number in lines_blocks(path, damages):
        lines = decoded(text).split("\n")
        # A file may end inside its last line, and the frame there may lack its last bytes.
        torn = lines.pop().strip()
        for at, line in enumerate(lines):
            line = line.strip()
            fault = take(line, rows) if line else None
            if fault == OTHER:
                damages.skip(OTHER)
            elif fault is not None:
                damages.add(fault, "line", number + at, shown(line))
            if len(rows) >= options.block_frames:
                yield rows.take()
        if torn:
            probe = Rows()
            fault = take(torn, probe)
            if len(probe) and fault is None and is_whole(torn):
                yield from _both(rows, probe)
            elif len(probe) or fault != OTHER:
                damages.add(TORN, "line", number + len(lines), shown(torn))
        if len(rows):
            yield rows.take()


def _both(rows: Rows, last: Rows) -> Iterator[Frames]:
    """What was gathered, and the frame of the last line."""
    if len(rows):
        yield rows.take()
    yield last.take()


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
