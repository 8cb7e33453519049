"""CSV of GVRET and SavvyCAN: one frame per line, stamped in microseconds."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog.damage import Damages
from canlog.formats.text import JUNK, NO_DATE, add_frame, hex_bytes, read_lines
from canlog.frames import CLASSIC_BYTES, EXTENDED, FD, TX, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows

NS_PER_US: Final = 1000
DATED_US: Final = 10**15
"""Least stamp that counts from 1970; smaller ones count from the start of the device."""
LINE: Final = re.compile(
    r"(?P<us>-?\d{1,16}),(?P<id>[0-9A-Fa-f]{1,8}),(?P<wide>true|false|0|1),(?:(?P<way>[RT]x),)?"
    r"(?P<bus>\d{1,3}),(?P<length>\d{1,2})(?P<data>(?:,[0-9A-Fa-f]{0,2})*)",
    re.ASCII | re.IGNORECASE,
)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames; bus 0 is called `can0`."""
    taker = _Taker(damages)
    yield from read_lines(path, options, damages, taker.take)


class _Taker:
    def __init__(self, damages: Damages) -> None:
        self._damages = damages
        self._first = True

    def take(self, line: str, rows: Rows) -> str | None:
        if line.lower().startswith("time stamp,"):
            return None
        found = LINE.fullmatch(line)
        if found is None:
            return JUNK
        length, past_us = int(found["length"]), int(found["us"])
        data = hex_bytes(found["data"].split(",")[1 : length + 1])
        wide = found["wide"].lower() in ("true", "1")
        flags = EXTENDED * wide | FD * (length > CLASSIC_BYTES)
        flags |= TX * ((found["way"] or "").lower() == "tx")
        at_ns, channel = past_us * NS_PER_US, f"can{int(found['bus'])}"
        fault = add_frame(rows, at_ns, int(found["id"], 16), flags, channel, length, data)
        if fault is None and self._first:
            self._first = False
            if past_us < DATED_US:
                self._damages.add(NO_DATE, "line", None, "its stamps count from the device's start")
        return fault
