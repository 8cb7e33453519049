"""What a parser of blocks of lines hands over, however it works."""

from dataclasses import dataclass
from typing import Any

from canlog.frames import Frames


@dataclass(frozen=True, slots=True)
class LineBlock:
    """A block of lines, one row for each line that is not empty."""

    frames: Frames
    odd: Any
    """(k,) rows that only the strict parser can tell; their frames are zeros yet."""
    odd_starts: Any
    """(k,) where the line of each odd row begins in the block, and where it ends."""
    odd_ends: Any
    odd_lines: Any
    """(k,) number of the line of each odd row in the block, from 0."""
    lines: int
    """Of the block."""
