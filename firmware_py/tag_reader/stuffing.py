"""Byte stuffing: content to a frame between flags, and back; inside nothing looks like a flag."""

from typing import Final

FLAG: Final = 0x7E
ESCAPE: Final = 0x7D
ESCAPE_XOR: Final = 0x20

_FLAG: Final = bytes([FLAG])
_ESCAPE: Final = bytes([ESCAPE])
_STUFFED_FLAG: Final = bytes([ESCAPE, FLAG ^ ESCAPE_XOR])
_STUFFED_ESCAPE: Final = bytes([ESCAPE, ESCAPE ^ ESCAPE_XOR])


def framed(content: bytes) -> bytes:
    """The stuffed content between two flags."""
    stuffed = content.replace(_ESCAPE, _STUFFED_ESCAPE).replace(_FLAG, _STUFFED_FLAG)
    return _FLAG + stuffed + _FLAG


def unstuffed(stuffed: bytes) -> bytes | None:
    """The content of a frame without its flags.

    None when an escape is followed by nothing or by a byte that never stands behind one.
    """
    first, *escaped = stuffed.split(_ESCAPE)
    content = bytearray(first)
    for part in escaped:
        if part[:1] not in (_STUFFED_FLAG[1:], _STUFFED_ESCAPE[1:]):
            return None
        content.append(part[0] ^ ESCAPE_XOR)
        content += part[1:]
    return bytes(content)
