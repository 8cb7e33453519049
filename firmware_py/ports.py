"""What a device may hold of the world: a CAN, a serial and a radio port, and what comes of them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class CanFrame(NamedTuple):
    """One classic CAN frame as it was seen on the bus."""

    stamp_ns: int
    """Instant of the end of the frame, on the clock of whoever received it."""
    can_id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


class SerialChunk(NamedTuple):
    """Bytes that a serial line handed over in one piece; a telegram may be spread over several."""

    stamp_ns: int
    data: bytes


class RadioMessage(NamedTuple):
    """One message heard on the radio, still in its safety envelope."""

    stamp_ns: int
    key: str
    payload: bytes


@dataclass(slots=True)
class LinkCounters:
    """What a link did since it was opened. Nothing is lost without one of these counting it."""

    sent: int = 0
    received: int = 0
    dropped_in: int = 0
    """Arrived, but the inbox was full."""
    dropped_out: int = 0
    """Could not be handed to the link."""
    errors: int = 0
    """Error frames, failed calls, torn records."""


class CanPort(Protocol):
    """A node's connection to one CAN bus. Never waits."""

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        """Offer one frame with an 11-bit identifier; a full link drops it and counts it."""
        ...

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Frames of other nodes that ended up to now and were not handed over yet, in bus order."""
        ...

    def close(self) -> None: ...


class SerialPort(Protocol):
    """One end of a serial line. Never waits."""

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, now_ns: int, data: bytes) -> None: ...

    def receive(self, now_ns: int) -> Sequence[SerialChunk]: ...

    def close(self) -> None: ...


class RadioPort(Protocol):
    """A connection to the radio. Never waits; delivery is not promised."""

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, now_ns: int, key: str, payload: bytes) -> None: ...

    def receive(self, now_ns: int) -> Sequence[RadioMessage]: ...

    def close(self) -> None: ...


class TunableRadioPort(RadioPort, Protocol):
    """One whose keys may be changed while it is open."""

    def listen(self, subscriptions: Collection[str]) -> None:
        """Hear what others send under these keys from now on, and nothing else."""
        ...
