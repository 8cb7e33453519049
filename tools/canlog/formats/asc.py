"""Vector ASC: text with hexadecimal or decimal numbers, absolute or relative stamps, CAN FD."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from canlog import kernel
from canlog.damage import Damages, shown
from canlog.formats.asc_write import write
from canlog.formats.dates import instant_ns
from canlog.formats.text import (
    JUNK,
    NO_DATE,
    OTHER,
    head_ns,
    hex_bytes,
    read_lines,
    stamp_ns,
)
from canlog.frames import (
    BRS,
    CLASSIC_BYTES,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_BYTES,
    FD_LENGTHS,
    REMOTE,
    TX,
    Frames,
)
from canlog.line_block import LineBlock
from canlog.options import ReadOptions
from canlog.rows import Rows

__all__ = ["read", "write"]

DATE: Final = re.compile(r"(?P<kind>date|begin triggerblock)\b(?P<text>.*)", re.IGNORECASE)
BASE: Final = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
UNUSUAL: Final = re.compile(rb"base[ \t]+(?:dec|hex[ \t]+timestamps[ \t]+relative)")
EVENT: Final = re.compile(r"(?P<stamp>-?\d{1,12}(?:\.\d{1,9})?)\s+(?P<rest>\S.*)", re.ASCII)
CLASSIC: Final = re.compile(
    r"(?P<channel>\d{1,3})\s+(?P<id>[0-9A-Fa-f]{1,10})(?P<wide>x?)\s+(?P<way>Rx|Tx|TxRq)\s+"
    r"(?P<kind>[dr])(?:\s+(?P<dlc>[0-9A-Fa-f]|[1-9A-Fa-f][0-9A-Fa-f]))?(?P<data>(?:\s+[0-9A-Fa-f]{1,3})*)"
    r"(?:\s+[A-Za-z]\w* = .*)?",
    re.ASCII,
)
FAST: Final = re.compile(
    r"CANFD\s+(?P<channel>\d{1,3})\s+(?P<way>Rx|Tx|TxRq)\s+(?P<id>[0-9A-Fa-f]{1,10})(?P<wide>x?)\s+"
    r"(?:(?P<name>[A-Za-z_]\w*)\s+)?(?P<brs>[01])\s+(?P<esi>[01])\s+(?P<dlc>[0-9A-Fa-f]{1,2})\s+"
    r"(?P<length>\d{1,2})(?P<rest>(?:\s+\S+)*)",
    re.ASCII,
)
ERRORS: Final = re.compile(
    r"(?:CANFD\s+)?(?P<channel>\d{1,3})\s+(?:Rx\s+|Tx\s+)?ErrorFrame\b.*", re.ASCII
)
KNOWN: Final = re.compile(
    r"//|(?:no )?internal events|end triggerblock|version|measurement|split|previous|#|"
    r"[A-Z]\w*:",
    re.IGNORECASE,
)
"""Lines without a stamp that belong to the format."""
BROKEN: Final = re.compile(
    r"CANFD\b|\d{1,3}\s+\S+\s+(?:Rx|Tx|TxRq)\b|\d{1,3}\s+[0-9A-Fa-f]+x?(?:\s|$)", re.IGNORECASE
)
"""Events that begin like CAN frames; one that cannot be parsed is damage."""
OTHER_EVENT: Final = re.compile(r"[^\W\d]|\d{1,3}\s+[^\W\d]|//|::")
"""Events of other buses or of the program: they begin with a word, or a channel and a word."""
CODE_MAX: Final = 15
"""Greatest length code of a classic frame; codes above 8 mean 8 bytes."""
WHOLE: Final = re.compile(r"(?!.*CANFD).*\s(?:d\s+0|[0-9A-Fa-f]{2})", re.ASCII)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of an ASC file; channel 1 is called `can1`.

    Stamps count from the date in the head, which is local time without a zone. It is taken as UTC
    and reported as damage, unless `options.utc_offset_s` gives the zone.
    """
    taker = _Taker(options, damages)
    fast = taker.fast if options.compiled else None
    yield from read_lines(
        path, options, damages, taker.take, taker.is_whole, fast, lambda: taker.start_ns
    )
    if not taker.dated:
        damages.add(NO_DATE, "line", None, "the log has no date; its stamps count from 1970")


