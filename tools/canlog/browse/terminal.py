"""A terminal in raw mode: reads keys without waiting for Enter, redraws only changed lines."""

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Final

from canlog.browse.screen import Line, ScreenStyle

ESCAPES: Final = {
    "[A": "up",
    "[B": "down",
    "[C": "right",
    "[D": "left",
    "OA": "up",
    "OB": "down",
    "OC": "right",
    "OD": "left",
    "[H": "home",
    "[F": "end",
    "OH": "home",
    "OF": "end",
    "[1~": "home",
    "[4~": "end",
    "[5~": "pageup",
    "[6~": "pagedown",
}
NAMES: Final = {
    "\r": "enter",
    "\n": "enter",
    "\t": "tab",
    " ": "space",
    "\x7f": "backspace",
    "\x08": "backspace",
    "\x03": "q",
}
ESCAPE: Final = "\x1b"
ENTER_SCREEN: Final = "\x1b[?1049h\x1b[?25l\x1b[2J"
LEAVE_SCREEN: Final = "\x1b[0m\x1b[?25h\x1b[?1049l"
BYTES_MAX: Final = 4096


class RawTerminal:
    """A terminal in raw mode that restores the previous state on every way out."""

    def __init__(self, *, colour: bool = True) -> None:
        self._in, self._out = sys.stdin.fileno(), sys.stdout.fileno()
        self._colour = colour
        self._before = termios.tcgetattr(self._in)
        self._drawn: list[str] = []
        self._size = (0, 0)

    def __enter__(self) -> "RawTerminal":
        tty.setraw(self._in)
        self._write(ENTER_SCREEN)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.suppress(OSError):
            self._write(LEAVE_SCREEN)
        termios.tcsetattr(self._in, termios.TCSADRAIN, self._before)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and lines of the terminal now."""
        found = os.get_terminal_size(self._out)
        return found.columns, found.lines

    def keys(self, wait_s: float) -> list[str] | None:
        """Return the keys pressed within `wait_s`; None when the terminal is closed."""
        ready, _, _ = select.select([self._in], [], [], wait_s)
        if not ready:
            return []
        try:
            raw = os.read(self._in, BYTES_MAX)
        except OSError:
            return None
        return list(key_names(raw.decode("utf-8", "ignore"))) if raw else None

    def show(self, lines: Sequence[Line]) -> None:
        """Write only the lines that differ from what the screen shows."""
        if self.size != self._size:
            self._size, self._drawn = self.size, []
            self._write("\x1b[2J")
        texts = [styled(line, colour=self._colour) for line in lines]
        texts += [""] * (len(self._drawn) - len(texts))
        changed = [
            f"\x1b[{row + 1};1H{text}\x1b[K"
            for row, text in enumerate(texts)
            if row >= len(self._drawn) or text != self._drawn[row]
        ]
        self._drawn = texts
        if changed:
            self._write("".join(changed))

    def _write(self, text: str) -> None:
        rest = text.encode("utf-8", "replace")
        while rest:
            rest = rest[os.write(self._out, rest) :]


def styled(line: Line, *, colour: bool) -> str:
    """Return the line with terminal codes; without colour only bold, dim and inverse remain."""
    text = ""
    for style, words in line:
        codes = style.value if colour else _plain(style)
        text += f"\x1b[{codes}m{words}\x1b[0m" if codes else words
    return text


def _plain(style: ScreenStyle) -> str:
    if style is ScreenStyle.CHANGED:
        return "7"
    return (
        style.value
        if style in (ScreenStyle.BOLD, ScreenStyle.DIM, ScreenStyle.HEAD, ScreenStyle.CHOSEN)
        else ""
    )


def key_names(text: str) -> Iterator[str]:
    """Yield the names of the keys that a terminal sends; unknown escape sequences are dropped."""
    at = 0
    while at < len(text):
        sign = text[at]
        at += 1
        if sign != ESCAPE:
            yield NAMES.get(sign, sign)
            continue
        stop = at
        if text[at : at + 1] in ("[", "O"):
            stop = at + 1
            while stop < len(text) and not (text[stop].isalpha() or text[stop] == "~"):
                stop += 1
            stop = min(stop + 1, len(text))
        found = ESCAPES.get(text[at:stop])
        if stop == at:
            yield "escape"
        elif found is not None:
            yield found
        at = stop
