"""Inflates zlib data with the fastest installed library: libdeflate, isal, or the standard one."""

import zlib
from collections.abc import Callable
from typing import Any, Final

Content = bytes | bytearray
INFLATED_MAX: Final = 1 << 28
"""Maximum content of a block; a block that claims more is broken."""


def _libdeflate() -> Callable[[Any, int], Content] | None:
    try:
        import deflate
    except ImportError:
        return None
    undo = deflate.zlib_decompress

    def inflate(data: Any, size: int) -> Content:
        # The library needs the size, and raises if it is wrong.
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
    """Return the inflater of that name, or else the fastest one installed.

    It takes the data and the size of the content.
    """
    for each in [name] if name else MAKERS:
        found = MAKERS[each]()
        if found is not None:
            return found
    return _standard()


def rescued(data: Any) -> tuple[bytes, str]:
    """Return the usable part of a block that cannot be inflated completely, and its fault.

    A torn block gives everything before its end. A corrupt block gives nothing, because content
    before the detected fault may already be wrong.
    """
    undo = zlib.decompressobj()
    try:
        found = undo.decompress(data, INFLATED_MAX)
    except zlib.error as error:
        return b"", str(error)
    if undo.unconsumed_tail:
        return b"", f"more than {INFLATED_MAX} bytes"
    return found, "" if undo.eof else "the block ends inside its content"
