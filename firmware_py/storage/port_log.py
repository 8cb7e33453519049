"""Records the inputs and outputs of a controller at its own ports, so that the run can be repeated.

The log is text, one record a line, in the order of the events:

    start {"...": ...}                          a controller starts; its configuration as JSON
    run control 150000000 412000                a task begins: instant; duration of its last run, ns
    rx can 149492000 185 000000A012039467       input of that run: stamp, identifier, data
    rx tags 148912345 7E0102...                 stamp, bytes
    rx radio 120000000 m/florence/w/0/ma/1/1 .. stamp, key, payload
    tx can 110 0000000000000300                 output
    tx tags 7E..
    tx radio m/florence/w/1/st/1 ..
    stop 1000000000                             the controller is asked to end
    end 4711                                    number of lines before this one

Instants are whole nanoseconds of the controller's clock. An identifier of 3 digits has 11 bits, one
of 8 has 29. `R:` before the data marks a remote frame, `E:` an error frame. A hyphen stands for
empty data.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py.clock.executive import Executive
from firmware_py.ports import (
    CanFrame,
    CanPort,
    LinkCounters,
    RadioMessage,
    RadioPort,
    SerialChunk,
    SerialPort,
)
from firmware_py.storage.recorder import NS_PER_S, LineFile

PORTS_LOG: Final = "ports.log"
VERSION: Final = 1
LINES_MAX: Final = 1024


class PortLog:
    """The log of one process's controllers, one after the other. Close it after its ports."""

    def __init__(self, path: Path | str) -> None:
        """Open the log. Raises RecorderError."""
        self._file = LineFile(path)
        self._lines: list[str] = []
        self._written = 0
        self._second = -1
        self._running = self._stopped = False

    @property
    def lost_lines(self) -> int:
        return self._file.lost_lines

    def start(self, table: Mapping[str, Any], executive: Executive, *, virtual: bool) -> None:
        """Record the start of a controller: its configuration, and from now on its tasks.

        Args:
            virtual: the controller runs in virtual time, so a repetition must give the same
                outputs.
        """
        told = {"version": VERSION, "virtual": virtual, "told": table}
        self.line(f"start {json.dumps(told, allow_nan=False)}\n")
        self._running = self._stopped = False
        executive.observe(self._began, self._ended)

    def _began(self, task: str, begin_ns: int, execution_ns: int) -> None:
        second = begin_ns // NS_PER_S
        if second != self._second or len(self._lines) >= LINES_MAX:
            self.flush()
            self._second = second
        self.line(f"run {task} {begin_ns} {execution_ns}\n")
        self._running = True

    def _ended(self) -> None:
        self._running = False

    def said(self, now_ns: int, text: str) -> None:
        """Record an output.

        An output outside of any task belongs to the end: the controller was asked to end.
        """
        if not self._running and not self._stopped:
            self._stopped = True
            self.line(f"stop {now_ns}\n")
        self.line(text)

    def line(self, text: str) -> None:
        self._lines.append(text)

    def lines(self, texts: Sequence[str]) -> None:
        self._lines.extend(texts)

    def flush(self) -> None:
        """Pass all lines to the operating system. This happens every second and on closing."""
        if self._lines:
            self._written += len(self._lines)
            self._file.write(self._lines)
            self._lines = []

    def close(self) -> None:
        self.flush()
        self.line(f"end {self._written}\n")
        self.flush()
        self._file.close()

    def can(self, port: CanPort) -> CanPort:
        return _LoggedCan(port, self)

    def tags(self, port: SerialPort) -> SerialPort:
        return _LoggedSerial(port, self)

    def radio(self, port: RadioPort) -> RadioPort:
        return _LoggedRadio(port, self)


class _LoggedCan:
    """Logs a port and passes all data through unchanged; the other two classes do the same."""

    def __init__(self, port: CanPort, log: PortLog) -> None:
        self._port, self._log = port, log
        self._identifiers: dict[int, str] = {}
        """Text of each 11-bit identifier."""

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        identifier = self._identifiers.get(can_id) or self._remember(can_id)
        self._log.said(now_ns, f"tx can {identifier} {data.hex().upper() or '-'}\n")
        self._port.send(now_ns, can_id, data)

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        frames = self._port.receive(now_ns)
        if frames:
            self._log.lines([self._reception(frame) for frame in frames])
        return frames

    def _reception(self, frame: CanFrame) -> str:
        stamp_ns, can_id, data, extended, remote, error = frame
        if extended or remote or error:
            return _unusual(frame)
        identifier = self._identifiers.get(can_id) or self._remember(can_id)
        return f"rx can {stamp_ns} {identifier} {data.hex().upper() or '-'}\n"

    def _remember(self, can_id: int) -> str:
        text = self._identifiers[can_id] = f"{can_id:03X}"
        return text

    def close(self) -> None:
        self._port.close()


class _LoggedSerial:
    def __init__(self, port: SerialPort, log: PortLog) -> None:
        self._port, self._log = port, log

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, data: bytes) -> None:
        self._log.said(now_ns, f"tx tags {_hex(data)}\n")
        self._port.send(now_ns, data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        chunks = self._port.receive(now_ns)
        for stamp_ns, data in chunks:
            self._log.line(f"rx tags {stamp_ns} {_hex(data)}\n")
        return chunks

    def close(self) -> None:
        self._port.close()


class _LoggedRadio:
    def __init__(self, port: RadioPort, log: PortLog) -> None:
        self._port, self._log = port, log

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._log.said(now_ns, f"tx radio {key} {_hex(payload)}\n")
        self._port.send(now_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard = self._port.receive(now_ns)
        for stamp_ns, key, payload in heard:
            self._log.line(f"rx radio {stamp_ns} {key} {_hex(payload)}\n")
        return heard

    def close(self) -> None:
        self._port.close()


def _hex(data: bytes) -> str:
    return data.hex().upper() or "-"


def _unusual(frame: CanFrame) -> str:
    digits = f"{frame.can_id:08X}" if frame.extended or frame.error else f"{frame.can_id:03X}"
    kind = "E:" if frame.error else "R:" if frame.remote else ""
    return f"rx can {frame.stamp_ns} {digits} {kind}{_hex(frame.data)}\n"
