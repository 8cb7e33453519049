"""A radio whose messages are written down as they pass, in both directions."""

from collections.abc import Sequence

from firmware_py.ports import LinkCounters, RadioMessage, RadioPort
from firmware_py.recorder import RadioLog, SerialDirection


class RecordedRadio:
    """Wraps a port; what it hands over and takes is that of the port."""

    def __init__(self, port: RadioPort, log: RadioLog) -> None:
        self._port, self._log = port, log

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._log.message(now_ns, SerialDirection.TX, key, payload)
        self._port.send(now_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard = self._port.receive(now_ns)
        for message in heard:
            self._log.message(message.stamp_ns, SerialDirection.RX, message.key, message.payload)
        return heard

    def close(self) -> None:
        self._port.close()
        self._log.close()
