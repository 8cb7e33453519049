"""A terminal as the desk needs it: keys without waiting, and a screen that is drawn over."""

import curses
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

ESCAPE_MS: Final = "25"
"""How long the library waits for the rest of an arrow key."""
NO_KEY: Final = -1
NAMES: Final = {
    curses.KEY_UP: "up",
    curses.KEY_DOWN: "down",
    curses.KEY_LEFT: "left",
    curses.KEY_RIGHT: "right",
    ord(" "): "space",
}
ASCII_MAX: Final = 126


class Terminal:
    """Drawn into from the top; what does not fit is cut off."""

    def __init__(self, window: "curses.window") -> None:
        self._window = window

    def pressed(self) -> Iterator[str]:
        """Keys since the last call, by the names in `plant_emulator.desk.hands`."""
        while (code := self._window.getch()) != NO_KEY:
            if code in NAMES:
                yield NAMES[code]
            elif 0 < code <= ASCII_MAX:
                yield chr(code).lower()

    def show(self, lines: Sequence[str]) -> None:
        window = self._window
        height, width = window.getmaxyx()
        window.erase()
        for row, line in enumerate(lines[:height]):
            # The last cell of a window cannot be written without scrolling it.
            window.addnstr(row, 0, line, max(0, width - 1))
        window.refresh()


@contextmanager
def open_terminal() -> Iterator[Terminal]:
    """Gives the terminal back as it was, whatever happens. Raises OSError without one."""
    os.environ.setdefault("ESCDELAY", ESCAPE_MS)
    try:
        window = curses.initscr()
    except curses.error as error:
        raise OSError(f"no terminal: {error}") from error
    try:
        curses.noecho()
        curses.cbreak()
        window.keypad(True)
        window.nodelay(True)
        with _without_cursor():
            yield Terminal(window)
    finally:
        window.keypad(False)
        curses.nocbreak()
        curses.echo()
        curses.endwin()


@contextmanager
def _without_cursor() -> Iterator[None]:
    """Some terminals cannot hide it."""
    try:
        before = curses.curs_set(0)
    except curses.error:
        yield
        return
    try:
        yield
    finally:
        curses.curs_set(before)
