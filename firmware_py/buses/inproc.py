"""A CAN bus in virtual time: arbitration by identifier, real frame durations, one total order.

Time is told by the callers and must not run backwards. The bus works lazily: telling it `now_ns`
starts every frame whose start lies strictly before that instant, because at the instant itself
other nodes may still offer one. Whichever caller tells the time first, the outcome is the same.

A node stands for a controller whose mailboxes are sorted by identifier: of all it has been given,
the lowest identifier goes first, and frames of one identifier go in the order given, none replacing
another. At each start the lowest identifier of all nodes wins. Two nodes that offer the same
identifier, an error on a real bus, go by the node's name. So frames are totally ordered by start,
identifier, node, number within the node; the order in which ports were made plays no part.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import Final, Protocol

from firmware_py.buses.timing import INTERMISSION_BITS, LONGEST_FRAME_BITS, frame_bits
from firmware_py.ports import CanFrame, LinkCounters

MAILBOX_FRAMES: Final = 256
"""With so many waiting a node offers faster than the bus carries; further ones are dropped."""
INBOX_FRAMES: Final = 65_536

Record = Callable[[CanFrame, str], None]

Offer = tuple[int, str, int, int, bytes, "InprocPort"]
"""Identifier, node, number within the node: these order it. Then length in bits, data, sender."""

_make_frame = tuple.__new__
"""Makes a CanFrame in a third of the time of its own constructor."""


@dataclass(frozen=True, slots=True)
class BusStatistics:
    """What a bus did since it was made."""

    frames: int
    busy_ns: int
    """Durations of the frames that have ended, each with its intermission."""
    waiting: int
    """Frames offered and not yet ended."""

    def load_ratio(self, duration_ns: int) -> float:
        """Share of the `duration_ns` since the bus was made that was occupied."""
        return self.busy_ns / duration_ns if duration_ns > 0 else 0.0


class FrameCarrier(Protocol):
    """Carries a bus's frames in its stead, for what the bus itself knows nothing of: errors."""

    @property
    def on_wire(self) -> int:
        """Number of frames that have started and not ended: 0 or 1."""
        ...

    def advance(self, now_ns: int) -> None:
        """What `InprocBus.advance` does."""
        ...

    def offer(self, now_ns: int, offer: Offer) -> bool:
        """Take one frame into a mailbox; False if it is dropped."""
        ...

    def forget(self, leaving: "InprocPort") -> int:
        """Drop what waits in the mailboxes of a node that leaves; says how many frames."""
        ...


class InprocBus:
    """One bus segment, shared by all devices of one process."""

    __slots__ = (
        "_bits",
        "_carrier",
        "_duration_ns",
        "_frames",
        "_offers",
        "_on_wire",
        "_ports",
        "_record",
        "_start_ns",
        "_told_ns",
        "bit_rate",
        "name",
    )

    def __init__(self, name: str, bit_rate: int, record: Record | None = None) -> None:
        """`record` is called once per frame, at its end, in bus order, with the sender's name."""
        if bit_rate <= 0:
            raise ValueError(f"bus {name!r}: bit rate {bit_rate} is not positive")
        self.name = name
        self.bit_rate = bit_rate
        self._record = record
        self._carrier: FrameCarrier | None = None
        self._ports: dict[str, InprocPort] = {}
        self._offers: list[Offer] = []
        self._start_ns = 0
        """Earliest start of the next frame; if offers wait, its start."""
        self._told_ns = 0
        self._on_wire: tuple[CanFrame, InprocPort, int] | None = None
        self._frames = 0
        self._bits = 0
        bits = range(LONGEST_FRAME_BITS + 1)
        self._duration_ns = [1_000_000_000 * count // bit_rate for count in bits]

    def port(self, node_name: str, accept_ids: Collection[int] | None = None) -> "InprocPort":
        """Connect a node; `accept_ids` are the identifiers it hears, None meaning all.

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
        """Start what starts before `now_ns`, and hand to its hearers what has ended by then."""
        assert now_ns >= self._told_ns, "time was told backwards"
        self._told_ns = now_ns
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
        while offers and self._start_ns < now_ns:
            can_id, _, _, bits, data, sender = heappop(offers)
            end_ns = self._start_ns + durations_ns[bits - INTERMISSION_BITS]
            self._start_ns += durations_ns[bits]
            sender._waiting -= 1
            frame = _make_frame(CanFrame, (end_ns, can_id, data, False, False, False))
            if end_ns > now_ns:
                self._on_wire = (frame, sender, bits)
                return
            self._end(frame, sender, bits)

    def _end(self, frame: CanFrame, sender: "InprocPort", bits: int) -> None:
        """The one place that every frame passes on its way from the wire to its hearers."""
        self._frames += 1
        self._bits += bits
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

    def _offer(self, now_ns: int, can_id: int, data: bytes, sender: "InprocPort") -> None:
        bits = frame_bits(can_id, data)
        offers = self._offers
        if self._carrier is not None:
            self._carry(now_ns, (can_id, sender.name, 0, bits, data, sender))
            return
        if offers and self._start_ns < now_ns:
            # Frames that start before this one is offered do not have to win against it.
            self.advance(now_ns)
        assert now_ns >= self._told_ns, "time was told backwards"
        self._told_ns = now_ns
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
        """A node that leaves takes along what waits in its mailboxes; a started frame ends."""
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
        """Off the bus or cut from it; only a carrier knows of that."""
        self._excepted: frozenset[int] = frozenset()
        """Identifiers for which the contrary holds."""
        self._inbox: list[CanFrame] = []
        self._hearers: dict[int, tuple[InprocPort, ...]] = {}
        """By identifier: who hears this node; filled when first asked for."""
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
        """All frames of other nodes that ended up to now and were not handed over yet."""
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
