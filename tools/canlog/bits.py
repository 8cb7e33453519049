"""Exact bus time of frames in bits, stuff bits included, computed for whole columns.

ISO 11898-1: after five equal bits the sender inserts one of opposite value. In a classic frame bit
stuffing ends with the CRC, so the number of stuff bits depends on the CRC, too. In an FD frame it
ends with the data; the stuff count and the CRC then have fixed stuff bits at fixed places.
"""

import functools
from itertools import pairwise
from typing import Any, Final

import numpy as np

from canlog.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_LENGTHS,
    REMOTE,
    Bytes,
    Frames,
)

INTERMISSION_BITS: Final = 3
TRAILER_BITS: Final = 10 + INTERMISSION_BITS
"""CRC delimiter, acknowledge slot and delimiter, end of frame, intermission: never stuffed."""
CRC_BITS: Final = 15
CRC_MASK: Final = 0x7FFF
CRC_POLYNOMIAL: Final = 0x4599
ERROR_FRAME_BITS: Final = 6 + 8 + INTERMISSION_BITS
"""Minimum length of an error frame: flag, delimiter and intermission."""
FD_CRC_BITS: Final = {17: 4 + 17 + 6, 21: 4 + 21 + 7}
"""Bits of the stuff count, the CRC and their fixed stuff bits, by the length of the CRC."""
FD_SHORT_MAX: Final = 16
"""Longest data, in bytes, that an FD frame protects with the CRC of 17 bits."""


@functools.cache
def _stuff_table(width: int) -> Any:
    """Stuffing table for `width` bits at once.

    The index is `state << width | word`. An entry is `stuff bits << 3 | next state`; a state is
    `value * 4 + run - 1`.
    """
    state = np.repeat(np.arange(8), 1 << width)
    word = np.tile(np.arange(1 << width), 8)
    count = np.zeros_like(state)
    for place in reversed(range(width)):
        state, stuffed = _stuff(state, word >> place & 1)
        count += stuffed
    return (count << 3 | state).astype(np.uint8)


def _stuff(state: Any, bit: Any) -> tuple[Any, Any]:
    """Return the state after one bit, and 1 where a stuff bit follows it."""
    run = np.where(state >> 2 == bit, (state & 3) + 2, 1)
    full = run == 5
    return np.where(full, (1 - bit) << 2, bit << 2 | run - 1), full.astype(np.int64)


@functools.cache
def _crc_table(width: int) -> Any:
    """CRC-15 of every word of `width` bits."""
    word = np.arange(1 << width)
    crc = np.zeros(1 << width, np.int64)
    for place in reversed(range(width)):
        crc = _crc_step(crc, word >> place & 1)
    return crc.astype(np.uint16)


def _crc_step(crc: Any, bit: Any) -> Any:
    flip = crc >> (CRC_BITS - 1) & 1 ^ bit
    return (crc << 1 ^ np.where(flip, CRC_POLYNOMIAL, 0)) & CRC_MASK


@functools.cache
def _head(identifier: int, flags: int, length: int) -> tuple[int, int, int, int]:
    """Return the bits before the data at the nominal and the fast rate, stuffing state, and CRC.

    Both counts include stuff bits.
    """
    nominal, fast = _head_bits(identifier, flags, length)
    state, crc = np.int64(0), np.int64(0)
    # The start of frame is the first bit of the first run; the initial state already holds it.
    bits = [1, 0]
    for part, values in enumerate((nominal, fast)):
        for bit in values:
            state, stuffed = _stuff(state, np.int64(bit))
            crc = _crc_step(crc, np.int64(bit))
            bits[part] += 1 + int(stuffed)
    return bits[0], bits[1], int(state), int(crc)


def _head_bits(identifier: int, flags: int, length: int) -> tuple[list[int], list[int]]:
    """Return the bits between start of frame and data, before and after the switch of the rate."""
    code = _places(FD_LENGTHS.index(length) if length in FD_LENGTHS else length, 4)
    extended, remote = bool(flags & EXTENDED), int(bool(flags & REMOTE))
    start = _places(identifier >> 18, 11) if extended else _places(identifier, 11)
    if extended:
        start += [1, 1, *_places(identifier & 0x3FFFF, 18)]
    if not flags & FD:
        reserved = [remote, 0, 0]
        return [*start, *reserved, *code], []
    # Remote request substitution, for 11 bits also the identifier extension, FD format, reserved
    # bit.
    start += [0, 1, 0] if extended else [0, 0, 1, 0]
    switch, indicator = int(bool(flags & BRS)), int(bool(flags & ESI))
    return [*start, switch], [indicator, *code]


