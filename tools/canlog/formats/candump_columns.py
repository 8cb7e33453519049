"""Parses candump lines with numpy: all lines of one shape at once; other lines are left over."""

import re
from itertools import pairwise
from typing import Any, Final

import numpy as np

from canlog.formats.candump_line import NS_PER_S, SECONDS_MAX
from canlog.frames import (
    BRS,
    CLASSIC_BYTES,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_BYTES,
    FD_LENGTHS,
    TX,
    Bytes,
    Frames,
    blank,
)
from canlog.line_block import LineBlock

SHAPES_MAX: Final = 40
"""Maximum number of shapes, such as channel names, of lines of one length; more are left as odd."""
NEWLINE: Final = 10
RETURN: Final = 13
_SHAPE: Final = re.compile(
    rb"\((?P<seconds>\d{10})\.(?P<fraction>\d{6}|\d{9})\) (?P<channel>\S+) "
    rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
    rb"(?:#(?P<data>(?:[0-9A-Fa-f]{2}){0,8})|##(?P<fd>[0-9A-Fa-f])(?P<fd_data>(?:[0-9A-Fa-f]{2}){0,64}))"
    rb"(?P<way> [RT])?"
)
_SHOWN_FD: Final = re.compile(rb"  \[\d\d\] ")
CHANNELS_MAX: Final = 256
_HEX: Final = np.full(256, 255, np.uint8)
for _digit in range(16):
    for _text in f"{_digit:x}", f"{_digit:X}":
        _HEX[ord(_text)] = _digit


def line_spans(text: Bytes) -> tuple[Any, Any, Any, int]:
    """Return start, end and number of each line that is not empty, and the number of all lines."""
    breaks = np.flatnonzero(text == NEWLINE)
    if not len(text) or text[-1] != NEWLINE:
        breaks = np.append(breaks, len(text))
    starts = np.empty_like(breaks)
    starts[0] = 0
    starts[1:] = breaks[:-1] + 1
    ends = breaks.copy()
    full = ends > starts
    ends[full] -= text[ends[full] - 1] == RETURN
    full = ends > starts
    return starts[full], ends[full], np.flatnonzero(full), len(full)


def parse_block(block: bytes, channels: list[str], width: int = CLASSIC_BYTES) -> LineBlock:
    """Parse a block of whole lines; new names are added to `channels`.

    It never raises: a line that does not have exactly the shape of a logged data frame is in `odd`.
    """
    text = np.frombuffer(block, np.uint8)
    starts, ends, lines, count = line_spans(text)
    lengths = ends - starts
    made = blank(len(starts), width=width)
    odd = np.ones(len(starts), np.bool_)
    order = np.argsort(np.minimum(lengths, 0xFFFF).astype(np.uint16), kind="stable")
    sorted_lengths = lengths[order]
    firsts = np.flatnonzero(np.diff(sorted_lengths, prepend=-1))
    for first, last in pairwise([*firsts.tolist(), len(order)]):
        length = int(sorted_lengths[first])
        if length > 256:
            break
        rows = order[first:last]
        windows = np.lib.stride_tricks.sliding_window_view(text, length)
        _parse_equal(windows[starts[rows]], rows, made, odd, channels)
    frames = Frames(
        made.at_ns, made.identifier, made.flags, made.channel, made.length, made.data,
        tuple(channels),
    )  # fmt: skip
    left = np.flatnonzero(odd)
    return LineBlock(frames, left, starts[left], ends[left], lines[left], count)


def _parse_equal(text: Bytes, rows: Any, made: Frames, odd: Any, channels: list[str]) -> None:
    """Parse lines of equal length, shape by shape."""
    left = np.arange(len(rows))
    for _ in range(SHAPES_MAX):
        if not len(left):
            return
        sample = text[left[0]].tobytes()
        shape = _SHAPE.fullmatch(sample)
        if shape is None:
            left = left[1:]
            continue
        alike = np.flatnonzero(_alike(text[left], shape))
        good = _fill(text[left[alike]], shape, rows[left[alike]], made, channels)
        odd[rows[left[alike[good]]]] = False
        # Lines that only looked alike may have another shape; the sample is done either way.
        done = np.zeros(len(left), np.bool_)
        done[alike[good]] = done[0] = True
        left = left[~done]


