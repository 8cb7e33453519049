"""CAN frames as columns: every reader produces them, and all else works on them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

EXTENDED: Final = 1
"""Flag of a 29-bit identifier."""
REMOTE: Final = 2
"""Flag of a remote frame; `length` is that of the requested data."""
ERROR: Final = 4
"""Flag of an error frame; `identifier` holds SocketCAN's error classes if the format has them."""
FD: Final = 8
BRS: Final = 16
ESI: Final = 32
TX: Final = 64
"""Flag of a frame that the logging node itself sent."""
NOT_DATA: Final = REMOTE | ERROR
CLASSIC_BYTES: Final = 8
FD_BYTES: Final = 64
KEY_EXTENDED: Final = 1 << 31
"""Set in the key of an extended identifier, as in a DBC file."""
FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Number of data bytes for each data length code."""

Ints = npt.NDArray[np.int64]
Words = npt.NDArray[np.uint32]
Bytes = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """`n` frames in log order, which may differ from the order of their stamps."""

    at_ns: Ints
    """(n,) int64. Nanoseconds since 1970, or since the start of a log without a date."""
    identifier: Words
    """(n,) uint32, without flags."""
    flags: Bytes
    """(n,) uint8: EXTENDED, REMOTE, ERROR, FD, BRS, ESI, TX."""
    channel: Bytes
    """(n,) uint8, index into `channels`."""
    length: Bytes
    """(n,) uint8, data bytes; for a remote frame, the requested number."""
    data: Bytes
    """(n, 8) uint8, or (n, 64) if any frame is longer; zeros after the last byte."""
    channels: tuple[str, ...] = ()
    """Channel names. A later block of the same log may add names, but never changes them."""

    def __len__(self) -> int:
        return len(self.at_ns)

    def __getitem__(self, rows: "slice | Ints | Bools") -> "Frames":
        """Select frames by a slice, indices or a mask; a slice copies nothing."""
        return Frames(
            self.at_ns[rows],
            self.identifier[rows],
            self.flags[rows],
            self.channel[rows],
            self.length[rows],
            self.data[rows],
            self.channels,
        )

    @property
    def key(self) -> Words:
        """(n,) uint32: identifier with KEY_EXTENDED for 29 bits, which identifies a message."""
        extended = (self.flags & np.uint8(EXTENDED)).astype(np.uint32)
        return self.identifier | extended << np.uint32(31)

    @property
    def is_data(self) -> Bools:
        """(n,) whether a frame is neither a remote nor an error frame."""
        is_data: Bools = (self.flags & np.uint8(NOT_DATA)) == 0
        return is_data

    def payload(self, row: int) -> bytes:
        """Return the data bytes of one frame; empty for a remote frame."""
        if int(self.flags[row]) & REMOTE:
            return b""
        return self.data[row, : int(self.length[row])].tobytes()


def empty(channels: tuple[str, ...] = ()) -> Frames:
    return blank(0, channels=channels)


def blank(n: int, *, width: int = CLASSIC_BYTES, channels: tuple[str, ...] = ()) -> Frames:
    """Return `n` frames of zeros to fill in."""
    return Frames(
        np.zeros(n, np.int64),
        np.zeros(n, np.uint32),
        np.zeros(n, np.uint8),
        np.zeros(n, np.uint8),
        np.zeros(n, np.uint8),
        np.zeros((n, width), np.uint8),
        channels,
    )


def concat(blocks: Sequence[Frames]) -> Frames:
    """Concatenate blocks. Channels are matched by name."""
    blocks = [block for block in blocks if len(block)] or list(blocks[-1:])
    if not blocks:
        return empty()
    if len(blocks) == 1:
        return blocks[0]
    channels = list(dict.fromkeys(name for block in blocks for name in block.channels))
    width = max(block.data.shape[1] for block in blocks)
    return Frames(
        np.concatenate([block.at_ns for block in blocks]),
        np.concatenate([block.identifier for block in blocks]),
        np.concatenate([block.flags for block in blocks]),
        np.concatenate([renumbered(block, channels) for block in blocks]),
        np.concatenate([block.length for block in blocks]),
        np.concatenate([widened(block.data, width) for block in blocks]),
        tuple(channels),
    )


def widened(data: Bytes, width: int) -> Bytes:
    """Return the same bytes padded with zeros to `width` columns."""
    if data.shape[1] == width:
        return data
    wide = np.zeros((len(data), width), np.uint8)
    wide[:, : data.shape[1]] = data
    return wide


def renumbered(block: Frames, channels: list[str]) -> Bytes:
    """(n,): the channel of each frame as an index into `channels`, which holds all its names."""
    if list(block.channels) == channels[: len(block.channels)]:
        return block.channel
    numbers = np.array([channels.index(name) for name in block.channels] or [0], np.uint8)
    return numbers[block.channel]
