"""Duration of a classic CAN frame on the bus in bits, stuff bits included.

From the start of frame to the end of the CRC the sender inserts a bit of opposite value after five
equal ones. Their number depends on all bits before, including the CRC, so the exact length needs
both. The frame is processed byte by byte: one table gives the number of stuff bits of a byte and
the next stuffing state, a second one continues the CRC. Tables for longer words would need fewer
steps, but they fill a processor's cache, so that each step would wait for memory.
"""

from functools import lru_cache
from typing import Final

INTERMISSION_BITS: Final = 3
"""Idle bits after every frame, in which no other frame may start."""
TRAILER_BITS: Final = 10 + INTERMISSION_BITS
"""CRC delimiter, acknowledge slot and delimiter, end of frame (7), intermission: never stuffed."""
MAX_STANDARD_ID: Final = 0x7FF
MAX_EXTENDED_ID: Final = 0x1FFF_FFFF
MAX_DATA_BYTES: Final = 8
LONGEST_FRAME_BITS: Final = 160
"""Longest frame: 29-bit identifier, eight bytes, 29 stuff bits."""

_CRC_BITS: Final = 15
_CRC_POLYNOMIAL: Final = 0x4599
_CRC_MASK: Final = 0x7FFF
_STUFF_LIMIT: Final = 5
# A stuffing state is the value of the last bit and the length of its run, 1 to 4 (the stuff bit
# turns a run of five into a run of one), packed into three bits: value * 4 + (run - 1).
_STATES: Final = 8
_STATE_MASK: Final = _STATES - 1
_COUNT_SHIFT: Final = 3
# Before the start of frame the bus is recessive and nothing is counted. The start of frame, always
# dominant, is the first bit of the first run.
_STATE_AFTER_START: Final = 0


def frame_bits(can_id: int, data: bytes, extended: bool = False, remote: bool = False) -> int:
    """Return the bits from start of frame to the end of the intermission.

    Args:
        can_id: 11 bits, or 29 if `extended`.
        data: at most eight bytes. A remote frame carries only their number, not their values.

    Raises:
        ValueError: for an identifier or data that no classic frame can carry.
    """
    length = len(data)
    if extended or remote:
        return _uncommon_frame_bits(can_id, data, extended, remote)
    head = _HEADS.get(can_id << 4 | length)
    if head is None or length > MAX_DATA_BYTES:
        head = _remember_head(can_id, length)
    bits, state, crc = head
    return _finish(bits, state, crc, data)


def _finish(bits: int, state: int, crc: int, data: bytes) -> int:
    """Return the bits of a frame from those up to the data field and the two states there."""
    for byte in data:
        step = _STUFF_8[(state & _STATE_MASK) << 8 | byte]
        bits += step >> _COUNT_SHIFT
        state = step
        top = crc >> 7 ^ byte
        crc = (crc << 8 & _CRC_MASK) ^ (_CRC_8_HIGH[top] << 8 | _CRC_8_LOW[top])
    high = _STUFF_7[(state & _STATE_MASK) << 7 | crc >> 8]
    low = _STUFF_8[(high & _STATE_MASK) << 8 | crc & 0xFF]
    return bits + (high >> _COUNT_SHIFT) + (low >> _COUNT_SHIFT)


def _uncommon_frame_bits(can_id: int, data: bytes, extended: bool, remote: bool) -> int:
    bits, state, crc = _head(can_id, len(data), extended, remote)
    return _finish(bits, state, crc, b"" if remote else data)


def _remember_head(can_id: int, length: int) -> tuple[int, int, int]:
    head = _head(can_id, length, extended=False, remote=False)
    _HEADS[can_id << 4 | length] = head
    return head


@lru_cache(maxsize=4096)
def _head(can_id: int, length: int, extended: bool, remote: bool) -> tuple[int, int, int]:
    """Compute the part before the data field.

    Returns:
        The frame's length without the stuff bits of data and CRC; the stuffing state; the CRC so
            far.
    """
    header = _header_bits(can_id, length, extended, remote)
    state, stuffed, crc = _STATE_AFTER_START, 0, 0
    for bit in header:
        state, inserted = _stuff_step(state, bit)
        stuffed += inserted
        crc = _crc_step(crc, bit)
    payload_bits = 0 if remote else 8 * length
    start_bits = 1
    bits = start_bits + len(header) + stuffed + payload_bits + _CRC_BITS + TRAILER_BITS
    return bits, state, crc


def _header_bits(can_id: int, length: int, extended: bool, remote: bool) -> list[int]:
    """Return arbitration and control field, first bit first, without the start of frame."""
    if not 0 <= length <= MAX_DATA_BYTES:
        raise ValueError(
            f"frame {can_id:#x}: {length} bytes where a classic frame carries at most 8"
        )
    limit = MAX_EXTENDED_ID if extended else MAX_STANDARD_ID
    if not 0 <= can_id <= limit:
        raise ValueError(f"frame {can_id:#x}: identifier outside 0..{limit:#x}")
    request = int(remote)
    if not extended:
        return [*_bits_of(can_id, 11), request, 0, 0, *_bits_of(length, 4)]
    base, extension = can_id >> 18, can_id & 0x3FFFF
    # Substitute remote request and identifier extension are recessive.
    start = [*_bits_of(base, 11), 1, 1, *_bits_of(extension, 18)]
    return [*start, request, 0, 0, *_bits_of(length, 4)]


def _bits_of(value: int, width: int) -> list[int]:
    return [value >> place & 1 for place in reversed(range(width))]


def _stuff_step(state: int, bit: int) -> tuple[int, int]:
    """Return the state after one bit, and whether a stuff bit follows it."""
    value, run = state >> 2, (state & 3) + 1
    run = run + 1 if bit == value else 1
    if run == _STUFF_LIMIT:
        return (1 - bit) << 2, 1
    return bit << 2 | (run - 1), 0


def _crc_step(crc: int, bit: int) -> int:
    flip = (crc >> (_CRC_BITS - 1)) ^ bit
    return (crc << 1 ^ (_CRC_POLYNOMIAL if flip else 0)) & _CRC_MASK


def _stuff_table(width: int) -> bytes:
    """Return the table; entry `state << width | word` is: stuff bits << 3 | next state."""
    table = bytearray()
    for start in range(_STATES):
        for word in range(1 << width):
            state, count = start, 0
            for bit in _bits_of(word, width):
                state, inserted = _stuff_step(state, bit)
                count += inserted
            table.append(count << _COUNT_SHIFT | state)
    return bytes(table)


def _crc_table() -> list[int]:
    """Return the table of the CRC of one byte, starting from zero."""
    table = []
    for byte in range(256):
        crc = 0
        for bit in _bits_of(byte, 8):
            crc = _crc_step(crc, bit)
        table.append(crc)
    return table


_HEADS: Final[dict[int, tuple[int, int, int]]] = {}
"""Cache for 11-bit data frames; at most 2048 identifiers times nine lengths."""
_STUFF_7: Final = _stuff_table(7)
_STUFF_8: Final = _stuff_table(8)
_CRC_8_HIGH: Final = bytes(crc >> 8 for crc in _crc_table())
_CRC_8_LOW: Final = bytes(crc & 0xFF for crc in _crc_table())
