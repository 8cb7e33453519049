"""Finds the objects of a BLF file and turns them into columns, one kind at a time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from canlog.frames import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    FD,
    FD_BYTES,
    FD_LENGTHS,
    REMOTE,
    TX,
    Bytes,
)

SIGNATURE: Final = b"LOBJ"
BASE: Final = np.dtype(
    [("signature", "S4"), ("head", "<u2"), ("version", "<u2"), ("size", "<u4"), ("kind", "<u4")]
)
STAMPS: Final = [("unit", "<u4"), ("client", "<u2"), ("revision", "<u2"), ("stamp", "<u8")]
"""Header fields that both versions share; version 2 has eight more bytes after them."""
HEADS: Final = (32, 40)
"""Size in bytes of each version of the header, base included."""
CAN_MESSAGE, CAN_ERROR, CONTAINER, CAN_ERROR_EXT = 1, 2, 10, 73
CAN_MESSAGE2, CAN_FD, CAN_FD_64, CAN_FD_ERROR_64 = 86, 100, 101, 104
EXTENDED_BIT: Final = 0x8000_0000
TEN_US: Final = 1
STAMP_MAX: Final = 1 << 62
LAYOUTS: Final[dict[int, Any]] = {
    CAN_MESSAGE: [
        ("channel", "<u2"),
        ("flags", "u1"),
        ("dlc", "u1"),
        ("id", "<u4"),
        ("data", "<u8"),
    ],
    CAN_ERROR: [("channel", "<u2"), ("length", "<u2")],
    CAN_ERROR_EXT: [
        *[("channel", "<u2"), ("length", "<u2"), ("flags", "<u4"), ("ecc", "u1")],
        *[("position", "u1"), ("dlc", "u1"), ("pad", "u1"), ("frame_ns", "<u4"), ("id", "<u4")],
        *[("more", "<u2"), ("pad2", "<u2"), ("data", "<u8")],
    ],
    CAN_FD: [
        *[("channel", "<u2"), ("flags", "u1"), ("dlc", "u1"), ("id", "<u4"), ("frame_ns", "<u4")],
        *[("bits", "u1"), ("fd", "u1"), ("length", "u1"), ("pad", "u1", 5), ("data", "u1", 64)],
    ],
    CAN_FD_64: [
        *[("channel", "u1"), ("dlc", "u1"), ("length", "u1"), ("tries", "u1"), ("id", "<u4")],
        *[("frame_ns", "<u4"), ("flags", "<u4"), ("rate", "<u4"), ("fast", "<u4")],
        *[("brs_ns", "<u4"), ("crc_ns", "<u4"), ("bits", "<u2"), ("sent", "u1"), ("ext", "u1")],
        ("crc", "<u4"),
    ],
    CAN_FD_ERROR_64: [
        *[("channel", "u1"), ("dlc", "u1"), ("length", "u1"), ("ecc", "u1"), ("flags", "<u2")],
        *[("code", "<u2"), ("more", "<u2"), ("ext", "u1"), ("pad", "u1"), ("id", "<u4")],
        *[("frame_ns", "<u4"), ("rate", "<u4"), ("fast", "<u4"), ("brs_ns", "<u4")],
        *[("crc_ns", "<u4"), ("crc", "<u4"), ("position", "<u2"), ("pad2", "<u2")],
    ],
}
LAYOUTS[CAN_MESSAGE2] = LAYOUTS[CAN_MESSAGE]
_DLC_LENGTH: Final = np.array([*FD_LENGTHS, *([64] * 240)], np.uint8)
_MASKS: Final = np.array([(1 << 8 * n) - 1 for n in range(9)], np.uint64)


@dataclass(frozen=True, slots=True)
class BlfObjects:
    """Positions of complete objects in a buffer."""

    at: Any
    """(n,) int64: offset of each object in the buffer."""
    size: Any
    kind: Any
    head: Any
    version: Any
    consumed: int
    """Bytes that are done; the rest waits for the next container."""
    damage: tuple[tuple[int, str], ...]
    """Place and description of each spot where no object begins."""


def find(buffer: bytes, start: int = 0) -> BlfObjects:
    """Walk from object to object; a run of objects of one size is one step."""
    text = np.frombuffer(buffer, np.uint8)
    parts: list[Any] = []
    damage: list[tuple[int, str]] = []
    at, end = start, len(buffer)
    while True:
        found = buffer.find(SIGNATURE, at, at + 8)
        if found < 0:
            if end - at < 16:
                break
            following = buffer.find(SIGNATURE, at)
            damage.append((at, "no object begins here"))
            if following < 0:
                # The end of the container may cut the signature in two.
                at = end - 3
                break
            at = following
            continue
        if end - found < BASE.itemsize:
            at = found
            break
        size = int.from_bytes(buffer[found + 8 : found + 12], "little")
        if size < BASE.itemsize:
            damage.append((found, f"an object of {size} bytes"))
            at = found + 4
            continue
        if size > end - found:
            nearer = buffer.find(SIGNATURE, found + 4)
            if nearer >= 0 and _is_object(buffer, nearer):
                damage.append((found, f"an object of {size} bytes reaches over the next"))
                at = nearer
                continue
            at = found
            break
        following = buffer.find(SIGNATURE, found + size, found + size + 8)
        stride = following - found if following >= 0 else size
        run, at = _run(text, found, size, stride)
        parts.append(run)
    places = np.concatenate(parts) if parts else np.zeros(0, np.int64)
    base = (
        _gather(text, places, BASE.itemsize).view(BASE)[:, 0] if len(places) else np.zeros(0, BASE)
    )
    return BlfObjects(
        places, base["size"], base["kind"], base["head"], base["version"], at, tuple(damage)
    )


def _is_object(buffer: bytes, at: int) -> bool:
    head = int.from_bytes(buffer[at + 4 : at + 6], "little")
    version = int.from_bytes(buffer[at + 6 : at + 8], "little")
    return version in (1, 2) and head in (16, 32, 40)


def _run(text: Bytes, at: int, size: int, stride: int) -> tuple[Any, int]:
    """Return the places of the objects of this size, `stride` apart, and the end of the last one.

    Writers add up to four fill bytes, or none; the next signature shows how many.
    """
    count = (len(text) - at - size) // stride + 1
    if count < 2:
        return np.array([at], np.int64), at + size
    rows = np.lib.stride_tricks.as_strided(text[at:], (count, 12), (stride, 1), writeable=False)
    first = np.array([*SIGNATURE, *size.to_bytes(4, "little")], np.uint8)
    alike = (rows[:, [0, 1, 2, 3, 8, 9, 10, 11]] == first).all(axis=1)
    length = count if alike.all() else max(1, int(alike.argmin()))
    return at + stride * np.arange(length, dtype=np.int64), at + stride * (length - 1) + size


def _gather(text: Bytes, places: Any, width: int) -> Bytes:
    """(n, width) bytes from each place on; evenly spaced places are gathered faster."""
    stride = int(places[1] - places[0]) if len(places) > 1 else width
    if len(places) > 1 and stride >= width and (np.diff(places) == stride).all():
        rows = np.lib.stride_tricks.as_strided(
            text[int(places[0]) :], (len(places), width), (stride, 1), writeable=False
        )
        return np.ascontiguousarray(rows)
    scattered: Bytes = np.lib.stride_tricks.sliding_window_view(text, width)[places]
    return scattered


@dataclass(frozen=True, slots=True)
class BlfColumns:
    """Frames of one kind of object as columns; `row` is each frame's index among all objects."""

    row: Any
    stamp_ns: Any
    identifier: Any
    flags: Any
    channel: Any
    length: Any
    data: Bytes


