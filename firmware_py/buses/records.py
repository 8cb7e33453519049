"""Records of the embedded bus: bytes on the socket between the hub and its clients.

Every record has 24 bytes, little-endian: the 16 bytes of SocketCAN's `struct can_frame` and the
instant at which the hub received the frame.

    0   u32  identifier; bit 31: 29-bit identifier, bit 30: remote frame, bit 29: error frame
    4   u8   number of data bytes, 0 to 8
    5   3    zero
    8   8    data, filled up with zeros
    16  i64  stamp_ns on the machine's monotonic clock; zero from client to hub

An identifier with all three flag bits set cannot come from a bus. It marks a control record, and
its low byte gives the kind:

    HELLO    client to hub: version (u16), bytes of node name (u16); the name follows, zero-filled
             to whole records
    WELCOME  hub to client: version (u16)
    REFUSED  hub to client: version (u16), reason (u16); the hub then closes
    ASK      client to hub instead of HELLO: version (u16). Requests the hub's status
    STATUS   hub to client: version (u16), bytes of text (u16); the text follows as with HELLO, in
             JSON. The hub then closes
    LOST     hub to client: number of frames that this client has missed since its connection
             (u64), because its queue in the hub was full. It stands where frames are missing
"""

import enum
import struct
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from firmware_py.ports import CanFrame

PROTOCOL_VERSION: Final = 1
RECORD_BYTES: Final = 24
MAX_DATA_BYTES: Final = 8
MAX_NAME_BYTES: Final = 64

EXTENDED_FLAG: Final = 0x8000_0000
REMOTE_FLAG: Final = 0x4000_0000
ERROR_FLAG: Final = 0x2000_0000
ID_MASK: Final = 0x1FFF_FFFF
MAX_STANDARD_ID: Final = 0x7FF
_ALL_FLAGS: Final = EXTENDED_FLAG | REMOTE_FLAG | ERROR_FLAG

_RECORD: Final = struct.Struct("<IB3x8sq")
_ANNOUNCE: Final = struct.Struct("<I4xHH12x")
_COUNT: Final = struct.Struct("<I4xQ8x")
_ID: Final = struct.Struct("<I")
assert _RECORD.size == _ANNOUNCE.size == _COUNT.size == RECORD_BYTES

_LENGTH_AT: Final = 4
_FLAGS_AT: Final = 3
_STAMP_AT: Final = 16
_STAMP: Final = struct.Struct("<q")

_make_frame = tuple.__new__
"""Creates a CanFrame in a third of the time of its own constructor."""


class Control(enum.IntEnum):
    """Kind of a control record."""

    HELLO = 1
    WELCOME = 2
    REFUSED = 3
    ASK = 4
    STATUS = 5
    LOST = 6


class HubRefusal(enum.IntEnum):
    """Why the hub refuses a client."""

    WRONG_VERSION = 1
    BAD_NAME = 2
    TOO_MANY_CLIENTS = 3
    NOT_A_HELLO = 4


REFUSAL_WORDS: Final[dict[int, str]] = {
    HubRefusal.WRONG_VERSION: "the hub uses another version of the protocol",
    HubRefusal.BAD_NAME: "the node name is empty, too long or not UTF-8",
    HubRefusal.TOO_MANY_CLIENTS: "the hub has no room for another client",
    HubRefusal.NOT_A_HELLO: "the hub did not understand the greeting",
}


@dataclass(frozen=True, slots=True)
class Announcement:
    """A control record other than LOST."""

    control: Control
    version: int
    detail: int
    """Number of bytes of the text that follows, or a reason, depending on the kind."""


def pack_frame(can_id: int, data: bytes) -> bytes:
    """Pack an 11-bit data frame as a record for the hub.

    Raises:
        ValueError: for an identifier or data that such a frame cannot carry.
    """
    length = len(data)
    if length > MAX_DATA_BYTES or not 0 <= can_id <= MAX_STANDARD_ID:
        raise ValueError(f"frame {can_id:#x} with {length} bytes: no classic 11-bit frame")
    return _RECORD.pack(can_id, length, data, 0)


def pack_announcement(control: Control, detail: int = 0, version: int = PROTOCOL_VERSION) -> bytes:
    return _ANNOUNCE.pack(_ALL_FLAGS | control, version, detail)


