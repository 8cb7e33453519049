"""Writes ASC with hexadecimal numbers and absolute stamps, readable by CANalyzer and python-can."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from canlog.damage import Damages
from canlog.formats.candump_write import text_file
from canlog.formats.text import NS_PER_S, first_ns_of, hex_rows
from canlog.frames import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, TX, Frames
from canlog.writing import Numbers, lost

NS_PER_US: Final = 1000
DAYS: Final = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
MONTHS: Final = (
    *("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"),
)
FDF, SWITCH, INDICATOR, REQUEST = 0x1000, 0x2000, 0x4000, 0x10
CODES: Final = {length: code for code, length in enumerate(FD_LENGTHS)}


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """Write all frames, stamped relative to the first one's whole millisecond; its date is UTC."""
    numbers = Numbers(losses)
    start_ns: int | None = None
    done = 0
    with text_file(path) as out:
        for frames in blocks:
            if not len(frames):
                continue
            if start_ns is None:
                start_ns = first_ns_of(frames)
                out.write(_head(start_ns).encode())
            _report_losses(frames, start_ns, losses, done)
            out.write("".join(_lines(frames, start_ns, numbers.of(frames).tolist())).encode())
            done += len(frames)
        if start_ns is None:
            out.write(_head(0).encode())
        out.write(b"End TriggerBlock\n")


def _report_losses(frames: Frames, start_ns: int, losses: Damages, done: int) -> None:
    lost(losses, frames.at_ns < start_ns, "stamp", "before the start; stamped with it", done)
    error = (frames.flags & ERROR) != 0
    detail = error & ((frames.identifier != 0) | (frames.length != 0))
    lost(losses, detail, "error detail", "class and data of error frames are not kept", done)


def _head(start_ns: int) -> str:
    date = date_text(start_ns)
    return (
        f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
        f"Begin Triggerblock {date}\n   0.000000 Start of measurement\n"
    )


def date_text(at_ns: int) -> str:
    """Return a UTC date such as `Sat Nov 21 17:16:09.123 2026` of whole milliseconds."""
    days, rest_ns = divmod(at_ns, 86_400 * NS_PER_S)
    year, month, day = (int(part) for part in str(np.datetime64(days, "D")).split("-"))
    second, ms = divmod(rest_ns // 1_000_000, 1000)
    clock = f"{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}.{ms:03d}"
    return f"{DAYS[(days + 3) % 7]} {MONTHS[month - 1]} {day:02d} {clock} {year}"


def _lines(frames: Frames, start_ns: int, channels: list[int]) -> Iterator[str]:
    past_ns = np.maximum(frames.at_ns - start_ns, 0)
    fine = bool((past_ns % NS_PER_US).any())
    columns = zip(
        (past_ns // NS_PER_S).tolist(),
        (past_ns % NS_PER_S).tolist(),
        channels,
        frames.identifier.tolist(),
        frames.flags.tolist(),
        frames.length.tolist(),
        hex_rows(frames, " "),
        strict=True,
    )
    for second, rest_ns, channel, identifier, flags, length, data in columns:
        fraction = f"{rest_ns:09d}" if fine else f"{rest_ns // NS_PER_US:06d}"
        yield f"{second:4d}.{fraction} {_frame(channel, identifier, flags, length, data)}\n"


def _frame(channel: int, identifier: int, flags: int, length: int, data: str) -> str:
    if flags & ERROR:
        return f"{channel}  ErrorFrame"
    digits = f"{identifier:X}{'x' if flags & EXTENDED else ''}"
    way = "Tx" if flags & TX else "Rx"
    if flags & FD:
        code, shown = CODES.get(length, 15), 0 if flags & REMOTE else length
        bits = FDF | (SWITCH if flags & BRS else 0) | (INDICATOR if flags & ESI else 0)
        bits |= REQUEST if flags & REMOTE else 0
        body = f" {data}" if shown else ""
        return (
            f"CANFD {channel:>3} {way:<4} {digits:>8}  {'':>32} {int(bool(flags & BRS))}"
            f" {int(bool(flags & ESI))} {code:x} {shown:>2}{body}"
            f" {0:>8} {0:>4} {bits:>8X} {0:>8} {0:>8} {0:>8} {0:>8} {0:>8}"
        )
    if flags & REMOTE:
        return f"{channel}  {digits:<15} {way:<4} r {length:x}"
    return f"{channel}  {digits:<15} {way:<4} d {length:x} {data}"
