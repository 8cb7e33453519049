"""SIGINT and SIGTERM as a wish that a loop looks at, so that it can end in good order."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

EXIT_OK: Final = 0
EXIT_INTERRUPTED: Final = 130
ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def never() -> bool:
    """The answer of a run that nothing interrupts."""
    return False


@contextmanager
def held_back() -> Iterator[None]:
    """Keep Ctrl-C waiting inside. Processes started inside never receive it: their starter does."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave_to_parent() -> None:
    """Make a forked process ignore Ctrl-C, which its parent handles, and end on SIGTERM."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


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

    @property
    def exit_code(self) -> int:
        """Of a program that runs until it is asked to end: 130 for Ctrl-C, 0 for SIGTERM."""
        return EXIT_INTERRUPTED if self.by_keyboard else EXIT_OK

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self.by_keyboard = number == signal.SIGINT
