"""A CAN bus in virtual time: arbitration by identifier, real frame durations, one total order.

Callers supply the time, which must not run backwards. The bus works lazily: a call with `now_ns`
starts every frame whose start lies strictly before that instant, because other nodes may still
offer one at the instant itself. The result does not depend on which caller comes first.

A node models a CAN controller with mailboxes sorted by identifier. It sends its lowest identifier
first and frames of one identifier in order; no frame replaces another. At each start the lowest
identifier of all nodes wins. If two nodes offer the same identifier, which is an error on a real
bus, the node's name decides. So frames are totally ordered by start, identifier, node, and number
within the node; the order in which ports were created has no effect.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import Final, Protocol, cast

from firmware_py.buses.timing import INTERMISSION_BITS, LONGEST_FRAME_BITS, frame_bits
from firmware_py.native.core import native_core
from firmware_py.ports import CanFrame, CanPort, LinkCounters
from firmware_py.storage.lines import FrameLines

MAILBOX_FRAMES: Final = 256
"""Capacity of a node's mailboxes. A node that fills them offers frames faster than the bus carries
them; further ones are dropped."""
INBOX_FRAMES: Final = 65_536

Record = Callable[[CanFrame, str], None]

Offer = tuple[int, str, int, int, bytes, "VirtualPort"]
"""Identifier, node and number within the node define the order; then length in bits, data,
sender."""
_OwnOffer = tuple[int, str, int, int, bytes, "InprocPort"]
Handover = tuple[int, list[Offer], tuple[int, Offer] | None]
"""What a carrier takes over: earliest start of the next frame, offers by their order, and the frame
on the wire with the instant of its end."""

_make_frame = tuple.__new__
"""Creates a CanFrame in a third of the time of its own constructor."""


@dataclass(frozen=True, slots=True)
class BusStatistics:
    """Totals of a bus since its creation."""

    frames: int
    busy_ns: int
    """Total duration of completed frames, each with its intermission."""
    waiting: int
    """Frames offered and not yet completed."""

    def load_ratio(self, duration_ns: int) -> float:
        """Share of the `duration_ns` since the bus was created that was occupied."""
        return self.busy_ns / duration_ns if duration_ns > 0 else 0.0


class VirtualPort(CanPort, Protocol):
    """A node on a bus in virtual time. The names with an underscore are for a `FrameCarrier`."""

    name: str
    is_open: bool
    _accepted: frozenset[int] | None
    _deaf: bool
    """The node is bus off or cut off; only a carrier sets this."""
    _excepted: frozenset[int]
    """Identifiers for which the opposite of `_deaf` holds."""
    _waiting: int
    """Number of frames in the mailboxes."""
    _sequence: int

    def accepts(self, can_id: int) -> bool: ...


class VirtualBus(Protocol):
    """A bus in virtual time: `InprocBus`, or the same in C. `open_bus` creates one."""

    name: str
    bit_rate: int
    _ports: dict[str, VirtualPort]
    _bits: int

    def port(self, node_name: str, accept_ids: Collection[int] | None = None) -> VirtualPort: ...

    def statistics(self) -> BusStatistics: ...

    def advance(self, now_ns: int) -> None: ...

    due_ns: int
    """Instant at which the pacer acts."""

    def pace(self, pacer: "Pacer | None") -> None: ...

    def pause(self, at_ns: int) -> None: ...

    def hand_over(self, carrier: "FrameCarrier") -> Handover: ...

    def _end(self, frame: CanFrame, sender: VirtualPort, bits: int) -> None: ...

    def _forget_routes(self) -> None: ...


def open_bus(
    name: str, bit_rate: int, record: Record | None = None, log: FrameLines | None = None
) -> VirtualBus:
    """Create a bus, in C where `native_core` is in use."""
    core = native_core()
    made = InprocBus if core is None else core.Bus
    return cast(VirtualBus, made(name, bit_rate, record, log))


class FrameCarrier(Protocol):
    """Replaces a bus's transmission to model errors, which the bus itself does not know."""

    @property
    def on_wire(self) -> int:
        """Number of frames that have started and not ended: 0 or 1."""
        ...

    def advance(self, now_ns: int) -> None:
        """Do the same as `InprocBus.advance`."""
        ...

    def offer(self, now_ns: int, offer: Offer) -> bool:
        """Put one frame into a mailbox; returns False if it is dropped."""
        ...

    def forget(self, leaving: VirtualPort) -> int:
        """Drop the frames in the mailboxes of a leaving node and return their number."""
        ...


class Pacer(Protocol):
    """Acts within the bus's own time, between the frames of a bus without errors."""

    def advance(self, now_ns: int) -> None:
        """Act at all instants up to this one; `bus.advance` carries the frames meanwhile."""
        ...

    def ended(self, frame: CanFrame, sender: str) -> None:
        """Take a completed frame. `bus.pause` lets `advance` act before the next one starts."""
        ...


