"""SIGINT and SIGTERM as a wish that a loop looks at, so that it can end in good order."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Remembers that somebody asked this process to end."""

    def __init__(self) -> None:
        self.asked = False
        self.by_keyboard = False
        """The last to ask did so with Ctrl-C."""

    @contextmanager
    def caught(self) -> Iterator[None]:
        """While inside, these signals only leave a note; afterwards they act as they did before."""
        before = [(number, signal.signal(number, self._note)) for number in ENDING_SIGNALS]
        try:
            yield
        finally:
            for number, handler in before:
                signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self.by_keyboard = number == signal.SIGINT