class _Taker:
    """Follows the head and the stamps of one file."""

    def __init__(self, options: ReadOptions, damages: Damages) -> None:
        self._options, self._damages = options, damages
        self._base = 16
        self._relative = False
        self._start_ns = 0
        self._last_ns = 0
        self._usual = True
        self.dated = False
        """Whether a line gave the date, readable or not."""

    def take(self, line: str, rows: Rows) -> str | None:
        event = EVENT.fullmatch(line)
        if event is None:
            return self._head(line)
        past_ns = stamp_ns(event["stamp"])
        if past_ns is None:
            return JUNK
        if self._relative:
            past_ns = self._last_ns = self._last_ns + past_ns
        return self._event(self._start_ns + past_ns, event["rest"], rows)

    @property
    def start_ns(self) -> int:
        """The instant that stamps count from."""
        return self._start_ns

    def fast(self, text: bytes, channels: list[str]) -> LineBlock | None:
        """Parse a block with the kernel, which reads only hexadecimal and absolute stamps."""
        told = text.lower() if b"base" in text or b"Base" in text else b""
        if UNUSUAL.search(told):
            self._usual = False
        if not self._usual:
            return None
        width = FD_BYTES if b"CANFD" in text else CLASSIC_BYTES
        return kernel.parse_text(text, channels, width, b"")

    def is_whole(self, line: str) -> bool:
        """Whether the line is a complete classic data frame: its last byte has both digits."""
        return self._base == 16 and WHOLE.fullmatch(line) is not None

    def _head(self, line: str) -> str | None:
        base = BASE.match(line)
        if base is not None:
            self._base = 10 if base[1].lower() == "dec" else 16
            self._relative = (base[2] or "").lower() == "relative"
            return None
        date = DATE.fullmatch(line)
        if date is not None:
            return self._date(date)
        return None if KNOWN.match(line) else JUNK

    def _date(self, date: re.Match[str]) -> str | None:
        """Read the date that the following stamps count from."""
        self._last_ns = 0
        if date["kind"].lower() != "date" and not date["text"].strip():
            return None
        self.dated = True
        start_ns = instant_ns(date["text"])
        if start_ns is None:
            self._start_ns = 0
            words = f"{shown(date['text'].strip())} cannot be read; stamps count from 1970"
            self._damages.add(NO_DATE, "line", None, words)
            return None
        self._start_ns = head_ns(start_ns, self._options, self._damages)
        return None

    def _event(self, at_ns: int, rest: str, rows: Rows) -> str | None:
        match = CLASSIC.fullmatch(rest)
        if match is not None:
            return self._classic(at_ns, match, rows)
        match = FAST.fullmatch(rest)
        if match is not None:
            return self._fast(at_ns, match, rows)
        match = ERRORS.fullmatch(rest)
        if match is not None:
            return None if rows.add(at_ns, 0, ERROR, f"can{match['channel']}", 0, b"") else JUNK
        if rest.lower().startswith("start of measurement"):
            return None
        if BROKEN.match(rest):
            return JUNK
        return OTHER if OTHER_EVENT.match(rest) else JUNK

    def _identifier(self, match: re.Match[str]) -> tuple[int, int] | None:
        try:
            identifier = int(match["id"], self._base)
        except ValueError:
            return None
        limit = 0x1FFF_FFFF if match["wide"] else 0x7FF
        if identifier > limit:
            return None
        flags = (EXTENDED if match["wide"] else 0) | (TX if match["way"] != "Rx" else 0)
        return identifier, flags

    def _classic(self, at_ns: int, match: re.Match[str], rows: Rows) -> str | None:
        known = self._identifier(match)
        if known is None or match["way"] == "TxRq":
            return JUNK if known is None else OTHER
        identifier, flags = known
        channel, texts = f"can{match['channel']}", match["data"].split()
        told = int(match["dlc"] or "0", 16)
        length = min(told, CLASSIC_BYTES)
        if match["kind"] == "r":
            added = rows.add(at_ns, identifier, flags | REMOTE, channel, length, b"")
            return None if added else JUNK
        data = hex_bytes(texts, self._base)
        if data is None or match["dlc"] is None:
            return JUNK
        if len(data) == told > CLASSIC_BYTES and told in FD_LENGTHS:
            # python-can writes the length of a longer frame in hexadecimal on a classic line.
            flags, length = flags | FD, told
        elif len(data) != length or told > CODE_MAX:
            return JUNK
        return None if rows.add(at_ns, identifier, flags, channel, length, data) else JUNK

    def _fast(self, at_ns: int, match: re.Match[str], rows: Rows) -> str | None:
        known = self._identifier(match)
        if known is None or match["way"] == "TxRq":
            return JUNK if known is None else OTHER
        identifier, flags = known
        channel, length = f"can{match['channel']}", int(match["length"])
        texts = match["rest"].split()
        # After the data come duration, bits, flags and CRC; the flags identify classic frames.
        data, tail = hex_bytes(texts[:length], self._base), texts[length:]
        if data is None or len(data) != length or length not in FD_LENGTHS:
            return JUNK
        bits = _flags_of(tail)
        # Some writers leave the flags empty; then a long frame, BRS or ESI identifies CAN FD.
        fd = bits is None or bool(bits & 0x1000) or length > 8
        fd = fd or (bits == 0 and "1" in (match["brs"], match["esi"]))
        if fd:
            flags |= FD | (BRS if match["brs"] == "1" else 0) | (ESI if match["esi"] == "1" else 0)
        elif length > 8:
            return JUNK
        if bits is not None and bits & 0x10:
            flags |= REMOTE
            length = FD_LENGTHS[min(int(match["dlc"], 16), 15)]
            length = length if fd else min(length, 8)
        return None if rows.add(at_ns, identifier, flags, channel, length, data) else JUNK


def _flags_of(tail: list[str]) -> int | None:
    """The third number after the data; None if the line ends before it."""
    if len(tail) < 3:
        return None
    try:
        return int(tail[2], 16)
    except ValueError:
        return None
