"""Radios that log their messages in both directions."""

from collections.abc import Collection, Sequence

from firmware_py.ports import LinkCounters, RadioMessage, RadioPort, TunableRadioPort
from firmware_py.storage.recorder import RadioLog, SerialDirection


class RecordedRadio:
    """Wraps a port and passes all data through unchanged."""

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


class LaterRecordedRadio:
    """The same for much traffic: it formats and writes only when `write_down` is called."""

    def __init__(self, port: TunableRadioPort, log: RadioLog) -> None:
        self._port, self._log = port, log
        self._waiting: list[tuple[int, SerialDirection, str, bytes]] = []

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._waiting.append((now_ns, SerialDirection.TX, key, payload))
        self._port.send(now_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard = self._port.receive(now_ns)
        rx = SerialDirection.RX
        self._waiting += [(each.stamp_ns, rx, each.key, each.payload) for each in heard]
        return heard

    def listen(self, subscriptions: Collection[str]) -> None:
        self._port.listen(subscriptions)

    def write_down(self) -> None:
        """Write the messages since the last call. Call it where a slow disk does no harm."""
        waiting, self._waiting = self._waiting, []
        for stamp_ns, direction, key, payload in waiting:
            self._log.message(stamp_ns, direction, key, payload)

    def close(self) -> None:
        self._port.close()
        self.write_down()
        self._log.close()