def pack_text(control: Control, text: bytes) -> bytes:
    """Pack a control record and its text, in whole records."""
    return pack_announcement(control, len(text)) + text + bytes(-len(text) % RECORD_BYTES)


def pack_lost(frames: int) -> bytes:
    return _COUNT.pack(_ALL_FLAGS | Control.LOST, frames)


def read_announcement(record: bytes | bytearray) -> Announcement | None:
    """Parse the first record of a connection; None if it is not a control record."""
    flags_and_kind, version, detail = _ANNOUNCE.unpack_from(record)
    kind = flags_and_kind & ID_MASK
    if flags_and_kind & _ALL_FLAGS != _ALL_FLAGS or kind not in Control.__members__.values():
        return None
    return Announcement(Control(kind), version, detail)


def whole_records_bytes(text_bytes: int) -> int:
    """Return the space that this many bytes of text take on the socket."""
    return text_bytes + -text_bytes % RECORD_BYTES


def stamp_frames(records: bytearray, stamp_ns: int) -> bytearray:
    """Stamp whole records from a client and drop those that are not frames.

    All records are checked at once by columns: every 24th byte holds a length, another column the
    flags. Clients of this project send only plain frames, so the slow check is for foreign clients.
    """
    if (
        any(records[_FLAGS_AT::RECORD_BYTES])
        or max(records[_LENGTH_AT::RECORD_BYTES]) > MAX_DATA_BYTES
    ):
        records = _only_frames(records)
    count = len(records) // RECORD_BYTES
    for place, byte in enumerate(_STAMP.pack(stamp_ns), start=_STAMP_AT):
        records[place::RECORD_BYTES] = bytes((byte,)) * count
    return records


def _only_frames(records: bytearray) -> bytearray:
    kept = bytearray()
    for start in range(0, len(records), RECORD_BYTES):
        (flags_and_id,) = _ID.unpack_from(records, start)
        is_control = flags_and_id & _ALL_FLAGS == _ALL_FLAGS
        if not is_control and records[start + _LENGTH_AT] <= MAX_DATA_BYTES:
            kept += records[start : start + RECORD_BYTES]
    return kept


class RecordReader:
    """Splits the stream from the hub into frames, in pieces of any size."""

    def __init__(self, accept_ids: Collection[int] | None) -> None:
        """`accept_ids` are 11-bit identifiers of data frames; None accepts all frames."""
        self._accepted = None if accept_ids is None else frozenset(accept_ids)
        self._rest = b""
        self.lost = 0
        """Number of frames for which the hub had no room."""
        self.errors = 0
        """Number of error frames and invalid records."""

    def feed(self, data: bytes, now_ns: int) -> list[CanFrame]:
        """Return the frames completed by `data`, none stamped later than `now_ns`."""
        if self._rest:
            data = self._rest + data
        surplus = len(data) % RECORD_BYTES
        self._rest = data[len(data) - surplus :] if surplus else b""
        if surplus:
            data = data[:-surplus]
        accepted = self._accepted
        frames: list[CanFrame] = []
        for flags_and_id, length, payload, stamp_ns in _RECORD.iter_unpack(data):
            if flags_and_id > MAX_STANDARD_ID or length > MAX_DATA_BYTES:
                frame = self._uncommon(flags_and_id, length, payload, min(stamp_ns, now_ns))
                if frame is not None and accepted is None:
                    frames.append(frame)
            elif accepted is None or flags_and_id in accepted:
                if stamp_ns > now_ns:
                    stamp_ns = now_ns
                values = (stamp_ns, flags_and_id, payload[:length], False, False, False)
                frames.append(_make_frame(CanFrame, values))
        return frames

    def _uncommon(
        self, flags_and_id: int, length: int, payload: bytes, stamp_ns: int
    ) -> CanFrame | None:
        if flags_and_id == _ALL_FLAGS | Control.LOST:
            self.lost = int.from_bytes(payload, "little")
            return None
        if flags_and_id & ERROR_FLAG or length > MAX_DATA_BYTES:
            self.errors += 1
            return None
        remote = bool(flags_and_id & REMOTE_FLAG)
        extended = bool(flags_and_id & EXTENDED_FLAG)
        if not extended and flags_and_id & ID_MASK > MAX_STANDARD_ID:
            self.errors += 1
            return None
        sent = b"" if remote else payload[:length]
        return CanFrame(stamp_ns, flags_and_id & ID_MASK, sent, extended, remote)