def _alike(text: Bytes, shape: re.Match[bytes]) -> Any:
    """Select lines with the same characters at all places where the shape has no digits."""
    sample = np.frombuffer(shape[0], np.uint8)
    fixed = np.ones(len(sample), np.bool_)
    for name in ("seconds", "fraction", "id", "data", "fd", "fd_data"):
        start, end = shape.span(name)
        if start >= 0:
            fixed[start:end] = False
    columns = np.flatnonzero(fixed)
    return (text[:, columns] == sample[columns]).all(axis=1)


def _fill(text: Bytes, shape: re.Match[bytes], rows: Any, made: Frames, channels: list[str]) -> Any:
    """Write the frames of lines of one shape, and return which lines are frames."""
    seconds, good = _number(text[:, slice(*shape.span("seconds"))])
    fraction, digits = _number(text[:, slice(*shape.span("fraction"))])
    good &= digits & (seconds <= SECONDS_MAX - 1)
    if len(shape["fraction"]) == 6:
        fraction *= 1000
    identifier, flags, known = _identifier(text[:, slice(*shape.span("id"))])
    good &= known
    name = "data" if shape["fd"] is None else "fd_data"
    data, hexadecimal = _payload(text[:, slice(*shape.span(name))])
    good &= hexadecimal
    length = data.shape[1]
    if shape["fd"] is not None:
        nibble = _HEX[text[:, shape.start("fd")]]
        good &= (nibble < 16) & ((flags & ERROR) == 0)
        flags |= FD | (nibble & 1) * np.uint8(BRS) | (nibble >> 1 & 1) * np.uint8(ESI)
        good &= length in FD_LENGTHS
    if length > made.data.shape[1]:
        return np.zeros(len(rows), np.bool_)
    if shape["way"] == b" T":
        flags |= np.uint8(TX)
    channel = shape["channel"].decode("ascii", "backslashreplace")
    if channel not in channels:
        if len(channels) == CHANNELS_MAX:
            return np.zeros(len(rows), np.bool_)
        channels.append(channel)
    rows = rows[good]
    made.at_ns[rows] = (seconds * NS_PER_S + fraction)[good]
    made.identifier[rows] = identifier[good]
    made.flags[rows] = flags[good]
    made.channel[rows] = channels.index(channel)
    made.length[rows] = length
    made.data[rows, :length] = data[good]
    return good


def _number(text: Bytes) -> tuple[Any, Any]:
    """Return the numbers as int64, and whether all characters are digits."""
    digits = text - np.uint8(ord("0"))
    value = np.zeros(len(text), np.int64)
    for column in digits.T:
        value *= 10
        value += column
    return value, (digits <= 9).all(axis=1)


def _identifier(text: Bytes) -> tuple[Any, Any, Any]:
    digits = _HEX[text]
    good = (digits < 16).all(axis=1)
    wide = np.zeros(len(text), np.uint32)
    for column in digits.T:
        wide = wide << np.uint32(4) | column
    if text.shape[1] == 3:
        return wide, np.zeros(len(text), np.uint8), good & (wide <= 0x7FF)
    error = (wide & np.uint32(0x2000_0000)) != 0
    flags = np.where(error, np.uint8(ERROR), np.uint8(EXTENDED))
    return wide & np.uint32(0x1FFF_FFFF), flags, good & (wide <= 0x3FFF_FFFF)


def _payload(text: Bytes) -> tuple[Bytes, Any]:
    digits = _HEX[text]
    data: Bytes = digits[:, 0::2] << np.uint8(4) | digits[:, 1::2]
    return data, (digits < 16).all(axis=1)


def wide_enough(block: bytes, width: int) -> int:
    """Width that the data of a block needs: 64 if any line may be an FD frame."""
    if width == FD_BYTES or b"##" in block:
        return FD_BYTES
    return FD_BYTES if _SHOWN_FD.search(block) else width
