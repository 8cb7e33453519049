"""Terminal functions for the desk: reading keys without waiting, and redrawing the screen."""

import curses
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from plant_emulator.desk.dmi import StatusColour

ESCAPE_MS: Final = "25"
"""Time that the curses library waits for the rest of an arrow key's bytes."""
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
"""Last byte of an arrow key's sequence, for terminals whose sequences differ from their
declaration."""
INTRODUCERS: Final = "[O"
COLOURS: Final = {
    StatusColour.GREY: (244, curses.COLOR_WHITE),
    StatusColour.WHITE: (231, curses.COLOR_WHITE),
    StatusColour.YELLOW: (226, curses.COLOR_YELLOW),
    StatusColour.ORANGE: (208, curses.COLOR_YELLOW),
    StatusColour.RED: (196, curses.COLOR_RED),
}
"""Number of each colour on a terminal with 256 colours, and on one with 8."""
COLOURS_MANY: Final = 256


class TerminalArea:
    """An area of text drawn from the top; text that does not fit is cut off."""

    def __init__(self, window: "curses.window") -> None:
        self._window = window
        self._attributes = _attributes()

    def pressed(self) -> Iterator[str]:
        """Keys since the last call, by their names in `plant_emulator.desk.hands`."""
        return key_names(iter(self._window.getch, NO_KEY))

    def show(
        self,
        lines: Sequence[str],
        *,
        coloured: range = range(0),
        colour: StatusColour | None = None,
    ) -> None:
        """Draw the lines; `coloured` are the rows in the status colour."""
        attribute = 0 if colour is None else self._attributes.get(colour, 0)
        window = self._window
        height, width = window.getmaxyx()
        window.erase()
        for row, line in enumerate(lines[:height]):
            # curses cannot write a window's last cell without scrolling.
            window.addnstr(row, 0, line, max(0, width - 1), attribute if row in coloured else 0)
        window.refresh()


def _attributes() -> dict[StatusColour, int]:
    """Attribute of each status colour; none on a terminal without colours."""
    try:
        curses.start_color()
        curses.use_default_colors()
    except curses.error:
        return {}
    if not curses.has_colors():
        return {}
    for pair, (many, few) in enumerate(COLOURS.values(), 1):
        curses.init_pair(pair, many if curses.COLORS >= COLOURS_MANY else few, -1)
    return {colour: curses.color_pair(pair) for pair, colour in enumerate(COLOURS, 1)}


def key_names(codes: Iterable[int]) -> Iterator[str]:
    """Return the names of keys from the key codes of curses.

    An escape sequence that curses does not know (a function key, an arrow with Control) counts as
    one key without a meaning. Its letters must neither start the train nor change a mode.
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
    """Return the rest of an escape sequence: an introducer, parameters, and a letter or `~`."""
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
    """Open the terminal and always restore it at the end. Raises OSError without a terminal."""
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
    """Hide the cursor, on terminals that can."""
    try:
        before = curses.curs_set(0)
    except curses.error:
        yield
        return
    try:
        yield
    finally:
        curses.curs_set(before)
