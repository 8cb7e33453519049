"""An initial file system for a kernel: a cpio archive in the format `newc`. Pure."""

from collections.abc import Mapping
from typing import Final

DIRECTORY: Final = 0o040755
PROGRAM: Final = 0o100755
TRAILER: Final = "TRAILER!!!"


def archive(directories: tuple[str, ...], files: Mapping[str, bytes]) -> bytes:
    """Return the archive with these directories, parents first, and these files, all executable."""
    entries = [(name, DIRECTORY, b"") for name in directories]
    entries += [(name, PROGRAM, content) for name, content in files.items()]
    parts = [_entry(number, *entry) for number, entry in enumerate(entries, start=1)]
    return b"".join((*parts, _entry(0, TRAILER, 0, b"")))


def _entry(number: int, name: str, mode: int, content: bytes) -> bytes:
    """Return a header of 13 hexadecimal fields, name and content, each padded to four bytes."""
    path = name.encode() + b"\0"
    fields = (number, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(path), 0)
    header = b"070701" + "".join(f"{field:08X}" for field in fields).encode()
    return _padded(header + path) + _padded(content)


def _padded(part: bytes) -> bytes:
    return part + bytes(-len(part) % 4)
