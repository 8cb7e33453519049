"""Ports whose inputs the caller supplies and whose outputs the caller collects."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from firmware_py.ports import CanFrame, LinkCounters, RadioMessage, SerialChunk


class SentOutputs(NamedTuple):
    """Outputs of a controller, in order within each link."""

    frames: tuple[tuple[int, bytes], ...] = ()
    """Identifier and data."""
    serial: tuple[bytes, ...] = ()
    radio: tuple[tuple[str, bytes], ...] = ()
    """Key and payload."""


class HandedCan:
    """A CAN port that returns each supplied frame once, whatever its stamp is."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.inbox: list[CanFrame] = []
        self.sent: list[tuple[int, bytes]] = []

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.counters.sent += 1
        self.sent.append((can_id, data))

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        heard, self.inbox = self.inbox, []
        self.counters.received += len(heard)
        return heard

    def close(self) -> None:
        self.inbox.clear()


class HandedSerial:
    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.inbox: list[SerialChunk] = []
        self.sent: list[bytes] = []

    def send(self, now_ns: int, data: bytes) -> None:
        self.counters.sent += len(data)
        self.sent.append(data)

    def receive(self, now_ns: int) -> Sequence[SerialChunk]:
        heard, self.inbox = self.inbox, []
        self.counters.received += sum(len(chunk.data) for chunk in heard)
        return heard

    def close(self) -> None:
        self.inbox.clear()


class HandedRadio:
    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.inbox: list[RadioMessage] = []
        self.sent: list[tuple[str, bytes]] = []

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self.counters.sent += 1
        self.sent.append((key, payload))

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard, self.inbox = self.inbox, []
        self.counters.received += len(heard)
        return heard

    def close(self) -> None:
        self.inbox.clear()


class HandedPorts:
    """The three ports of one controller."""

    def __init__(self) -> None:
        self.can = HandedCan()
        self.tags = HandedSerial()
        self.radio = HandedRadio()

    def hand(
        self,
        frames: Iterable[CanFrame] = (),
        chunks: Iterable[SerialChunk] = (),
        messages: Iterable[RadioMessage] = (),
    ) -> None:
        self.can.inbox += frames
        self.tags.inbox += chunks
        self.radio.inbox += messages

    def take(self) -> SentOutputs:
        """Return the outputs since the last call."""
        can, tags, radio = self.can, self.tags, self.radio
        said = SentOutputs(tuple(can.sent), tuple(tags.sent), tuple(radio.sent))
        can.sent, tags.sent, radio.sent = [], [], []
        return said
