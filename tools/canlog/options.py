"""What a reader may be told."""

from dataclasses import dataclass
from typing import Final

ZERO: Final = "zero"
DELTA: Final = "delta"
BLOCK_FRAMES: Final = 262_144


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """How a log is read; the defaults are right for whole files."""

    format: str | None = None
    """Name of the format where neither name nor content of the file tell."""
    stamps: str | None = None
    """Of a candump log with short stamps: DELTA or ZERO; None finds out."""
    utc_offset_s: int = 0
    """East of Greenwich, of formats that tell local time without a zone."""
    block_frames: int = BLOCK_FRAMES
    """About so many frames come at a time."""
    inflater: str | None = None
    """libdeflate, isal or zlib; None takes the fastest that is installed."""
    compiled: bool = True
    """Use the compiled kernel where there is one."""
    on_disk: bool = False
    """Keep large columns in files without a name, so that a log need not fit into memory."""
    channels: tuple[str, ...] = ()
    """Only frames of these channels; all without any."""
    refuse_empty: bool = False
    """A file without a frame raises LogError: nothing can be concluded from it."""
