"""Parses one line of any candump output strictly: it accepts only an exact match."""

import re
from dataclasses import dataclass
from typing import Final

import numpy as np

from canlog.damage import EXTENDED_MAX, STANDARD_MAX
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, TX

NS_PER_S: Final = 1_000_000_000
ERROR_FLAG: Final = 0x2000_0000
"""SocketCAN's flag in an identifier that marks an error frame."""
ERROR_MASK: Final = EXTENDED_MAX
"""Mask for the error classes in the identifier of an error frame."""
SECONDS_MAX: Final = 9_223_372_035
"""Last second for which 64 bits hold the nanoseconds."""
ABSOLUTE, SINCE, LOCAL, NONE = "absolute", "since", "local", "none"
"""Origin of a stamp: 1970; the start or the frame before; 1970 in local time; none."""
SINCE_DIGITS_MAX: Final = 8
"""Maximum digits of a relative stamp: candump prints three for those, ten since 1970."""

_ID: Final = rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
LOGGED: Final = re.compile(
    rb"\((?P<seconds>\d{1,12})\.(?P<fraction>\d{6}|\d{9})\) +(?P<channel>\S+) " + _ID + rb"#"
    rb"(?:R(?P<remote>[0-8]?)|#(?P<fd>[0-9A-Fa-f])(?P<fd_data>(?:[0-9A-Fa-f]{2}){0,64})"
    rb"|(?P<data>(?:[0-9A-Fa-f]{2}){0,8})(?:_[9A-Fa-f])?)(?: (?P<way>[RT]))?"
)
SHOWN: Final = re.compile(
    rb" *(?:\((?:(?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)|(?P<seconds>\d{1,12}))"
    rb"\.(?P<fraction>\d{6}|\d{9})\))? +(?P<channel>\S+)"
    rb"(?:  (?P<way>RX|TX) (?P<brs>[B-]) (?P<esi>[E-]))? +" + _ID + rb" +"
    rb"(?:\[(?P<length>\d{1,2})\]|\{(?P<code>[9A-F])\}) *(?P<rest>.*)"
)
"""A printed line; `-8` shows data length codes above 8 of classic frames in braces."""
BYTES: Final = re.compile(rb"(?P<data>(?:(?:[01]{8}|[0-9A-Fa-f]{2})(?:[ `]+|$)){0,64})(?P<tail>.*)")
"""Data bytes: hexadecimal, or binary with `-i`; `-S` prints the last byte first, with backticks."""
COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
DROPPED: Final = re.compile(rb"DROPCOUNT: dropped (\d+) CAN frames?.*")
BESIDE: Final = re.compile(
    rb"[\t ]+[a-z][^#\[]*|(?:Disabled|Enabled|Warning|New|using|interface)\b[^#]*", re.IGNORECASE
)
"""Lines besides frames: the error details that `-e` adds, and candump's own notes."""
EXTRA_LONG: Final = re.compile(
    rb"\(\d+\.\d+\) \S+ [0-9A-Fa-f]+#[0-9A-Fa-f]{2}:[0-9A-Fa-f]{2}:[0-9A-Fa-f]+#[0-9A-Fa-f]*"
    rb"(?: [RT])?"
    rb"| *(?:\([^)]*\))? +\S+ .*\[\d{4,5}\] .*"
)
"""CAN XL frames, as logged and as printed."""


@dataclass(frozen=True, slots=True)
class CandumpLine:
    """One frame of a candump log."""

    at_ns: int
    since: str
    """Origin of the stamp: ABSOLUTE, SINCE, LOCAL or NONE."""
    identifier: int
    flags: int
    channel: str
    length: int
    data: bytes


def parse(line: bytes) -> CandumpLine | None:
    """Parse a line without its line end; None for a line that candump cannot have written
    completely.
    """
    if b"\x1b" in line:
        line = COLOUR.sub(b"", line)
    match = LOGGED.fullmatch(line)
    if match is not None:
        return _logged(match)
    match = SHOWN.fullmatch(line)
    return _shown(match) if match is not None else None


