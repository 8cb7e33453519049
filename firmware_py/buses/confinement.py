"""Error confinement as ISO 11898-1 has it: error counters of a node, and lengths of error frames.

A dominant bit is 0, a recessive one 1. Bits are counted from the start of frame, stuff bits
included, as they are on the wire.
"""

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.buses.timing import INTERMISSION_BITS
from firmware_py.ports import CanFrame

PASSIVE_FROM: Final = 128
OFF_FROM: Final = 256
ERROR_STEP: Final = 8
"""By so much the transmit error counter rises when a frame is destroyed."""
REC_MOST: Final = 255
REC_AFTER_PASSIVE: Final = 127
"""The standard leaves 119 to 127: where a passive receiver's counter goes with a good frame."""
FLAG_BITS: Final = 6
DELIMITER_BITS: Final = 8
SUSPEND_BITS: Final = 8
"""A passive node waits so much longer after a frame of its own before it starts another."""
RECOVERY_SEQUENCES: Final = 128
RECOVERY_SEQUENCE_BITS: Final = 11
RECOVERY_BITS: Final = RECOVERY_SEQUENCES * RECOVERY_SEQUENCE_BITS
"""On an idle bus."""

HEAD_BITS: Final = 19
"""Start of frame, identifier (11), remote request, extension, reserved bit, length (4)."""
CRC_BITS: Final = 15
CRC_POLYNOMIAL: Final = 0x4599
STUFF_RUN: Final = 5
END_BITS: Final = 7

ERROR_ACKNOWLEDGE: Final = 0x20
ERROR_BUS_OFF: Final = 0x40
ERROR_PROTOCOL: Final = 0x08
ERROR_COUNTERS: Final = 0x200
PROTOCOL_BIT: Final = 0x01
PROTOCOL_SENDING: Final = 0x80
COUNTER_MOST: Final = 255
"""Identifier and data of an error frame as Linux has it, in linux/can/error.h."""

Bits = Sequence[int]


class ErrorState(enum.Enum):
    ACTIVE = "error active"
    PASSIVE = "error passive"
    OFF = "bus off"


@dataclass(slots=True)
class ErrorCounters:
    """Of one node."""

    tec: int = 0
    """Transmit error counter."""
    rec: int = 0
    """Receive error counter."""
    off: bool = False

    @property
    def state(self) -> ErrorState:
        if self.off:
            return ErrorState.OFF
        if self.tec >= PASSIVE_FROM or self.rec >= PASSIVE_FROM:
            return ErrorState.PASSIVE
        return ErrorState.ACTIVE

    def sent(self) -> None:
        """A frame of its own came through."""
        self.tec = max(0, self.tec - 1)

    def heard(self) -> None:
        """A frame of another node came through."""
        if self.rec >= PASSIVE_FROM:
            self.rec = REC_AFTER_PASSIVE
        else:
            self.rec = max(0, self.rec - 1)

    def sending_failed(self) -> None:
        """It saw an error in a frame of its own and sent an error flag."""
        self.tec += ERROR_STEP
        self.off = self.tec >= OFF_FROM

    def nobody_acknowledged(self) -> None:
        """The one error that a passive sender does not count: it may be alone on the bus."""
        if self.state is ErrorState.ACTIVE:
            self.sending_failed()

    def hearing_failed(self) -> None:
        """It saw an error in a frame of another node, and not as the first to see it."""
        self.rec = min(REC_MOST, self.rec + 1)

    def recovered(self) -> None:
        self.tec = self.rec = 0
        self.off = False


@dataclass(frozen=True, slots=True)
class WireFrame:
    """A classic frame with an 11-bit identifier, bit by bit."""

    bits: Bits
    """From start of frame to end of frame, acknowledged, without the intermission."""
    payload_bytes: int
    first: int
    """Bit at which the data field begins."""
    last: int
    """Last bit of the CRC sequence, or the stuff bit behind it."""


def wire_frame(can_id: int, data: bytes) -> WireFrame:
    """What a sender puts on the wire."""
    head = [0, *_bits_of(can_id, 11), 0, 0, 0, *_bits_of(len(data), 4)]
    content = head + [bit for byte in data for bit in _bits_of(byte, 8)]
    content += _bits_of(_crc(content), CRC_BITS)
    stuffed: list[int] = []
    first = run = 0
    for index, bit in enumerate(content):
        if index == HEAD_BITS:
            first = len(stuffed)
        run = run + 1 if stuffed and stuffed[-1] == bit else 1
        stuffed.append(bit)
        if run == STUFF_RUN:
            stuffed.append(1 - bit)
            run = 1
    last = len(stuffed) - 1
    # CRC delimiter, acknowledge slot and delimiter, end of frame.
    return WireFrame((*stuffed, 1, 0, 1, *[1] * END_BITS), len(data), first, last)


