"""zlib undone with the fastest library that is installed: libdeflate, isal, or the standard one."""

import zlib
from collections.abc import Callable
from typing import Any, Final

Content = bytes | bytearray
INFLATED_MAX: Final = 1 << 28
"""A block that claims to hold more is broken."""


def _libdeflate() -> Callable[[Any, int], Content] | None:
    try:
        import deflate
    except ImportError:
        return None
    undo = deflate.zlib_decompress

    def inflate(data: Any, size: int) -> Content:
        # The library wants the size; it raises when that is wrong.
        found: Content = undo(data, size) if size else b""
        return found

    return inflate


def _isal() -> Callable[[Any, int], Content] | None:
    try:
        from isal import isal_zlib
    except ImportError:
        return None

    def inflate(data: Any, size: int) -> bytes:
        found: bytes = isal_zlib.decompress(data, bufsize=max(size, 1))
        return found

    return inflate


def _standard() -> Callable[[Any, int], Content]:
    def inflate(data: Any, size: int) -> bytes:
        return zlib.decompress(data, bufsize=max(size, 1))

    return inflate


MAKERS: Final = {"libdeflate": _libdeflate, "isal": _isal, "zlib": _standard}


def fastest(name: str | None = None) -> Callable[[Any, int], Content]:
    """The inflater of that name, else the fastest one that is there: data and size to content."""
    for each in [name] if name else MAKERS:
        found = MAKERS[each]()
        if found is not None:
            return found
    return _standard()


def rescued(data: Any) -> tuple[bytes, str]:
    """What a block gives that cannot be inflated as a whole, and what is wrong with it.

    Of one that is torn everything before the end. Of one that is broken nothing: what comes before
    the spot where that is noticed may be made up already.
    """
    undo = zlib.decompressobj()
    try:
        found = undo.decompress(data, INFLATED_MAX)
    except zlib.error as error:
        return b"", str(error)
    if undo.unconsumed_tail:
        return b"", f"more than {INFLATED_MAX} bytes"
    return found, "" if undo.eof else "the block ends inside its content"
