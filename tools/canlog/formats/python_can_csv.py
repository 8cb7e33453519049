"""CSV in the format of python-can's CSVWriter."""

import base64
import binascii
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog.damage import Damages
from canlog.formats.text import JUNK, add_frame, read_lines, stamp_ns
from canlog.frames import CLASSIC_BYTES, ERROR, EXTENDED, FD, REMOTE, Frames
from canlog.options import ReadOptions
from canlog.rows import Rows

LINE: Final = re.compile(
    r"(?P<stamp>-?\d{1,12}(?:\.\d+)?(?:[eE][-+]?\d+)?),(?:0x)?(?P<id>[0-9A-Fa-f]{1,8}),(?P<wide>[01]),"
    r"(?P<remote>[01]),(?P<error>[01]),(?P<length>\d{1,2}),(?P<data>[A-Za-z0-9+/=]*)",
    re.ASCII,
)
CHANNEL: Final = "can0"
"""Channel of all frames; the format does not name one."""


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames, all on channel `can0`."""
    yield from read_lines(path, options, damages, _take)


def _take(line: str, rows: Rows) -> str | None:
    if line.startswith("timestamp,"):
        return None
    found = LINE.fullmatch(line)
    if found is None:
        return JUNK
    stamp = found["stamp"]
    at_ns = round(float(stamp) * 1e9) if "e" in stamp.lower() else stamp_ns(stamp)
    try:
        data = base64.b64decode(found["data"], validate=True)
    except binascii.Error:
        return JUNK
    flags = EXTENDED * (found["wide"] == "1") | REMOTE * (found["remote"] == "1")
    flags |= ERROR * (found["error"] == "1")
    length = int(found["length"])
    return add_message(rows, at_ns, int(found["id"], 16), flags, length, data)


def add_message(
    rows: Rows, at_ns: int | None, identifier: int, flags: int, length: int, data: bytes
) -> str | None:
    """Add the frame of a python-can message; return JUNK if its numbers contradict each other."""
    flags |= FD * (length > CLASSIC_BYTES)
    return add_frame(rows, at_ns, identifier, flags, CHANNEL, length, data)
