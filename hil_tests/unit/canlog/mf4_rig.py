"""Builds MDF 4 files block by block like loggers: packed bits, several groups, unfinished files."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

FIXED, VARIABLE, MASTER = 0, 1, 2
BYTES = 10
CAN_FIELDS = (
    # Name, kind, data type, bit, byte, bits. The stamp takes the low six bytes; the rest is packed
    # like in CANedge files.
    ("Timestamp", MASTER, 0, 0, 0, 48),
    ("CAN_DataFrame", FIXED, BYTES, 0, 6, 120),
    ("CAN_DataFrame.BusChannel", FIXED, 0, 0, 6, 2),
    ("CAN_DataFrame.ID", FIXED, 0, 2, 6, 30),
    ("CAN_DataFrame.IDE", FIXED, 0, 0, 10, 1),
    ("CAN_DataFrame.DLC", FIXED, 0, 1, 10, 4),
    ("CAN_DataFrame.DataLength", FIXED, 0, 0, 11, 7),
    ("CAN_DataFrame.Dir", FIXED, 0, 7, 11, 1),
    ("CAN_DataFrame.EDL", FIXED, 0, 5, 10, 1),
    ("CAN_DataFrame.BRS", FIXED, 0, 6, 10, 1),
)
LIN_FIELDS = (("Timestamp", MASTER, 0, 0, 0, 48), ("LIN_Frame.ID", FIXED, 0, 0, 6, 8))
BUS_EVENT = 2 | 4
"""Flags of a group that holds frames of a bus."""
STEP_S = 1e-6
"""Step of the stamps: 1 us."""


@dataclass(frozen=True, slots=True)
class MadeFrame:
    at_us: int
    bus: int
    identifier: int
    extended: bool
    sent: bool
    fd: bool
    data: bytes


class _Blocks:
    """A file that grows block by block; links are filled in once they are known."""

    def __init__(self, magic: bytes, flags: int) -> None:
        head = magic.ljust(8) + b"4.11    " + b"rig".ljust(8) + struct.pack("<4xH30x", 411)
        self.bytes = bytearray(head + struct.pack("<HH", flags, 0))

    def add(self, kind: bytes, links: Sequence[int], body: bytes) -> int:
        self.bytes += bytes(-len(self.bytes) % 8)
        at = len(self.bytes)
        size = 24 + 8 * len(links) + len(body)
        self.bytes += struct.pack("<4s4xQQ", kind, size, len(links))
        self.bytes += struct.pack(f"<{len(links)}Q", *links) + body
        return at

    def link(self, at: int, number: int, target: int) -> None:
        struct.pack_into("<Q", self.bytes, at + 24 + 8 * number, target)

    def text(self, text: str) -> int:
        raw = text.encode() + b"\0"
        return self.add(b"##TX", (), raw + bytes(-len(raw) % 8))

    def channels(self, fields: Sequence[tuple[str, int, int, int, int, int]], values: int) -> int:
        """Add channels, those of a frame below it, and return the first one."""
        last: dict[str, int] = {}
        first = 0
        for name, kind, data_type, bit, byte, bits in fields:
            conversion = 0
            if kind == MASTER:
                body = struct.pack("<BBHHHdddd", 1, 0, 0, 0, 2, 0.0, 0.0, 0.0, STEP_S)
                conversion = self.add(b"##CC", (0, 0, 0, 0), body)
            links = (0, 0, self.text(name), 0, conversion, values if kind == VARIABLE else 0, 0, 0)
            sync = 1 if kind == MASTER else 0
            body = struct.pack("<BBBBIIII2xHdddddd", kind, sync, data_type, bit, byte, bits, 0, 0,
                               0, *[0.0] * 6)  # fmt: skip
            at = self.add(b"##CN", links, body)
            frame = name.rpartition(".")[0]
            if frame in last:
                self.link(last[frame], 0, at)
            elif frame:
                self.link(last[""], 1, at)
            first, last[frame] = first or at, at
        return first

    def group(self, number: int, channels: int, count: int, size: int, flags: int) -> int:
        source = self.add(
            b"##SI", (self.text("CAN"), self.text("CAN"), 0), bytes([2, 2]) + bytes(6)
        )
        body = struct.pack("<QQHH4xII", number, count, flags, 0, size, 0)
        return self.add(b"##CG", (0, channels, 0, source, 0, 0), body)


def record(frame: MadeFrame, *, place: int | None = None) -> bytes:
    """Return a record without its group number; `place` locates data stored elsewhere."""
    codes = [*range(9), 12, 16, 20, 24, 32, 48, 64]
    code = min(at for at, size in enumerate(codes) if size >= len(frame.data))
    head = frame.at_us.to_bytes(6, "little")
    head += (frame.bus | frame.identifier << 2).to_bytes(4, "little")
    head += bytes([frame.extended | code << 1 | frame.fd << 5, len(frame.data) | frame.sent << 7])
    if place is None:
        return head + frame.data.ljust(8, b"\0")
    return head + place.to_bytes(8, "little")


def sorted_file(frames: Sequence[MadeFrame], *, finished: bool = True, start_ns: int = 0) -> bytes:
    """Return a file with one group, its blocks first and its records last, like a logger."""
    fields = (*CAN_FIELDS, ("CAN_DataFrame.DataBytes", FIXED, BYTES, 0, 12, 64))
    out = _Blocks(b"MDF     " if finished else b"UnFinMF ", 0 if finished else 5)
    header = out.add(b"##HD", (0,) * 6, struct.pack("<Qhh4B2d", start_ns, 0, 0, 0, 0, 0, 0, 0, 0))
    group = out.group(0, out.channels(fields, 0), len(frames) if finished else 0, 20, BUS_EVENT)
    data = out.add(b"##DG", (0, group, 0, 0), bytes(8))
    out.link(header, 0, data)
    content = b"".join(record(each) for each in frames)
    out.link(data, 2, out.add(b"##DT", (), content))
    if not finished:
        struct.pack_into("<Q", out.bytes, len(out.bytes) - len(content) - 16, 24)
    return bytes(out.bytes)


def unsorted_file(frames: Sequence[MadeFrame], *, start_ns: int = 0) -> bytes:
    """Return an unfinished file with CAN frames, their variable-length data, and LIN frames."""
    out = _Blocks(b"UnFinMF ", 5)
    header = out.add(b"##HD", (0,) * 6, struct.pack("<Qhh4B2d", start_ns, 0, 0, 0, 0, 0, 0, 0, 0))
    values = out.group(2, 0, 0, 0, 1)
    fields = (*CAN_FIELDS, ("CAN_DataFrame.DataBytes", VARIABLE, BYTES, 0, 12, 64))
    group = out.group(1, out.channels(fields, values), 0, 20, BUS_EVENT)
    lin = out.group(3, out.channels(LIN_FIELDS, 0), len(frames), 7, 0)
    out.link(group, 0, values)
    out.link(values, 0, lin)
    data = out.add(b"##DG", (0, group, 0, 0), bytes([1, 0, 0, 0, 0, 0, 0, 0]))
    out.link(header, 0, data)
    content, place = b"", 0
    for each in frames:
        content += b"\1" + record(each, place=place)
        content += b"\2" + len(each.data).to_bytes(4, "little") + each.data
        content += b"\3" + each.at_us.to_bytes(6, "little") + b"\x2a"
        place += 4 + len(each.data)
    out.link(data, 2, out.add(b"##DT", (), content))
    struct.pack_into("<Q", out.bytes, len(out.bytes) - len(content) - 16, 24)
    return bytes(out.bytes)
