"""Running hash over the frames of a run: equal hashes mean equal bus traffic, bit for bit."""

import hashlib
import struct
from typing import Final

LINK_S: Final = 10
"""Time that one link of the hash chain covers, s."""
_LINK_NS: Final = LINK_S * 1_000_000_000
_FLUSH: Final = 512
_head: Final = struct.Struct("<qHB").pack


class FrameHash:
    """Hash of all frames, which it receives in bus order.

    A link is SHA-256 over the link before it and each frame that ended within its time. For a frame
    it takes the instant of its end (int64 ns, little endian), identifier (uint16), length (uint8)
    and data. Two runs that differ share all links before their first difference.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._pieces: list[bytes] = []
        self._digest = hashlib.sha256()
        self._links: list[str] = []
        self._link_end_ns = _LINK_NS

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        if stamp_ns >= self._link_end_ns:
            self._close_links(stamp_ns)
        self.frames += 1
        pieces = self._pieces
        pieces.append(_head(stamp_ns, can_id, len(data)) + data)
        if len(pieces) >= _FLUSH:
            self._flush()

    def _flush(self) -> None:
        self._digest.update(b"".join(self._pieces))
        self._pieces.clear()

    def _close_links(self, stamp_ns: int) -> None:
        while stamp_ns >= self._link_end_ns:
            self._flush()
            link = self._digest.digest()
            self._links.append(link.hex())
            self._digest = hashlib.sha256(link)
            self._link_end_ns += _LINK_NS

    @property
    def links(self) -> tuple[str, ...]:
        """Hashes up to the end of each full interval, then the hash up to now."""
        self._flush()
        return (*self._links, self._digest.hexdigest())

    @property
    def value(self) -> str:
        """The last link, which is the hash of the whole run."""
        return self.links[-1]
