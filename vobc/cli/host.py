"""Services of the host: exit codes, messages for people, and a serial line that is opened later."""

import sys
from collections.abc import Sequence
from typing import Final

from firmware_py.ports import LinkCounters, SerialChunk, SerialPort
from firmware_py.tag_reader.serial_line import SerialError, open_serial
from vobc.process import VobcDevice
from vobc.vocabulary import SAFE_OUTPUT

EXIT_OK: Final = 0
EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_ENVIRONMENT: Final = 3
EXIT_INTERRUPTED: Final = 130

RETRY_NS: Final = 500_000_000


class PatientLine:
    """A serial line that may not exist yet. The controller waits for it with the brakes on."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._line: SerialPort | None = None
        self._retry_ns = 0
        self._counters = LinkCounters()
        self.error = ""
        """Why the line is not open. Empty: it is open."""

    @property
    def counters(self) -> LinkCounters:
        return self._counters if self._line is None else self._line.counters

    def send(self, now_ns: int, data: bytes) -> None:
        if self._line is not None:
            self._line.send(now_ns, data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        if self._line is None and now_ns >= self._retry_ns:
            self._retry_ns = now_ns + RETRY_NS
            self._open()
        return () if self._line is None else self._line.receive(now_ns)

    def _open(self) -> None:
        try:
            self._line = open_serial(self._path)
            self.error = ""
        except SerialError as error:
            self._counters.errors += 1
            if str(error) != self.error:
                self.error = str(error)
                say(f"waits for the tag reader: {error}")

    def close(self) -> None:
        if self._line is not None:
            self._line.close()


class ProtectionNotices:
    """Prints the state of protection on standard error whenever it changes."""

    def __init__(self, vobc: VobcDevice) -> None:
        self._vobc = vobc
        self._said = ""

    def tell(self) -> None:
        output = self._vobc.output
        if output is SAFE_OUTPUT:
            return
        state = output.supervision.name.lower().replace("_", " ")
        words = f"{state}: {output.cause}" if output.cause else state
        if self._vobc.waits_for_line:
            words += f"; {self._vobc.waits_for_line}"
        if words != self._said:
            self._said = words
            say(words)


def say(words: str) -> None:
    print(f"vobc: {words}", file=sys.stderr, flush=True)
