"""Shared by readers of text formats: whole lines become blocks of frames, others are counted."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from canlog.damage import Damages, shown
from canlog.frames import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    Frames,
    widened,
)
from canlog.line_block import LineBlock
from canlog.options import ReadOptions
from canlog.rows import Rows
from canlog.source import lines_blocks

NS_PER_S: Final = 1_000_000_000
JUNK: Final = "junk line"
TORN: Final = "torn line"
OTHER: Final = "line that is no frame"
"""Line besides frames that the format defines, such as a statistic; skipped, not damage."""
NO_DATE: Final = "no date"
"""Kind of damage of a log whose stamps are not dates."""
UNDATED: Final = "the head gives no date; stamps count from 1970"
UTF8_MARK: Final = b"\xef\xbb\xbf"
IDENTIFIER_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFF_FFFF

Fast = Callable[[bytes, list[str]], LineBlock | None]
"""Parses a block of whole lines as far as it can; None if it cannot parse it at all."""
Take = Callable[[str, Rows], str | None]
"""Adds the frame of a line; returns JUNK or OTHER for a line without one, None on success."""


def decoded(text: bytes) -> str:
    """Decode as UTF-8 if that is valid, or else as Latin-1, which keeps every byte."""
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
    fast: Fast | None = None,
    start: Callable[[], int] = lambda: 0,
) -> Iterator[Frames]:
    """Yield the frames of a text log in blocks.

    Args:
        is_whole: whether an unfinished last line that `take` accepted still holds a complete
            frame, by its own number of data bytes.
        fast: parses what it can of a block first. Its stamps count from `start`.
        start: instant that the lines before have set.
    """
    rows = Rows()
    for text, number in lines_blocks(path, damages):
        whole = text[: text.rfind(b"\n") + 1].removeprefix(UTF8_MARK) if fast is not None else b""
        found = fast(whole, rows.channels) if fast is not None and whole else None
        if found is not None:
            made = _mixed(found, whole, number, rows, take, start, damages)
            for at in range(0, len(made), options.block_frames):
                yield made[at : at + options.block_frames]
            text, number = text[text.rfind(b"\n") + 1 :], number + found.lines
        lines = decoded(text).split("\n")
        # A file may end inside its last line, whose frame may lack its last bytes.
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


def _mixed(
    block: LineBlock,
    text: bytes,
    number: int,
    rows: Rows,
    take: Take,
    start: Callable[[], int],
    damages: Damages,
) -> Frames:
    """Return the frames of a block in line order, with those of lines that only `take` reads."""
    frames, keep, since, start_ns = block.frames, np.ones(len(block.frames), np.bool_), 0, start()
    odd = (block.odd, block.odd_starts, block.odd_ends, block.odd_lines)
    for row, first, last, line_at in zip(*(each.tolist() for each in odd), strict=True):
        line = decoded(text[first:last])
        fault = take(line, rows)
        if fault == OTHER:
            damages.skip(OTHER)
        elif fault is not None:
            damages.add(fault, "line", number + line_at, shown(line))
        if start() != start_ns:
            frames.at_ns[since:row] += start_ns
            since, start_ns = row, start()
        keep[row] = len(rows) > 0
        if len(rows):
            frames = _put(rows.take(), frames, row, start_ns)
    frames.at_ns[since:] += start_ns
    frames = replace(frames, channels=tuple(rows.channels))
    return frames if keep.all() else frames[keep]


def _put(one: Frames, frames: Frames, row: int, start_ns: int) -> Frames:
    """Put one frame into its row; the caller adds the start to its stamp later."""
    width = max(one.data.shape[1], frames.data.shape[1])
    frames = replace(frames, data=widened(frames.data, width))
    frames.at_ns[row] = int(one.at_ns[0]) - start_ns
    frames.identifier[row], frames.flags[row] = one.identifier[0], one.flags[0]
    frames.channel[row], frames.length[row] = one.channel[0], one.length[0]
    frames.data[row] = widened(one.data, width)[0]
    return frames


def _both(rows: Rows, last: Rows) -> Iterator[Frames]:
    """Yield the gathered frames, then the frame of the last line."""
    if len(rows):
        yield rows.take()
    yield last.take()


def stamp_ns(text: str, digits: int = 9) -> int | None:
    """Parse seconds, or milliseconds with `digits` 6, into exact nanoseconds; None if malformed."""
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
    """Parse bytes written one by one; None if one of them is malformed."""
    try:
        return bytes([int(text, base) for text in texts])
    except ValueError:
        return None


def add_frame(
    rows: Rows,
    at_ns: int | None,
    identifier: int,
    flags: int,
    channel: str,
    length: int,
    data: bytes | None,
) -> str | None:
    """Add a frame; return JUNK if its numbers contradict each other, None on success.

    Args:
        at_ns, data: None if the text is malformed. Data of a remote frame are ignored.
    """
    limit = EXTENDED_MAX if flags & (EXTENDED | ERROR) else IDENTIFIER_MAX
    if at_ns is None or data is None or identifier > limit:
        return JUNK
    if length not in FD_LENGTHS or (length > CLASSIC_BYTES and not flags & FD):
        return JUNK
    if flags & REMOTE:
        data = b""
    elif len(data) != length:
        return JUNK
    return None if rows.add(at_ns, identifier, flags, channel, length, data) else JUNK


def head_ns(local_ns: int, options: ReadOptions, damages: Damages, where: str = "the head") -> int:
    """Return the instant of a local time. Without `utc_offset_s` it counts as UTC, with a warning.

    Args:
        where: what gives the time, for the warning.
    """
    if not options.utc_offset_s:
        damages.add("local time", "line", None, f"{where} gives no time zone; taken as UTC")
    return local_ns - options.utc_offset_s * NS_PER_S


def date_ns(year: int, month: int, day: int, clock: str) -> int | None:
    """Return nanoseconds since 1970 of a date and `hh:mm:ss.fraction`; None if it is invalid."""
    try:
        at = np.datetime64(f"{year:04d}-{month:02d}-{day:02d}T{clock}", "ns")
    except ValueError:
        return None
    return int(at.astype(np.int64))


def first_ns_of(frames: Frames) -> int:
    """Whole millisecond of the first frame: start of a log that is written with relative stamps."""
    first_ns = int(frames.at_ns[0])
    return first_ns - first_ns % 1_000_000


def hex_rows(frames: Frames, separator: str = "") -> list[str]:
    """Return the data of each frame in hexadecimal; the caller leaves out data of remote frames."""
    width = frames.data.shape[1]
    whole = np.ascontiguousarray(frames.data).tobytes()
    text = (whole.hex(separator) if separator else whole.hex()).upper()
    step = 2 + len(separator)
    row = width * step
    return [
        text[at * row : at * row + max(0, length * step - len(separator))]
        for at, length in enumerate(frames.length.tolist())
    ]
