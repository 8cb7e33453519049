"""Reads logs of `CandumpWriter` or of `candump -l` of can-utils."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from firmware_py.ports import CanFrame
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.lines import (
    ERROR_FLAG,
    ERROR_MASK,
    EXTENDED_MAX,
    STANDARD_MAX,
)

NS_PER_S: Final = 1_000_000_000


class LoggedFrame(NamedTuple):
    """One line of a candump log. The frame's stamp is in nanoseconds since 1970."""

    channel: str
    frame: CanFrame


class CandumpReader:
    """Iterates over a candump log.

    Lines that are not a classic CAN frame are counted, not raised.
    """

    def __init__(self, path: Path | str) -> None:
        self._path = Path(path)
        self.bad_lines = 0

    def __iter__(self) -> Iterator[LoggedFrame]:
        """Yield the frames. Raises RecorderError when the file cannot be read."""
        self.bad_lines = 0
        try:
            with self._path.open("rb") as lines:
                for line in lines:
                    logged = parse_candump_line(line.decode("ascii", "replace"))
                    if logged is not None:
                        yield logged
                    else:
                        self.bad_lines += 1
        except OSError as error:
            raise RecorderError(f"{self._path}: cannot be read: {error.strerror}") from error


def read_candump(path: Path | str) -> CandumpReader:
    """Return the frames of a log in the order of its lines; `bad_lines` counts invalid lines."""
    return CandumpReader(path)


CANDUMP_LINE: Final = re.compile(
    r"\((?P<seconds>\d{1,12})\.(?P<fraction>\d{6}|\d{9})\) +(?P<channel>\S+) "
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:(?P<remote>R[0-8]?)|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))(?: [RT])?\r?\n?",
    re.ASCII,
)


def parse_candump_line(line: str) -> LoggedFrame | None:
    """Parse one line; None for a truncated line or one that no classic CAN frame can have
    produced.
    """
    match = CANDUMP_LINE.fullmatch(line)
    if match is None:
        return None
    digits, wide = match["id"], int(match["id"], 16)
    error = len(digits) == 8 and bool(wide & ERROR_FLAG)
    can_id = wide & ERROR_MASK if error else wide
    if can_id > (STANDARD_MAX if len(digits) == 3 else EXTENDED_MAX):
        return None
    stamp_ns = int(match["seconds"]) * NS_PER_S + int(match["fraction"].ljust(9, "0"))
    frame = CanFrame(
        stamp_ns=stamp_ns,
        can_id=can_id,
        data=bytes.fromhex(match["data"] or ""),
        extended=len(digits) == 8 and not error,
        remote=match["remote"] is not None,
        error=error,
    )
    return LoggedFrame(match["channel"], frame)
