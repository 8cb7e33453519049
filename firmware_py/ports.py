"""Ports through which a device reaches the world: CAN, serial line and radio, with their data
types.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class CanFrame(NamedTuple):
    """One classic CAN frame as seen on the bus."""

    stamp_ns: int
    """Instant of the frame's end, by the receiver's clock."""
    can_id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


class SerialChunk(NamedTuple):
    """Bytes that a serial line delivered in one piece; a telegram may be spread over several."""

    stamp_ns: int
    data: bytes


class RadioMessage(NamedTuple):
    """One message received by radio, still in its safety envelope."""

    stamp_ns: int
    key: str
    payload: bytes


@dataclass(slots=True)
class LinkCounters:
    """Counters of a link since it was opened. Every loss is counted in one of them."""

    sent: int = 0
    received: int = 0
    dropped_in: int = 0
    """Data that arrived while the inbox was full."""
    dropped_out: int = 0
    """Data that could not be passed to the link."""
    errors: int = 0
    """Error frames, failed calls, truncated records."""


class CanPort(Protocol):
    """A node's connection to one CAN bus. It never waits."""

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        """Offer one frame with an 11-bit identifier; a full link drops and counts it."""
        ...

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Return frames of other nodes that ended up to now and were not returned before, in bus
        order.
        """
        ...

    def close(self) -> None: ...


class SerialPort(Protocol):
    """One end of a serial line. It never waits."""

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, now_ns: int, data: bytes) -> None: ...

    def receive(self, now_ns: int) -> Sequence[SerialChunk]: ...

    def close(self) -> None: ...


class RadioPort(Protocol):
    """A connection to the radio. It never waits and does not guarantee delivery."""

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, now_ns: int, key: str, payload: bytes) -> None: ...

    def receive(self, now_ns: int) -> Sequence[RadioMessage]: ...

    def close(self) -> None: ...


class TunableRadioPort(RadioPort, Protocol):
    """A radio port whose subscriptions can be changed while it is open."""

    def listen(self, subscriptions: Collection[str]) -> None:
        """Receive messages under these keys from now on, and no others."""
        ...
