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
from firmware_py.native.core import native_core
from firmware_py.ports import (
    CanFrame,
    CanPort,
    LinkCounters,
    RadioMessage,
    RadioPort,
    SerialChunk,
    SerialPort,
)
from firmware_py.storage import lines
from firmware_py.storage.lines import LINES_MAX, NS_PER_S, RecordLines, hex_text
from firmware_py.storage.recorder import LineFile

PORTS_LOG: Final = "ports.log"
VERSION: Final = 1


class PortLog:
    """The log of one process's controllers, one after the other. Close it after its ports."""

    def __init__(self, path: Path | str) -> None:
        """Open the log. Raises RecorderError."""
        self._file = LineFile(path)
        native = native_core()
        self.lines: RecordLines = (native or lines).PortLines(self._take)
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
        if second != self._second or self.lines.waiting >= LINES_MAX:
            self.flush()
            self._second = second
        self.line(f"run {task} {begin_ns} {execution_ns}\n")
        self._running = True

    def _ended(self) -> None:
        self._running = False

    def note_output(self, now_ns: int) -> None:
        """Call this before the line of an output.

        An output outside of any task belongs to the end: the controller was asked to end.
        """
        if not self._running and not self._stopped:
            self._stopped = True
            self.line(f"stop {now_ns}\n")

    def said(self, now_ns: int, text: str) -> None:
        """Record an output."""
        self.note_output(now_ns)
        self.line(text)

    def line(self, text: str) -> None:
        self.lines.text(text)

    def flush(self) -> None:
        """Pass all lines to the operating system. This happens every second and on closing."""
        self.lines.flush()

    def _take(self, block: bytes, count: int) -> None:
        self._written += count
        self._file.append(block, count)

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

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self._log.note_output(now_ns)
        self._log.lines.sent(can_id, data)
        self._port.send(now_ns, can_id, data)

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        frames = self._port.receive(now_ns)
        if frames:
            self._log.lines.received(frames)
        return frames

    def close(self) -> None:
        self._port.close()


class _LoggedSerial:
    def __init__(self, port: SerialPort, log: PortLog) -> None:
        self._port, self._log = port, log

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, data: bytes) -> None:
        self._log.said(now_ns, f"tx tags {hex_text(data)}\n")
        self._port.send(now_ns, data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        chunks = self._port.receive(now_ns)
        for stamp_ns, data in chunks:
            self._log.line(f"rx tags {stamp_ns} {hex_text(data)}\n")
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
        self._log.said(now_ns, f"tx radio {key} {hex_text(payload)}\n")
        self._port.send(now_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard = self._port.receive(now_ns)
        for stamp_ns, key, payload in heard:
            self._log.line(f"rx radio {stamp_ns} {key} {hex_text(payload)}\n")
        return heard

    def close(self) -> None:
        self._port.close()
