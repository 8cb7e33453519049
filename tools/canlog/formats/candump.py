"""candump logs of can-utils, plain or compressed: fast for `-l` and `-L`, strict for printed
output.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from canlog import kernel
from canlog.damage import Damages, shown
from canlog.formats import candump_line
from canlog.formats.candump_columns import (
    CHANNELS_MAX,
    parse_block,
    wide_enough,
)
from canlog.formats.candump_line import (
    BESIDE,
    COLOUR,
    DROPPED,
    EXTRA_LONG,
    LOCAL,
    NONE,
    SINCE,
    CandumpLine,
)
from canlog.formats.candump_write import write
from canlog.formats.text import UTF8_MARK
from canlog.frames import CLASSIC_BYTES, Bools, Frames, Ints
from canlog.line_block import LineBlock
from canlog.options import DELTA, ReadOptions
from canlog.source import text_blocks

__all__ = ["read", "whole_lines", "write"]


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of a candump log in the order of its lines.

    Lines without a frame and an unfinished last line are counted. Stamps of `candump -t z` and `-t
    d` become nanoseconds since the start of the log. Stamps of `-t A`, which have no time zone,
    count since 1970 as if they were UTC.
    """
    channels: list[str] = []
    stamps = _Stamps(options, damages)
    width, first_line = CLASSIC_BYTES, 1
    for text in text_blocks(path, damages):
        text = text.removeprefix(UTF8_MARK) if first_line == 1 else text
        if not text.endswith(b"\n"):
            damages.add("torn line", "line", first_line, shown(text))
            continue
        block = _parse(text, channels, width, options)
        if len(block.odd) and (wider := wide_enough(text, width)) != width:
            width = wider
            block = _parse(text, channels, width, options)
        frames = _with_odd(block, text, first_line, channels, stamps, damages)
        first_line += block.lines
        if len(frames):
            yield frames


def whole_lines(text: bytes, channels: list[str]) -> Frames:
    """Return the frames of lines as `candump -l` writes them; other lines are left out.

    Args:
        text: whole lines.
        channels: names of the channels so far; new names are added.
    """
    width = wide_enough(text, CLASSIC_BYTES)
    block = _parse(text, channels, width, ReadOptions())
    keep = np.ones(len(block.frames), np.bool_)
    keep[block.odd] = False
    return _renamed(block.frames, channels, keep)


def _parse(text: bytes, channels: list[str], width: int, options: ReadOptions) -> LineBlock:
    block = kernel.parse_candump(text, channels, width) if options.compiled else None
    return block if block is not None else parse_block(text, channels, width)


def _with_odd(
    block: LineBlock,
    text: bytes,
    first_line: int,
    channels: list[str],
    stamps: "_Stamps",
    damages: Damages,
) -> Frames:
    """Return the frames of a block, including those of lines that only the strict parser reads."""
    frames = block.frames
    if not len(block.odd):
        return frames
    keep = np.ones(len(frames), np.bool_)
    since = np.zeros(len(frames), np.bool_)
    odd = (block.odd, block.odd_starts, block.odd_ends, block.odd_lines)
    for row, start, end, number in zip(*(each.tolist() for each in odd), strict=True):
        raw = text[start:end]
        line = candump_line.parse(raw)
        if line is None or (line.channel not in channels and len(channels) == CHANNELS_MAX):
            keep[row] = False
            _report_other(raw, first_line + number, damages)
            continue
        if line.channel not in channels:
            channels.append(line.channel)
        _put(line, row, frames, channels)
        since[row] = line.since == SINCE
        stamps.note(line, first_line + number)
    stamps.settle(frames.at_ns, since & keep)
    return _renamed(frames, channels, keep)


def _report_other(raw: bytes, number: int, damages: Damages) -> None:
    """Report a line that is no frame: as damage, or as skipped."""
    raw = COLOUR.sub(b"", raw)
    dropped = DROPPED.fullmatch(raw)
    if dropped is not None:
        words = "candump itself lost them; it read too slowly"
        damages.add("dropped frame", "line", number, words, int(dropped[1]))
    elif EXTRA_LONG.fullmatch(raw):
        damages.skip("CAN XL frame")
    elif BESIDE.fullmatch(raw):
        damages.skip("line that is no frame")
    else:
        damages.add("junk line", "line", number, shown(raw))


def _put(line: CandumpLine, row: int, frames: Frames, channels: list[str]) -> None:
    frames.at_ns[row] = line.at_ns
    frames.identifier[row] = line.identifier
    frames.flags[row] = line.flags
    frames.channel[row] = channels.index(line.channel)
    frames.length[row] = line.length
    if len(line.data) <= frames.data.shape[1]:
        frames.data[row, : len(line.data)] = np.frombuffer(line.data, np.uint8)


def _renamed(frames: Frames, channels: list[str], keep: Bools) -> Frames:
    kept = frames if keep.all() else frames[keep]
    return Frames(
        kept.at_ns, kept.identifier, kept.flags, kept.channel, kept.length, kept.data,
        tuple(channels),
    )  # fmt: skip


class _Stamps:
    """Converts stamps relative to the start or to the frame before into one continuous count."""

    def __init__(self, options: ReadOptions, damages: Damages) -> None:
        self._delta: bool | None = options.stamps == DELTA if options.stamps else None
        self._damages = damages
        self._last_ns = 0

    def note(self, line: CandumpLine, number: int) -> None:
        if line.since == NONE:
            self._damages.add("no time stamps", "line", number, "frames without `-t` are at 0")
        elif line.since == LOCAL:
            self._damages.add(
                "local time", "line", number, "`-t A` gives no time zone; taken as UTC"
            )

    def settle(self, at_ns: Ints, since: Bools) -> None:
        """Convert in place: stamps are those of `-t d` if they run backwards, which `-t z` never
        does.
        """
        rows = np.flatnonzero(since)
        if not len(rows):
            return
        told = at_ns[rows]
        if self._delta is None:
            self._delta = bool((np.diff(told) < 0).any())
            kind = "the frame before (`-t d`)" if self._delta else "the start (`-t z`)"
            self._damages.add("relative stamps", "frame", None, f"taken to count from {kind}")
        if self._delta:
            at_ns[rows] = self._last_ns + np.cumsum(told)
            self._last_ns = int(at_ns[rows[-1]])
