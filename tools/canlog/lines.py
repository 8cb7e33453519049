"""Renders frames as lines for people: instant, identifier, name, cycle, signals, verdict."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from canlog.database import Bus, SignalSpec
from canlog.frames import ERROR, EXTENDED, FD, REMOTE, TX, Frames, Ints
from canlog.table import Groups, Table
from canlog.verdict_codes import UNCONFIRMED

NS_PER_S: Final = 1_000_000_000
DIM, BOLD, RED, GREEN, CYAN, YELLOW = "2", "1", "31", "32", "36", "33"
TRAILER: Final = ("alive_counter", "crc16")
"""Signals that only protect a frame; the verdict already covers them."""
FIRST_LINES, LINES_AT_ONCE = 64, 1 << 14
"""Frames decoded together: few at first, so that the first lines appear at once."""
DIGITS_MAX: Final = 9


@dataclass(slots=True)
class LineStyle:
    """Options for the look of the lines."""

    colour: bool = False
    absolute: bool = False
    """Show date and time of day in UTC instead of seconds since the start."""
    raw: bool = False
    """Show the data in hexadecimal beside the signals."""
    bits: bool = False
    """Show the data bit by bit, with changed bits marked."""
    trailer: bool = False
    """Show alive counters and CRCs, too."""
    start_ns: int = 0
    name_width: int = 12

    def paint(self, text: str, code: str) -> str:
        return f"\x1b[{code}m{text}\x1b[0m" if self.colour else text


@dataclass(slots=True)
class Writer:
    """Makes lines of blocks in order."""

    bus: Bus
    style: LineStyle
    _before: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def lines(
        self, frames: Frames, rows: Ints, code: Any = None, cycle: Any = None, sent: Any = None
    ) -> Iterator[str]:
        """Yield the lines of the rows of a block.

        Args:
            code: (n,) verdicts of the block.
            cycle: (n,) control cycle of each frame in a run.
            sent: (n,) whether the controller sent it.
        """
        first, count = 0, FIRST_LINES
        while first < len(rows):
            some = rows[first : first + count]
            yield from self._some_lines(frames, some, code, cycle, sent)
            first, count = first + count, min(2 * count, LINES_AT_ONCE)

    def _some_lines(
        self, frames: Frames, rows: Ints, code: Any, cycle: Any, sent: Any
    ) -> Iterator[str]:
        chosen = frames[rows]
        texts = self._signals(chosen)
        for at, row in enumerate(rows.tolist()):
            head = self._head(chosen, at)
            told = "" if cycle is None else self._cycle(int(cycle[row]), bool(sent[row]))
            number = 0 if code is None else int(code[row])
            verdict = self._verdict(frames, row, number)
            line = f"{head}{told}  {texts[at]}{verdict}".rstrip()
            yield "\n".join([line, *self._bits(chosen, at)]) if self.style.bits else line

    def _head(self, frames: Frames, at: int) -> str:
        flags, identifier = int(frames.flags[at]), int(frames.identifier[at])
        key = identifier | (1 << 31 if flags & EXTENDED else 0)
        digits = f"{identifier:08X}" if flags & (EXTENDED | ERROR) else f"     {identifier:03X}"
        channel = frames.channels[int(frames.channel[at])]
        spec = self.bus.on(channel).spec_at(key) if not flags & ERROR else None
        name = spec.name if spec else ("error frame" if flags & ERROR else "?")
        stamp = self._stamp(int(frames.at_ns[at]))
        way = "Tx " if flags & TX else ""
        style = self.style
        return (
            f"{style.paint(stamp, DIM)}  {channel}  {style.paint(digits, CYAN)}  "
            f"{way}{style.paint(name.ljust(style.name_width), BOLD)}"
        )

    def _stamp(self, at_ns: int) -> str:
        if self.style.absolute:
            return f"{np.datetime64(at_ns, 'ns')}Z"
        past_ns = at_ns - self.style.start_ns
        second, rest = divmod(abs(past_ns), NS_PER_S)
        return f"{'-' if past_ns < 0 else ''}{second}.{rest:09d}".rjust(15)

    def _cycle(self, cycle: int, sent: bool) -> str:
        if cycle < 0:
            return "            "
        text = f"{'from' if sent else ' to '} {cycle:6d}"
        return " " + self.style.paint(text, GREEN if sent else DIM)

    def _verdict(self, frames: Frames, row: int, code: int) -> str:
        if code <= UNCONFIRMED:
            return "  (no other half)" if code == UNCONFIRMED else ""
        # Showing a log of another bus does not load the codec.
        from canlog.verdict import REASONS, detail_of

        words = REASONS[code].name.lower().replace("_", " ")
        detail = detail_of(frames, row, code)
        text = f"  REJECTED {words}" + (f": {detail}" if detail else "")
        return self.style.paint(text, RED)

    def _signals(self, frames: Frames) -> list[str]:
        """Return the signals of each frame as text; decoded message by message, column by
        column.
        """
        texts = [""] * len(frames)
        for at in np.flatnonzero(~frames.is_data).tolist():
            flags, length = int(frames.flags[at]), int(frames.length[at])
            texts[at] = f"remote request for {length}" if flags & REMOTE else _hex(frames, at)
        groups = Groups(frames)
        for key, channel in groups.places:
            spec = self.bus.on(channel).spec_at(key)
            rows = groups.rows(key, channel=channel).tolist()
            if spec is None:
                for at in rows:
                    texts[at] = self._unknown(frames, at)
                continue
            table = groups.table(spec, channel, (key,))
            for at, text in zip(rows, self._table(table), strict=True):
                texts[at] = f"{_hex(frames, at)}  {text}" if self.style.raw else text
        return texts

    def _unknown(self, frames: Frames, at: int) -> str:
        kind = "FD " if int(frames.flags[at]) & FD else ""
        return f"{kind}[{int(frames.length[at])}] {_hex(frames, at)}"

    def _table(self, table: Table) -> list[str]:
        parts: list[list[str]] = [[] for _ in range(len(table))]
        for signal in table.spec.signals:
            if signal.name in TRAILER and not self.style.trailer:
                continue
            column = zip(parts, value_texts(table, signal), strict=True)
            for part, text in column:
                if text:
                    part.append(f"{signal.name} {text}")
        undefined = table.undefined.tolist()
        length = table.payloads.length
        for part, odd, size in zip(parts, undefined, length.tolist(), strict=True):
            if odd:
                part.append(self.style.paint("undefined multiplexer", YELLOW))
            if size < table.spec.length:
                part.append(self.style.paint(f"short: {size} bytes", YELLOW))
        return [", ".join(part) for part in parts]

    def _bits(self, frames: Frames, at: int) -> Iterator[str]:
        data = frames.payload(at)
        place = int(frames.key[at]), int(frames.channel[at])
        before = self._before.get(place, data)
        self._before[place] = data
        old = before.ljust(len(data), b"\0")[: len(data)]
        flips = [new ^ was for new, was in zip(data, old, strict=True)]
        bits, marks = [], []
        for byte, flip in zip(data, flips, strict=True):
            digits = [(f"{byte:08b}"[i], f"{flip:08b}"[i] == "1") for i in range(8)]
            bits.append("".join(self.style.paint(d, "7") if m else d for d, m in digits))
            marks.append("".join("^" if m else " " for _, m in digits))
        indent = " " * 17
        yield f"{indent}{' '.join(bits)}".rstrip()
        if not self.style.colour and any(flips):
            yield f"{indent}{' '.join(marks)}".rstrip()


def value_texts(table: Table, signal: SignalSpec) -> list[str]:
    """Return value and unit of a signal, or the name in its value table; empty if absent."""
    values, valid = table[signal.name].tolist(), table.valid(signal.name).tolist()
    labels = table.labels(signal.name) if signal.choices else [None] * len(values)
    digits = digits_of(signal)
    unit = f" {signal.unit}" if signal.unit not in ("", "1") else ""
    texts = []
    for value, there, label in zip(values, valid, labels, strict=True):
        if not there:
            texts.append("")
        elif label is not None:
            texts.append(label)
        else:
            text = f"{value:.{digits}f}" if isinstance(value, float) and digits >= 0 else f"{value}"
            texts.append(text + unit)
    return texts


def digits_of(signal: SignalSpec) -> int:
    """Return the decimals that show every step of a signal; -1 for all digits."""
    if signal.is_float:
        return -1
    for digits in range(DIGITS_MAX + 1):
        scaled = (signal.scale * 10**digits, signal.offset * 10**digits)
        if all(math.isclose(each, round(each), rel_tol=1e-9, abs_tol=1e-9) for each in scaled):
            return digits
    return -1


def _hex(frames: Frames, at: int) -> str:
    return frames.payload(at).hex(" ").upper()
