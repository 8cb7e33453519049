"""A terminal as the desk needs it: keys without waiting, and a screen that is drawn over."""

import curses
import os
from collections.abc import Iterable, Iterator, Sequence
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
ESCAPE: Final = 27
ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
"""Last letter of an arrow key's bytes, for terminals that send other ones than they declare."""
INTRODUCERS: Final = "[O"


class TerminalArea:
    """Drawn into from the top; what does not fit is cut off."""

    def __init__(self, window: "curses.window") -> None:
        self._window = window

    def pressed(self) -> Iterator[str]:
        """Keys since the last call, by the names in `plant_emulator.desk.hands`."""
        return key_names(iter(self._window.getch, NO_KEY))

    def show(self, lines: Sequence[str]) -> None:
        window = self._window
        height, width = window.getmaxyx()
        window.erase()
        for row, line in enumerate(lines[:height]):
            # The last cell of a window cannot be written without scrolling it.
            window.addnstr(row, 0, line, max(0, width - 1))
        window.refresh()


def key_names(codes: Iterable[int]) -> Iterator[str]:
    """Names of keys from the codes of the terminal's library.

    What follows an escape that the library made no key of (a function key, an arrow with Control)
    is one key, and none of the desk's: its letters must neither start the train nor change a mode.
    """
    rest = iter(codes)
    for code in rest:
        if code == ESCAPE:
            sequence = _sequence(rest)
            if sequence[:1] in INTRODUCERS and sequence[1:] in ARROWS:
                yield ARROWS[sequence[1:]]
        elif code in NAMES:
            yield NAMES[code]
        elif 0 < code <= ASCII_MAX:
            yield chr(code).lower()


def _sequence(rest: Iterator[int]) -> str:
    """What belongs to an escape: an introducer, parameters, and a letter or `~`."""
    text = ""
    for code in rest:
        text += chr(code)
        last = text[-1]
        introduces = len(text) == 1 and last in INTRODUCERS
        if not introduces and (len(text) == 1 or last.isalpha() or last == "~"):
            break
    return text


@contextmanager
def open_terminal() -> Iterator[TerminalArea]:
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
            yield TerminalArea(window)
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
