"""CAN frames as columns: what every reader makes and everything else works on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

EXTENDED: Final = 1
"""29-bit identifier."""
REMOTE: Final = 2
"""Asks for data; `length` is that of the data asked for."""
ERROR: Final = 4
"""An error frame; `identifier` holds the error class bits of SocketCAN where the format has any."""
FD: Final = 8
BRS: Final = 16
ESI: Final = 32
TX: Final = 64
"""Sent by whoever logged it."""
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
    """`n` frames in the order of the log, which need not be that of their stamps."""

    at_ns: Ints
    """(n,) int64. Nanoseconds since 1970, or since the start of a log that does not tell."""
    identifier: Words
    """(n,) uint32, without any flag."""
    flags: Bytes
    """(n,) uint8: EXTENDED, REMOTE, ERROR, FD, BRS, ESI, TX."""
    channel: Bytes
    """(n,) uint8, index into `channels`."""
    length: Bytes
    """(n,) uint8, data bytes; of a remote frame those that it asks for."""
    data: Bytes
    """(n, 8) or, once a frame is longer, (n, 64) uint8, zeros behind the last byte."""
    channels: tuple[str, ...] = ()
    """Names. A later block of the same log may have more, never others."""

    def __len__(self) -> int:
        return len(self.at_ns)

    def __getitem__(self, rows: "slice | Ints | Bools") -> "Frames":
        """The frames of a slice, of indices or of a mask; a slice copies nothing."""
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
        """(n,) uint32: identifier, with KEY_EXTENDED for 29 bits; it tells messages apart."""
        extended = (self.flags & np.uint8(EXTENDED)).astype(np.uint32)
        return self.identifier | extended << np.uint32(31)

    @property
    def is_data(self) -> Bools:
        """(n,) neither remote nor error frame."""
        is_data: Bools = (self.flags & np.uint8(NOT_DATA)) == 0
        return is_data

    def payload(self, row: int) -> bytes:
        """The data bytes of one frame; none for a remote frame."""
        if int(self.flags[row]) & REMOTE:
            return b""
        return self.data[row, : int(self.length[row])].tobytes()


def empty(channels: tuple[str, ...] = ()) -> Frames:
    return blank(0, channels=channels)


def blank(n: int, *, width: int = CLASSIC_BYTES, channels: tuple[str, ...] = ()) -> Frames:
    """`n` frames of zeros to be filled."""
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
    """All blocks one after the other. Channels are matched by name."""
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
    """The same bytes with zeros up to `width` columns."""
    if data.shape[1] == width:
        return data
    wide = np.zeros((len(data), width), np.uint8)
    wide[:, : data.shape[1]] = data
    return wide


def renumbered(block: Frames, channels: list[str]) -> Bytes:
    """(n,) the channel of each frame as an index into other names, which hold all of its own."""
    if list(block.channels) == channels[: len(block.channels)]:
        return block.channel
    numbers = np.array([channels.index(name) for name in block.channels] or [0], np.uint8)
    return numbers[block.channel]
