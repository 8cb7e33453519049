"""BusMaster logs (`.log`): hexadecimal or decimal, with three time modes."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog.damage import Damages
from canlog.formats.text import (
    JUNK,
    NO_DATE,
    NS_PER_S,
    UNDATED,
    add_frame,
    date_ns,
    head_ns,
    hex_bytes,
    read_lines,
)
from canlog.frames import ERROR, EXTENDED, FD, REMOTE, TX, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows

SYSTEM, ABSOLUTE, RELATIVE = "SYSTEM MODE", "ABSOLUTE MODE", "RELATIVE MODE"
DAY_NS: Final = 86_400 * NS_PER_S
START: Final = re.compile(
    r"START DATE AND TIME (\d{1,2}):(\d{1,2}):(\d{4}) (\d{1,2}):(\d\d):(\d\d):(\d{1,4})", re.ASCII
)
LINE: Final = re.compile(
    r"(?P<hour>\d{1,3}):(?P<minute>\d\d):(?P<second>\d\d):(?P<fraction>\d{1,6})\s+(?P<way>Rx|Tx)\s+"
    r"(?P<channel>\d{1,3})\s+(?:0x)?(?P<id>[0-9A-Fa-f]{1,10})\s+(?P<kind>s|x|sr|xr|s-fd|x-fd)\s+"
    r"(?P<length>\d{1,2})(?P<data>(?:\s+[0-9A-Fa-f]{1,3})*)",
    re.ASCII | re.IGNORECASE,
)
ERRORS: Final = re.compile(
    r"(?P<hour>\d{1,3}):(?P<minute>\d\d):(?P<second>\d\d):(?P<fraction>\d{1,6})\s+(?:Rx|Tx|Err)\s+"
    r"(?P<channel>\d{1,3})\s+.*(?:ERR|error).*",
    re.ASCII | re.IGNORECASE,
)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames; channel 1 is called `can1`.

    In system mode a stamp is the time of day; in absolute mode it counts from the start of the log;
    in relative mode it counts from the frame before. All are local time and taken as UTC.
    """
    yield from read_lines(path, options, damages, _Taker(options, damages).take)


class _Taker:
    """Follows the head and the stamps of one file."""

    def __init__(self, options: ReadOptions, damages: Damages) -> None:
        self._options, self._damages = options, damages
        self._mode, self._base = SYSTEM, 16
        self._day_ns = self._start_ns = self._last_ns = 0
        self._dated = False

    def take(self, line: str, rows: Rows) -> str | None:
        if line.startswith("***"):
            self._head(line.strip("* "))
            return None
        found = LINE.fullmatch(line) or ERRORS.fullmatch(line)
        if found is None:
            return JUNK
        if not self._dated:
            self._damages.add(NO_DATE, "line", None, UNDATED)
            self._dated = True
        at_ns = self._at_ns(found)
        channel = f"can{int(found['channel'])}"
        if found.re is ERRORS:
            return None if rows.add(at_ns, 0, ERROR, channel, 0, b"") else JUNK
        return self._frame(at_ns, channel, found, rows)

    def _head(self, text: str) -> None:
        if text in (SYSTEM, ABSOLUTE, RELATIVE):
            self._mode = text
        elif text in ("HEX", "DEC"):
            self._base = 16 if text == "HEX" else 10
        elif (found := START.fullmatch(text)) is not None:
            day, month, year, hour, minute, second, ms = (int(each) for each in found.groups())
            clock = f"{hour:02d}:{minute:02d}:{second:02d}.{ms:03d}"
            start_ns = date_ns(year, month, day, clock)
            if start_ns is None:
                return
            self._dated = True
            self._start_ns = head_ns(start_ns, self._options, self._damages)
            self._day_ns = self._start_ns - start_ns % DAY_NS
            self._last_ns = self._start_ns

    def _at_ns(self, found: re.Match[str]) -> int:
        seconds = int(found["hour"]) * 3600 + int(found["minute"]) * 60 + int(found["second"])
        past_ns = seconds * NS_PER_S + int(found["fraction"].ljust(9, "0"))
        if self._mode == ABSOLUTE:
            return self._start_ns + past_ns
        if self._mode == RELATIVE:
            self._last_ns += past_ns
            return self._last_ns
        at_ns = self._day_ns + past_ns
        if self._last_ns - at_ns > DAY_NS // 2:
            # Midnight has passed.
            self._day_ns += DAY_NS
            at_ns += DAY_NS
        self._last_ns = at_ns
        return at_ns

    def _frame(self, at_ns: int, channel: str, found: re.Match[str], rows: Rows) -> str | None:
        kind = found["kind"].lower()
        data = b"" if "r" in kind else hex_bytes(found["data"].split(), self._base)
        try:
            identifier = int(found["id"], self._base)
        except ValueError:
            return JUNK
        flags = EXTENDED * kind.startswith("x") | REMOTE * ("r" in kind) | FD * ("fd" in kind)
        flags |= TX * (found["way"].lower() == "tx")
        return add_frame(rows, at_ns, identifier, flags, channel, int(found["length"]), data)