def columns(buffer: bytes, objects: BlfObjects) -> tuple[list[BlfColumns], Any, int]:
    """Return the frames, the places of malformed CAN objects, and the number of other objects.

    Other objects are, for instance, those of other buses.
    """
    text = np.frombuffer(buffer, np.uint8)
    found: list[BlfColumns] = []
    known = np.isin(objects.kind, list(_TAKERS))
    foreign = int((~known & (objects.kind != CONTAINER)).sum())
    for kind in np.unique(objects.kind).tolist():
        take = _TAKERS.get(kind)
        for head in HEADS if take else ():
            rows = np.flatnonzero((objects.kind == kind) & (objects.head == head))
            more = head - HEADS[0]
            layout = np.dtype([*STAMPS, *([("more_", "u1", more)] if more else []), *LAYOUTS[kind]])
            rows = rows[objects.size[rows] >= BASE.itemsize + layout.itemsize - _slack(kind)]
            places = objects.at[rows] + BASE.itemsize
            inside = places + layout.itemsize <= len(text)
            if not inside.all():
                text = np.concatenate([text, np.zeros(layout.itemsize, np.uint8)])
            if len(rows) and take:
                told = _gather(text, places, layout.itemsize).view(layout)[:, 0]
                found.append(take(rows, told, text, places + layout.itemsize, objects.size[rows]))
                known[rows] = False
    return found, objects.at[known], foreign


