"""What happened, as a hash that two runs of one seed share, and as a story for people."""

from array import array
from collections.abc import Callable
from hashlib import blake2b
from typing import Final

CHUNK: Final = 8192
NS_PER_US: Final = 1000
US_PER_S: Final = 1_000_000

Teller = Callable[[int, str, str], None]
"""Takes the true instant, who, and what."""


class EventHash:
    """Numbers go into a running hash in the order in which they come."""

    __slots__ = ("_numbers", "_state", "note")

    def __init__(self) -> None:
        self._state = blake2b(digest_size=16)
        self._numbers: list[int] = []
        self.note: Callable[[int], None] = self._numbers.append
        """Takes one whole number of 64 bits, signed."""

    def spill(self) -> None:
        """Hash what has been noted so far; to be called now and then, so that memory stays."""
        if len(self._numbers) >= CHUNK:
            self._flush()

    def digest(self) -> str:
        """Of all noted so far, in hexadecimal."""
        self._flush()
        return self._state.hexdigest()

    def _flush(self) -> None:
        self._state.update(array("q", self._numbers).tobytes())
        self._numbers.clear()


class EventTranscript:
    """Lines in the order of events: second, who, what."""

    def __init__(self, out: Callable[[str], None]) -> None:
        self._out = out

    def __call__(self, at_ns: int, who: str, what: str) -> None:
        seconds, us = divmod(at_ns // NS_PER_US, US_PER_S)
        self._out(f"{seconds:6d}.{us:06d}  {who:<12} {what}")
