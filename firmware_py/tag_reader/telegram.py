"""Telegrams of the tag reader: conversion between bytes on its serial line and values.

docs/reference/serial_interface.md defines the layout. Every frame has two flags of its own, so a
damaged flag costs only its own telegram and not the neighbouring one.
"""

import enum
import math
import struct
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from zlib import crc32

from firmware_py.tag_reader.stuffing import framed, unstuffed
from firmware_py.trackdb.line_map import TagKind

VERSION: Final = 1
MAX_PAYLOAD_BYTES: Final = 104
"""Room for the 830 bits of a user telegram as in [SUBSET-036]."""
TICKS_PER_MS: Final = 10
"""Resolution of the reader's clock on the wire: 0.1 ms, 2 mm at 20 m/s. The clock wraps after 4.97
days."""
CLOCK_PERIOD_MS: Final = 2**32 / TICKS_PER_MS
PULSE_PERIOD: Final = 2**16
SEQUENCE_PERIOD: Final = 2**8
HEALTH_PERIOD_S: Final = 0.5

KIND_CODES: Final[Mapping[TagKind, int]] = {
    TagKind.BALISE: 1,
    TagKind.T1: 2,
    TagKind.T2: 3,
    TagKind.T3: 4,
    TagKind.STOP: 5,
}
_KINDS: Final = {code: kind for kind, code in KIND_CODES.items()}

TYPE_TAG: Final = 1
TYPE_HEALTH: Final = 2
HEADER: Final = struct.Struct(">BBB")
TAG_BODY: Final = struct.Struct(">BIIIHB")
HEALTH_BODY: Final = struct.Struct(">BIIII")
CRC: Final = struct.Struct(">I")
ANTENNA_OK: Final = 0x01

_MIN_BYTES: Final = HEADER.size + CRC.size
_MAX_BYTES: Final = HEADER.size + TAG_BODY.size + MAX_PAYLOAD_BYTES + CRC.size
MAX_FRAME_BYTES: Final = 2 * _MAX_BYTES + 2
"""Longest frame on the line, with every byte stuffed and both flags."""
_REMEMBERED: Final = 8
_FORWARD_STEPS: Final = SEQUENCE_PERIOD // 2


@dataclass(frozen=True, slots=True)
class TagTelegram:
    """A tag or balise under the antenna. Position and time are those of the antenna's centre."""

    sequence: int
    """Counter over all telegrams of the reader, modulo 256."""
    tag_id: int
    kind: TagKind
    stamp_ms: float
    """Reader clock, modulo CLOCK_PERIOD_MS, when the antenna's centre was over the tag's centre."""
    sent_ms: float
    """Reader clock, modulo CLOCK_PERIOD_MS, when the first byte of the frame left the reader."""
    pulses: int
    """Counter of tacho A at the antenna's centre, modulo 65536."""
    payload: bytes = b""
    """User telegram of a balise; empty for a magnetic tag."""

    @property
    def age_at_sending_s(self) -> float:
        """Time from the antenna's centre to the first byte on the line; correct across a clock
        wrap.
        """
        return ((self.sent_ms - self.stamp_ms) % CLOCK_PERIOD_MS) / 1000.0


@dataclass(frozen=True, slots=True)
class HealthTelegram:
    """Life sign of the reader, sent every HEALTH_PERIOD_S independent of tags."""

    sequence: int
    sent_ms: float
    antenna_ok: bool
    telegrams_read: int
    """Tags read over the air since power-up, modulo 2**32."""
    crc_errors: int
    """Telegrams corrupted between tag and antenna since power-up, modulo 2**32."""
    uptime_s: int


class TornReason(enum.Enum):
    TOO_SHORT = "too short"
    TOO_LONG = "too long"
    BROKEN_ESCAPE = "broken escape"
    WRONG_CRC = "wrong CRC"
    UNKNOWN_VERSION = "unknown version"
    UNKNOWN_TYPE = "unknown type"
    WRONG_LENGTH = "wrong length"
    INVALID_VALUE = "invalid value"


