"""Builds columns from single frames, for formats that are read line by line."""

from collections.abc import Iterable
from typing import Final

import numpy as np

from canlog.frames import CLASSIC_BYTES, FD_BYTES, Frames

CHANNELS_MAX: Final = 256


class Rows:
    """Gathers frames into a block, and keeps the channel names of earlier blocks."""

    def __init__(self) -> None:
        self.channels: list[str] = []
        self._clear()

    def _clear(self) -> None:
        self._at_ns: list[int] = []
        self._identifier: list[int] = []
        self._flags: list[int] = []
        self._channel: list[int] = []
        self._length: list[int] = []
        self._data: list[bytes] = []

    def __len__(self) -> int:
        return len(self._at_ns)

    def add(
        self, at_ns: int, identifier: int, flags: int, channel: str, length: int, data: bytes
    ) -> bool:
        """Add a frame. False if it cannot be kept: a stamp beyond 64 bits, or too many channels."""
        if not -(1 << 63) <= at_ns < 1 << 63:
            return False
        if channel not in self.channels:
            if len(self.channels) == CHANNELS_MAX:
                return False
            self.channels.append(channel)
        self._at_ns.append(at_ns)
        self._identifier.append(identifier)
        self._flags.append(flags)
        self._channel.append(self.channels.index(channel))
        self._length.append(length)
        self._data.append(data)
        return True

    def take(self) -> Frames:
        """Return all frames since the last call."""
        wide = max(map(len, self._data), default=0) > CLASSIC_BYTES
        width = FD_BYTES if wide else CLASSIC_BYTES
        joined = b"".join([each.ljust(width, b"\0") for each in self._data])
        made = Frames(
            np.array(self._at_ns, np.int64),
            np.array(self._identifier, np.uint32),
            np.array(self._flags, np.uint8),
            np.array(self._channel, np.uint8),
            np.array(self._length, np.uint8),
            np.frombuffer(joined, np.uint8).reshape(-1, width).copy(),
            tuple(self.channels),
        )
        self._clear()
        return made


def from_rows(rows: Iterable[tuple[int, int, int, str, bytes]]) -> Frames:
    """Make frames of (at_ns, identifier, flags, channel, data); the length is that of the data."""
    made = Rows()
    for at_ns, identifier, flags, channel, data in rows:
        made.add(at_ns, identifier, flags, channel, len(data), data)
    return made.take()