class Receiver:
    """What every listening node makes of the bits on the wire: it finds the error or it does not.

    It knows the frame's length, so the bits up to the data field must be sound.
    """

    def __init__(self, payload_bytes: int) -> None:
        self._content: list[int] = []
        self._wanted = HEAD_BITS + 8 * payload_bytes + CRC_BITS
        self._run = 0
        self._value = 1
        self._stuff_next = False
        self._tail = 0

    def sees_error(self, bit: int) -> bool:
        """Takes the next bit; whether this is the one at which an error shows."""
        if len(self._content) < self._wanted or self._stuff_next:
            return self._stuff_error(bit)
        self._tail += 1
        if self._tail == 2:
            # The acknowledge slot: a receiver accepts both.
            return False
        if bit == 0:
            return True
        # A wrong CRC is told behind the acknowledge delimiter.
        return self._tail == 3 and _crc(self._content) != 0

    def _stuff_error(self, bit: int) -> bool:
        if self._stuff_next:
            self._stuff_next = False
            if bit == self._value:
                return True
            self._value, self._run = bit, 1
            return False
        self._run = self._run + 1 if bit == self._value and self._content else 1
        self._value = bit
        self._content.append(bit)
        self._stuff_next = self._run == STUFF_RUN
        return False


def destroyed_bits(
    frame: WireFrame, at_bit: int, *, sender_passive: bool, hearers_active: bool
) -> int:
    """Bus time of a frame of which one bit is inverted for all, up to where the next may start.

    The sender sees its bit wrong and sends its flag from the next bit on; the receivers see the
    error in that bit, or in the flag, and send theirs from the bit after. Then come the error
    delimiter and the intermission.

    Args:
        at_bit: in the data field or the CRC sequence: `frame.first` to `frame.last`.
        sender_passive: its flag is recessive, so that only those of the receivers are seen.
        hearers_active: whether the flag of at least one receiver is dominant.
    """
    assert frame.first <= at_bit <= frame.last, f"bit {at_bit} is not within data or CRC"
    receiver = Receiver(frame.payload_bytes)
    for bit in frame.bits[:at_bit]:
        assert not receiver.sees_error(bit)
    flag = 0
    if not receiver.sees_error(1 - frame.bits[at_bit]):
        flag = _until_seen(receiver, int(sender_passive))
    length = max(FLAG_BITS, flag + FLAG_BITS if hearers_active else 0)
    return at_bit + 1 + length + DELIMITER_BITS + INTERMISSION_BITS


def abandoned_bits(frame: WireFrame, at_bit: int, *, hearers_active: bool) -> int:
    """The same for a frame whose sender is gone from `at_bit` on: the wire stays recessive."""
    receiver = Receiver(frame.payload_bytes)
    for bit in frame.bits[:at_bit]:
        assert not receiver.sees_error(bit)
    seen = _until_seen(receiver, 1)
    length = seen + (FLAG_BITS if hearers_active else 0)
    return at_bit + length + DELIMITER_BITS + INTERMISSION_BITS


def unacknowledged_bits(frame_bits: int) -> int:
    """The same for a frame that nobody hears: the sender alone sends a flag, of either kind.

    Args:
        frame_bits: of the frame when it is heard, intermission included.
    """
    # Instead of acknowledge delimiter and end of frame: flag and error delimiter.
    return frame_bits - 1 - END_BITS + FLAG_BITS + DELIMITER_BITS


def error_frame(end_ns: int, errors: ErrorCounters, acknowledged: bool) -> CanFrame:
    """An error frame as Linux shows it, with the counters of the sender."""
    can_id = (ERROR_PROTOCOL if acknowledged else ERROR_ACKNOWLEDGE) | ERROR_COUNTERS
    if errors.off:
        can_id |= ERROR_BUS_OFF
    data = bytearray(8)
    data[2] = PROTOCOL_BIT | PROTOCOL_SENDING if acknowledged else 0
    data[6:] = min(errors.tec, COUNTER_MOST), min(errors.rec, COUNTER_MOST)
    return CanFrame(end_ns, can_id, bytes(data), error=True)


def _until_seen(receiver: Receiver, bit: int) -> int:
    """So many equal bits until the receiver sees an error."""
    count = 1
    while not receiver.sees_error(bit):
        count += 1
    return count


def _crc(bits: Bits) -> int:
    """Of a frame's content; 0 when its own CRC is run in behind it."""
    crc = 0
    for bit in bits:
        flip = crc >> (CRC_BITS - 1) ^ bit
        crc = (crc << 1 ^ (CRC_POLYNOMIAL if flip else 0)) & ((1 << CRC_BITS) - 1)
    return crc


def _bits_of(value: int, width: int) -> list[int]:
    return [value >> place & 1 for place in reversed(range(width))]
