"""Microchip CAN BUS Analyzer text logs: fields separated by semicolons, stamps in milliseconds."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog.damage import Damages
from canlog.formats.text import JUNK, NO_DATE, UNDATED, add_frame, date_ns, head_ns, read_lines
from canlog.frames import EXTENDED, TX, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows

NS_PER_MS: Final = 1_000_000
CHANNEL: Final = "can0"
STARTED: Final = re.compile(
    r"Logging Started:\s*(\d{1,2})/(\d{1,2})/(\d{4}) (\d{1,2}):(\d{1,2}):(\d{1,2})(?: (AM|PM))?",
    re.IGNORECASE | re.ASCII,
)
LINE: Final = re.compile(
    r"(?P<ms>\d{1,15}(?:\.\d{1,6})?);(?P<way>RX|TX);(?P<id>(?:0x[0-9A-F]{1,8}|\d{1,10})x?);"
    r"(?P<length>\d);(?P<data>(?:(?:0x[0-9A-F]{1,2}|\d{1,3});?)*)",
    re.IGNORECASE | re.ASCII,
)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames, all on channel `can0`; stamps count from the local time in the head."""
    yield from read_lines(path, options, damages, _Taker(options, damages).take)


class _Taker:
    """Parses lines, and the comment at the head between two lines of slashes."""

    def __init__(self, options: ReadOptions, damages: Damages) -> None:
        self._options, self._damages = options, damages
        self._comment = False
        self._start_ns = 0
        self._dated = False

    def take(self, line: str, rows: Rows) -> str | None:
        if line.startswith("//"):
            self._comment = not self._comment
            return None
        if self._comment:
            found = STARTED.fullmatch(line)
            if found is not None:
                self._start(found)
            return None
        return self._frame(line, rows)

    def _start(self, found: re.Match[str]) -> None:
        first, second, year, hour, minute, past = (int(each) for each in found.groups()[:6])
        half = (found[7] or "").upper()
        # American programs write AM or PM and put the month first.
        day, month = (second, first) if half or second > 12 else (first, second)
        if half:
            hour = hour % 12 + 12 * (half == "PM")
        at_ns = date_ns(year, month, day, f"{hour:02d}:{minute:02d}:{past:02d}")
        if at_ns is None:
            return
        self._dated = True
        self._start_ns = head_ns(at_ns, self._options, self._damages)

    def _frame(self, line: str, rows: Rows) -> str | None:
        found = LINE.fullmatch(line)
        if found is None:
            return JUNK
        if not self._dated:
            self._damages.add(NO_DATE, "line", None, UNDATED)
            self._dated = True
        whole, _, fraction = found["ms"].partition(".")
        at_ns = self._start_ns + int(whole) * NS_PER_MS + int(fraction.ljust(6, "0"))
        identifier, length = int(found["id"].rstrip("xX"), 0), int(found["length"])
        texts = [each for each in found["data"].split(";") if each]
        try:
            data = bytes(int(each, 0) for each in texts[:length])
        except ValueError:
            return JUNK
        wide = identifier > 0x7FF or found["id"][-1] in "xX"
        flags = EXTENDED * wide | TX * (found["way"].upper() == "TX")
        return add_frame(rows, at_ns, identifier, flags, CHANNEL, length, data)
