"""The log for the benchmarks: 12 identifiers, 79 signals, both byte orders."""

from pathlib import Path
from typing import Any

import numpy as np

from canlog.damage import Damages
from canlog.formats.registry import named
from canlog.frames import EXTENDED, Frames
from canlog.rows import from_rows

SIGNALS = (8, 8, 7, 7, 7, 7, 6, 6, 6, 6, 6, 5)
"""Number of signals in each message, 79 in all."""
LENGTHS = (8, 8, 8, 8, 8, 8, 8, 7, 8, 6, 8, 5)
EXTENDED_AT = 11
"""The last message has an identifier of 29 bits."""
START_NS = 1_700_000_000_000_000_000
FRAME_NS = 250_000
SEED = 1


def dbc_text() -> str:
    """Return a DBC file, always the same, with adjacent signals from the first bit on."""
    draw = np.random.default_rng(SEED)
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: A B", ""]
    for at, (count, length) in enumerate(zip(SIGNALS, LENGTHS, strict=True)):
        frame_id = identifier(at) | (1 << 31 if at == EXTENDED_AT else 0)
        lines.append(f"BO_ {frame_id} MESSAGE_{at:02d}: {length} A")
        size = 8 * length // count
        for number in range(count):
            start, signed = number * size, draw.random() < 0.4
            motorola = at % 2 == 1
            first = 8 * (start // 8) + 7 - start % 8 if motorola else start
            scale = draw.choice([1, 0.5, 0.1, 0.01, 0.001, 2])
            offset = draw.choice([0, 0, 0, -40, 100])
            lines.append(
                f" SG_ signal_{at:02d}_{number} : {first}|{size}@{0 if motorola else 1}"
                f'{"-" if signed else "+"} ({scale:g},{offset}) [0|0] "u" B'
            )
        lines.append("")
    return "\n".join(lines) + "\n"


def identifier(at: int) -> int:
    return 0x18FF_1000 + at if at == EXTENDED_AT else 0x100 + 0x20 * at


def frames(count: int) -> Frames:
    """Return frames with random data, about 250 µs apart."""
    draw = np.random.default_rng(SEED)
    which = draw.integers(0, len(LENGTHS), count)
    lengths = np.array(LENGTHS, np.uint8)[which]
    data = draw.integers(0, 256, (count, 8), np.uint8)
    data[np.arange(8) >= lengths[:, None]] = 0
    past_ns = np.cumsum(FRAME_NS + 1000 * draw.integers(-20, 20, count))
    ids = np.array([identifier(at) for at in range(len(LENGTHS))], np.uint32)
    return Frames(
        START_NS + past_ns,
        ids[which],
        np.where(which == EXTENDED_AT, EXTENDED, 0).astype(np.uint8),
        np.zeros(count, np.uint8),
        lengths,
        data,
        ("can1",),
    )


def write_logs(folder: Path, count: int, forms: tuple[str, ...]) -> dict[str, Path]:
    """Write the same frames in each format, and `bench.dbc`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bench.dbc").write_text(dbc_text())
    made: Any = frames(count)
    paths = {}
    for form in forms:
        found = named(form)
        paths[form] = folder / f"bench{found.suffixes[0]}"
        found.write(
            paths[form], [made[at : at + 200_000] for at in range(0, count, 200_000)], Damages()
        )
    return paths


def transport_frames(messages: int) -> Frames:
    """Return this many messages of 40 bytes, J1939 broadcasts and ISO-TP in turn."""
    rows: list[tuple[int, int, int, str, bytes]] = []
    for at in range(messages):
        data = bytes([at % 256] * 40)
        parts = [data[first : first + 7] for first in range(0, 40, 7)]
        if at % 2:
            told = bytes([32, 40, 0, 6, 255, 0xCA, 0xFE, 0])
            sent = [(0x18ECFF00 | at % 250, told)]
            sent += [
                (0x18EBFF00 | at % 250, bytes([number]) + part.ljust(7, b"\xff"))
                for number, part in enumerate(parts, 1)
            ]
            flags = EXTENDED
        else:
            sent = [(0x7E0, bytes([0x10, 40]) + data[:6])]
            sent += [
                (0x7E0, bytes([0x20 | number]) + data[first : first + 7].ljust(7, b"\0"))
                for number, first in enumerate(range(6, 40, 7), 1)
            ]
            flags = 0
        rows += [(len(rows) * FRAME_NS, key, flags, "can1", part) for key, part in sent]
    return from_rows(rows)


def many_messages(count: int) -> str:
    """A DBC file of this many messages, with a value table in each."""
    lines = ['VERSION ""', "BU_: A B"]
    for at in range(count):
        lines.append(f"BO_ {at} MANY_{at:03d}: 8 A")
        lines += [f' SG_ s_{at:03d}_{n} : {8 * n}|8@1+ (1,0) [0|255] "u" B' for n in range(8)]
    for at in range(count):
        lines.append(f'VAL_ {at} s_{at:03d}_0 0 "OFF" 1 "ON" 2 "FAULT" 3 "SNA" ;')
    return "\n".join(lines) + "\n"
