"""The result of a parser of blocks of lines."""

from dataclasses import dataclass
from typing import Any

from canlog.frames import Frames


@dataclass(frozen=True, slots=True)
class LineBlock:
    """A block of lines, one row for each line that is not empty."""

    frames: Frames
    odd: Any
    """(k,) rows that need the strict parser; their frames are still zeros."""
    odd_starts: Any
    """(k,) offset of each odd row's line in the block."""
    odd_ends: Any
    odd_lines: Any
    """(k,) line number of each odd row in the block, from 0."""
    lines: int
    """Number of lines of the block."""