def _slack(kind: int) -> int:
    """Bytes that may be missing at the end of an object: CAN FD may end with its data."""
    return FD_BYTES if kind == CAN_FD else 0


def _stamps(told: Any) -> Any:
    """(n,) int64 nanoseconds since the start of the log, -1 for an invalid stamp."""
    stamp = told["stamp"]
    coarse = told["unit"] == TEN_US
    limit = np.where(coarse, STAMP_MAX // 10_000, STAMP_MAX).astype(np.uint64)
    good = stamp <= limit
    factor = np.where(coarse, 10_000, 1)
    return np.where(good, np.where(good, stamp, 0).astype(np.int64) * factor, -1)


def _identifier(told: Any) -> tuple[Any, Any]:
    wide = told["id"]
    extended = (wide & np.uint32(EXTENDED_BIT)) != 0
    return wide & np.uint32(0x1FFF_FFFF), extended * np.uint8(EXTENDED)


def _words(data: Any, length: Any) -> Bytes:
    """(n, 8): the first `length` bytes; bytes after them have no meaning and become 0."""
    cut = np.ascontiguousarray(data) & _MASKS[length]
    rows: Bytes = cut.astype("<u8").view(np.uint8).reshape(-1, 8)
    return rows


def _message(rows: Any, told: Any, text: Bytes, ends: Any, sizes: Any) -> BlfColumns:
    del text, ends, sizes
    identifier, flags = _identifier(told)
    remote = (told["flags"] & 0x80) != 0
    flags = flags | remote * np.uint8(REMOTE) | (told["flags"] & 1) * np.uint8(TX)
    length = np.minimum(told["dlc"], np.uint8(8))
    data = _words(told["data"], np.where(remote, 0, length))
    return BlfColumns(rows, _stamps(told), identifier, flags, told["channel"], length, data)


def _error(rows: Any, told: Any, text: Bytes, ends: Any, sizes: Any) -> BlfColumns:
    del text, ends, sizes
    n = len(rows)
    flags = np.full(n, ERROR, np.uint8)
    nothing = np.zeros(n, np.uint8)
    return BlfColumns(
        rows, _stamps(told), np.zeros(n, np.uint32), flags, told["channel"], nothing,
        np.zeros((n, 8), np.uint8),
    )  # fmt: skip


def _error_ext(rows: Any, told: Any, text: Bytes, ends: Any, sizes: Any) -> BlfColumns:
    del text, ends, sizes
    identifier, _ = _identifier(told)
    length = np.minimum(told["dlc"], np.uint8(8))
    flags = np.full(len(rows), ERROR, np.uint8)
    data = _words(told["data"], length)
    return BlfColumns(rows, _stamps(told), identifier, flags, told["channel"], length, data)


def _fd(rows: Any, told: Any, text: Bytes, ends: Any, sizes: Any) -> BlfColumns:
    del text, ends
    identifier, flags = _identifier(told)
    remote, fd = (told["flags"] & 0x80) != 0, told["fd"]
    flags = flags | remote * np.uint8(REMOTE) | (told["flags"] & 1) * np.uint8(TX)
    flags = flags | (fd & 1) * np.uint8(FD) | (fd >> 1 & 1) * np.uint8(BRS)
    flags = flags | (fd >> 2 & 1) * np.uint8(ESI)
    there = sizes.astype(np.int64) - (BASE.itemsize + told.dtype.itemsize - FD_BYTES)
    length = np.minimum(told["length"], np.uint8(FD_BYTES))
    length = np.where(remote, _DLC_LENGTH[told["dlc"]], length)
    shown = np.where(remote, 0, np.minimum(length, np.maximum(there, 0)))
    data = np.where(np.arange(FD_BYTES) < shown[:, None], told["data"], 0).astype(np.uint8)
    return BlfColumns(rows, _stamps(told), identifier, flags, told["channel"], length, data)


def _fd_64(rows: Any, told: Any, text: Bytes, ends: Any, sizes: Any) -> BlfColumns:
    identifier, flags = _identifier(told)
    bits = told["flags"]
    remote = (bits & 0x10) != 0
    flags = flags | remote * np.uint8(REMOTE) | (told["sent"] != 0) * np.uint8(TX)
    flags = flags | ((bits & 0x1000) != 0) * np.uint8(FD) | ((bits & 0x2000) != 0) * np.uint8(BRS)
    flags = flags | ((bits & 0x4000) != 0) * np.uint8(ESI)
    length = np.minimum(told["length"], np.uint8(FD_BYTES))
    length = np.where(remote, _DLC_LENGTH[told["dlc"]], length).astype(np.uint8)
    data = _behind(told, text, ends, sizes, np.where(remote, 0, length))
    return BlfColumns(rows, _stamps(told), identifier, flags, told["channel"], length, data)


def _fd_error_64(rows: Any, told: Any, text: Bytes, ends: Any, sizes: Any) -> BlfColumns:
    identifier, _ = _identifier(told)
    flags = np.full(len(rows), ERROR, np.uint8)
    length = np.minimum(told["length"], np.uint8(FD_BYTES))
    data = _behind(told, text, ends, sizes, length)
    return BlfColumns(rows, _stamps(told), identifier, flags, told["channel"], length, data)


def _behind(told: Any, text: Bytes, ends: Any, sizes: Any, length: Any) -> Bytes:
    """(n, 64): `length` bytes from `ends` on, up to the end of the object without its extension."""
    limit = np.where(told["ext"] != 0, np.minimum(told["ext"], sizes), sizes).astype(np.int64)
    there = np.clip(limit - BASE.itemsize - told.dtype.itemsize, 0, FD_BYTES)
    shown = np.minimum(length, there)
    padded = np.concatenate([text, np.zeros(FD_BYTES, np.uint8)])
    data: Bytes = np.lib.stride_tricks.sliding_window_view(padded, FD_BYTES)[ends].copy()
    data[np.arange(FD_BYTES) >= shown[:, None]] = 0
    return data


_TAKERS: Final[dict[int, Callable[..., BlfColumns]]] = {
    CAN_MESSAGE: _message,
    CAN_MESSAGE2: _message,
    CAN_ERROR: _error,
    CAN_ERROR_EXT: _error_ext,
    CAN_FD: _fd,
    CAN_FD_64: _fd_64,
    CAN_FD_ERROR_64: _fd_error_64,
}
