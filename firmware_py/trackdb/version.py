"""Version of a track database: a hash of everything that a train or its wayside relies on.

The check between train and wayside is that of [IEEE 1474.1]: places and authorities are chainages,
so they mean something only to a receiver with the same survey of the same line.
"""

import dataclasses
import enum
import functools
import hashlib
import json
from typing import Any, Final

from firmware_py.trackdb.line_map import LineMap
from firmware_py.trackdb.sites import TUNNELS, ZONES

VERSION_BYTES: Final = 8
VERSION_MAX: Final = 2 ** (8 * VERSION_BYTES) - 1
LINES_MAX: Final = 16
"""Number of lines whose version is cached."""
NOT_VITAL: Final = frozenset({"description", "dwell_s", "run_s"})
"""Fields of a line that a timetable may change without another survey."""

LEFT_OUT_EMPTY: Final = frozenset({*ZONES, TUNNELS})
"""Fields that count only where they have a value. A line without them keeps its version."""


@functools.lru_cache(maxsize=LINES_MAX)
def database_version(line: LineMap) -> int:
    """Version of a line's data. Two maps have the same one only if their vital data are equal."""
    return version_of(line, NOT_VITAL)


def version_of(value: Any, left_out: frozenset[str] = frozenset()) -> int:
    """Hash of nested dataclasses, tuples, numbers and texts, the same on every machine."""
    text = json.dumps(_plain(value, left_out), separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:VERSION_BYTES], "big")


def version_text(version: int) -> str:
    """The first half of a version, in hexadecimal, for messages."""
    return f"{version:0{2 * VERSION_BYTES}x}"[:VERSION_BYTES]


def _plain(value: Any, left_out: frozenset[str]) -> Any:
    if dataclasses.is_dataclass(value):
        fields = [field for field in dataclasses.fields(value) if field.init]
        return {
            field.name: _plain(getattr(value, field.name), left_out)
            for field in fields
            if field.name not in left_out
            and (field.name not in LEFT_OUT_EMPTY or getattr(value, field.name))
        }
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, tuple | list):
        return [_plain(item, left_out) for item in value]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value).hex()
    return value
