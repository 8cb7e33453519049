"""CAN operations of FMI-LS-BUS 1.0 as bytes. Pure."""

import struct
from collections.abc import Iterator
from typing import Final, NamedTuple

FORMAT_ERROR: Final = 0x01
CAN_TRANSMIT: Final = 0x10
CONFIRM: Final = 0x20
CONFIGURATION: Final = 0x40
STATUS: Final = 0x41
_HEAD: Final = struct.Struct("<II")
"""Code and length of an operation; the length counts these 8 bytes."""
_TRANSMIT: Final = struct.Struct("<IBBH")
"""Identifier, extended, remote, number of data bytes."""


class BusOperation(NamedTuple):
    code: int
    content: bytes
    """The bytes after code and length."""


class LsBusError(ValueError):
    """Bytes that are no operations; the text says why."""


def transmit(can_id: int, data: bytes) -> bytes:
    """Encode one classic frame with an 11-bit identifier."""
    content = _TRANSMIT.pack(can_id, 0, 0, len(data)) + data
    return _HEAD.pack(CAN_TRANSMIT, _HEAD.size + len(content)) + content


def operations(data: bytes) -> Iterator[BusOperation]:
    """Split the content of a binary variable. Raises LsBusError."""
    at = 0
    while at < len(data):
        if len(data) - at < _HEAD.size:
            raise LsBusError(f"{len(data) - at} bytes are no operation")
        code, length = _HEAD.unpack_from(data, at)
        if not _HEAD.size <= length <= len(data) - at:
            raise LsBusError(f"operation {code:#04x} has a length of {length}")
        yield BusOperation(code, data[at + _HEAD.size : at + length])
        at += length


def frame_of(operation: BusOperation) -> tuple[int, bytes]:
    """Return identifier and data of a transmit operation. Raises LsBusError."""
    content = operation.content
    if len(content) < _TRANSMIT.size:
        raise LsBusError(f"a frame of {len(content)} bytes has no head")
    can_id, extended, remote, length = _TRANSMIT.unpack_from(content)
    if extended or remote or can_id > 0x7FF:
        raise LsBusError(f"frame {can_id:#x}: only data frames with 11-bit identifiers are known")
    if length > 8 or length != len(content) - _TRANSMIT.size:
        raise LsBusError(f"frame {can_id:#05x}: {length} bytes are announced")
    return can_id, content[_TRANSMIT.size :]
