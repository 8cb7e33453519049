"""Notices that nobody is heard on a line's radio, for the person who waits for an authority."""

from typing import Final

from can_dbc.vobc import EventKind
from vobc.vocabulary import Event

SILENT_S: Final = 5.0
"""A centre answers each status, five times a second; a session takes a second or two to begin."""
NS_PER_S: Final = 1e9


class LineSilence:
    """Nobody is told apart who is not there, speaks under other keys or belongs to another line."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._received = 0
        self._heard_ns: int | None = None
        self.words = ""
        """What is wrong; empty while somebody is heard."""

    def look(self, now_ns: int, received: int) -> Event | None:
        """What there is to tell; `received` counts all messages so far."""
        if self._heard_ns is None:
            self._heard_ns = now_ns
        if received != self._received:
            self._received, self._heard_ns = received, now_ns
            return self._is_back()
        if self.words or now_ns - self._heard_ns < SILENT_S * NS_PER_S:
            return None
        self.words = (
            f"nothing is heard on the line's radio at {self._endpoint}: is its wayside there, and "
            "of this line?"
        )
        return Event(EventKind.INPUT_LOST, self.words)

    def _is_back(self) -> Event | None:
        if not self.words:
            return None
        self.words = ""
        return Event(EventKind.INPUT_BACK, "the line's radio is heard")
