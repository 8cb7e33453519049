"""Error confinement of [ISO 11898]: error counters of a node, and lengths of error frames.

A dominant bit is 0, a recessive one 1. Bits count from the start of frame, stuff bits included.
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
"""Increase of the transmit error counter for a destroyed frame."""
REC_MOST: Final = 255
REC_AFTER_PASSIVE: Final = 127
"""Value of a passive receiver's counter after a good frame; the standard permits 119 to 127."""
FLAG_BITS: Final = 6
DELIMITER_BITS: Final = 8
SUSPEND_BITS: Final = 8
"""Additional wait of an error-passive node after its own frame before it starts another."""
RECOVERY_SEQUENCES: Final = 128
RECOVERY_SEQUENCE_BITS: Final = 11
RECOVERY_BITS: Final = RECOVERY_SEQUENCES * RECOVERY_SEQUENCE_BITS
"""Recovery time on an idle bus."""

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
"""Identifier and data fields of an error frame as in linux/can/error.h."""

Bits = Sequence[int]


class ErrorState(enum.Enum):
    ACTIVE = "error active"
    PASSIVE = "error passive"
    OFF = "bus off"


@dataclass(slots=True)
class ErrorCounters:
    """Error counters of one node."""

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
        """Count a transmitted frame."""
        self.tec = max(0, self.tec - 1)

    def heard(self) -> None:
        """Count a received frame."""
        if self.rec >= PASSIVE_FROM:
            self.rec = REC_AFTER_PASSIVE
        else:
            self.rec = max(0, self.rec - 1)

    def sending_failed(self) -> None:
        """Count an error in the node's own frame, for which it sent an error flag."""
        self.tec += ERROR_STEP
        self.off = self.tec >= OFF_FROM

    def nobody_acknowledged(self) -> None:
        """Count a missing acknowledgement.

        A passive sender does not count it, because it may be alone on the bus.
        """
        if self.state is ErrorState.ACTIVE:
            self.sending_failed()

    def hearing_failed(self) -> None:
        """Count an error in another node's frame that this node was not the first to detect."""
        self.rec = min(REC_MOST, self.rec + 1)

    def recovered(self) -> None:
        self.tec = self.rec = 0
        self.off = False


@dataclass(frozen=True, slots=True)
class WireFrame:
    """A classic frame with an 11-bit identifier, bit by bit."""

    bits: Bits
    """Bits from start of frame to end of frame, acknowledged, without the intermission."""
    payload_bytes: int
    first: int
    """Index of the first bit of the data field."""
    last: int
    """Index of the last bit of the CRC sequence, or of the stuff bit behind it."""


def wire_frame(can_id: int, data: bytes) -> WireFrame:
    """Return the bits that a sender puts on the wire."""
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
    """A receiving node: it evaluates the bits on the wire and detects errors.

    It is given the frame's length, so the bits up to the data field must be correct.
    """

    def __init__(self, payload_bytes: int) -> None:
        self._content: list[int] = []
        self._wanted = HEAD_BITS + 8 * payload_bytes + CRC_BITS
        self._run = 0
        self._value = 1
        self._stuff_next = False
        self._tail = 0

    def sees_error(self, bit: int) -> bool:
        """Process the next bit and return whether it reveals an error."""
        if len(self._content) < self._wanted or self._stuff_next:
            return self._stuff_error(bit)
        self._tail += 1
        if self._tail == 2:
            # In the acknowledge slot a receiver accepts both values.
            return False
        if bit == 0:
            return True
        # A wrong CRC is signalled behind the acknowledge delimiter.
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
    """Return the bus time of a frame with one bit inverted for all nodes, up to the next possible
    start.

    The sender sees its bit wrong and sends its flag from the next bit on. The receivers detect the
    error in that bit or in the flag and send their flags from the bit after it. Error delimiter and
    intermission follow.

    Args:
        at_bit: in the data field or the CRC sequence: `frame.first` to `frame.last`.
        sender_passive: the sender's flag is recessive, so only the receivers' flags are visible.
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
    """Return the same for a frame whose sender is lost from `at_bit` on, so that the wire stays
    recessive.
    """
    receiver = Receiver(frame.payload_bytes)
    for bit in frame.bits[:at_bit]:
        assert not receiver.sees_error(bit)
    seen = _until_seen(receiver, 1)
    length = seen + (FLAG_BITS if hearers_active else 0)
    return at_bit + length + DELIMITER_BITS + INTERMISSION_BITS


def unacknowledged_bits(frame_bits: int) -> int:
    """Return the same for a frame without receivers: only the sender sends a flag, active or
    passive.

    Args:
        frame_bits: length of the frame with receivers, intermission included.
    """
    # Flag and error delimiter replace the acknowledge delimiter and the end of frame.
    return frame_bits - 1 - END_BITS + FLAG_BITS + DELIMITER_BITS


def error_frame(end_ns: int, errors: ErrorCounters, acknowledged: bool) -> CanFrame:
    """Build an error frame in the layout of Linux, with the sender's counters."""
    can_id = (ERROR_PROTOCOL if acknowledged else ERROR_ACKNOWLEDGE) | ERROR_COUNTERS
    if errors.off:
        can_id |= ERROR_BUS_OFF
    data = bytearray(8)
    data[2] = PROTOCOL_BIT | PROTOCOL_SENDING if acknowledged else 0
    data[6:] = min(errors.tec, COUNTER_MOST), min(errors.rec, COUNTER_MOST)
    return CanFrame(end_ns, can_id, bytes(data), error=True)


def _until_seen(receiver: Receiver, bit: int) -> int:
    """Return the number of equal bits until the receiver detects an error."""
    count = 1
    while not receiver.sees_error(bit):
        count += 1
    return count


def _crc(bits: Bits) -> int:
    """CRC of a frame's content; 0 if the content includes its own CRC."""
    crc = 0
    for bit in bits:
        flip = crc >> (CRC_BITS - 1) ^ bit
        crc = (crc << 1 ^ (CRC_POLYNOMIAL if flip else 0)) & ((1 << CRC_BITS) - 1)
    return crc


def _bits_of(value: int, width: int) -> list[int]:
    return [value >> place & 1 for place in reversed(range(width))]