def _places(value: int, width: int) -> list[int]:
    return [value >> place & 1 for place in reversed(range(width))]


def equal_frame_bits(identifier: int, flags: int, length: int, data: Bytes) -> tuple[Any, Any]:
    """Return (n,) bits at the nominal and at the fast rate of frames that differ only in their
    data.

    Args:
        data: (n, >= length).
    """
    if flags & ERROR:
        return np.full(len(data), ERROR_FRAME_BITS, np.int64), np.zeros(len(data), np.int64)
    nominal, fast, state, crc = _head(
        identifier, flags & (EXTENDED | REMOTE | FD | BRS | ESI), length
    )
    size = 0 if flags & REMOTE else length
    stuffed, states, crcs = _data_part(data[:, :size], state, crc, with_crc=not flags & FD)
    if not flags & FD:
        last = _stuff_table(CRC_BITS)[states.astype(np.uint32) << np.uint32(CRC_BITS) | crcs]
        stuffed = stuffed + (last >> np.uint8(3))
        fixed = nominal + 8 * size + CRC_BITS + TRAILER_BITS
        return stuffed.astype(np.int64) + fixed, np.zeros(len(data), np.int64)
    checked = FD_CRC_BITS[17 if length <= FD_SHORT_MAX else 21]
    rest = stuffed.astype(np.int64) + fast + 8 * size + checked
    if flags & BRS:
        # The CRC delimiter is still sent at the fast rate.
        return np.full(len(data), nominal + TRAILER_BITS - 1, np.int64), rest + 1
    return rest + nominal + TRAILER_BITS, np.zeros(len(data), np.int64)


def _data_part(data: Bytes, state: int, crc: int, *, with_crc: bool) -> tuple[Any, Any, Any]:
    """Return stuff bits of the data, the stuffing state after it, and the CRC.

    It takes two bytes at a time.
    """
    n, size = data.shape
    stuffed = np.zeros(n, np.uint16)
    states = np.full(n, state, np.uint8)
    crcs = np.full(n, crc, np.uint32)
    at = 0
    while at < size:
        wide = size - at >= 2
        width = 16 if wide else 8
        word = data[:, at].astype(np.uint32)
        if wide:
            word = word << np.uint32(8) | data[:, at + 1]
        step = _stuff_table(width)[states.astype(np.uint32) << np.uint32(width) | word]
        stuffed += step >> np.uint8(3)
        states = step & np.uint8(7)
        if with_crc:
            crcs = _next_crc(crcs, word, width)
        at += width // 8
    return stuffed, states, crcs


def _next_crc(crc: Any, word: Any, width: int) -> Any:
    mask = np.uint32((1 << width) - 1)
    shift = CRC_BITS - width
    high = crc >> np.uint32(shift) if shift > 0 else crc << np.uint32(-shift)
    rest = crc << np.uint32(width) & np.uint32(CRC_MASK) if shift > 0 else np.uint32(0)
    return _crc_table(width)[(high ^ word) & mask].astype(np.uint32) ^ rest


def frame_bits(frames: Frames) -> tuple[Any, Any]:
    """Return (n,) bits of every frame at the nominal and at the fast rate, with intermission."""
    nominal, fast = np.zeros(len(frames), np.int64), np.zeros(len(frames), np.int64)
    kind = (
        frames.identifier.astype(np.uint64) << np.uint64(16)
        | frames.flags.astype(np.uint64) << np.uint64(8)
        | frames.length
    )
    order = np.argsort(kind, kind="stable")
    firsts = np.flatnonzero(np.diff(kind[order], prepend=np.uint64(1 << 63)))
    for first, last in pairwise([*firsts.tolist(), len(order)]):
        rows = order[first:last]
        row = rows[0]
        nominal[rows], fast[rows] = equal_frame_bits(
            int(frames.identifier[row]), int(frames.flags[row]), int(frames.length[row]),
            frames.data[rows],
        )  # fmt: skip
    return nominal, fast
