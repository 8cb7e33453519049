"""Options of the readers."""

from dataclasses import dataclass
from typing import Final

ZERO: Final = "zero"
DELTA: Final = "delta"
BLOCK_FRAMES: Final = 262_144


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options for reading a log; the defaults suit whole files."""

    format: str | None = None
    """Name of the format if neither suffix nor content identify it."""
    stamps: str | None = None
    """Kind of short stamps of a candump log: DELTA or ZERO; None detects it."""
    utc_offset_s: int = 0
    """Seconds east of Greenwich, for formats with local time without a zone."""
    block_frames: int = BLOCK_FRAMES
    """Approximate number of frames per block."""
    inflater: str | None = None
    """libdeflate, isal or zlib; None takes the fastest one installed."""
    compiled: bool = True
    """Whether to use the compiled kernel if it is available."""
    on_disk: bool = False
    """Whether to keep large columns in unnamed files, for logs larger than memory."""
    channels: tuple[str, ...] = ()
    """Read only frames of these channels; empty for all."""
    refuse_empty: bool = False
    """Whether a file without frames raises LogError, because it is no evidence of anything."""
