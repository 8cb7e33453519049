"""Test tool: generates DBC files and logs from a seed that use every feature of the formats."""

import random
from dataclasses import dataclass, field

from canlog.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    TX,
    Frames,
)
from canlog.rows import Rows

SCALES = ("1", "1", "1", "2", "-1", "0.5", "0.1", "0.001", "-0.25", "10", "3.7")
OFFSETS = ("0", "0", "0", "-40", "100", "0.5", "1e6")


@dataclass
class DrawnDbc:
    """A generated DBC file with one message called M."""

    text: str
    length: int
    frame_id: int
    extended: bool
    kind: str = "plain"
    """Multiplexing: plain has none; basic or extended."""
    names: list[str] = field(default_factory=list)

    @property
    def told(self) -> int:
        """Identifier as the DBC file writes it: bit 31 marks one of 29 bits."""
        return self.frame_id | 1 << 31 if self.extended else self.frame_id


def drawn_dbc(seed: int) -> DrawnDbc:
    """Generate a message with non-overlapping signals of every kind."""
    draw = random.Random(seed)
    length = draw.choice([1, 2, 5, 7, 8, 8, 8, 8, *FD_LENGTHS[9:]])
    extended = draw.random() < 0.4
    frame_id = draw.randrange(1 << 29) if extended else draw.randrange(1 << 11)
    free = set(range(8 * length))
    kind = draw.choice(["plain", "plain", "basic", "extended"])
    lines: list[str] = []
    tail: list[str] = []
    made = DrawnDbc("", length, frame_id, extended, kind)
    marks = [""] * draw.randrange(1, 6)
    if kind != "plain":
        marks = ["M", *[f"m{draw.randrange(4)}" for _ in range(draw.randrange(1, 5))], *marks]
    if kind == "extended":
        marks = ["M", "m1M", "m0", "m2", "", ""]
    for number, mark in enumerate(marks):
        placed = _signal(draw, made, free, number, mark, lines, tail)
        if not placed and "M" in mark:
            return drawn_dbc(seed + 7919)
    if not lines:
        return drawn_dbc(seed + 7919)
    head = ['VERSION ""', "NS_ :", "BS_:", "BU_: A B", "", f"BO_ {made.told} M: {length} A"]
    made.text = "\n".join([*head, *lines, "", *tail, ""])
    return made


def _signal(
    draw: random.Random,
    made: DrawnDbc,
    free: set[int],
    number: int,
    mark: str,
    lines: list[str],
    tail: list[str],
) -> bool:
    """Add one signal to the message, or nothing if it finds no room.

    Args:
        free: bits that no signal has; the signal takes its bits out.
        mark: of the multiplexer: M, m1, m1M or nothing.
        lines: receives the signal.
        tail: receives its value type, its multiplexer values and its names.
    """
    plain = "M" in mark
    size = draw.randrange(1, 5) if plain else _size(draw)
    little = draw.random() < 0.5
    place = _place(draw, free, size, little=little, total=8 * made.length)
    if place is None:
        return False
    start, used = place
    free -= used
    name = f"s{number}"
    made.names.append(name)
    sign = "+" if plain or draw.random() < 0.5 else "-"
    scale, offset = ("1", "0") if plain else (draw.choice(SCALES), draw.choice(OFFSETS))
    floating = size in (32, 64) and not plain and draw.random() < 0.5
    order = 1 if little else 0
    shown = f" {mark}" if mark else ""
    lines.append(
        f' SG_ {name}{shown} : {start}|{size}@{order}{sign} ({scale},{offset}) [0|0] "u" B'
    )
    if floating:
        tail.append(f"SIG_VALTYPE_ {made.told} {name} : {1 if size == 32 else 2};")
    if made.kind == "extended" and mark:
        tail += _extended_values(made.told, name, mark)
    if not floating and not plain and draw.random() < 0.3:
        tail.append(f'VAL_ {made.told} {name} 0 "NONE" 1 "ONE" ;')
    return True


def _size(draw: random.Random) -> int:
    return draw.choice([1, 2, 3, 7, 8, 9, 12, 15, 16, 17, 24, 31, 32, 32, 33, 40, 53, 63, 64, 64])


def _extended_values(told: int, name: str, mark: str) -> list[str]:
    """Build the multiplexer tree: s0 selects s1 with 1 or 3, and others with 0 and 2; s1 selects
    one.
    """
    if mark == "m1M":
        return [f"SG_MUL_VAL_ {told} {name} s0 1-1, 3-3;"]
    if mark == "m0":
        return [f"SG_MUL_VAL_ {told} {name} s1 0-1;"]
    if mark == "m2":
        return [f"SG_MUL_VAL_ {told} {name} s0 2-2;"]
    return []


def _place(
    draw: random.Random, free: set[int], size: int, *, little: bool, total: int
) -> tuple[int, set[int]] | None:
    """Return the start bit as in the DBC file, and the used bits as 8 * byte + bit from the low
    end.
    """
    for _ in range(30):
        start = draw.randrange(total)
        used = bits_of(start, size, little=little)
        if used <= free and max(used) < total:
            return start, used
    return None


def bits_of(start: int, size: int, *, little: bool) -> set[int]:
    """Return every bit of a signal, found one by one as the DBC format describes."""
    return set(bit_order(start, size, little=little))


def bit_order(start: int, size: int, *, little: bool) -> list[int]:
    """Return the bits of a signal, from the lowest one (Intel) or the highest one (Motorola)."""
    bits, at = [], start
    for _ in range(size):
        bits.append(at)
        if little:
            at += 1
        else:
            at = at - 1 if at % 8 else at + 15
    return bits


def drawn_frames(seed: int, count: int, *, fine: bool = False, classic: bool = False) -> Frames:
    """Generate frames of every kind on two channels, in order of their stamps."""
    draw = random.Random(seed)
    rows, at_ns = Rows(), 1_700_000_000_123_000_000
    for _ in range(count):
        at_ns += draw.randrange(1, 10_000_000) * (1 if fine else 1000)
        extended = draw.random() < 0.25
        identifier = draw.randrange(1 << 29) if extended else draw.randrange(1 << 11)
        flags, channel = EXTENDED * extended, f"can{draw.randrange(1, 3)}"
        kind = draw.random() * (0.8 if classic else 1.0)
        if kind < 0.6:
            length = draw.randrange(9)
            rows.add(at_ns, identifier, flags, channel, length, draw.randbytes(length))
        elif kind < 0.7:
            rows.add(at_ns, identifier, flags | REMOTE, channel, draw.randrange(9), b"")
        elif kind < 0.8:
            rows.add(at_ns, 0x4, ERROR, channel, 8, draw.randbytes(8))
        else:
            length = draw.choice(FD_LENGTHS)
            flags |= FD | draw.choice([0, BRS, ESI, BRS | ESI]) | draw.choice([0, TX])
            rows.add(at_ns, identifier, flags, channel, length, draw.randbytes(length))
    return rows.take()
