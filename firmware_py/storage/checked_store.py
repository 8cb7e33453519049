"""One checked value in one file, replaced atomically, for data that must not be lost."""

import zlib
from pathlib import Path
from typing import Final, Generic, TypeVar

import msgspec

from firmware_py.storage.nvram import NvramState, replace_file

SIZE_MAX: Final = 1 << 20
T = TypeVar("T")


class CheckedStore(Generic[T]):
    """Stores a dataclass of numbers, texts and tuples.

    Disk errors never raise here.

    `put` waits for the disk; when it returns True, the value survives a power cut.
    """

    def __init__(self, path: Path | None, kind: type[T]) -> None:
        """`path` None keeps the value in memory only."""
        self.failed_writes = 0
        self.detail = ""
        """Why the last read or write failed."""
        self._path = path
        self._decoder: msgspec.json.Decoder[T] = msgspec.json.Decoder(kind)
        self.state, self.value = self._read()
        """State at the start; the value is None unless the state is OK."""

    def put(self, value: T) -> bool:
        self.value = value
        if self._path is None:
            return True
        content = msgspec.json.encode(value) + b"\n"
        try:
            replace_file(self._path, content + b"crc32 %08X\n" % zlib.crc32(content))
        except OSError as error:
            self.failed_writes += 1
            self.detail = f"{self._path}: cannot be written: {error.strerror or error}"
            return False
        return True

    def _read(self) -> tuple[NvramState, T | None]:
        if self._path is None:
            return NvramState.ABSENT, None
        try:
            with self._path.open("rb") as file:
                stored = file.read(SIZE_MAX)
        except FileNotFoundError:
            return NvramState.ABSENT, None
        except OSError as error:
            self.detail = f"{self._path}: cannot be read: {error.strerror}"
            return NvramState.CORRUPT, None
        content, newline, trailer = stored.partition(b"\n")
        content += newline
        try:
            if trailer != b"crc32 %08X\n" % zlib.crc32(content):
                raise ValueError("torn or altered: the CRC-32 does not fit")
            return NvramState.OK, self._decoder.decode(content)
        except (ValueError, RecursionError) as error:
            self.detail = f"{self._path}: {error}"
            return NvramState.CORRUPT, None