class InprocBus:
    """One bus segment, shared by all devices of one process."""

    __slots__ = (
        "_bits",
        "_carrier",
        "_duration_ns",
        "_frames",
        "_latest_ns",
        "_log",
        "_offers",
        "_on_wire",
        "_paced",
        "_pacer",
        "_paused",
        "_ports",
        "_record",
        "_start_ns",
        "bit_rate",
        "due_ns",
        "name",
    )

    def __init__(
        self,
        name: str,
        bit_rate: int,
        record: Record | None = None,
        log: FrameLines | None = None,
    ) -> None:
        """Args:
        record: called once per frame, at its end, in bus order, with the sender's name.
        log: receives the same frames before that.
        """
        if bit_rate <= 0:
            raise ValueError(f"bus {name!r}: bit rate {bit_rate} is not positive")
        self.name = name
        self.bit_rate = bit_rate
        self._record, self._log = record, log
        self._carrier: FrameCarrier | None = None
        self._pacer: Pacer | None = None
        self._paced = self._paused = False
        """Whether the pacer is acting; whether it asked to act before the next frame."""
        self.due_ns = 0
        self._ports: dict[str, InprocPort] = {}
        self._offers: list[_OwnOffer] = []
        self._start_ns = 0
        """Earliest start of the next frame; the exact start if frames are waiting."""
        self._latest_ns = 0
        self._on_wire: tuple[CanFrame, InprocPort, int] | None = None
        self._frames = 0
        self._bits = 0
        bits = range(LONGEST_FRAME_BITS + 1)
        self._duration_ns = [1_000_000_000 * count // bit_rate for count in bits]

    def port(self, node_name: str, accept_ids: Collection[int] | None = None) -> "InprocPort":
        """Connect a node; `accept_ids` are the identifiers it receives, None means all.

        Raises:
            ValueError: if a node of that name is connected already.
        """
        if node_name in self._ports:
            raise ValueError(f"bus {self.name!r}: a node {node_name!r} is connected already")
        port = InprocPort(self, node_name, None if accept_ids is None else frozenset(accept_ids))
        self._ports[node_name] = port
        self._forget_routes()
        return port

    def statistics(self) -> BusStatistics:
        on_wire = 0 if self._on_wire is None else 1
        if self._carrier is not None:
            on_wire = self._carrier.on_wire
        busy_ns = 1_000_000_000 * self._bits // self.bit_rate
        waiting = sum(port._waiting for port in self._ports.values())
        return BusStatistics(self._frames, busy_ns, waiting + on_wire)

    def advance(self, now_ns: int) -> None:
        """Start all frames that start before `now_ns`, and deliver those that have ended by
        then.
        """
        if self._pacer is None or self._paced:
            self._carry_on(now_ns)
            return
        self._paced = True
        try:
            acts = now_ns >= self.due_ns
            if not acts:
                self._carry_on(now_ns)
            if acts or self._paused:
                self._pacer.advance(now_ns)
        finally:
            self._paced = False

    def _carry_on(self, now_ns: int) -> None:
        self._paused = False
        assert now_ns >= self._latest_ns, "time ran backwards"
        self._latest_ns = now_ns
        if self._carrier is not None:
            self._carrier.advance(now_ns)
            return
        on_wire = self._on_wire
        if on_wire is not None:
            if on_wire[0][0] > now_ns:
                return
            self._on_wire = None
            self._end(*on_wire)
        offers = self._offers
        durations_ns = self._duration_ns
        while offers and self._start_ns < now_ns and not self._paused:
            can_id, _, _, bits, data, sender = heappop(offers)
            end_ns = self._start_ns + durations_ns[bits - INTERMISSION_BITS]
            self._start_ns += durations_ns[bits]
            sender._waiting -= 1
            frame = _make_frame(CanFrame, (end_ns, can_id, data, False, False, False))
            if end_ns > now_ns:
                self._on_wire = (frame, sender, bits)
                return
            self._end(frame, sender, bits)

    def pace(self, pacer: Pacer | None) -> None:
        """Let a pacer act from now on."""
        self._pacer = pacer

    def pause(self, at_ns: int) -> None:
        """Start no frame until the next call of `advance`; the bus's time goes on from here."""
        self._latest_ns = at_ns
        self._paused = True

    def hand_over(self, carrier: FrameCarrier) -> Handover:
        """Let a carrier transmit from now on, and return what it takes over."""
        assert self._carrier is None, "another one carries this bus"
        offers: list[Offer] = []
        while self._offers:
            offer = heappop(self._offers)
            offer[5]._waiting -= 1
            offers.append(offer)
        on_wire: tuple[int, Offer] | None = None
        if self._on_wire is not None:
            frame, port, bits = self._on_wire
            on_wire = frame.stamp_ns, (frame.can_id, port.name, 0, bits, frame.data, port)
            self._on_wire = None
        self._carrier = carrier
        return self._start_ns, offers, on_wire

    def _end(self, frame: CanFrame, sender: "InprocPort", bits: int) -> None:
        """Deliver a completed frame; every frame passes here."""
        self._frames += 1
        self._bits += bits
        if self._log is not None:
            self._log.frame(frame[0], frame[1], frame[2])
        if self._record is not None:
            self._record(frame, sender.name)
        hearers = sender._hearers.get(frame[1])
        if hearers is None:
            hearers = self._route(sender, frame[1])
        for port in hearers:
            inbox = port._inbox
            if len(inbox) < INBOX_FRAMES:
                inbox.append(frame)
            else:
                port.counters.dropped_in += 1
        if self._pacer is not None:
            self._pacer.ended(frame, sender.name)

    def _offer(self, now_ns: int, can_id: int, data: bytes, sender: "InprocPort") -> None:
        bits = frame_bits(can_id, data)
        offers = self._offers
        if self._pacer is not None and not self._paced:
            self.advance(now_ns)
        if self._carrier is not None:
            self._carry(now_ns, (can_id, sender.name, 0, bits, data, sender))
            return
        if offers and self._start_ns < now_ns:
            # Frames that start before this offer do not arbitrate against it.
            self.advance(now_ns)
        assert now_ns >= self._latest_ns, "time ran backwards"
        self._latest_ns = now_ns
        if self._start_ns < now_ns:
            # The bus is idle.
            self._start_ns = now_ns
        if sender._waiting >= MAILBOX_FRAMES:
            sender.counters.dropped_out += 1
            return
        sender._waiting += 1
        sender._sequence += 1
        sender.counters.sent += 1
        heappush(offers, (can_id, sender.name, sender._sequence, bits, data, sender))

    def _carry(self, now_ns: int, offer: Offer) -> None:
        assert self._carrier is not None
        sender = offer[5]
        self.advance(now_ns)
        if not self._carrier.offer(now_ns, offer):
            sender.counters.dropped_out += 1

    def _route(self, sender: "InprocPort", can_id: int) -> "tuple[InprocPort, ...]":
        others = (port for port in self._ports.values() if port is not sender)
        hearers = tuple(port for port in others if port.accepts(can_id))
        sender._hearers[can_id] = hearers
        return hearers

    def _disconnect(self, leaving: "InprocPort") -> None:
        """Drop the frames in a leaving node's mailboxes; a frame that has started is completed."""
        del self._ports[leaving.name]
        if self._carrier is not None:
            leaving.counters.dropped_out += self._carrier.forget(leaving)
        kept = [offer for offer in self._offers if offer[5] is not leaving]
        leaving.counters.dropped_out += len(self._offers) - len(kept)
        self._offers[:] = kept
        heapify(self._offers)
        leaving._hearers.clear()
        self._forget_routes()

    def _forget_routes(self) -> None:
        for port in self._ports.values():
            port._hearers.clear()


class InprocPort:
    """A node on an `InprocBus`; a `CanPort`."""

    __slots__ = (
        "_accepted",
        "_bus",
        "_deaf",
        "_excepted",
        "_hearers",
        "_inbox",
        "_sequence",
        "_waiting",
        "counters",
        "is_open",
        "name",
    )

    def __init__(self, bus: InprocBus, name: str, accepted: frozenset[int] | None) -> None:
        self.name = name
        self.counters = LinkCounters()
        self.is_open = True
        self._bus = bus
        self._accepted = accepted
        self._deaf = False
        """The node is bus off or cut off; only a carrier sets this."""
        self._excepted: frozenset[int] = frozenset()
        """Identifiers for which the opposite of `_deaf` holds."""
        self._inbox: list[CanFrame] = []
        self._hearers: dict[int, tuple[InprocPort, ...]] = {}
        """By identifier, the ports that receive this node's frames; filled on first use."""
        self._waiting = 0
        self._sequence = 0

    def accepts(self, can_id: int) -> bool:
        if self._deaf is not (can_id in self._excepted):
            return False
        return self._accepted is None or can_id in self._accepted

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        """Put one frame into a mailbox.

        Raises:
            ValueError: for an identifier or data that no classic frame can carry.
        """
        if self.is_open:
            self._bus._offer(now_ns, can_id, data, self)
        else:
            self.counters.dropped_out += 1

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        """Return all frames of other nodes that ended up to now and were not returned before."""
        if self.is_open:
            self._bus.advance(now_ns)
        inbox = self._inbox
        if not inbox:
            return ()
        self._inbox = []
        self.counters.received += len(inbox)
        return inbox

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self._bus._disconnect(self)
