"""Shared by writers: channel numbers, and a list of what a format cannot hold."""

import re
from typing import Any, Final

import numpy as np

from canlog.damage import Damages
from canlog.frames import Frames

NUMBERED: Final = re.compile(r"can([1-9]\d{0,2})")
"""Channel name that gives its own number; others are numbered in order of appearance."""
FROM_ZERO: Final = re.compile(r"(v?can)0")
"""The first SocketCAN channel; if it is present, `can1` is the second channel, and so on."""


class Numbers:
    """Channel numbers from 1 for channel names, the same for all blocks of a log."""

    def __init__(self, losses: Damages, *, most: int = 255) -> None:
        self._losses = losses
        self._most = most
        self._numbers: dict[str, int] = {}
        self._shifted = ""
        """Prefix of channel names that count from 0."""

    def of(self, frames: Frames) -> Any:
        """(n,) uint8 channel number of each frame."""
        zero = next(
            (found for each in frames.channels if (found := FROM_ZERO.fullmatch(each))), None
        )
        if zero is not None and not self._numbers:
            self._shifted = zero[1]
        table = [self._number(name) for name in frames.channels] or [1]
        return np.array(table, np.uint8)[frames.channel]

    def _number(self, name: str) -> int:
        if name in self._numbers:
            return self._numbers[name]
        shifted = name.removeprefix(self._shifted) if self._shifted else ""
        if self._shifted and name.startswith(self._shifted) and shifted.isdigit():
            number = int(shifted) + 1
            if number <= self._most and number not in self._numbers.values():
                words = f"{name} becomes channel {number}"
                self._losses.add("channel name", "frame", None, words)
                self._numbers[name] = number
                return number
        match = NUMBERED.fullmatch(name)
        taken = set(self._numbers.values())
        number = int(match[1]) if match else 0
        if not match or number in taken or number > self._most:
            number = next(n for n in range(1, 1 << 16) if n not in taken)
            self._losses.add("channel name", "frame", None, f"{name} becomes channel {number}")
        self._numbers[name] = min(number, self._most)
        return self._numbers[name]


def lost(losses: Damages, rows: Any, kind: str, detail: str, first_row: int = 0) -> None:
    """Count frames that lose information, given as a mask of a block; frames count from 1."""
    found = np.flatnonzero(rows)
    if len(found):
        losses.add(kind, "frame", first_row + int(found[0]) + 1, detail, len(found))
