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

from firmware_py.storage.errors import RecorderError

NS_PER_S: Final = 1_000_000_000
LINES_MAX: Final = 1024
"""Maximum number of buffered lines, about 50 KiB of frames."""
ERROR_FLAG: Final = 0x2000_0000
ERROR_MASK: Final = 0x1FFF_FFFF
EXTENDED_MAX: Final = 0x1FFF_FFFF
STANDARD_MAX: Final = 0x7FF
PAYLOAD_MAX: Final = 8
_THOUSAND: Final = [f"{number:03d}" for number in range(1000)]
"""A lookup table, which is faster than formatting."""


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

    def write(self, lines: Sequence[str]) -> None:
        """Pass whole lines to the operating system.

        Lines that it does not accept are lost and counted.
        """
        block = "".join(lines).encode("utf-8", "surrogateescape")
        # After an incomplete line the next block starts on a new line.
        block = b"\n" + block if self._torn and block else block
        taken = 0
        try:
            while taken < len(block):
                taken += self._file.write(block[taken:])
        except (OSError, ValueError) as error:
            self.error = f"{self.path}: {getattr(error, 'strerror', None) or error}"
            self.lost_lines += max(0, len(lines) - block[:taken].count(b"\n"))
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
        self._lines: list[str] = []
        self._middle = f") {channel} "
        self._heads: dict[int, str] = {}
        self._second_ns = 0
        self._seconds = "(0000000000."
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

    def frame(
        self,
        epoch_ns: int,
        can_id: int,
        data: bytes,
        *,
        extended: bool = False,
        remote: bool = False,
        error: bool = False,
    ) -> None:
        """Log one frame; the stamp is truncated, not rounded, to microseconds, as in the kernel."""
        # This runs for every frame of a simulated hour. The texts of the second and of the
        # identifier are cached, and only a new second causes a flush.
        past_ns = epoch_ns - self._second_ns
        if not 0 <= past_ns < NS_PER_S or len(self._lines) >= LINES_MAX:
            past_ns = self._turn_second(epoch_ns)
        if extended or remote or error:
            head = self._middle + _identifier(can_id, extended, error)
            payload = _remote_payload(data) if remote and not error else data.hex().upper()
        else:
            head = self._heads.get(can_id) or self._remember(can_id)
            payload = data.hex().upper()
        past_ms = past_ns // 1_000_000
        past_us = past_ns // 1000 - past_ms * 1000
        self._lines.append(
            f"{self._seconds}{_THOUSAND[past_ms]}{_THOUSAND[past_us]}{head}{payload}\n"
        )

    def flush(self) -> None:
        """Pass all lines to the operating system. This happens every second and on closing."""
        if self._lines:
            self.frames += len(self._lines)
            self._file.write(self._lines)
            self._lines = []

    def close(self) -> None:
        self.flush()
        self._file.close()

    def _turn_second(self, epoch_ns: int) -> int:
        self.flush()
        second, past_ns = divmod(epoch_ns, NS_PER_S)
        self._second_ns = epoch_ns - past_ns
        self._seconds = f"({second:010d}."
        return past_ns

    def _remember(self, can_id: int) -> str:
        head = self._middle + _identifier(can_id, extended=False, error=False)
        self._heads[can_id] = head
        return head


class LineLog:
    """A CSV log with a header line.

    Its first column is the time in seconds and controls the flushing.

    Numbers have nine significant digits, true and false are 1 and 0, an enum is its name in lower
    case. Several values in one field are separated by blanks, and None is an empty field.
    """

    def __init__(self, path: Path | str, columns: Sequence[str]) -> None:
        """Open the log.

        Raises RecorderError for the path, ValueError for empty or duplicate column names.
        """
        if not columns or "" in columns or len(set(columns)) != len(columns):
            raise ValueError(f"{path}: columns {list(columns)} are not distinct names")
        self.columns = tuple(columns)
        self._file = LineFile(path)
        self._lines = [_line([_field(name) for name in columns])]
        self._second: int | None = None
        self.flush()

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
        second = int(float(values[0]))  # type: ignore[arg-type]
        if second != self._second or len(self._lines) >= LINES_MAX:
            self.flush()
            self._second = second
        fields = [f"{v:.9g}" if type(v) is float else _field(v) for v in values]
        self._lines.append(_line(fields))

    def flush(self) -> None:
        """Pass all lines to the operating system. This happens every second and on closing."""
        if self._lines:
            self._file.write(self._lines)
            self._lines = []

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

    def close(self) -> None:
        self._log.close()


def _identifier(can_id: int, extended: bool, error: bool) -> str:
    if error:
        return f"{can_id & ERROR_MASK | ERROR_FLAG:08X}#"
    if extended:
        return f"{can_id & EXTENDED_MAX:08X}#"
    return f"{can_id & STANDARD_MAX:03X}#"


def _remote_payload(data: bytes) -> str:
    """A remote frame has no data, but its length code is that of the requested data."""
    return f"R{len(data)}" if 0 < len(data) <= PAYLOAD_MAX else "R"


def _field(value: object) -> str:
    """Format one CSV field, quoted as RFC 4180 requires."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "1" if value else "0"
    if isinstance(value, enum.Enum):
        # Read the attribute directly: the property costs three more calls.
        name: str | None = value._name_
        return name.lower() if name is not None else str(value.value)
    if isinstance(value, tuple):
        return " ".join([_field(each) for each in value])
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    if "," in text or '"' in text or "\n" in text or "\r" in text:
        return '"' + text.replace('"', '""') + '"'
    return text


def _line(fields: Sequence[str]) -> str:
    return ",".join(fields) + "\n"
