"""SIGINT and SIGTERM as a flag that a loop checks, so that it can end in order."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

EXIT_OK: Final = 0
EXIT_INTERRUPTED: Final = 130
ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


def never() -> bool:
    """Return False: the stop condition of a run that nothing interrupts."""
    return False


@contextmanager
def held_back() -> Iterator[None]:
    """Block Ctrl-C inside this context.

    Processes started inside never receive it; their starter does.
    """
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
    """Records that a signal asked this process to end."""

    def __init__(self) -> None:
        self.asked = False
        self.by_keyboard = False
        """The last such signal was Ctrl-C."""

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Inside this context the signals only set the flag; afterwards their old handlers
        return.
        """
        before = [(number, signal.signal(number, self._note)) for number in ENDING_SIGNALS]
        try:
            yield
        finally:
            for number, handler in before:
                signal.signal(number, handler)

    @property
    def exit_code(self) -> int:
        """Exit code of a program that runs until asked to end: 130 for Ctrl-C, 0 for SIGTERM."""
        return EXIT_INTERRUPTED if self.by_keyboard else EXIT_OK

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        self.by_keyboard = number == signal.SIGINT
