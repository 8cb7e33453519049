"""zlib undone with the fastest library that is installed: libdeflate, isal, or the standard one."""

import zlib
from collections.abc import Callable
from typing import Any, Final

INFLATED_MAX: Final = 1 << 28
"""A block that claims to hold more is broken."""


def _libdeflate() -> Callable[[Any, int], bytes] | None:
    try:
        import deflate
    except ImportError:
        return None
    undo = deflate.zlib_decompress

    def inflate(data: Any, size: int) -> bytes:
        # The library wants the size; it raises when that is wrong.
        return bytes(undo(data, size)) if size else b""

    return inflate


def _isal() -> Callable[[Any, int], bytes] | None:
    try:
        from isal import isal_zlib
    except ImportError:
        return None

    def inflate(data: Any, size: int) -> bytes:
        found: bytes = isal_zlib.decompress(data, bufsize=max(size, 1))
        return found

    return inflate


def _standard() -> Callable[[Any, int], bytes]:
    def inflate(data: Any, size: int) -> bytes:
        return zlib.decompress(data, bufsize=max(size, 1))

    return inflate


MAKERS: Final = {"libdeflate": _libdeflate, "isal": _isal, "zlib": _standard}


def fastest(name: str | None = None) -> Callable[[Any, int], bytes]:
    """The inflater of that name, else the fastest one that is there: data and size to content."""
    for each in [name] if name else MAKERS:
        found = MAKERS[each]()
        if found is not None:
            return found
    return _standard()


def rescued(data: Any) -> tuple[bytes, str]:
    """What can be inflated of a block that is torn or broken, and what is wrong with it."""
    undo = zlib.decompressobj()
    found = bytearray()
    view = memoryview(data)
    # In small bites: what stands before the break is then not lost with it.
    for start in range(0, len(view), 512):
        try:
            found += undo.decompress(view[start : start + 512], INFLATED_MAX - len(found) or 1)
        except zlib.error as error:
            return bytes(found), str(error)
        if len(found) >= INFLATED_MAX:
            return bytes(found), f"more than {INFLATED_MAX} bytes"
    return bytes(found), "" if undo.eof else "the block ends inside its content"
