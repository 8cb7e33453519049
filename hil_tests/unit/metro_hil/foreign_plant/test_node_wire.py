"""The bus of LS-BUS nodes: what each node receives, at which instant, and what its errors do."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.buses.confinement import RECOVERY_BITS
from firmware_py.buses.inproc import open_bus
from firmware_py.buses.timing import INTERMISSION_BITS, frame_bits
from firmware_py.ports import CanFrame
from metro_hil.foreign_plant import ls_bus
from metro_hil.foreign_plant.ls_bus import BusErrorCode
from metro_hil.foreign_plant.node_wire import VISITS_MAX, NodeErrors, NodeWire
from metro_hil.foreign_plant.terminal_node import FAR_NS

RATE: Final = 250_000
BIT_NS: Final = 4000
MS: Final = 1_000_000
DISCARD: Final = bytes.fromhex("400000000a0000000402")
OFF: Final = bytes.fromhex("410000000900000003")
PASSIVE: Final = bytes.fromhex("410000000900000002")
ACTIVE: Final = bytes.fromhex("410000000900000001")
Record = list[tuple[int, int, bytes, str]]


@dataclass
class Played:
    """A node that sends given operations at given instants, and remembers what it received."""

    name: str
    plan: dict[int, bytes] = field(default_factory=dict)
    notified: bool = True
    answer: bytes = b""
    """What it sends at each visit with operations."""
    heard: list[tuple[int, bytes]] = field(default_factory=list)
    sent: bytes = b""
    due_ns: int = FAR_NS
    closed: bool = False

    def __post_init__(self) -> None:
        self.sent = self.plan.pop(0, b"")
        self.due_ns = min(self.plan, default=FAR_NS)

    def go(self, at_ns: int, received: bytes) -> None:
        assert at_ns <= self.due_ns
        assert not self.heard or at_ns >= self.heard[-1][0]
        if received:
            self.heard.append((at_ns, received))
        self.sent = self.plan.pop(at_ns, b"") + (self.answer if received else b"")
        self.due_ns = min(self.plan, default=FAR_NS)

    def died_error(self, at_ns: int, words: str) -> Exception:
        return RuntimeError(f"{self.name} {words}")

    def close(self) -> None:
        self.closed = True


def bus_of(
    *nodes: Played, errors: Iterable[NodeErrors] = (), until_ns: int = 100 * MS
) -> tuple[NodeWire, Record]:
    """Run the nodes and return the frames, each with its end and its sender."""
    record: Record = []

    def note(frame: CanFrame, sender: str) -> None:
        record.append((frame.stamp_ns, frame.can_id, frame.data, sender))

    bus = open_bus("bus", RATE, record=note)
    wire = NodeWire(bus, nodes, tuple(errors))
    bus.advance(until_ns)
    return wire, record


def end_ns(start_ns: int, can_id: int, data: bytes) -> int:
    return start_ns + (frame_bits(can_id, data) - INTERMISSION_BITS) * BIT_NS


def test_a_frame_reaches_the_others_at_its_end_and_its_sender_gets_confirm() -> None:
    one, two = Played("one", {MS: ls_bus.transmit(0x123, b"\x01")}), Played("two")
    silent = Played("three", notified=False)

    _, record = bus_of(one, two, silent)

    at_ns = end_ns(MS, 0x123, b"\x01")
    assert record == [(at_ns, 0x123, b"\x01", "one")]
    assert two.heard == silent.heard == [(at_ns, ls_bus.transmit(0x123, b"\x01"))]
    assert one.heard == [(at_ns, bytes.fromhex("200000000c00000023010000"))]


def test_a_node_without_notifications_gets_none() -> None:
    one = Played("one", {MS: ls_bus.transmit(1, b"")}, notified=False)

    wire, _ = bus_of(one, Played("two"))

    assert one.heard == []
    assert wire.nodes["one"].counts.confirmed == 1


def test_a_lost_frame_waits_unless_its_node_wants_it_discarded() -> None:
    start = {0: b"", MS: ls_bus.transmit(0x200, b"")}
    buffering, winner = Played("a", dict(start)), Played("b", {MS: ls_bus.transmit(0x100, b"")})
    discarding = Played("c", {0: DISCARD, MS: ls_bus.transmit(0x300, b"")})

    wire, record = bus_of(buffering, winner, discarding)

    assert [(can_id, sender) for _, can_id, _, sender in record] == [(0x100, "b"), (0x200, "a")]
    assert discarding.heard[0] == (MS, bytes.fromhex("300000000c00000000030000"))
    assert wire.nodes["c"].counts.lost == 1
    assert wire.nodes["a"].counts.lost == 0


def test_a_node_that_repeats_a_lost_frame_at_once_sends_it_next() -> None:
    one = Played("one", {0: DISCARD, MS: ls_bus.transmit(0x300, b"")})
    two = Played("two", {MS: ls_bus.transmit(0x100, b"")})
    one.answer = ls_bus.transmit(0x301, b"")

    _, record = bus_of(one, two, until_ns=MS + 60 * BIT_NS)

    assert [can_id for _, can_id, _, _ in record] == [0x100]
    assert one.heard[0][0] == MS


def test_a_destroyed_frame_gives_every_node_a_bus_error_and_goes_again() -> None:
    one, two = Played("one", {MS: ls_bus.transmit(0x10, b"\x55")}), Played("two")

    wire, record = bus_of(one, two, errors=[NodeErrors("one", MS, MS + 1)])

    assert len(record) == 1
    assert one.heard[0][1] == bytes.fromhex("310000000f00000010000000010101")
    assert two.heard[0][1] == bytes.fromhex("310000000f00000010000000010200")
    assert wire.nodes["one"].counts.bus_errors == 1
    assert wire.nodes["one"].state.errors.tec == 8 - 1


def test_a_node_alone_is_not_acknowledged() -> None:
    alone = Played("alone", {MS: ls_bus.transmit(0x10, b"")})

    wire, record = bus_of(alone)

    assert record == []
    error = ls_bus.bus_error(0x10, BusErrorCode.ACKNOWLEDGE, sender=True)
    assert alone.heard[0][1] == error
    assert wire.nodes["alone"].state.errors.tec == 128


def test_a_node_driven_to_bus_off_recovers_after_128_times_11_recessive_bits() -> None:
    plan = {MS: ls_bus.transmit(0x10, b""), 60 * MS: ls_bus.transmit(0x11, b"")}
    one, two = Played("one", dict(plan)), Played("two")

    wire, record = bus_of(one, two, errors=[NodeErrors("one", 0, 50 * MS)])

    passive, off, active = (each.at_ns for each in wire.events if each.node == "one")
    assert 0 < passive < off
    assert active - off == RECOVERY_BITS * BIT_NS
    assert wire.nodes["one"].tally().off == 1
    assert wire.nodes["one"].tally().dropped == 1
    assert [can_id for _, can_id, _, _ in record] == [0x11]


def test_what_a_node_reports_holds_if_it_is_worse() -> None:
    one = Played("one", {MS: PASSIVE, 2 * MS: ACTIVE, 3 * MS: OFF, 4 * MS: ACTIVE})
    two = Played("two", {5 * MS: ls_bus.transmit(0x10, b""), 20 * MS: ls_bus.transmit(0x11, b"")})

    wire, record = bus_of(one, two)

    assert [(each.at_ns // MS, each.state.value) for each in wire.events if each.node == "one"] == [
        (1, "error passive"),
        (2, "error active"),
        (3, "bus off"),
        # The other node repeats its frame, and eleven recessive bits end each attempt.
        (26, "error active"),
    ]
    assert wire.nodes["one"].counts.early == 1
    assert [at_ns // MS for at_ns, *_ in record] == [26, 26]


def test_a_node_that_stays_off_acknowledges_nothing_and_sends_nothing() -> None:
    one = Played("one", {0: OFF, MS: ls_bus.transmit(0x10, b"")})
    two = Played("two", {50 * MS: ls_bus.transmit(0x11, b"")})

    wire, record = bus_of(one, two)

    assert record == []
    assert one.heard == []
    assert wire.nodes["one"].tally().dropped == 1


def test_a_wakeup_reaches_all_others_at_once() -> None:
    one, two, three = Played("one", {MS: ls_bus.wakeup()}), Played("two"), Played("three")

    bus_of(one, two, three)

    assert two.heard == three.heard == [(MS, bytes.fromhex("4200000008000000"))]
    assert one.heard == []


@pytest.mark.parametrize(
    "operation",
    [
        b"\x10",
        ls_bus.transmit(0x10, b"\x01")[:-1],
        ls_bus.transmit(0x800, b""),
        ls_bus.transmit(0x10, bytes(9)),
        ls_bus.confirm(0x10),
        ls_bus.arbitration_lost(0x10),
        bytes.fromhex("9900000008000000"),
        bytes.fromhex("1000000000000000"),
        bytes.fromhex("410000000900000004"),
        bytes.fromhex("400000000d0000000100000000"),
        bytes.fromhex("400000000a0000000403"),
        bytes.fromhex("4000000008000000"),
    ],
)
def test_an_operation_that_is_none_is_counted_and_answered_with_format_error(
    operation: bytes,
) -> None:
    one = Played("one", {MS: ls_bus.transmit(0x20, b"") + operation})

    wire, record = bus_of(one, Played("two"))

    assert wire.nodes["one"].counts.malformed == 1
    assert one.heard[0] == (MS, ls_bus.format_error(operation))
    assert [can_id for _, can_id, _, _ in record] == [0x20]


def test_full_mailboxes_drop_and_count() -> None:
    burst = b"".join(ls_bus.transmit(can_id, b"") for can_id in range(300))

    wire, record = bus_of(Played("one", {MS: burst}), Played("two"))

    assert len(record) == 256
    assert wire.tallies() == (
        "one: sent 300, confirmed 256, received 0, dropped 44",
        "two: sent 0, confirmed 0, received 256",
    )


def test_two_nodes_that_answer_each_other_without_end_are_ended() -> None:
    one, two = Played("one", {MS: ls_bus.wakeup()}), Played("two")
    one.answer = two.answer = ls_bus.wakeup()

    with pytest.raises(RuntimeError, match=f"floods the bus: over {VISITS_MAX} events"):
        bus_of(one, two)


def test_another_bit_rate_is_an_error() -> None:
    rate = bytes.fromhex("400000000d00000001") + (125_000).to_bytes(4, "little")

    with pytest.raises(RuntimeError, match="125000 bit/s, the bus 250000"):
        bus_of(Played("one", {MS: rate}))


def test_a_retired_node_is_neither_visited_nor_fed() -> None:
    one, two = Played("one", {MS: ls_bus.transmit(1, b""), 90 * MS: b""}), Played("two")
    bus = open_bus("bus", RATE)
    wire = NodeWire(bus, [one, two])
    bus.advance(MS + 1)

    wire.retire()
    bus.advance(200 * MS)

    assert bus.statistics().frames == 1
    assert one.closed
    assert one.heard == two.heard == []


Offers = st.lists(
    st.tuples(
        st.integers(1, 400),
        st.sampled_from(["a", "b", "c"]),
        st.integers(0, 5),
        st.binary(max_size=8),
    ),
    max_size=20,
)


@settings(max_examples=40)
@given(Offers, st.lists(st.integers(1, 40_000_000), max_size=6))
def test_frames_of_nodes_are_those_of_native_ports(
    offers: list[tuple[int, str, int, bytes]], looks: list[int]
) -> None:
    """The total order depends neither on who sends nor on when others look at the bus."""
    offers.sort(key=lambda each: each[:2])
    native: Record = []
    bus = open_bus("bus", RATE, record=lambda frame, sender: native.append((*frame[:3], sender)))
    ports = {name: bus.port(name) for name in ("a", "b", "c")}
    for step, name, can_id, data in offers:
        ports[name].send(step * 100_000, can_id, data)
    bus.advance(1000 * MS)

    nodes = {name: Played(name) for name in ("a", "b", "c")}
    for step, name, can_id, data in offers:
        plan = nodes[name].plan
        at_ns = step * 100_000
        plan[at_ns] = plan.get(at_ns, b"") + ls_bus.transmit(can_id, data)
        nodes[name].due_ns = min(plan)
    record: Record = []
    other = open_bus("bus", RATE, record=lambda frame, sender: record.append((*frame[:3], sender)))
    NodeWire(other, list(nodes.values()))
    for look_ns in sorted(looks):
        other.advance(look_ns)
    other.advance(1000 * MS)

    assert record == native


@settings(max_examples=30)
@given(
    Offers,
    st.lists(st.integers(1, 20 * MS), max_size=6),
    st.sampled_from([b"", ls_bus.transmit(0x7, b"\x01"), ls_bus.transmit(0x700, b"")]),
)
def test_the_bus_carries_frames_as_the_wire_with_errors_does(
    offers: list[tuple[int, str, int, bytes]], looks: list[int], answer: bytes
) -> None:
    """Without errors the bus itself carries the frames; the nodes see no difference."""

    def run(errors: Iterable[NodeErrors]) -> tuple[Record, list[list[tuple[int, bytes]]]]:
        nodes = {name: Played(name, notified=name != "b") for name in ("a", "b")}
        for step, name, can_id, data in offers:
            plan = nodes.get(name, nodes["a"]).plan
            at_ns = step * 100_000
            plan[at_ns] = plan.get(at_ns, b"") + ls_bus.transmit(can_id, data)
        for node in nodes.values():
            node.due_ns = min(node.plan, default=FAR_NS)
        nodes["b"].answer = answer
        record: Record = []

        def note(frame: CanFrame, sender: str) -> None:
            record.append((frame.stamp_ns, frame.can_id, frame.data, sender))

        bus = open_bus("bus", RATE, record=note)
        NodeWire(bus, list(nodes.values()), tuple(errors))
        native = bus.port("native", None)
        for look_ns in sorted(looks):
            native.receive(look_ns)
            native.send(look_ns, 0x30, b"\x02")
        native.receive(20 * MS)
        return record, [node.heard for node in nodes.values()]

    assert run([]) == run([NodeErrors("a", FAR_NS - 1, FAR_NS)])
