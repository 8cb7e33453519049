"""Kvaser CANKing text logs: columns of channel, identifier, flags, data and time."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog.damage import Damages
from canlog.formats.heads import KVASER
from canlog.formats.text import (
    JUNK,
    NO_DATE,
    OTHER,
    add_frame,
    hex_bytes,
    read_lines,
    stamp_ns,
)
from canlog.frames import ERROR, EXTENDED, FD, REMOTE, TX, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows

LINE: Final = re.compile(
    r"(?P<channel>\d{1,3})\s+(?P<id>[0-9A-Fa-f]{1,10})\s+(?P<flags>[A-Za-z ]*?)\s*"
    r"(?P<length>\d{1,2})(?P<data>(?:\s+[0-9A-Fa-f]{1,3})*)\s+(?P<stamp>\d{1,12}\.\d{1,9})"
    r"\s+(?P<way>[RT])\w*",
    re.ASCII,
)
ERRORS: Final = re.compile(
    r"(?P<channel>\d{1,3})\s+Error ?Frame\s+(?P<stamp>\d{1,12}\.\d{1,9}).*", re.I
)
ENDED: Final = ("Logging stopped", "Log ", "=", "Time", "Settings", "Kvaser", "Trigger")


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames; channel 0 is called `can0`. Stamps count from the start of the log."""
    damages.add(NO_DATE, "line", None, "the format has none; stamps count from the start")
    yield from read_lines(path, options, damages, _Taker().take)


class _Taker:
    """Parses lines; numbers are hexadecimal unless a data byte has three digits."""

    def take(self, line: str, rows: Rows) -> str | None:
        if KVASER.match(line.encode("ascii", "replace")) or line.startswith(ENDED):
            return None
        found = LINE.fullmatch(line) or ERRORS.fullmatch(line)
        if found is None:
            return JUNK if line[0].isdigit() else OTHER
        at_ns, channel = stamp_ns(found["stamp"]), f"can{int(found['channel'])}"
        if at_ns is None:
            return JUNK
        if found.re is ERRORS:
            return None if rows.add(at_ns, 0, ERROR, channel, 0, b"") else JUNK
        return self._frame(at_ns, channel, found, rows)

    def _frame(self, at_ns: int, channel: str, found: re.Match[str], rows: Rows) -> str | None:
        marks, texts = found["flags"].upper(), found["data"].split()
        base = 10 if any(len(each) == 3 for each in texts) else 16
        identifier = int(found["id"], base)
        wide = "X" in marks or identifier > 0x7FF
        flags = EXTENDED * wide | REMOTE * ("R" in marks) | FD * ("F" in marks)
        flags |= TX * (found["way"] == "T")
        length, data = int(found["length"]), hex_bytes(texts, base)
        return add_frame(rows, at_ns, identifier, flags, channel, length, data)
