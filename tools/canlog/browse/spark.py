"""Small plots made of characters: one line of blocks, or a field of dots."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from canlog.frames import Ints
from canlog.views.traces import Floats

BLOCKS: Final = "▁▂▃▄▅▆▇█"
ASCII_BLOCKS: Final = "_.-~=*#@"
BRAILLE: Final = 0x2800
DOTS: Final = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bits of a braille character by row and column."""
ROWS: Final = 4
COLUMNS: Final = 2

Span = tuple[float, float]


def spans(at_ns: Ints, values: Floats, start_ns: int, end_ns: int, count: int) -> list[Span | None]:
    """Minimum and maximum in each of `count` equal intervals of time; None without samples."""
    cuts = start_ns + ((end_ns - start_ns) * np.arange(count + 1)) // count
    edges = np.searchsorted(at_ns, cuts, "right")
    found: list[Span | None] = []
    for first, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        inside = values[first:stop]
        inside = inside[np.isfinite(inside)]
        found.append((float(inside.min()), float(inside.max())) if len(inside) else None)
    return found


def held(found: Sequence[Span | None]) -> list[Span | None]:
    """Fill intervals without samples with the previous value: a signal holds its value."""
    kept: list[Span | None] = []
    last: Span | None = None
    for each in found:
        last = each if each is not None else last
        kept.append(last)
    return kept


def line(found: Sequence[Span | None], *, ascii_only: bool = False) -> str:
    """Return one character per interval.

    It shows the minimum or the maximum, whichever differs more from the character before.
    """
    blocks = ASCII_BLOCKS if ascii_only else BLOCKS
    low, high = limits(found)
    text, before = "", (low + high) / 2
    for each in found:
        if each is None:
            text += " "
            continue
        value = max(each, key=lambda one, last=before: abs(one - last))  # type: ignore[misc]
        text += blocks[min(len(blocks) - 1, int((value - low) / (high - low) * len(blocks)))]
        before = value
    return text


def limits(found: Sequence[Span | None]) -> Span:
    """Minimum and maximum of all intervals; kept apart when the signal is constant."""
    there = [each for each in found if each is not None]
    if not there:
        return 0.0, 1.0
    low, high = min(each[0] for each in there), max(each[1] for each in there)
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def field(found: Sequence[Span | None], height: int, *, ascii_only: bool = False) -> list[str]:
    """Return `height` lines that draw each interval from minimum to maximum, joined to the next.

    A braille character shows two intervals, a plain character one.
    """
    rows = height if ascii_only else height * ROWS
    low, high = limits(found)
    dots = np.zeros((rows, len(found)), np.bool_)
    before: tuple[int, int] | None = None
    for column, each in enumerate(found):
        if each is None:
            before = None
            continue
        top, bottom = (
            rows - 1 - min(rows - 1, int((value - low) / (high - low) * rows))
            for value in (each[1], each[0])
        )
        reach = (top, bottom)
        if before is not None:
            # Extend to the nearer end of the previous interval, so that a step becomes a line.
            top, bottom = min(top, before[1]), max(bottom, before[0])
        dots[top : bottom + 1, column] = True
        before = reach
    if ascii_only:
        return ["".join("*" if dot else " " for dot in row) for row in dots.tolist()]
    return [_braille(dots[row : row + ROWS]) for row in range(0, rows, ROWS)]


def _braille(dots: "np.ndarray[tuple[int, int], np.dtype[np.bool_]]") -> str:
    text = ""
    for column in range(0, dots.shape[1], COLUMNS):
        bits = 0
        for row in range(ROWS):
            for beside in range(min(COLUMNS, dots.shape[1] - column)):
                if dots[row, column + beside]:
                    bits |= DOTS[row][beside]
        text += chr(BRAILLE + bits) if bits else " "
    return text