def _identifier(digits: bytes) -> tuple[int, int] | None:
    wide = int(digits, 16)
    if len(digits) == 3:
        return (wide, 0) if wide <= STANDARD_MAX else None
    if wide & ERROR_FLAG and wide <= ERROR_FLAG | ERROR_MASK:
        return wide & ERROR_MASK, ERROR
    return (wide, EXTENDED) if wide <= EXTENDED_MAX else None


def _stamp(seconds: bytes, fraction: bytes) -> int | None:
    if int(seconds) > SECONDS_MAX:
        return None
    return int(seconds) * NS_PER_S + int(fraction.ljust(9, b"0"))


def _logged(match: re.Match[bytes]) -> CandumpLine | None:
    at_ns, known = _stamp(match["seconds"], match["fraction"]), _identifier(match["id"])
    if at_ns is None or known is None:
        return None
    identifier, flags = known
    data = bytes.fromhex((match["fd_data"] or match["data"] or b"").decode())
    length = len(data)
    if match["fd"] is not None:
        if flags & ERROR or length not in FD_LENGTHS:
            return None
        bits = int(match["fd"], 16)
        flags |= FD | (BRS if bits & 1 else 0) | (ESI if bits & 2 else 0)
    elif match["remote"] is not None:
        if flags & ERROR:
            return None
        flags, length = flags | REMOTE, int(match["remote"] or b"0")
    flags |= TX if match["way"] == b"T" else 0
    channel = match["channel"].decode("ascii", "backslashreplace")
    return CandumpLine(at_ns, ABSOLUTE, identifier, flags, channel, length, data)


def _shown(match: re.Match[bytes]) -> CandumpLine | None:
    known, stamp = _identifier(match["id"]), _shown_stamp(match)
    if known is None or stamp is None:
        return None
    identifier, flags = known
    length, found = int(match["length"] or 8), BYTES.fullmatch(match["rest"])
    if found is None:
        return None
    data, tail = _bytes(found["data"]), found["tail"].strip()
    flags |= TX if match["way"] == b"TX" else 0
    if tail == b"remote request":
        if data or flags & ERROR or length > 8:
            return None
        flags |= REMOTE
    elif len(data) != length or not _is_comment(tail, bool(flags & ERROR)):
        return None
    if len(match["length"] or b"") == 2:
        if length not in FD_LENGTHS:
            return None
        flags |= FD | (BRS if match["brs"] == b"B" else 0) | (ESI if match["esi"] == b"E" else 0)
    elif length > 8:
        return None
    channel = match["channel"].decode("ascii", "backslashreplace")
    return CandumpLine(stamp[0], stamp[1], identifier, flags, channel, length, data)


def _bytes(text: bytes) -> bytes:
    texts = text.replace(b"`", b" ").split()
    data = bytes(int(each, 2 if len(each) == 8 else 16) for each in texts)
    return data[::-1] if b"`" in text else data


def _is_comment(tail: bytes, is_error: bool) -> bool:
    """Whether the tail is empty, the data as characters (`-a`), or the text of an error frame."""
    if is_error:
        return tail.startswith(b"ERRORFRAME")
    return not tail or (len(tail) >= 2 and tail[:1] in b"'`" and tail[-1:] == tail[:1])


def _shown_stamp(match: re.Match[bytes]) -> tuple[int, str] | None:
    if match["date"] is not None:
        try:
            day = np.datetime64(match["date"].decode().replace(" ", "T"), "s")
        except ValueError:
            return None
        return int(day.astype(np.int64)) * NS_PER_S + int(match["fraction"].ljust(9, b"0")), LOCAL
    if match["seconds"] is None:
        return 0, NONE
    at_ns = _stamp(match["seconds"], match["fraction"])
    if at_ns is None:
        return None
    return at_ns, SINCE if len(match["seconds"]) <= SINCE_DIGITS_MAX else ABSOLUTE
