"""A serial line that logs its bytes in both directions."""

from collections.abc import Sequence

from firmware_py.ports import LinkCounters, SerialChunk, SerialPort
from firmware_py.storage.recorder import SerialDirection, SerialLog


class RecordedLine:
    """Wraps a port and passes all data through unchanged."""

    def __init__(self, port: SerialPort, log: SerialLog) -> None:
        self._port, self._log = port, log

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, data: bytes) -> None:
        self._log.chunk(now_ns, SerialDirection.TX, data)
        self._port.send(now_ns, data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        chunks = self._port.receive(now_ns)
        for chunk in chunks:
            self._log.chunk(chunk.stamp_ns, SerialDirection.RX, chunk.data)
        return chunks

    def close(self) -> None:
        self._port.close()
        self._log.close()
