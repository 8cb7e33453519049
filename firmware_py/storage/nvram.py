"""Data that survives a power cycle: a small checked record, replaced atomically."""

import contextlib
import dataclasses
import enum
import json
import math
import os
import threading
import zlib
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

VERSION: Final = 2
SIZE_MAX: Final = 65_536
WHEEL_DIAMETER_MIN_M: Final = 0.5
WHEEL_DIAMETER_MAX_M: Final = 1.3


@dataclass(frozen=True, slots=True)
class NvramRecord:
    """The stored record; its defaults describe a new board.

    Raises ValueError for impossible values.
    """

    boot_count: int = 0
    """Number of power-ups, including the present one once the controller has stored it."""
    wheel_diameter_m: float | None = None
    """Diameter of the last calibration; None if never calibrated."""
    front_m: float | None = None
    """Chainage of the front coupler when the record was stored; None if unknown."""
    standing: bool = False
    """Whether standstill was proven at that time. Only then can `front_m` be valid after the next
    power-up."""
    distance_m: float = 0.0
    """Distance run over the life of the board."""
    emergency_count: int = 0
    """Number of emergency brakings over the life of the board."""
    highest_term: int = 0
    """Highest authority term ever received; authorities of a lower term are refused."""
    train: int = 0
    """Address of the train that place, wheel and term belong to; 0: none stored yet."""
    line: str = ""
    """Line that they belong to."""
    database: int = 0
    """Version of the track database that `front_m` is a chainage of."""
    parameters: int = 0
    """Version of the vital parameters of the controller that stored them."""
    software: str = ""
    """Version of the program that stored them."""

    def __post_init__(self) -> None:
        for name in _COUNTS:
            if getattr(self, name) < 0:
                raise ValueError(f"{name} {getattr(self, name)} is negative")
        wheel_m = self.wheel_diameter_m
        if wheel_m is not None and not WHEEL_DIAMETER_MIN_M <= wheel_m <= WHEEL_DIAMETER_MAX_M:
            raise ValueError(f"wheel_diameter_m {wheel_m} is no wheel")
        if self.front_m is not None and not math.isfinite(self.front_m):
            raise ValueError(f"front_m {self.front_m} is not finite")
        if not 0.0 <= self.distance_m < math.inf:
            raise ValueError(f"distance_m {self.distance_m} is not a distance run")


_COUNTS: Final = (
    "boot_count",
    "emergency_count",
    "highest_term",
    "train",
    "database",
    "parameters",
)


class NvramState(enum.Enum):
    """State of the record when the board started."""

    OK = "ok"
    ABSENT = "absent"
    """No file: a new board, or memory only."""
    CORRUPT = "corrupt"
    """A file exists but cannot be read or trusted; `Nvram.detail` gives the reason."""


class Nvram:
    """The record of one board in one file. Disk errors never raise here."""

    def __init__(self, path: Path | str | None, initial: NvramRecord | None = None) -> None:
        """Args:
        path: path of the file; None keeps the record in memory only. One process per file.
        initial: record to start with if the file gives none; default: that of a new board.
        """
        self._path = None if path is None else Path(path)
        self._lock = threading.Lock()
        self._pending: deque[NvramRecord] = deque(maxlen=1)
        self._wake = threading.Event()
        self._closing = False
        self._writer: threading.Thread | None = None
        self.failed_writes = 0
        self.error: str | None = None
        """Reason of the last failed write."""
        self.state, self.detail, found = _read(self._path)
        self._record = found or initial or NvramRecord()

    @property
    def record(self) -> NvramRecord:
        """The newest record, whether or not the disk has stored it yet."""
        return self._record

    def put(self, record: NvramRecord) -> bool:
        """Store the record now.

        True means that it survives a power cut from here on.

        The call waits for the disk, mostly some milliseconds but sometimes far longer. Use it where
        a late cycle does no harm: at start-up, at standstill, at the end. Elsewhere use
        `put_later`.
        """
        self._record = record
        with self._lock:
            self._pending.clear()
            return self._store(record)

    def put_later(self, record: NvramRecord) -> None:
        """Pass the record to a thread that stores it; only the newest of several is stored.

        The thread keeps the scheduling of its creator. It mostly waits for the disk, and with a
        lower priority it could lose the processor while the control cycle waits for the
        interpreter.
        """
        if self._closing:
            self.put(record)
            return
        self._record = record
        if self._path is None:
            return
        self._pending.append(record)
        if self._writer is None:
            self._writer = threading.Thread(target=self._write_pending, name="nvram", daemon=True)
            self._writer.start()
        self._wake.set()

    def close(self) -> None:
        """Store a pending record and stop the thread."""
        self._closing = True
        self._wake.set()
        if self._writer is not None:
            self._writer.join()
            self._writer = None

    def _write_pending(self) -> None:
        closing = False
        while not closing:
            self._wake.wait()
            self._wake.clear()
            closing = self._closing
            with self._lock, contextlib.suppress(IndexError):
                self._store(self._pending.popleft())

    def _store(self, record: NvramRecord) -> bool:
        if self._path is None:
            return True
        try:
            replace_file(self._path, encode_record(record))
        except OSError as error:
            self.failed_writes += 1
            self.error = f"{self._path}: cannot be written: {error.strerror or error}"
            return False
        return True


