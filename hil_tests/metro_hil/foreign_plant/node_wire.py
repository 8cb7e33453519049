"""A bus with LS-BUS nodes on it: arbitration, errors and total order are those of the bench.

The nodes are part of the bus's own time. Before any frame starts, every node has advanced to that
instant, and each operation reaches a node at its exact instant: a frame and its confirmation at the
end of the frame, a lost arbitration at its start, a wakeup at once. So the result depends neither
on the instants at which other devices look at the bus nor on the speed of the nodes' processes.

Without errors the bus itself carries the frames, which is faster, and `NodeWire` is its pacer. It
takes the bus over for good when frames are destroyed or discarded, or a node reports a state.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Final, Protocol

from firmware_py.buses.bus_node import BusNode, Passing
from firmware_py.buses.confinement import ErrorState
from firmware_py.buses.disturbed import Disturber
from firmware_py.buses.inproc import VirtualBus
from firmware_py.buses.timing import MAX_STANDARD_ID, frame_bits
from firmware_py.ports import CanFrame
from metro_hil.faults.bus import SharedWire
from metro_hil.foreign_plant import ls_bus
from metro_hil.foreign_plant.ls_bus import BusErrorCode, BusOperation, LsBusError, NodeStatus
from metro_hil.foreign_plant.terminal_node import FAR_NS

WINDOW_NS: Final = 1_000_000
VISITS_MAX: Final = 1000
"""Number of visits within a millisecond at which a node counts as hanging; the bus carries 21
frames in it at most."""
STATES: Final[Mapping[NodeStatus, ErrorState]] = {
    NodeStatus.ERROR_ACTIVE: ErrorState.ACTIVE,
    NodeStatus.ERROR_PASSIVE: ErrorState.PASSIVE,
    NodeStatus.BUS_OFF: ErrorState.OFF,
}


@dataclass(slots=True)
class NodeCounts:
    """What happened at one node."""

    transmitted: int = 0
    """Frames that the node offered."""
    confirmed: int = 0
    """Frames of the node that other nodes acknowledged."""
    received: int = 0
    lost: int = 0
    """Frames that lost arbitration and were discarded, as the node wants it."""
    bus_errors: int = 0
    """Destroyed frames that were reported to the node."""
    dropped: int = 0
    """Frames that found full mailboxes, or a node that is bus off."""
    malformed: int = 0
    """Operations that are damaged or unknown to a bus, which answers with Format Error."""
    complaints: int = 0
    """Operations that the node itself refused with Format Error."""
    early: int = 0
    """Times that the node reported to be error active before its recovery from bus off."""
    off: int = 0
    """Times that the node went bus off."""

    def __str__(self) -> str:
        said = f"sent {self.transmitted}, confirmed {self.confirmed}, received {self.received}"
        rare = self.others()
        return f"{said}, {rare}" if rare else said

    def others(self) -> str:
        """The counts that are rarely above zero, as text; empty if all are zero."""
        texts = {
            "arbitration lost": self.lost,
            "bus errors": self.bus_errors,
            "bus off": self.off,
            "dropped": self.dropped,
            "malformed": self.malformed,
            "refused by the node": self.complaints,
            "early recovery": self.early,
        }
        return ", ".join(f"{text} {count}" for text, count in texts.items() if count)


@dataclass(frozen=True, slots=True)
class NodeErrors:
    """Destroys every frame of one node within a time."""

    node: str
    from_ns: int
    until_ns: int


class NodeLink(Protocol):
    """A node that has started, as `NodeProcess` is."""

    name: str
    due_ns: int
    sent: bytes
    notified: bool

    def go(self, at_ns: int, received: bytes) -> None: ...

    def died_error(self, at_ns: int, words: str) -> Exception: ...

    def close(self) -> None: ...


class WireNode:
    """A node as the bus sees it."""

    def __init__(self, process: NodeLink, state: BusNode, receives: frozenset[int] | None) -> None:
        self.process = process
        self.state = state
        self._receives = receives
        self.counts = NodeCounts()
        self.discards = False
        """Whether a frame that loses arbitration is discarded."""
        self.window = (-1, 0)
        """Number of the present millisecond, and of the visits in it."""

    def tally(self) -> NodeCounts:
        """Return the counts up to now."""
        return replace(self.counts, dropped=self.state.port.counters.dropped_out)

    def receives(self, can_id: int) -> bool:
        """Return whether the node receives this frame of another node."""
        return self.state.there and (self._receives is None or can_id in self._receives)


class NodeWire(SharedWire):
    """A bus with LS-BUS nodes."""

    def __init__(
        self,
        bus: VirtualBus,
        processes: Sequence[NodeLink],
        errors: Sequence[NodeErrors] = (),
        filters: Mapping[str, frozenset[int]] | None = None,
        acting: Mapping[int, str] | None = None,
    ) -> None:
        """Connect the nodes, which have started, at the instant 0.

        Args:
            filters: identifiers that a node receives, by its name; without an entry, all.
            acting: see `DisturbedWire`.
        """
        super().__init__(bus, self if errors else None, acting=acting, at_once=False)
        self._calm = True
        """Whether the bus itself carries the frames."""
        self._errors = errors
        self._retired = False
        self._discarding = False
        """Whether any node wants frames discarded that lose arbitration."""
        self._last_ns = 0
        self._due_ns = FAR_NS
        self._mail: dict[str, bytes] = defaultdict(bytes)
        self._mail_ns = 0
        self.nodes: dict[str, WireNode] = {}
        for process in sorted(processes, key=lambda each: each.name):
            # The node takes its frames from this class, so its port stores none.
            state = self._node(bus.port(process.name, ()))
            self.nodes[process.name] = WireNode(process, state, (filters or {}).get(process.name))
        self._stack = ExitStack()
        self._received_ids = _received_ids(processes, filters or {})
        bus.pace(self)
        if errors or (len(self.nodes) < 2 and acting is None):
            # A node that is alone gets no acknowledgement.
            self._leave_calm()
        for node in self.nodes.values():
            self._stack.callback(node.process.close)
            self._take(node, 0)
        self._deliver(0)

    def struck_bit(self, start_ns: int, can_id: int, data: bytes, sender: str) -> int | None:
        """Return the bit that is destroyed in a starting frame; see `Disturber`."""
        for each in self._errors:
            if each.node == sender and each.from_ns <= start_ns < each.until_ns:
                return 8 * len(data)
        return super().struck_bit(start_ns, can_id, data, sender)

    def disturb(self, disturber: Disturber) -> None:
        super().disturb(disturber)
        self._leave_calm()

    def _leave_calm(self) -> None:
        """Carry the frames from now on, because there may be errors."""
        if self._calm:
            self._calm = False
            self._bus.pace(None)
            self.take_over()

    def ended(self, frame: CanFrame, sender: str) -> None:
        """See `Pacer`."""
        if frame[1] not in self._received_ids and sender not in self.nodes:
            return
        self._tell(frame[1], frame[2], sender)
        if self._mail:
            self._mail_ns = frame[0]
            self._bus.pause(frame[0])

    def _pace(self, now_ns: int) -> None:
        while self._calm:
            if self._mail:
                self._deliver(self._mail_ns)
                continue
            self._bus.advance(min(now_ns, self._due_ns))
            if not self._mail:
                if self._due_ns > now_ns:
                    return
                self._deliver(self._due_ns)

    def advance(self, now_ns: int) -> None:
        if self._calm:
            self._pace(now_ns)
            if self._calm:
                return
        while True:
            passing = self._passing
            if passing is not None:
                if passing.end_ns <= self._due_ns:
                    if passing.end_ns > now_ns:
                        return
                    self._passing = None
                    self._finish(passing)
                    if self._mail or self._due_ns == passing.end_ns:
                        self._deliver(passing.end_ns)
                    continue
            else:
                start_ns = self._next_start_ns()
                if start_ns is not None and start_ns < self._due_ns:
                    if start_ns >= now_ns:
                        return
                    self._begin(start_ns)
                    if self._mail:
                        self._deliver(start_ns)
                    continue
            if self._due_ns > now_ns:
                return
            self._deliver(self._due_ns)

    def retire(self) -> None:
        """Let no node act from now on; the frames in their mailboxes still leave."""
        self._retired = True
        self._due_ns = self._bus.due_ns = FAR_NS
        self._mail.clear()
        self._stack.close()

    def story(self) -> list[tuple[int, str]]:
        """Return changes of error state with their instants, and last the counts of each node."""
        told = [(each.at_ns, f"{each.node} is {each.state.value}") for each in self.events]
        return told + [(self._last_ns, f"node {text}") for text in self.tallies()]

    def tallies(self) -> tuple[str, ...]:
        """Return the counts of each node as text."""
        return tuple(f"{name}: {node.tally()}" for name, node in self.nodes.items())

    # Hooks of the transmission of one frame.

    def _begin(self, start_ns: int) -> None:
        if self._restarting:
            for each in tuple(self._restarting):
                self._look_for_recovery(each, start_ns)
        if self._discarding and len(self._waiting) > 1:
            self._discard(start_ns)
        super()._begin(start_ns)

    def _discard(self, start_ns: int) -> None:
        """Discard the frames that lose arbitration at this start, of nodes that want it so."""
        contenders = [node for node in self._waiting if node.ready_ns <= start_ns and node.there]
        winner = min(contenders, key=lambda node: node.offers[0][:3])
        for state in contenders:
            node = self.nodes.get(state.port.name)
            if node is not None and node.discards and state is not winner:
                can_id = state.pop()[0]
                node.counts.lost += 1
                self._post(node, ls_bus.arbitration_lost(can_id), notice=True)

    def _finish(self, passing: Passing) -> None:
        super()._finish(passing)
        can_id, _, _, _, data, port = passing.offer
        if passing.destroyed:
            code = BusErrorCode.BIT if passing.acknowledged else BusErrorCode.ACKNOWLEDGE
            for node in self.nodes.values():
                if node.state is passing.node or node.state.there:
                    node.counts.bus_errors += 1
                    error = ls_bus.bus_error(can_id, code, sender=node.state is passing.node)
                    self._post(node, error, notice=True)
            self._look_at_sender(passing)
            return
        self._tell(can_id, data, port.name)

    def _tell(self, can_id: int, data: bytes, sender: str) -> None:
        """Let the nodes know of a completed frame."""
        for name, node in self.nodes.items():
            if name == sender:
                node.counts.confirmed += 1
                self._post(node, ls_bus.confirm(can_id), notice=True)
            elif node.receives(can_id):
                node.counts.received += 1
                self._post(node, ls_bus.transmit(can_id, data))

    def _look_at_sender(self, passing: Passing) -> None:
        """Let a node that has just gone bus off start its recovery."""
        sender = self.nodes.get(passing.node.port.name)
        if sender is not None and passing.node.errors.off and not passing.node.restarting:
            sender.counts.off += 1
            self._recover(passing.node, passing.end_ns)

    def _recover(self, state: BusNode, now_ns: int) -> None:
        state.restart(now_ns, self._free_ns)
        self._restarting.append(state)

    # Visits of nodes.

    def _post(self, node: WireNode, operation: bytes, *, notice: bool = False) -> None:
        """Keep an operation for the next visit; a notice is for nodes that wait for notices."""
        if not self._retired and (node.process.notified or not notice):
            self._mail[node.process.name] += operation

    def _deliver(self, at_ns: int) -> None:
        """Visit all nodes that have something to do at this instant, until none has."""
        while not self._retired:
            visited = False
            for name, node in self.nodes.items():
                if name in self._mail or node.process.due_ns <= at_ns:
                    visited = True
                    self._visit(node, at_ns, self._mail.pop(name, b""))
            if not visited:
                break
        if not self._retired:
            self._due_ns = self._bus.due_ns = min(
                (each.process.due_ns for each in self.nodes.values()), default=FAR_NS
            )

    def _visit(self, node: WireNode, at_ns: int, received: bytes) -> None:
        self._last_ns = at_ns
        window, visits = at_ns // WINDOW_NS, 1
        if node.window[0] == window:
            visits += node.window[1]
        if visits > VISITS_MAX:
            raise node.process.died_error(
                at_ns, f"floods the bus: over {VISITS_MAX} events within a millisecond"
            )
        node.window = window, visits
        try:
            node.process.go(at_ns, received)
            self._take(node, at_ns)
        except Exception:
            # The bus may still be asked to advance, when the other devices stop.
            self.retire()
            raise

    def _take(self, node: WireNode, at_ns: int) -> None:
        """Do what the operations of a node say."""
        try:
            for operation in ls_bus.operations(node.process.sent):
                try:
                    self._do(node, at_ns, operation)
                except LsBusError as error:
                    self._refuse(node, error)
        except LsBusError as error:
            self._refuse(node, error)

    def _refuse(self, node: WireNode, error: LsBusError) -> None:
        node.counts.malformed += 1
        self._post(node, ls_bus.format_error(error.refused))

    def _do(self, node: WireNode, at_ns: int, operation: BusOperation) -> None:
        if operation.code == ls_bus.CAN_TRANSMIT:
            can_id, data = ls_bus.frame_of(operation)
            port = node.state.port
            node.counts.transmitted += 1
            if self._calm:
                port.send(at_ns, can_id, data)
                return
            bits = frame_bits(can_id, data)
            if not self.offer(at_ns, (can_id, port.name, 0, bits, data, port)):
                port.counters.dropped_out += 1
        elif operation.code == ls_bus.CONFIGURATION:
            kind, value = ls_bus.configuration_of(operation)
            if kind == ls_bus.LOST_BEHAVIOUR:
                node.discards = value == ls_bus.DISCARD
                if node.discards:
                    self._leave_calm()
                self._discarding = any(each.discards for each in self.nodes.values())
            elif kind == ls_bus.BIT_RATE and value != self._bus.bit_rate:
                raise node.process.died_error(
                    at_ns, f"has another bit rate: {value} bit/s, the bus {self._bus.bit_rate}"
                )
        elif operation.code == ls_bus.STATUS:
            self._report(node, at_ns, STATES[ls_bus.status_of(operation)])
        elif operation.code == ls_bus.WAKEUP:
            for other in self.nodes.values():
                if other is not node:
                    self._post(other, ls_bus.wakeup())
        elif operation.code == ls_bus.FORMAT_ERROR:
            node.counts.complaints += 1
        else:
            raise LsBusError(
                f"operation {operation.code:#04x} is not for the bus", operation.whole()
            )

    def _report(self, node: WireNode, at_ns: int, reported: ErrorState) -> None:
        """Take the error state that a node reports."""
        state = node.state
        if reported is not ErrorState.ACTIVE:
            self._leave_calm()
        self._look_for_recovery(state, at_ns)
        if reported is ErrorState.OFF and not state.errors.off:
            node.counts.off += 1
            state.errors.off = True
            state.port.counters.dropped_out += state.drop_all()
            self._recover(state, at_ns)
        elif reported is not ErrorState.OFF and state.errors.off:
            node.counts.early += 1
        state.reported = reported
        self._admit(state)
        self._enter_state(state, at_ns)


def _received_ids(
    processes: Sequence[NodeLink], filters: Mapping[str, frozenset[int]]
) -> frozenset[int]:
    """Identifiers that at least one node receives."""
    if any(each.name not in filters for each in processes):
        return frozenset(range(MAX_STANDARD_ID + 1))
    return frozenset().union(*filters.values())
