"""A bus in virtual time with destroyed frames, nodes that are off or cut, and a babbling node.

`DisturbedWire` takes over from an `InprocBus`. Without disturbance it carries the frames at the
same instants and in the same order. A destroyed frame costs its bits up to the error and an error
frame; all nodes count it as ISO 11898-1 defines, and its sender arbitrates again.

A node that is bus off or cut off drops the frames in its mailboxes and all new ones until it is
back, so that it sends nothing old then. A cut-off node transmits in vain and so becomes error
passive.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from firmware_py.buses import confinement
from firmware_py.buses.bus_node import BusNode, Passing, WireEvent
from firmware_py.buses.confinement import ErrorCounters, ErrorState, WireFrame, wire_frame
from firmware_py.buses.inproc import MAILBOX_FRAMES, Offer, VirtualBus, VirtualPort
from firmware_py.buses.timing import INTERMISSION_BITS, frame_bits
from firmware_py.ports import CanFrame

EVENTS_MAX: Final = 1000
TABLE_BITS: Final = 256
"""Number of durations that are computed beforehand; no frame is longer."""
NS_PER_S: Final = 1_000_000_000


class Disturber(Protocol):
    """Decides which frames are destroyed."""

    def struck_bit(self, start_ns: int, can_id: int, data: bytes, sender: str) -> int | None:
        """Return the bit of a starting frame that is inverted for all nodes; None for a good frame.

        The bit counts from the first bit of the data field, stuff bits included. A bit behind the
        CRC sequence counts as its last bit.
        """
        ...


class DisturbedWire:
    """Carries the frames of a bus from now on, with the same timing as the bus itself."""

    def __init__(
        self,
        bus: VirtualBus,
        disturber: Disturber | None = None,
        on_error: Callable[[CanFrame, str], None] | None = None,
        acting: Mapping[int, str] | None = None,
        *,
        at_once: bool = True,
    ) -> None:
        """Args:
        at_once: take the bus over now, and not by a later call of `take_over`.
        on_error: called at the end of every error frame, with the frame in the layout of Linux and
            the name of the destroyed frame's sender.
        acting: by identifier, the node that acts on a frame, if a port with a filter receives it
            for another node. Such a frame is received while that node is present.
        """
        self.disturber = disturber
        self.error_frames: Counter[str] = Counter()
        """Error frames by the sender of the destroyed frame."""
        self.events: list[WireEvent] = []
        """Changes of error state; only the first EVENTS_MAX are stored."""
        self.events_left_out = 0
        self._bus, self._on_error, self._acting = bus, on_error, acting or {}
        self._nodes: dict[str, BusNode] = {}
        self._bits_ns = [NS_PER_S * bits // bus.bit_rate for bits in range(TABLE_BITS)]
        self._waiting: dict[BusNode, None] = {}
        self._free_ns = 0
        self._passing: Passing | None = None
        self._mending: list[BusNode] = []
        self._restarting: list[BusNode] = []
        self._present: tuple[BusNode, ...] = ()
        """All nodes that are neither bus off nor cut off."""
        self._ports_seen = 0
        self._blemished = False
        """Whether any receive error counter may be above zero."""
        if at_once:
            self.take_over()

    def take_over(self) -> None:
        """Carry the frames from now on."""
        self._free_ns, offers, on_wire = self._bus.hand_over(self)
        for offer in offers:
            self._node(offer[5]).push(offer)
        if on_wire is not None:
            end_ns, offer = on_wire
            _, _, _, bits, _, port = offer
            start_ns = end_ns - self._ns(bits - INTERMISSION_BITS)
            self._passing = Passing(offer, self._node(port), start_ns, end_ns, bits)

    # Methods that the bus calls.

    @property
    def on_wire(self) -> int:
        return 0 if self._passing is None else 1

    def advance(self, now_ns: int) -> None:
        while True:
            passing = self._passing
            if passing is not None:
                if passing.end_ns > now_ns:
                    return
                self._passing = None
                self._finish(passing)
            start_ns = self._next_start_ns()
            if start_ns is None or start_ns >= now_ns:
                return
            self._begin(start_ns)

    def offer(self, now_ns: int, offer: Offer) -> bool:
        can_id, name, _, bits, data, port = offer
        node = self._node(port)
        if node.restarting:
            self._look_for_recovery(node, now_ns)
        if node.cut_ns >= 0 and node not in self._mending:
            node.begin_tries(now_ns, bits)
            return False
        if node.present_state is ErrorState.OFF or port._waiting >= MAILBOX_FRAMES:
            return False
        if not node.offers:
            node.ready_ns = max(node.ready_ns, now_ns)
        port._sequence += 1
        port.counters.sent += 1
        node.push((can_id, name, port._sequence, bits, data, port))
        return True

    def forget(self, leaving: VirtualPort) -> int:
        node = self._nodes.pop(leaving.name, None)
        if node is None:
            return 0
        self._mending = [each for each in self._mending if each is not node]
        self._restarting = [each for each in self._restarting if each is not node]
        self._ports_seen = 0
        return node.drop_all()

    # Methods that a fault layer calls.

    def errors_of(self, node: str, now_ns: int) -> ErrorCounters:
        """Return a copy of the node's error counters."""
        self._bus.advance(now_ns)
        found = self._named(node)
        self._look_for_recovery(found, now_ns)
        return ErrorCounters(found.errors.tec, found.errors.rec, found.errors.off)

    def nodes_off(self) -> tuple[str, ...]:
        """Names of the nodes that are bus off and not restarting, in the order of their
        connection.
        """
        off = (each for each in self._nodes_all() if each.errors.off and not each.restarting)
        return tuple(each.port.name for each in off)

    def cut(self, node: str, now_ns: int) -> None:
        """Cut the wire to a node; a frame that it is sending is lost."""
        self._bus.advance(now_ns)
        cut = self._named(node)
        if cut in self._mending:
            self._mending.remove(cut)
            return
        if cut.cut_ns >= 0:
            return
        cut.cut_ns, cut.tries_ns = now_ns, -1
        cut.port.counters.dropped_out += cut.drop_all()
        self._admit(cut)
        passing = self._passing
        if passing is not None and passing.node is cut and not passing.destroyed:
            self._abandon(passing, now_ns)

    def mend(self, node: str, now_ns: int) -> None:
        """Reconnect a node; it does not receive the frame that is on the wire."""
        self._bus.advance(now_ns)
        mended = self._named(node)
        if mended.cut_ns < 0 or mended in self._mending:
            return
        mended.count_tries(now_ns, self._ns(1))
        self._enter_state(mended, now_ns)
        mended.ready_ns = max(mended.ready_ns, now_ns)
        if self._passing is None:
            mended.cut_ns = -1
            self._admit(mended)
        else:
            self._mending.append(mended)

    def restart(self, node: str, now_ns: int) -> None:
        """Let a bus-off node start waiting for 128 times eleven recessive bits."""
        self._bus.advance(now_ns)
        off = self._named(node)
        if not off.errors.off or off.restarting:
            return
        off.restart(now_ns, self._free_ns)
        self._restarting.append(off)

    def babble(
        self, port: VirtualPort, can_id: int, data: bytes, load_ratio: float, now_ns: int
    ) -> None:
        """Let the node send this frame repeatedly; alone on the bus it fills this share of it."""
        self._bus.advance(now_ns)
        node = self._node(port)
        bits = frame_bits(can_id, data)
        node.babble_gap_ns = round(self._ns(bits) * (1.0 / load_ratio - 1.0))
        if self._passing is not None and self._passing.node is node:
            # The node is still sending its last frame from before; it continues babbling after
            # that.
            self._passing.last_try = False
            return
        self.offer(now_ns, (can_id, port.name, 0, bits, data, port))

    def hush(self, port: VirtualPort, now_ns: int) -> None:
        """Stop the babbling; a frame on the wire is still finished."""
        self._bus.advance(now_ns)
        node = self._node(port)
        node.babble_gap_ns = -1
        node.drop_all()
        if self._passing is not None and self._passing.node is node:
            self._passing.last_try = True

    # Transmission of one frame.

    def _next_start_ns(self) -> int | None:
        start_ns: int | None = None
        for node in self._waiting:
            ready_ns = max(node.ready_ns, self._free_ns)
            if (start_ns is None or ready_ns < start_ns) and node.there:
                start_ns = ready_ns
        return start_ns

    def _begin(self, start_ns: int) -> None:
        node: BusNode | None = None
        for each in self._waiting:
            if each.ready_ns > start_ns or not each.there:
                continue
            # The order of offers is by identifier, node and number within the node.
            if node is None or each.offers[0][:3] < node.offers[0][:3]:
                node = each
        assert node is not None
        offer = node.pop()
        can_id, name, _, bits, data, _ = offer
        passing = Passing(offer, node, start_ns, 0, bits)
        present = self._nodes_present()
        if len(present) < 2:
            passing.destroyed, passing.acknowledged = True, False
            passing.bits = confinement.unacknowledged_bits(bits)
        elif self.disturber is not None:
            bit = self.disturber.struck_bit(start_ns, can_id, data, name)
            if bit is not None:
                passing.destroyed = True
                passing.bits = self._destroyed_bits(wire_frame(can_id, data), bit, node)
        self._occupy(passing)
        if self._restarting:
            for each in tuple(self._restarting):
                self._look_for_recovery(each, start_ns)
                each.pass_frame(start_ns, self._free_ns)
        self._passing = passing

    def _destroyed_bits(self, frame: WireFrame, bit: int, sender: BusNode) -> int:
        return confinement.destroyed_bits(
            frame,
            min(frame.first + bit, frame.last),
            sender_passive=sender.state is ErrorState.PASSIVE,
            hearers_active=self._any_active(sender),
        )

    def _occupy(self, passing: Passing) -> None:
        passing.end_ns = passing.start_ns + self._ns(passing.bits - INTERMISSION_BITS)
        self._free_ns = passing.start_ns + self._ns(passing.bits)

    def _finish(self, passing: Passing) -> None:
        node = passing.node
        if passing.destroyed:
            self._fail(passing)
        else:
            can_id, _, _, bits, data, port = passing.offer
            self._bus._end(CanFrame(passing.end_ns, can_id, data), port, bits)
            if node.errors.tec:
                node.errors.sent()
                self._enter_state(node, passing.end_ns)
            if self._blemished:
                self._heal(node, passing.end_ns)
            if node.babble_gap_ns >= 0:
                self.offer(passing.end_ns, passing.offer)
        # An error-passive node lets others start first after its own frame, whether that succeeded
        # or not.
        wait_ns = 0
        if node.state is ErrorState.PASSIVE:
            wait_ns = self._ns(confinement.SUSPEND_BITS)
        if not passing.destroyed:
            wait_ns = max(wait_ns, node.babble_gap_ns)
        node.ready_ns = max(node.ready_ns, self._free_ns + wait_ns)
        if self._mending:
            for mended in self._mending:
                mended.cut_ns = -1
                self._admit(mended)
            self._mending.clear()

    def _heal(self, sender: BusNode, end_ns: int) -> None:
        """Count a good frame for all nodes that received it."""
        self._blemished = False
        for each in self._nodes_present():
            if each.errors.rec:
                self._blemished = True
                if each is not sender:
                    each.errors.heard()
                    self._enter_state(each, end_ns)

    def _fail(self, passing: Passing) -> None:
        node, end_ns = passing.node, passing.end_ns
        self._bus._bits += passing.bits
        self.error_frames[passing.offer[1]] += 1
        if not passing.gone:
            if passing.acknowledged:
                node.errors.sending_failed()
            else:
                node.errors.nobody_acknowledged()
        self._blemished = True
        for each in self._nodes_present():
            if each is not node:
                each.errors.hearing_failed()
                self._enter_state(each, end_ns)
        if passing.gone or not node.port.is_open:
            node.port.counters.dropped_out += 1
        elif not passing.last_try:
            node.push(passing.offer)
        if self._on_error is not None:
            self._on_error(
                confinement.error_frame(end_ns, node.errors, passing.acknowledged), node.port.name
            )
        if node.errors.off:
            self._admit(node)
            node.port.counters.dropped_out += node.drop_all()
        self._enter_state(node, end_ns)

    def _abandon(self, passing: Passing, now_ns: int) -> None:
        """Handle a sender that is cut off in the middle of its frame."""
        can_id, _, _, _, data, _ = passing.offer
        frame = wire_frame(can_id, data)
        at_bit = (now_ns - passing.start_ns) * self._bus.bit_rate // NS_PER_S
        if at_bit > frame.last:
            # The receivers already have the complete content.
            return
        active = self._any_active(passing.node)
        passing.bits = confinement.abandoned_bits(frame, at_bit, hearers_active=active)
        passing.destroyed = passing.gone = True
        self._occupy(passing)

    # Absent nodes.

    def _admit(self, node: BusNode) -> None:
        """Update what this node receives, and what other ports receive in its place."""
        node.port._deaf = not node.there
        self._ports_seen = 0
        there = {each.port.name: each.there for each in self._nodes_all()}
        for each in self._nodes_all():
            if each.port._accepted is not None:
                each.port._excepted = frozenset(
                    can_id
                    for can_id, name in self._acting.items()
                    if there.get(name, each.there) is not each.there
                )
        self._bus._forget_routes()

    def _look_for_recovery(self, node: BusNode, now_ns: int) -> None:
        back_ns = node.recovered_ns(now_ns)
        if back_ns is not None:
            node.restarting = False
            self._restarting.remove(node)
            node.errors.recovered()
            node.ready_ns = back_ns
            self._admit(node)
            self._enter_state(node, back_ns)

    # Small helpers.

    def _nodes_present(self) -> tuple[BusNode, ...]:
        ports = self._bus._ports
        if self._ports_seen != len(ports):
            self._ports_seen = len(ports)
            self._present = tuple(node for node in self._nodes_all() if node.there)
        return self._present

    def _any_active(self, sender: BusNode) -> bool:
        """Return whether any other node sends dominant error flags."""
        others = (each for each in self._nodes_present() if each is not sender)
        return any(each.state is ErrorState.ACTIVE for each in others)

    def _nodes_all(self) -> list[BusNode]:
        return [self._node(port) for port in self._bus._ports.values()]

    def _node(self, port: VirtualPort) -> BusNode:
        node = self._nodes.get(port.name)
        if node is None:
            node = self._nodes[port.name] = BusNode(
                port, self._ns(confinement.RECOVERY_SEQUENCE_BITS), self._waiting
            )
        return node

    def _named(self, name: str) -> BusNode:
        return self._node(self._bus._ports[name])

    def _enter_state(self, node: BusNode, at_ns: int) -> None:
        state = node.present_state
        if state is not node.state:
            node.state = state
            if len(self.events) < EVENTS_MAX:
                self.events.append(WireEvent(at_ns, node.port.name, state))
            else:
                self.events_left_out += 1

    def _ns(self, bits: int) -> int:
        return self._bits_ns[bits] if bits < TABLE_BITS else NS_PER_S * bits // self._bus.bit_rate