def encode_record(record: NvramRecord) -> bytes:
    """Encode a record as two lines of text: the values as JSON, and the CRC-32 of that line."""
    table = {"version": VERSION, **dataclasses.asdict(record)}
    content = json.dumps(table, sort_keys=True, allow_nan=False).encode("ascii") + b"\n"
    return content + b"crc32 %08X\n" % zlib.crc32(content)


def decode_record(stored: bytes) -> NvramRecord:
    """Decode a record.

    Raises ValueError with the cause for anything that `encode_record` did not write.
    """
    content, newline, trailer = stored.partition(b"\n")
    content += newline
    if trailer != b"crc32 %08X\n" % zlib.crc32(content):
        raise ValueError("torn or altered: the CRC-32 does not fit")
    table = json.loads(content)
    if not isinstance(table, dict) or table.pop("version", None) != VERSION:
        raise ValueError(f"not written by version {VERSION} of this memory")
    fields = dataclasses.fields(NvramRecord)
    if set(table) != {field.name for field in fields}:
        raise ValueError(f"holds {', '.join(sorted(table))}")
    return NvramRecord(**{field.name: _typed(field, table[field.name]) for field in fields})


def replace_file(path: Path, content: bytes) -> None:
    """Replace the content of a file so that it holds the old or the new content after a crash at
    any point.

    The content is on the disk before the name points to it, and the name is on the disk before this
    returns. After an OSError the file holds either the old or the new content.
    """
    fresh = path.with_name(path.name + ".new")
    _write_through(fresh, content)
    os.replace(fresh, path)  # noqa: PTH105 # beside os.open and os.fsync, one level of calls
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _write_through(path: Path, content: bytes) -> None:
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    try:
        while content:
            content = content[os.write(file, content) :]
        os.fsync(file)
    finally:
        os.close(file)


def _read(path: Path | None) -> tuple[NvramState, str, NvramRecord | None]:
    if path is None:
        return NvramState.ABSENT, "memory only", None
    try:
        with path.open("rb") as file:
            stored = file.read(SIZE_MAX)
    except FileNotFoundError:
        return NvramState.ABSENT, f"{path}: no such file", None
    except OSError as error:
        return NvramState.CORRUPT, f"{path}: cannot be read: {error.strerror}", None
    try:
        return NvramState.OK, "", decode_record(stored)
    except (ValueError, OverflowError, RecursionError) as error:
        return NvramState.CORRUPT, f"{path}: {error}", None


def _typed(field: dataclasses.Field[Any], value: Any) -> Any:
    kind = field.type
    if value is None and kind == float | None:
        return None
    if isinstance(value, bool) == (kind is bool):
        if kind in (bool, int, str):
            if isinstance(value, kind):
                return value
        elif isinstance(value, int | float):
            return float(value)
    raise ValueError(f"{field.name}: {value!r} is not of type {getattr(kind, '__name__', kind)}")
