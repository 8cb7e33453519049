"""The binary form of the messages between a bench in virtual time and a controller.

A controller asks for it in `ready`. Every later message is then a record instead of a line of JSON,
with the same content. `docs/reference/lockstep_interface.md` has the bytes.
"""

import struct
from collections.abc import Iterable
from typing import Final

from firmware_py.grants import Answer, GrantProtocolError, checked_key
from firmware_py.handed_ports import SentOutputs
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk

GRANT: Final = 1
STOP: Final = 2
YIELD: Final = 3
RECORD_BYTES_MAX: Final = 1 << 20
STANDARD_ID_MAX: Final = 0x7FF
FRAME_BYTES_MAX: Final = 8

_SIZE: Final = struct.Struct("<I")
_GRANT: Final = struct.Struct("<IBqHHH")
_STOP: Final = struct.Struct("<IBq")
_YIELD: Final = struct.Struct("<BqqHHH")
_HEARD_FRAME: Final = struct.Struct("<qHB8s")
_SENT_FRAME: Final = struct.Struct("<HB8s")
_HEARD_CHUNK: Final = struct.Struct("<qI")
_SENT_CHUNK: Final = struct.Struct("<I")
_HEARD_MESSAGE: Final = struct.Struct("<qHI")
_SENT_MESSAGE: Final = struct.Struct("<HI")


class BinaryForm:
    """Records with little-endian numbers. Each begins with its length, without these four bytes."""

    def grant(
        self,
        now_ns: int,
        frames: Iterable[CanFrame],
        chunks: Iterable[SerialChunk],
        messages: Iterable[RadioMessage],
    ) -> bytes:
        heard = [
            _HEARD_FRAME.pack(stamp_ns, can_id, len(data), data)
            for stamp_ns, can_id, data, extended, remote, error in frames
            if not (extended or remote or error)
        ]
        serial = [_HEARD_CHUNK.pack(at_ns, len(data)) + data for at_ns, data in chunks]
        radio = [_heard_message(message) for message in messages]
        body = b"".join([*heard, *serial, *radio])
        size = _GRANT.size - _SIZE.size + len(body)
        return _GRANT.pack(size, GRANT, now_ns, len(heard), len(serial), len(radio)) + body

    def stop(self, now_ns: int) -> bytes:
        return _STOP.pack(_STOP.size - _SIZE.size, STOP, now_ns)

    def end(self, received: bytearray) -> int:
        """Length of the first message of what was received; 0 while it is incomplete."""
        if len(received) < _SIZE.size:
            return 0
        size: int = _SIZE.unpack_from(received)[0] + _SIZE.size
        if size > RECORD_BYTES_MAX:
            raise GrantProtocolError(f"a record of {size} bytes; {RECORD_BYTES_MAX} are the most")
        return size if len(received) >= size else 0

    def answer(self, record: bytes) -> Answer:
        """Read a yield. Raises GrantProtocolError."""
        try:
            kind, now_ns, next_ns, frames, chunks, messages = _YIELD.unpack_from(record, _SIZE.size)
            if kind != YIELD:
                raise GrantProtocolError(f"a record of type {kind}; {YIELD}, a yield, is needed")
            at = _SIZE.size + _YIELD.size
            said = _sent_outputs(record, at, frames, chunks, messages)
        except (struct.error, IndexError):
            raise GrantProtocolError(f"a yield of {len(record)} bytes ends too early") from None
        return Answer(now_ns, next_ns, said)


def _heard_message(message: RadioMessage) -> bytes:
    key = message.key.encode()
    head = _HEARD_MESSAGE.pack(message.stamp_ns, len(key), len(message.payload))
    return head + key + message.payload


def _sent_outputs(record: bytes, at: int, frames: int, chunks: int, messages: int) -> SentOutputs:
    sent = []
    for _ in range(frames):
        can_id, length, data = _SENT_FRAME.unpack_from(record, at)
        if can_id > STANDARD_ID_MAX:
            raise GrantProtocolError(f"frames: identifier {can_id} is not in 0..{STANDARD_ID_MAX}")
        if length > FRAME_BYTES_MAX:
            raise GrantProtocolError(f"frames: {can_id:03X} has {length} bytes, over 8")
        sent.append((can_id, data[:length]))
        at += _SENT_FRAME.size
    serial = []
    for _ in range(chunks):
        (length,) = _SENT_CHUNK.unpack_from(record, at)
        at += _SENT_CHUNK.size + length
        serial.append(record[at - length : at])
    radio = []
    for _ in range(messages):
        key_length, length = _SENT_MESSAGE.unpack_from(record, at)
        at += _SENT_MESSAGE.size
        key = record[at : at + key_length].decode("utf-8", "replace")
        at += key_length + length
        radio.append((checked_key(key), record[at - length : at]))
    if at != len(record):
        raise GrantProtocolError(f"a yield of {len(record)} bytes whose lists take {at}")
    return SentOutputs(tuple(sent), tuple(serial), tuple(radio))
