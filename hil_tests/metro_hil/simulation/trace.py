"""Records a run: as a hash that is equal for equal seeds, and as a transcript for people."""

from array import array
from collections.abc import Callable
from hashlib import blake2b
from typing import Final

CHUNK: Final = 8192
NS_PER_US: Final = 1000
US_PER_S: Final = 1_000_000

Teller = Callable[[int, str, str], None]
"""Takes the true instant, the name of the node, and the event as text."""


class EventHash:
    """A running hash over numbers in the order of their arrival."""

    __slots__ = ("_numbers", "_state", "note")

    def __init__(self) -> None:
        self._state = blake2b(digest_size=16)
        self._numbers: list[int] = []
        self.note: Callable[[int], None] = self._numbers.append
        """Adds one signed whole number of 64 bits."""

    def spill(self) -> None:
        """Hash the collected numbers; called now and then to bound the memory."""
        if len(self._numbers) >= CHUNK:
            self._flush()

    def digest(self) -> str:
        """Return the hash of all numbers so far, in hexadecimal."""
        self._flush()
        return self._state.hexdigest()

    def _flush(self) -> None:
        self._state.update(array("q", self._numbers).tobytes())
        self._numbers.clear()


class EventTranscript:
    """Writes one line for each event: second, node and text."""

    def __init__(self, out: Callable[[str], None]) -> None:
        self._out = out

    def __call__(self, at_ns: int, who: str, what: str) -> None:
        seconds, us = divmod(at_ns // NS_PER_US, US_PER_S)
        self._out(f"{seconds:6d}.{us:06d}  {who:<12} {what}")
