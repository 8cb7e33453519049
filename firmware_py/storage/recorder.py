"""The event recorder: bus, serial line and cycles as text files that stay readable after a kill.

Every log is flushed to the operating system when the whole second of its stamps changes, so at most
the last second is lost with the process. A log that cannot be opened is an error. A log that can no
longer be written counts its losses and never stops the control cycle.
"""

import enum
import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Protocol

from firmware_py.native.core import native_core
from firmware_py.storage import lines
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.lines import FrameLines, RowLines

NS_PER_S: Final = lines.NS_PER_S


class Lossy(Protocol):
    """A log that counts the lines that the disk did not store."""

    @property
    def lost_lines(self) -> int: ...


def lost_lines(logs: Iterable[Lossy]) -> int:
    """Sum over all logs. Close them first, because that writes their last lines."""
    return sum(log.lost_lines for log in logs)


def loss_text(lost: int) -> str:
    """Return the message about lost lines."""
    return f"the disk did not take {lost} lines of the logs"


class LineFile:
    """A text file that grows by blocks of whole lines and keeps the SHA-256 of its content."""

    def __init__(self, path: Path | str) -> None:
        """Open the file and overwrite an existing one. Raises RecorderError."""
        self.path = Path(path)
        try:
            self._file = self.path.open("wb", buffering=0)
        except OSError as error:
            raise RecorderError(f"{path}: cannot be written: {error.strerror}") from error
        self._digest = hashlib.sha256()
        self._torn = False
        self.lost_lines = 0
        self.error: str | None = None
        """Reason of the last loss."""

    @property
    def sha256(self) -> str:
        """SHA-256 of the content written so far, as 64 hexadecimal digits."""
        return self._digest.hexdigest()

    def write(self, texts: Sequence[str]) -> None:
        """Pass whole lines to the operating system.

        Lines that it does not accept are lost and counted.
        """
        self.append("".join(texts).encode("utf-8", "surrogateescape"), len(texts))

    def append(self, block: bytes, count: int) -> None:
        """Do the same with a block of `count` whole lines."""
        # After an incomplete line the next block starts on a new line.
        block = b"\n" + block if self._torn and block else block
        taken = 0
        try:
            while taken < len(block):
                taken += self._file.write(block[taken:])
        except (OSError, ValueError) as error:
            self.error = f"{self.path}: {getattr(error, 'strerror', None) or error}"
            self.lost_lines += max(0, count - block[:taken].count(b"\n"))
        written = block[:taken]
        self._digest.update(written)
        if written:
            self._torn = not written.endswith(b"\n")

    def close(self) -> None:
        self._file.close()


class CandumpWriter:
    """Writes the frames of one bus in the exact format of `candump -l` of can-utils."""

    def __init__(self, path: Path | str, channel: str) -> None:
        """Open the log. Raises RecorderError."""
        self._file = LineFile(path)
        native = native_core()
        self.lines: FrameLines = (native or lines).CandumpLines(self._take, channel)
        """Takes the frames, each with its instant since 1970, identifier and data."""
        self.frame = self.lines.frame
        self.frames = 0

    @property
    def sha256(self) -> str:
        """SHA-256 of the flushed lines."""
        return self._file.sha256

    @property
    def lost_lines(self) -> int:
        return self._file.lost_lines

    @property
    def error(self) -> str | None:
        return self._file.error

    def flush(self) -> None:
        """Pass all lines to the operating system. This happens every second and on closing."""
        self.lines.flush()

    def close(self) -> None:
        self.flush()
        self._file.close()

    def _take(self, block: bytes, count: int) -> None:
        self.frames += count
        self._file.append(block, count)


class LineLog:
    """A CSV log with a header line; `lines.CsvLines` describes its fields.

    Its first column is the time in seconds and controls the flushing.
    """

    def __init__(self, path: Path | str, columns: Sequence[str]) -> None:
        """Open the log.

        Raises RecorderError for the path, ValueError for empty or duplicate column names.
        """
        if not columns or "" in columns or len(set(columns)) != len(columns):
            raise ValueError(f"{path}: columns {list(columns)} are not distinct names")
        self.columns = tuple(columns)
        self._file = LineFile(path)
        self._file.write([",".join([lines.field_text(name) for name in columns]) + "\n"])
        native = native_core()
        self._lines: RowLines = (native or lines).CsvLines(self._file.append)

    @property
    def lost_lines(self) -> int:
        return self._file.lost_lines

    @property
    def error(self) -> str | None:
        return self._file.error

    def row(self, *values: object) -> None:
        """Write one value for each column; the first is the time in seconds, as a number or its
        text.
        """
        assert len(values) == len(self.columns), f"{self._file.path}: {len(values)} values"
        self._lines.row(values)

    def flush(self) -> None:
        """Pass all lines to the operating system. This happens every second and on closing."""
        self._lines.flush()

    def close(self) -> None:
        self.flush()
        self._file.close()


class SerialDirection(enum.Enum):
    RX = "rx"
    TX = "tx"


class SerialLog:
    """Log of one serial line: time in seconds, direction, bytes in hexadecimal."""

    def __init__(self, path: Path | str, start_ns: int = 0) -> None:
        """Open the log. `start_ns` is the instant written as zero seconds. Raises RecorderError."""
        self._log = LineLog(path, ("t_s", "direction", "data"))
        self._start_ns = start_ns

    @property
    def lost_lines(self) -> int:
        return self._log.lost_lines

    @property
    def error(self) -> str | None:
        return self._log.error

    def chunk(self, stamp_ns: int, direction: SerialDirection, data: bytes) -> None:
        stamp_s = (stamp_ns - self._start_ns) / NS_PER_S
        self._log.row(f"{stamp_s:.6f}", direction, data.hex().upper())

    def flush(self) -> None:
        self._log.flush()

    def close(self) -> None:
        self._log.close()


class RadioLog:
    """Log of one radio: time in seconds, direction, key, payload in hexadecimal."""

    def __init__(self, path: Path | str, start_ns: int = 0) -> None:
        """Open the log. `start_ns` is the instant written as zero seconds. Raises RecorderError."""
        self._log = LineLog(path, ("t_s", "direction", "key", "payload"))
        self._start_ns = start_ns

    @property
    def lost_lines(self) -> int:
        return self._log.lost_lines

    def message(self, stamp_ns: int, direction: SerialDirection, key: str, payload: bytes) -> None:
        stamp_s = (stamp_ns - self._start_ns) / NS_PER_S
        self._log.row(f"{stamp_s:.6f}", direction, key, payload.hex().upper())

    def flush(self) -> None:
        self._log.flush()

    def close(self) -> None:
        self._log.close()
