"""CAN operations of FMI-LS-BUS 1.0 as bytes. Pure."""

import enum
import struct
from collections.abc import Iterator
from typing import Final, NamedTuple

FORMAT_ERROR: Final = 0x01
CAN_TRANSMIT: Final = 0x10
CONFIRM: Final = 0x20
ARBITRATION_LOST: Final = 0x30
BUS_ERROR: Final = 0x31
CONFIGURATION: Final = 0x40
STATUS: Final = 0x41
WAKEUP: Final = 0x42
BIT_RATE: Final = 1
"""Kind of configuration: bit rate of classic CAN."""
OTHER_RATES: Final = (2, 3)
"""Kinds of configuration: bit rates of CAN FD and CAN XL."""
LOST_BEHAVIOUR: Final = 4
"""Kind of configuration: what the bus does with a frame that lost arbitration."""
BUFFER: Final = 1
DISCARD: Final = 2
REFUSED_BYTES_MAX: Final = 1000
"""Largest part of a refused operation that a Format Error returns."""
_HEAD: Final = struct.Struct("<II")
"""Code and length of an operation; the length counts these 8 bytes."""
_TRANSMIT: Final = struct.Struct("<IBBH")
"""Identifier, extended, remote, number of data bytes."""
_IDENTIFIER: Final = struct.Struct("<I")
_ERROR: Final = struct.Struct("<IBBB")
"""Identifier, code, flag, whether the receiver of the operation sent the frame."""


class BusErrorCode(enum.IntEnum):
    BIT = 1
    ACKNOWLEDGE = 5


class NodeStatus(enum.IntEnum):
    """What a node says about its error state."""

    ERROR_ACTIVE = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3


class BusOperation(NamedTuple):
    code: int
    content: bytes
    """The bytes after code and length."""

    def whole(self) -> bytes:
        """The operation as bytes."""
        return _operation(self.code, self.content)


class LsBusError(ValueError):
    """Bytes that are no operations; the text says why."""

    def __init__(self, text: str, refused: bytes) -> None:
        super().__init__(text)
        self.refused = refused


def _operation(code: int, content: bytes) -> bytes:
    return _HEAD.pack(code, _HEAD.size + len(content)) + content


def transmit(can_id: int, data: bytes) -> bytes:
    """Encode one classic frame with an 11-bit identifier."""
    return _operation(CAN_TRANSMIT, _TRANSMIT.pack(can_id, 0, 0, len(data)) + data)


def confirm(can_id: int) -> bytes:
    """Tell the sender that another node has acknowledged its frame."""
    return _operation(CONFIRM, _IDENTIFIER.pack(can_id))


def arbitration_lost(can_id: int) -> bytes:
    """Tell the sender that its frame lost arbitration and was discarded."""
    return _operation(ARBITRATION_LOST, _IDENTIFIER.pack(can_id))


def bus_error(can_id: int, code: BusErrorCode, *, sender: bool) -> bytes:
    """Tell a node that a frame was destroyed; its sender detects the error first."""
    return _operation(BUS_ERROR, _ERROR.pack(can_id, code, 1 if sender else 2, int(sender)))


def wakeup() -> bytes:
    return _operation(WAKEUP, b"")


def format_error(refused: bytes) -> bytes:
    """Return an operation to the node that sent it."""
    part = refused[:REFUSED_BYTES_MAX]
    return _operation(FORMAT_ERROR, struct.pack("<H", len(part)) + part)


def operations(data: bytes) -> Iterator[BusOperation]:
    """Split the content of a binary variable. Raises LsBusError."""
    at = 0
    while at < len(data):
        if len(data) - at < _HEAD.size:
            raise LsBusError(f"{len(data) - at} bytes are no operation", data[at:])
        code, length = _HEAD.unpack_from(data, at)
        if not _HEAD.size <= length <= len(data) - at:
            raise LsBusError(f"operation {code:#04x} has a length of {length}", data[at:])
        yield BusOperation(code, data[at + _HEAD.size : at + length])
        at += length


def frame_of(operation: BusOperation) -> tuple[int, bytes]:
    """Return identifier and data of a transmit operation. Raises LsBusError."""
    content = operation.content
    if len(content) < _TRANSMIT.size:
        raise _refused(operation, f"a frame of {len(content)} bytes has no head")
    can_id, extended, remote, length = _TRANSMIT.unpack_from(content)
    if extended or remote or can_id > 0x7FF:
        raise _refused(
            operation, f"frame {can_id:#x}: only data frames with 11-bit identifiers are known"
        )
    if length > 8 or length != len(content) - _TRANSMIT.size:
        raise _refused(operation, f"frame {can_id:#05x}: {length} bytes are announced")
    return can_id, content[_TRANSMIT.size :]


def configuration_of(operation: BusOperation) -> tuple[int, int]:
    """Return kind and value of a configuration. Raises LsBusError."""
    content = operation.content
    kind = content[0] if content else 0
    if kind in (BIT_RATE, *OTHER_RATES) and len(content) == 1 + _IDENTIFIER.size:
        rate = int(_IDENTIFIER.unpack_from(content, 1)[0])
        if rate > 0:
            return kind, rate
    elif kind == LOST_BEHAVIOUR and len(content) == 2 and content[1] in (BUFFER, DISCARD):
        return kind, content[1]
    raise _refused(operation, f"configuration {content.hex()} is unknown")


def status_of(operation: BusOperation) -> NodeStatus:
    """Return the error state that a node reports. Raises LsBusError."""
    content = operation.content
    if len(content) != 1 or content[0] not in set(NodeStatus):
        raise _refused(operation, f"status {content.hex()} is unknown")
    return NodeStatus(content[0])


def _refused(operation: BusOperation, text: str) -> LsBusError:
    return LsBusError(text, operation.whole())