@dataclass(frozen=True, slots=True)
class TornTelegram:
    """Bytes between two flags that are not a telegram."""

    reason: TornReason
    data: bytes
    """The bytes on the line without the flags; at most MAX_FRAME_BYTES."""


@dataclass(frozen=True, slots=True)
class DuplicateTelegram:
    """A valid telegram with a repeated sequence number. It must not be processed a second time."""

    telegram: TagTelegram | HealthTelegram


Heard = TagTelegram | HealthTelegram | TornTelegram | DuplicateTelegram


def encode(telegram: TagTelegram | HealthTelegram) -> bytes:
    """Encode a telegram as the frame on the line, flags included.

    Stamps are taken modulo the reader clock's period. Raises ValueError with the field's name for a
    value that the frame cannot carry.
    """
    header = HEADER.pack(
        VERSION,
        TYPE_TAG if isinstance(telegram, TagTelegram) else TYPE_HEALTH,
        _checked("sequence", telegram.sequence, SEQUENCE_PERIOD),
    )
    content = header + (
        _tag_body(telegram) if isinstance(telegram, TagTelegram) else _health_body(telegram)
    )
    return framed(content + CRC.pack(crc32(content)))


class TelegramParser:
    """Finds telegrams in a stream of bytes in pieces of any size; resynchronises at any flag."""

    def __init__(self) -> None:
        self.tags = 0
        self.healths = 0
        self.duplicates = 0
        self.lost = 0
        """Number of telegrams missing in the sequence."""
        self.jumps = 0
        """Number of steps back in the sequence: a restarted reader, or a replayed old telegram."""
        self.gaps = 0
        """Number of received telegrams before which telegrams are, or may be, missing; the first
        one counts."""
        self.torn: Counter[TornReason] = Counter()
        self._piece = bytearray()
        self._too_long = False
        self._last_sequence: int | None = None
        self._recent: deque[bytes] = deque(maxlen=_REMEMBERED)

    @property
    def pending_bytes(self) -> int:
        """Bytes that wait for the next flag; never more than MAX_FRAME_BYTES."""
        return len(self._piece)

    def feed(self, data: bytes) -> list[Heard]:
        """Return all telegrams completed by `data`, in the order of the line."""
        heard: list[Heard] = []
        if not data:
            return heard
        pieces = data.split(b"\x7e")
        for piece in pieces[:-1]:
            self._hold(piece)
            self._close(heard)
        self._hold(pieces[-1])
        return heard

    def _hold(self, piece: bytes) -> None:
        room = MAX_FRAME_BYTES - len(self._piece)
        self._too_long = self._too_long or len(piece) > room
        self._piece += piece[:room]

    def _close(self, heard: list[Heard]) -> None:
        stuffed, too_long = bytes(self._piece), self._too_long
        self._piece.clear()
        self._too_long = False
        if not stuffed:
            return
        result = TornReason.TOO_LONG if too_long else _decode(stuffed)
        if isinstance(result, TornReason):
            self.torn[result] += 1
            heard.append(TornTelegram(result, stuffed))
        else:
            heard.append(self._sequenced(result, stuffed))

    def _sequenced(self, telegram: TagTelegram | HealthTelegram, stuffed: bytes) -> Heard:
        sequence, last = telegram.sequence, self._last_sequence
        said_before = stuffed in self._recent
        if sequence == last or said_before:
            self.duplicates += 1
            # A different telegram with the same sequence number is not delivered, so its content
            # counts as a gap.
            self.gaps += not said_before
            return DuplicateTelegram(telegram)
        step = 0 if last is None else (sequence - last) % SEQUENCE_PERIOD
        self.gaps += step != 1
        if last is not None:
            if step < _FORWARD_STEPS:
                self.lost += step - 1
            else:
                self.jumps += 1
        self._last_sequence = sequence
        self._recent.append(stuffed)
        if isinstance(telegram, TagTelegram):
            self.tags += 1
        else:
            self.healths += 1
        return telegram


