"""Formats the lines of the logs and passes them on in blocks of whole lines.

These classes are the readable reference of the types of the same names in native/lines.h, which
`recorder` and `port_log` use where that module is available.
"""

import enum
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from firmware_py.ports import CanFrame

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

Write = Callable[[bytes, int], object]
"""Takes whole lines and their number."""


class FrameLines(Protocol):
    """Lines of a bus log. It passes them on when the whole second of the stamps changes."""

    def frame(
        self,
        epoch_ns: int,
        can_id: int,
        data: bytes,
        *,
        extended: bool = False,
        remote: bool = False,
        error: bool = False,
    ) -> None: ...

    def flush(self) -> None: ...


class RowLines(Protocol):
    """Rows of a CSV log. It passes them on when the whole second of the first value changes."""

    def row(self, values: tuple[object, ...]) -> None: ...

    def flush(self) -> None: ...


class RecordLines(Protocol):
    """Lines of a port log."""

    @property
    def waiting(self) -> int:
        """Number of lines that were not passed on yet."""
        ...

    def text(self, line: str) -> None: ...

    def sent(self, can_id: int, data: bytes) -> None: ...

    def received(self, frames: Sequence[CanFrame]) -> None: ...

    def flush(self) -> None: ...


class _Lines:
    """Buffered lines."""

    def __init__(self, write: Write) -> None:
        self._write = write
        self._lines: list[str] = []

    def flush(self) -> None:
        """Pass all lines on."""
        if self._lines:
            lines, self._lines = self._lines, []
            self._write("".join(lines).encode("utf-8", "surrogateescape"), len(lines))


class CandumpLines(_Lines):
    """Lines in the format of `candump -l` of can-utils."""

    def __init__(self, write: Write, channel: str) -> None:
        super().__init__(write)
        self._middle = f") {channel} "
        self._heads: dict[int, str] = {}
        self._second_ns = 0
        self._seconds = "(0000000000."

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
        """Add one frame; the stamp is truncated, not rounded, to microseconds, as in the kernel."""
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


class CsvLines(_Lines):
    """Rows of values.

    Numbers have nine significant digits, true and false are 1 and 0, an enum is its name in lower
    case. Several values in one field are separated by blanks, and None is an empty field.
    """

    def __init__(self, write: Write) -> None:
        super().__init__(write)
        self._second: int | None = None

    def row(self, values: tuple[object, ...]) -> None:
        """Add one row; the first value is the time in seconds, as a number or its text."""
        second = int(float(values[0]))  # type: ignore[arg-type]
        if second != self._second or len(self._lines) >= LINES_MAX:
            self.flush()
            self._second = second
        fields = [f"{v:.9g}" if type(v) is float else field_text(v) for v in values]
        self._lines.append(",".join(fields) + "\n")


class PortLines(_Lines):
    """Lines of a port log, whose format `port_log` describes."""

    def __init__(self, write: Write) -> None:
        super().__init__(write)
        self._identifiers: dict[int, str] = {}
        """Text of each 11-bit identifier."""

    @property
    def waiting(self) -> int:
        return len(self._lines)

    def text(self, line: str) -> None:
        self._lines.append(line)

    def sent(self, can_id: int, data: bytes) -> None:
        self._lines.append(f"tx can {self._identifier(can_id)} {hex_text(data)}\n")

    def received(self, frames: Sequence[CanFrame]) -> None:
        self._lines += [self._reception(frame) for frame in frames]

    def _reception(self, frame: CanFrame) -> str:
        stamp_ns, can_id, data, extended, remote, error = frame
        if extended or remote or error:
            digits = f"{can_id:08X}" if extended or error else f"{can_id:03X}"
            kind = "E:" if error else "R:" if remote else ""
            return f"rx can {stamp_ns} {digits} {kind}{hex_text(data)}\n"
        return f"rx can {stamp_ns} {self._identifier(can_id)} {hex_text(data)}\n"

    def _identifier(self, can_id: int) -> str:
        text = self._identifiers.get(can_id)
        if text is None:
            text = self._identifiers[can_id] = f"{can_id:03X}"
        return text


def hex_text(data: bytes) -> str:
    return data.hex().upper() or "-"


def field_text(value: object) -> str:
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
        return " ".join([field_text(each) for each in value])
    text = f"{value:.9g}" if isinstance(value, float) else str(value)
    if "," in text or '"' in text or "\n" in text or "\r" in text:
        return '"' + text.replace('"', '""') + '"'
    return text


def _identifier(can_id: int, extended: bool, error: bool) -> str:
    if error:
        return f"{can_id & ERROR_MASK | ERROR_FLAG:08X}#"
    if extended:
        return f"{can_id & EXTENDED_MAX:08X}#"
    return f"{can_id & STANDARD_MAX:03X}#"


def _remote_payload(data: bytes) -> str:
    """A remote frame has no data, but its length code is that of the requested data."""
    return f"R{len(data)}" if 0 < len(data) <= PAYLOAD_MAX else "R"
