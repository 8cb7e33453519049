"""A radio port with an observer of the received messages."""

from collections.abc import Callable, Sequence

from firmware_py.ports import LinkCounters, RadioMessage, RadioPort


class TappedRadio:
    """Wraps a port and behaves like it."""

    def __init__(self, port: RadioPort, heard: Callable[[bytes], None]) -> None:
        """`heard` receives the payload of each message, in order, when `receive` returns it."""
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