def _decode(stuffed: bytes) -> TagTelegram | HealthTelegram | TornReason:
    content = unstuffed(stuffed)
    if content is None:
        return TornReason.BROKEN_ESCAPE
    if len(content) < _MIN_BYTES:
        return TornReason.TOO_SHORT
    if len(content) > _MAX_BYTES:
        return TornReason.TOO_LONG
    body_end = len(content) - CRC.size
    if crc32(content[:body_end]) != CRC.unpack_from(content, body_end)[0]:
        return TornReason.WRONG_CRC
    version, kind, sequence = HEADER.unpack_from(content)
    body = content[HEADER.size : body_end]
    if version != VERSION:
        return TornReason.UNKNOWN_VERSION
    if kind == TYPE_TAG:
        return _tag(sequence, body)
    if kind == TYPE_HEALTH:
        return _health(sequence, body)
    return TornReason.UNKNOWN_TYPE


def _tag(sequence: int, body: bytes) -> TagTelegram | TornReason:
    if len(body) < TAG_BODY.size:
        return TornReason.WRONG_LENGTH
    code, tag_id, stamp, sent, pulses, length = TAG_BODY.unpack_from(body)
    payload = body[TAG_BODY.size :]
    if len(payload) != length or length > MAX_PAYLOAD_BYTES:
        return TornReason.WRONG_LENGTH
    kind = _KINDS.get(code)
    if kind is None or tag_id == 0:
        return TornReason.INVALID_VALUE
    return TagTelegram(
        sequence, tag_id, kind, stamp / TICKS_PER_MS, sent / TICKS_PER_MS, pulses, payload
    )


def _health(sequence: int, body: bytes) -> HealthTelegram | TornReason:
    if len(body) != HEALTH_BODY.size:
        return TornReason.WRONG_LENGTH
    flags, sent, telegrams_read, crc_errors, uptime_s = HEALTH_BODY.unpack(body)
    if flags & ~ANTENNA_OK:
        return TornReason.INVALID_VALUE
    return HealthTelegram(
        sequence, sent / TICKS_PER_MS, bool(flags), telegrams_read, crc_errors, uptime_s
    )


def _tag_body(telegram: TagTelegram) -> bytes:
    if len(telegram.payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(f"payload: {len(telegram.payload)} bytes, {MAX_PAYLOAD_BYTES} at most")
    if telegram.tag_id == 0:
        raise ValueError("tag_id: 0 is no tag")
    fixed = TAG_BODY.pack(
        KIND_CODES[telegram.kind],
        _checked("tag_id", telegram.tag_id, 2**32),
        _ticks("stamp_ms", telegram.stamp_ms),
        _ticks("sent_ms", telegram.sent_ms),
        _checked("pulses", telegram.pulses, PULSE_PERIOD),
        len(telegram.payload),
    )
    return fixed + telegram.payload


def _health_body(telegram: HealthTelegram) -> bytes:
    return HEALTH_BODY.pack(
        ANTENNA_OK if telegram.antenna_ok else 0,
        _ticks("sent_ms", telegram.sent_ms),
        _checked("telegrams_read", telegram.telegrams_read, 2**32),
        _checked("crc_errors", telegram.crc_errors, 2**32),
        _checked("uptime_s", telegram.uptime_s, 2**32),
    )


def _checked(name: str, value: int, limit: int) -> int:
    if not 0 <= value < limit:
        raise ValueError(f"{name}: {value} is not in 0..{limit - 1}")
    return value


def _ticks(name: str, instant_ms: float) -> int:
    if not math.isfinite(instant_ms):
        raise ValueError(f"{name}: {instant_ms} is not a finite number")
    return round(instant_ms * TICKS_PER_MS) % 2**32
