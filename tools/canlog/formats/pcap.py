"""pcap and pcapng captures of SocketCAN interfaces, as written by tcpdump and Wireshark."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from canlog.damage import Damages, LogError
from canlog.formats.heads import PCAPNG_SECTION, is_pcap
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
from canlog.options import ReadOptions
from canlog.source import opened

MICROSECONDS, NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
SECTION, INTERFACE, OLD_PACKET, SIMPLE, ENHANCED = 0x0A0D0D0A, 1, 2, 3, 6
ORDER_MARK: Final = 0x1A2B3C4D
SOCKETCAN, COOKED, COOKED_2 = 227, 113, 276
"""Link types: bare frames, and frames after the head of a cooked capture of version 1 or 2."""
CAN_PROTOCOLS: Final = (0x000C, 0x000D)
CAN_XL: Final = 0x000E
OUTGOING: Final = 4
EFF, RTR, ERR = 0x8000_0000, 0x4000_0000, 0x2000_0000
FD_BRS, FD_ESI, FD_FDF = 1, 2, 4
FRAME_HEAD: Final = 8
FD_FRAME: Final = 72
"""Size of a complete `canfd_frame`: a capture of this size is CAN FD, whatever its flags say."""
NAME_OPTION, FLAGS_OPTION, RESOLUTION_OPTION, OFFSET_OPTION = 2, 2, 9, 14
NS_PER_S: Final = 1_000_000_000
CHANNELS_MAX: Final = 256
AT_MAX: Final = (1 << 63) - 1

Order = Literal["little", "big"]


@dataclass(frozen=True, slots=True)
class _Interface:
    """A capture interface, the source of packets."""

    link: int
    name: str
    per_second: int
    """Ticks per second of its stamps."""
    offset_s: int


@dataclass(frozen=True, slots=True)
class _Packet:
    """Place and stamp of one packet."""

    at: int
    size: int
    at_ns: int
    interface: _Interface
    sent: bool


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the CAN frames of a capture, and skip packets of other networks.

    An interface of pcapng keeps its name; the only interface of pcap is called `can0`.

    Raises:
        LogError: for a file that is neither pcap nor pcapng.
    """
    with opened(path, damages) as file:
        capture = _Capture(file.data, file.size, damages)
        if file.data[:4] == PCAPNG_SECTION:
            packets = capture.blocks()
        elif is_pcap(bytes(file.data[:4])):
            packets = capture.records()
        else:
            raise LogError(f"{path}: no pcap or pcapng file")
        taken = _Taken(file.data, damages)
        for packet in packets:
            taken.add(packet)
            if len(taken) >= options.block_frames:
                yield taken.frames()
        if len(taken):
            yield taken.frames()


class _Capture:
    """Walks the packets of one file."""

    def __init__(self, data: Any, size: int, damages: Damages) -> None:
        self._data, self._size, self._damages = data, size, damages

    def _number(self, at: int, size: int, order: Order) -> int:
        return int.from_bytes(self._data[at : at + size], order)

    def records(self) -> Iterator[_Packet]:
        """Yield the packets of a pcap file."""
        order: Order = "little"
        if self._number(0, 4, order) not in (MICROSECONDS, NANOSECONDS):
            order = "big"
        fine = self._number(0, 4, order) == NANOSECONDS
        link = self._number(20, 4, order) & 0x0FFF_FFFF
        interface = _Interface(link, "can0", NS_PER_S if fine else 1_000_000, 0)
        step = 1 if fine else 1000
        head = struct.Struct("<IIII" if order == "little" else ">IIII")
        at = 24
        while at + 16 <= self._size:
            seconds, fraction, size, _ = head.unpack(self._data[at : at + 16])
            if at + 16 + size > self._size:
                self._damages.add("torn file", "byte", at, "it ends inside a packet")
                return
            yield _Packet(
                at + 16, size, seconds * NS_PER_S + fraction * step, interface, sent=False
            )
            at += 16 + size
        if at < self._size:
            self._damages.add("torn file", "byte", at, "it ends inside the head of a packet")

    def blocks(self) -> Iterator[_Packet]:
        """Yield the packets of a pcapng file; a section has its own byte order and interfaces."""
        order: Order = "little"
        interfaces: list[_Interface] = []
        at = 0
        while at + 12 <= self._size:
            if self._data[at : at + 4] == PCAPNG_SECTION:
                order = "little" if self._number(at + 8, 4, "little") == ORDER_MARK else "big"
                interfaces = []
            kind, size = self._number(at, 4, order), self._number(at + 4, 4, order)
            if size < 12 or size % 4 or at + size > self._size:
                self._damages.add("torn file", "byte", at, f"a block of {size} bytes")
                return
            body, end = at + 8, at + size - 4
            if kind == INTERFACE:
                interfaces.append(self._interface(body, end, order, len(interfaces)))
            elif kind in (ENHANCED, OLD_PACKET, SIMPLE):
                packet = self._packet(kind, body, end, order, interfaces)
                if packet is not None:
                    yield packet
            at += size
        if at < self._size:
            self._damages.add("torn file", "byte", at, "it ends inside a block")

    def _options(self, at: int, end: int, order: Order) -> Iterator[tuple[int, bytes]]:
        while at + 4 <= end:
            code, size = self._number(at, 2, order), self._number(at + 2, 2, order)
            if code == 0:
                return
            yield code, bytes(self._data[at + 4 : min(at + 4 + size, end)])
            at += 4 + size + -size % 4

    def _interface(self, body: int, end: int, order: Order, number: int) -> _Interface:
        name, per_second, offset_s = f"can{number}", 1_000_000, 0
        for code, value in self._options(body + 8, end, order):
            if code == NAME_OPTION and value:
                name = value.rstrip(b"\0").decode("utf-8", "replace")
            elif code == RESOLUTION_OPTION and value:
                power = value[0] & 0x7F
                per_second = 1 << power if value[0] & 0x80 else 10 ** min(power, 18)
            elif code == OFFSET_OPTION and len(value) == 8:
                offset_s = int.from_bytes(value, order, signed=True)
        return _Interface(self._number(body, 2, order), name, per_second, offset_s)

    def _packet(
        self, kind: int, body: int, end: int, order: Order, interfaces: list[_Interface]
    ) -> _Packet | None:
        if kind == SIMPLE:
            number, first, size, ticks = 0, body + 4, self._number(body, 4, order), 0
            size = min(size, end - first)
        else:
            width = 4 if kind == ENHANCED else 2
            number = self._number(body, width, order)
            high, low = (self._number(body + at, 4, order) for at in (4, 8))
            first, size, ticks = body + 20, self._number(body + 12, 4, order), high << 32 | low
        if number >= len(interfaces) or first + size > end:
            self._damages.add(
                "broken packet", "byte", body, "of no interface, or longer than its block"
            )
            return None
        interface = interfaces[number]
        at_ns = ticks * NS_PER_S // interface.per_second + interface.offset_s * NS_PER_S
        if at_ns > AT_MAX:
            self._damages.add("impossible stamp", "byte", body, "left out")
            return None
        told = self._options(first + size + -size % 4, end, order)
        flags = next((value for code, value in told if code == FLAGS_OPTION), b"")
        sent = int.from_bytes(flags, order) & 3 == 2
        return _Packet(first, size, at_ns, interface, sent)


