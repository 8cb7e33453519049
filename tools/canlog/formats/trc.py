"""PEAK TRC, versions 1.0 to 1.3 and 2.0 to 2.1."""

import re
from collections.abc import Iterable, Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Final

import numpy as np

from canlog import kernel
from canlog.damage import Damages
from canlog.formats.candump_write import text_file
from canlog.formats.text import (
    JUNK,
    NO_DATE,
    NS_PER_S,
    OTHER,
    first_ns_of,
    head_ns,
    hex_bytes,
    hex_rows,
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
    Ints,
)
from canlog.line_block import LineBlock
from canlog.options import ReadOptions
from canlog.rows import Rows
from canlog.writing import Numbers, lost

DAYS_MAX: Final = 100_000
"""Maximum days since 1970 of a start time; 64 bits of nanoseconds reach a little further."""
HEAD: Final = re.compile(rb"^;\$[^\n]*", re.MULTILINE)
LONG: Final = re.compile(rb"\d+\)?[ \t]+[\d.]+[ \t]+(?:FD|FB|FE|BI)\b")
"""A CAN FD line, whose data may exceed 8 bytes."""
ODD_MAX: Final = 1000
"""Maximum number of odd lines of a block that are searched for a CAN FD line."""
HEAD_BYTES: Final = 1 << 14
"""Maximum size of the head of a log."""
MS_DIGITS: Final = 6
"""Digits after the point that milliseconds need for nanoseconds."""
NS_PER_DAY: Final = 86_400 * NS_PER_S
DAY_OF_1970: Final = 25_569
"""Day number of 1970-01-01, counted from 30 December 1899."""
COLUMNS_1: Final = {
    "1.0": ("N", "O", "I", "L"),
    "1.1": ("N", "O", "d", "I", "L"),
    "1.2": ("N", "O", "B", "d", "I", "L"),
    "1.3": ("N", "O", "B", "d", "I", "R", "L"),
}
"""Columns of version 1; the data follow them."""
TYPES: Final = {
    "DT": 0,
    "RR": REMOTE,
    "FD": FD,
    "FB": FD | BRS,
    "FE": FD | BRS | ESI,
    "BI": FD | ESI,
    "ER": ERROR,
}
OTHER_TYPES: Final = frozenset({"ST", "EC", "EV"})
WHOLE: Final = re.compile(
    r"(?:\s[0-9A-Fa-f]{2}|\sRTR|\sRR\s.*\s\d|(?:-|Rx|Tx|[0-9A-Fa-f]{4,8})\s+0)$", re.ASCII
)
"""Line ends that complete a frame: both digits of a byte, or a frame without data."""
NUMBER: Final = re.compile(r"\d+\)?", re.ASCII)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of a TRC file; bus 1, and a bus without a number, is called `can1`.

    `$STARTTIME` is local time without a zone. It is taken as UTC and reported as damage, unless
    `options.utc_offset_s` gives the zone.
    """
    taker = _Taker(options, damages)
    fast = taker.fast if options.compiled else None
    yield from read_lines(
        path,
        options,
        damages,
        taker.take,
        lambda line: bool(WHOLE.search(line)),
        fast,
        lambda: taker.start_ns,
    )
    if not taker.dated:
        damages.add(NO_DATE, "line", None, "the log has no $STARTTIME; its stamps count from 1970")


class _Taker:
    """Parses lines; follows the version and the columns in the head."""

    def __init__(self, options: ReadOptions, damages: Damages) -> None:
        self._options, self._damages = options, damages
        self._start_ns = 0
        self.dated = False
        self._wide = False
        self._version = "1.0"
        self._columns: tuple[str, ...] = COLUMNS_1["1.0"]

    @property
    def start_ns(self) -> int:
        """The instant that stamps count from."""
        return self._start_ns

    def fast(self, text: bytes, channels: list[str]) -> LineBlock | None:
        """Parse a block with the kernel, once the head has named the columns."""
        version, columns = self._version, self._columns
        if b";$" in text:
            # The caller takes the lines of the head one by one later; this probe reads them ahead.
            probe = _Taker(self._options, Damages())
            for line in HEAD.findall(text[:HEAD_BYTES]):
                probe.take(line.decode("latin-1").strip(), Rows())
            version, columns = probe._version, probe._columns
            if b";$" in text[HEAD_BYTES:]:
                return None
        marks = "v" if version.startswith("1") else ""
        told = "".join(columns)
        if len(told) != len(columns) or (marks and not set(told) <= set("NOIdBRL")):
            return None
        names = (marks + told).encode()
        if not self._wide:
            found = kernel.parse_text(text, channels, CLASSIC_BYTES, names)
            if found is None or not any(
                LONG.match(text, int(at)) for at in found.odd_starts[:ODD_MAX]
            ):
                return found
            self._wide = True
        return kernel.parse_text(text, channels, FD_BYTES, names)

    def take(self, line: str, rows: Rows) -> str | None:
        if line.startswith(";"):
            return self._head(line[1:].strip())
        words = line.split(maxsplit=len(self._columns))
        if len(words) < len(self._columns) or not NUMBER.fullmatch(words[0]):
            return JUNK
        told = dict(zip(self._columns, words, strict=False))
        told["D"] = words[len(self._columns)] if len(words) > len(self._columns) else ""
        if self._version.startswith("1"):
            return self._first(told, rows)
        return self._second(told, rows)

    def _head(self, line: str) -> str | None:
        name, _, value = line.partition("=")
        if name == "$FILEVERSION":
            self._version = value.strip()
            if self._version.startswith("1"):
                self._columns = COLUMNS_1.get(self._version, COLUMNS_1["1.3"])
            elif self._version not in ("2.0", "2.1"):
                self._damages.add("unknown version", "line", None, f"{value}: read as 2.1")
        elif name == "$COLUMNS":
            columns = [each.strip() for each in value.split(",")]
            if not {"N", "O", "I"} <= set(columns) or not {"l", "L"} & set(columns):
                return JUNK
            # The data are the rest of the line, however many blanks it has.
            self._columns = tuple(each for each in columns if each != "D")
        elif name == "$STARTTIME":
            try:
                days = Decimal(value.strip()) - DAY_OF_1970
                self._start_ns = int((days * NS_PER_DAY).to_integral_value())
            except (InvalidOperation, ValueError, OverflowError):
                return JUNK
            if not 0 <= days <= DAYS_MAX:
                self._start_ns = 0
                return None
            self.dated = True
            self._start_ns = head_ns(
                self._start_ns, self._options, self._damages, where="$STARTTIME"
            )
        return None

    def _first(self, told: dict[str, str], rows: Rows) -> str | None:
        """Parse a line of version 1."""
        way = told.get("d", "Rx")
        if way.lower() in ("warng", "error"):
            return self._error(told, rows) if way.lower() == "error" else OTHER
        if way not in ("Rx", "Tx") or told["I"].upper() == "FFFFFFFF":
            return OTHER if told["I"].upper() == "FFFFFFFF" else JUNK
        size = told.get("L", told.get("l", ""))
        if not _is_number(size):
            return JUNK
        length, flags = int(size), TX if way == "Tx" else 0
        if length > 8:
            return JUNK
        if told["D"].strip() == "RTR":
            return self._add(told, flags | REMOTE, length, b"", rows)
        data = hex_bytes(told["D"].split())
        if data is None or len(data) != length:
            return JUNK
        return self._add(told, flags, length, data, rows)

    def _second(self, told: dict[str, str], rows: Rows) -> str | None:
        """Parse a line of version 2."""
        kind = told.get("T", "DT")
        if kind not in TYPES:
            return OTHER if kind in OTHER_TYPES else JUNK
        if kind == "ER":
            return self._error(told, rows)
        flags = TYPES[kind] | (TX if told.get("d") == "Tx" else 0)
        told_length = told.get("l", told.get("L", ""))
        if not _is_number(told_length) or int(told_length) > 64:
            return JUNK
        length = int(told_length)
        if "l" not in told:
            if length > 15:
                return JUNK
            length = FD_LENGTHS[length] if flags & FD else min(length, 8)
        data = b"" if flags & REMOTE else self._data(told, length)
        if data is None or (not flags & FD and length > 8):
            return JUNK
        return self._add(told, flags, length, data, rows)

    def _data(self, told: dict[str, str], length: int) -> bytes | None:
        data = hex_bytes(told.get("D", "").split())
        return data if data is not None and len(data) == length else None

    def _error(self, told: dict[str, str], rows: Rows) -> str | None:
        past_ns = stamp_ns(told["O"], MS_DIGITS)
        if past_ns is None:
            return JUNK
        channel = f"can{told.get('B', '1')}"
        return None if rows.add(self._start_ns + past_ns, 0, ERROR, channel, 0, b"") else JUNK

    def _add(
        self, told: dict[str, str], flags: int, length: int, data: bytes, rows: Rows
    ) -> str | None:
        past_ns, digits = stamp_ns(told["O"], MS_DIGITS), told["I"]
        try:
            identifier = int(digits, 16)
        except ValueError:
            return JUNK
        extended = len(digits) > 4
        if past_ns is None or not 0 <= identifier <= (0x1FFF_FFFF if extended else 0x7FF):
            return JUNK
        flags |= EXTENDED if extended else 0
        channel = f"can{told.get('B', '1')}"
        added = rows.add(self._start_ns + past_ns, identifier, flags, channel, length, data)
        return None if added else JUNK


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit()


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """Write all frames as version 2.1, with stamps in microseconds."""
    numbers = Numbers(losses, most=16)
    start_ns: int | None = None
    done = 0
    with text_file(path) as out:
        for frames in blocks:
            if not len(frames):
                continue
            if start_ns is None:
                start_ns = first_ns_of(frames)
                out.write(_head_text(start_ns).encode())
            past_ns = frames.at_ns - start_ns
            lost(losses, past_ns % 1000 != 0, "nanoseconds", "stamps are cut to microseconds", done)
            lost(losses, past_ns < 0, "stamp", "before the start; stamped with it", done)
            error = (frames.flags & ERROR) != 0
            lost(losses, error, "error detail", "class and data of error frames are not kept", done)
            channels = numbers.of(frames).tolist()
            out.write("".join(_lines(frames, np.maximum(past_ns, 0), channels, done)).encode())
            done += len(frames)
        if start_ns is None:
            out.write(_head_text(0).encode())


def _head_text(start_ns: int) -> str:
    days = Decimal(start_ns) / NS_PER_DAY + DAY_OF_1970
    return (
        f";$FILEVERSION=2.1\n;$STARTTIME={days:.14f}\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
        ";   Message   Time    Type    ID     Rx/Tx\n"
        ";   Number    Offset  |  Bus  [hex]  |  Reserved\n"
        ";   |         [ms]    |  |    |      |  |  Data Length Code\n"
        ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --\n"
    )


def _lines(frames: Frames, past_ns: Ints, channels: list[int], done: int) -> Iterator[str]:
    types = {flags: name for name, flags in TYPES.items()}
    columns = zip(
        (past_ns // 1000).tolist(),
        channels,
        frames.identifier.tolist(),
        frames.flags.tolist(),
        frames.length.tolist(),
        hex_rows(frames, " "),
        strict=True,
    )
    for number, (us, channel, identifier, flags, length, data) in enumerate(columns, done + 1):
        stamp = f"{us // 1000}.{us % 1000:03d}"
        way = "Tx" if flags & TX else "Rx"
        if flags & ERROR:
            yield f"{number:>7} {stamp:>13} ER {channel:>2}        - {way} -  0\n"
            continue
        kind = "RR" if flags & REMOTE else types[flags & (FD | (BRS | ESI if flags & FD else 0))]
        digits = f"{identifier:08X}" if flags & EXTENDED else f"{identifier:04X}"
        code = FD_LENGTHS.index(length) if flags & FD else length
        body = "" if flags & REMOTE else f"    {data}" if data else ""
        yield f"{number:>7} {stamp:>13} {kind} {channel:>2} {digits:>8} {way} -  {code}{body}\n"
