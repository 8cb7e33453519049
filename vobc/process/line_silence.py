"""Detects a silent line radio and slow arbiters, and reports both once."""

from typing import Final

from can_dbc.vobc import EventKind
from vobc.vocabulary import Event

SILENT_S: Final = 5.0
"""Silence that is reported. A centre answers each status, five times a second, and a session takes
a second or two to begin."""
QUICK_RATIO: Final = 0.9
"""Share of the network budget below which slow arbiters count as quick again."""
NS_PER_S: Final = 1e9


def silence_text(endpoint: str) -> str:
    """The problem as a question to the user; bench and controller ask it alike."""
    return (
        f"nothing is received on the line's radio at {endpoint}: is its wayside there, and of this "
        "line?"
    )


class LineSilence:
    """Watches the line radio. A missing wayside, a wrong key and another line look the same."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self._received = 0
        self._heard_ns: int | None = None
        self.slow = ""
        """Text of the problem with slow arbiters. Empty without one."""
        self.words = ""
        """Text of the problem. Empty while messages arrive."""

    def look(self, now_ns: int, received: int) -> Event | None:
        """The event to report, if any. `received` counts all messages so far."""
        if self._heard_ns is None:
            self._heard_ns = now_ns
        if received != self._received:
            self._received, self._heard_ns = received, now_ns
            return self._is_back()
        if self.words or now_ns - self._heard_ns < SILENT_S * NS_PER_S:
            return None
        self.words = silence_text(self._endpoint)
        return Event(EventKind.INPUT_LOST, self.words)

    def look_at_answers(self, took_ms: float, need_ms: int) -> Event | None:
        """The event to report if the arbiters have become too slow, or quick enough again.

        Args:
            took_ms: time that they take to answer. 0: unknown.
            need_ms: network budget of the line's timers.
        """
        if not self.slow and took_ms > need_ms:
            self.slow = f"arbiters answer after {took_ms:.0f} ms, need < {need_ms}"
            return Event(EventKind.INPUT_LOST, self.slow)
        if self.slow and took_ms < QUICK_RATIO * need_ms:
            self.slow = ""
            return Event(EventKind.INPUT_BACK, f"arbiters answer after {took_ms:.0f} ms")
        return None

    def _is_back(self) -> Event | None:
        if not self.words:
            return None
        self.words = ""
        return Event(EventKind.INPUT_BACK, "the line's radio is back")
