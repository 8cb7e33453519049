"""Byte stuffing: converts content to a frame between flags and back.

Stuffed content contains no flag.
"""

from typing import Final

FLAG: Final = 0x7E
ESCAPE: Final = 0x7D
ESCAPE_XOR: Final = 0x20

_FLAG: Final = bytes([FLAG])
_ESCAPE: Final = bytes([ESCAPE])
_STUFFED_FLAG: Final = bytes([ESCAPE, FLAG ^ ESCAPE_XOR])
_STUFFED_ESCAPE: Final = bytes([ESCAPE, ESCAPE ^ ESCAPE_XOR])


def framed(content: bytes) -> bytes:
    """Return the stuffed content between two flags."""
    stuffed = content.replace(_ESCAPE, _STUFFED_ESCAPE).replace(_FLAG, _STUFFED_FLAG)
    return _FLAG + stuffed + _FLAG


def unstuffed(stuffed: bytes) -> bytes | None:
    """Return the content of a frame without its flags.

    Returns None if an escape is followed by no byte or by an invalid one.
    """
    first, *escaped = stuffed.split(_ESCAPE)
    content = bytearray(first)
    for part in escaped:
        if part[:1] not in (_STUFFED_FLAG[1:], _STUFFED_ESCAPE[1:]):
            return None
        content.append(part[0] ^ ESCAPE_XOR)
        content += part[1:]
    return bytes(content)