class _Taken:
    """Gathers frames of packets until they make a block."""

    def __init__(self, data: Any, damages: Damages) -> None:
        self._data, self._damages = data, damages
        self._names: list[str] = []
        self._clear()

    def _clear(self) -> None:
        self._heads: list[bytes] = []
        self._at_ns: list[int] = []
        self._flags: list[int] = []
        self._channel: list[int] = []

    def __len__(self) -> int:
        return len(self._heads)

    def add(self, packet: _Packet) -> None:
        at, size, sent = packet.at, packet.size, packet.sent
        link = packet.interface.link
        if link in (COOKED, COOKED_2):
            first = 16 if link == COOKED else 20
            place = at + (14 if link == COOKED else 0)
            protocol = int.from_bytes(self._data[place : place + 2], "big")
            way = self._data[at + 1] if link == COOKED else self._data[at + 10]
            if protocol not in CAN_PROTOCOLS:
                self._damages.skip("CAN XL frame" if protocol == CAN_XL else "packet of no CAN bus")
                return
            at, size, sent = at + first, size - first, sent or way == OUTGOING
        elif link != SOCKETCAN:
            self._damages.skip("packet of no CAN bus")
            return
        if size < FRAME_HEAD:
            self._damages.add("broken packet", "byte", at, f"{size} bytes are no frame")
            return
        raw = bytes(self._data[at : at + min(size, FD_FRAME)])
        if raw[4] > 0x80 and size > FD_FRAME:
            self._damages.skip("CAN XL frame")
            return
        length = raw[4]
        remote = bool(raw[0] & 0x40)
        if length not in FD_LENGTHS or (not remote and len(raw) < FRAME_HEAD + length):
            self._damages.add("broken packet", "byte", at, f"{len(raw)} bytes for {length} of data")
            return
        name = packet.interface.name
        if name not in self._names:
            if len(self._names) == CHANNELS_MAX:
                self._damages.add("too many channels", "byte", at, f"{name} is left out")
                return
            self._names.append(name)
        is_fd = bool(raw[5] & FD_FDF) or length > CLASSIC_BYTES or size == FD_FRAME
        self._heads.append(raw.ljust(FD_FRAME, b"\0"))
        self._at_ns.append(packet.at_ns)
        self._flags.append(FD * is_fd | TX * sent)
        self._channel.append(self._names.index(name))

    def frames(self) -> Frames:
        """Return all frames added since the last call."""
        raw = np.frombuffer(b"".join(self._heads), np.uint8).reshape(-1, FD_FRAME)
        wide = np.ascontiguousarray(raw[:, :4]).view(">u4")[:, 0].astype(np.uint32)
        flags = np.array(self._flags, np.uint8)
        is_fd = (flags & np.uint8(FD)) != 0
        error, remote = (wide & ERR) != 0, (wide & RTR) != 0
        for bit, on in (
            (EXTENDED, ((wide & EFF) != 0) & ~error),
            (REMOTE, remote & ~error),
            (ERROR, error),
            (BRS, is_fd & ((raw[:, 5] & FD_BRS) != 0)),
            (ESI, is_fd & ((raw[:, 5] & FD_ESI) != 0)),
        ):
            flags |= on * np.uint8(bit)
        length = raw[:, 4].copy()
        width = CLASSIC_BYTES if int(length.max(initial=0)) <= CLASSIC_BYTES else FD_BYTES
        shown = np.where((flags & np.uint8(REMOTE)) != 0, 0, length)
        data = raw[:, FRAME_HEAD : FRAME_HEAD + width]
        identifier = wide & np.uint32(0x1FFF_FFFF)
        standard = (flags & np.uint8(EXTENDED | ERROR)) == 0
        found = Frames(
            np.array(self._at_ns, np.int64),
            np.where(standard, identifier & np.uint32(0x7FF), identifier).astype(np.uint32),
            flags,
            np.array(self._channel, np.uint8),
            length,
            np.where(np.arange(width) < shown[:, None], data, 0).astype(np.uint8),
            tuple(self._names),
        )
        self._clear()
        return found
