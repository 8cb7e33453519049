"""Sets the dynamic loader of an ELF program. Pure."""

import struct
from typing import Final

PT_INTERP: Final = 3
HEADER: Final = "<16xHHIQQQIHHHHHH"
"""ELF64, little endian: the part of the header after the 16 identification bytes."""
SEGMENT: Final = "<IIQQQQQQ"
"""Type, flags, offset, virtual and physical address, size in the file and in memory, alignment."""


def with_interpreter(program: bytes, loader: str) -> bytes:
    """Return the program with the dynamic loader at this absolute path.

    The path is appended to the file, and the segment that names the loader points to it. Linux
    reads the path from the file, so no address in the program changes.

    Raises:
        ValueError: not a 64-bit ELF program, or one without a dynamic loader.
    """
    if len(program) < struct.calcsize(HEADER) or program[:6] != b"\x7fELF\x02\x01":
        raise ValueError("no 64-bit ELF program")
    _, _, _, _, table, _, _, _, entry_bytes, entries, *_ = struct.unpack_from(HEADER, program)
    for place in range(table, table + entries * entry_bytes, entry_bytes):
        kind, flags, _, virtual, physical, _, _, alignment = struct.unpack_from(
            SEGMENT, program, place
        )
        if kind == PT_INTERP:
            path = loader.encode() + b"\0"
            changed = bytearray(program) + path
            fields = (kind, flags, len(program), virtual, physical, len(path), len(path), alignment)
            struct.pack_into(SEGMENT, changed, place, *fields)
            return bytes(changed)
    raise ValueError("an ELF program without a dynamic loader")
