"""CSV of GVRET and SavvyCAN: one frame per line, stamped in microseconds."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog.damage import Damages
from canlog.formats.text import JUNK, NO_DATE, hex_bytes, read_lines
from canlog.frames import EXTENDED, FD, FD_LENGTHS, TX, Frames
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
CLASSIC_COLUMNS: Final = 8


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
        length, identifier = int(found["length"]), int(found["id"], 16)
        texts = found["data"].split(",")[1 : length + 1]
        data = hex_bytes(texts)
        wide = found["wide"].lower() in ("true", "1")
        if data is None or len(data) != length or identifier > (0x1FFF_FFFF if wide else 0x7FF):
            return JUNK
        if length not in FD_LENGTHS:
            return JUNK
        past_us = int(found["us"])
        if self._first and past_us < DATED_US:
            self._damages.add(NO_DATE, "line", None, "its stamps count from the device's start")
        self._first = False
        flags = EXTENDED * wide | FD * (length > CLASSIC_COLUMNS)
        flags |= TX * ((found["way"] or "").lower() == "tx")
        channel = f"can{int(found['bus'])}"
        added = rows.add(past_us * NS_PER_US, identifier, flags, channel, length, data)
        return None if added else JUNK
