"""A radio port that lets somebody listen to what it hands over."""

from collections.abc import Callable, Sequence

from firmware_py.ports import LinkCounters, RadioMessage, RadioPort


class TappedRadio:
    """Wraps a port; what it hands over and takes is that of the port."""

    def __init__(self, port: RadioPort, heard: Callable[[bytes], None]) -> None:
        """`heard` is told the payload of each message, in order, when it is handed over."""
        self._port, self._heard = port, heard

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._port.send(now_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        messages = self._port.receive(now_ns)
        for message in messages:
            self._heard(message.payload)
        return messages

    def close(self) -> None:
        self._port.close()
