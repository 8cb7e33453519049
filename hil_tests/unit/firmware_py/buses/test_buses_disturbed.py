"""A bus with errors in virtual time, against instants and counters worked out by hand."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.buses.confinement import ErrorState
from firmware_py.buses.disturbed import DisturbedWire
from firmware_py.buses.inproc import VirtualPort, open_bus
from firmware_py.buses.timing import frame_bits
from firmware_py.ports import CanFrame
from hil_tests.native_rig import in_both_languages  # noqa: F401

BIT_RATE = 250_000
BIT_NS = 4_000
MS = 1_000_000
FAR_NS = 10**12
NODES = ("bcu", "dcu", "tcu", "vobc")
FOUR = b"\xaa" * 4
"""With identifier 0x555 no bit is stuffed before the CRC; an error in data bit 1 costs 12 bits
of flags."""

Spoils = Callable[[int, str], bool]


class Strikes:
    """Inverts the second data bit of the frames that the test selects."""

    def __init__(self, spoils: Spoils) -> None:
        self.spoils = spoils
        self.attempts: list[tuple[int, int, str]] = []

    def struck_bit(self, start_ns: int, can_id: int, data: bytes, sender: str) -> int | None:
        self.attempts.append((start_ns, can_id, sender))
        return 1 if self.spoils(len(self.attempts), sender) else None


class Rig:
    def __init__(self, spoils: Spoils = lambda number, sender: False) -> None:
        self.log: list[tuple[int, int, str]] = []
        self.error_frames: list[CanFrame] = []
        self.bus = open_bus("can0", BIT_RATE, self._note)
        self.strikes = Strikes(spoils)
        self.wire = DisturbedWire(
            self.bus, self.strikes, lambda frame, node: self.error_frames.append(frame)
        )
        self.ports = {name: self.bus.port(name) for name in NODES}

    def _note(self, frame: CanFrame, node: str) -> None:
        self.log.append((frame.stamp_ns, frame.can_id, node))

    def state(self, node: str, now_ns: int) -> ErrorState:
        return self.wire.errors_of(node, now_ns).state


Step = tuple[int, int, str, int, bytes]
INSTANTS = st.one_of(st.integers(0, 8).map(lambda n: n * 500_000), st.integers(0, 4_000_000))
STEPS = st.lists(
    st.tuples(
        INSTANTS,
        st.integers(0, 1),
        st.sampled_from(NODES),
        st.sampled_from([0x101, 0x102, 0x181, 0x182, 0x700]),
        st.binary(max_size=8),
    ),
    max_size=40,
).map(lambda steps: sorted(steps, key=lambda step: step[0]))


@given(steps=STEPS, taken_over_at=st.integers(0, 40))
def test_without_errors_the_bus_behaves_the_same_to_the_nanosecond(
    steps: list[Step], taken_over_at: int
) -> None:
    def run(disturbed: bool) -> tuple[list[object], object]:
        log: list[object] = []
        bus = open_bus("can0", BIT_RATE, lambda frame, node: log.append((frame, node)))
        ports = {name: bus.port(name) for name in NODES}
        for number, (at_ns, looks, node, can_id, data) in enumerate(steps):
            if disturbed and number == taken_over_at:
                DisturbedWire(bus)
            if looks:
                log.append((node, at_ns, list(ports[node].receive(at_ns))))
            else:
                ports[node].send(at_ns, can_id, data)
        for name in NODES:
            log.append((name, list(ports[name].receive(FAR_NS))))
        return log, (bus.statistics(), [port.counters for port in ports.values()])

    assert run(True) == run(False)


def test_a_destroyed_frame_costs_its_bits_and_an_error_frame_and_is_sent_again() -> None:
    """The frame is destroyed at bit 20: 21 bits, 12 of flags, 8 of delimiter and 3 of
    intermission make 44."""
    rig = Rig(lambda number, sender: number == 1)
    rig.ports["vobc"].send(0, 0x555, FOUR)
    heard = rig.ports["bcu"].receive(FAR_NS)

    end_bit = 44 + frame_bits(0x555, FOUR) - 3
    assert [frame.stamp_ns for frame in heard] == [end_bit * BIT_NS]
    assert rig.strikes.attempts == [(0, 0x555, "vobc"), (44 * BIT_NS, 0x555, "vobc")]
    assert rig.bus.statistics().busy_ns == (44 + frame_bits(0x555, FOUR)) * BIT_NS
    errors = [rig.wire.errors_of(node, FAR_NS) for node in ("vobc", "bcu")]
    assert [(each.tec, each.rec) for each in errors] == [(7, 0), (0, 0)]
    assert rig.ports["vobc"].counters.sent == 1


def test_a_lower_identifier_goes_before_the_repetition() -> None:
    rig = Rig(lambda number, sender: number == 1)
    rig.ports["vobc"].send(0, 0x555, FOUR)
    rig.ports["bcu"].send(10 * BIT_NS, 0x100, FOUR)
    rig.bus.advance(FAR_NS)

    assert [can_id for _, can_id, _ in rig.log] == [0x100, 0x555]


def test_a_node_goes_bus_off_after_thirty_two_destroyed_frames() -> None:
    """The first 16 attempts fail while the node is error active, 44 bits each.

    Then its flag is recessive. Bits 19 and 20 are recessive, four more make six, then six follow:
    10 bits instead of 12. It also waits 8 bits before each attempt. The receivers with 16 or more
    errors stay active.
    """
    rig = Rig(lambda number, sender: sender == "vobc")
    rig.ports["vobc"].send(0, 0x555, FOUR)
    rig.ports["vobc"].send(0, 0x556, FOUR)
    rig.bus.advance(FAR_NS)

    starts = [start_ns // BIT_NS for start_ns, _, _ in rig.strikes.attempts]
    assert starts[:16] == [44 * n for n in range(16)]
    assert starts[16:] == [16 * 44 + 8 + 50 * n for n in range(16)]
    assert rig.wire.error_frames == {"vobc": 32}
    off_bit = starts[-1] + 42 - 3
    assert [(event.at_ns, event.state) for event in rig.wire.events] == [
        ((16 * 44 - 3) * BIT_NS, ErrorState.PASSIVE),
        (off_bit * BIT_NS, ErrorState.OFF),
    ]
    assert rig.log == []
    # Both frames are lost, and so is every later one.
    assert rig.ports["vobc"].counters.dropped_out == 2
    rig.ports["vobc"].send(FAR_NS, 0x555, FOUR)
    assert rig.ports["vobc"].counters.dropped_out == 3
    assert rig.wire.errors_of("bcu", FAR_NS).rec == 32
    assert [frame.data[6] for frame in rig.error_frames[:3]] == [8, 16, 24]
    assert all(frame.error for frame in rig.error_frames)


def test_a_passive_node_lets_a_higher_identifier_go_first() -> None:
    """After its 16th failure the node waits eight bits, in which another node starts."""
    rig = Rig(lambda number, sender: number <= 16)
    rig.ports["vobc"].send(0, 0x100, FOUR)
    rig.ports["bcu"].send(1, 0x700, FOUR)
    rig.bus.advance(FAR_NS)

    assert [node for _, _, node in rig.log] == ["bcu", "vobc"]


def off_node(spoiled: str = "vobc") -> tuple[Rig, int]:
    """A rig whose node `spoiled` is bus off, and an instant after that."""
    rig = Rig(lambda number, sender: sender == spoiled)
    rig.ports[spoiled].send(0, 0x555, FOUR)
    rig.bus.advance(100 * MS)
    assert rig.state(spoiled, 100 * MS) is ErrorState.OFF
    rig.strikes.spoils = lambda number, sender: False
    return rig, 100 * MS


def test_a_node_stays_bus_off_until_a_restart() -> None:
    rig, now_ns = off_node()

    assert rig.state("vobc", now_ns + 10_000 * MS) is ErrorState.OFF


def test_on_an_idle_bus_recovery_takes_128_times_eleven_bits() -> None:
    rig, now_ns = off_node()
    rig.wire.restart("vobc", now_ns)
    back_ns = now_ns + 128 * 11 * BIT_NS

    assert rig.state("vobc", back_ns - 1) is ErrorState.OFF
    assert rig.state("vobc", back_ns) is ErrorState.ACTIVE
    rig.ports["vobc"].send(back_ns, 0x555, FOUR)
    rig.bus.advance(FAR_NS)
    assert [node for _, _, node in rig.log] == ["vobc"]


def test_on_a_full_bus_recovery_takes_128_frames() -> None:
    """The frames follow without a gap; each brings its eleven recessive bits once, at its end."""
    rig, now_ns = off_node()
    for _ in range(200):
        rig.ports["bcu"].send(now_ns, 0x555, FOUR)
    rig.wire.restart("vobc", now_ns)
    back_ns = now_ns + 128 * frame_bits(0x555, FOUR) * BIT_NS

    assert rig.state("vobc", back_ns - 1) is ErrorState.OFF
    assert rig.state("vobc", back_ns) is ErrorState.ACTIVE


def test_a_bus_off_node_receives_nothing() -> None:
    rig, now_ns = off_node()
    rig.ports["bcu"].send(now_ns, 0x101, FOUR)

    assert list(rig.ports["vobc"].receive(FAR_NS)) == []
    assert len(rig.ports["dcu"].receive(FAR_NS)) == 1


def babbling(load_ratio: float, can_id: int = 0x200) -> tuple[Rig, VirtualPort]:
    rig = Rig()
    idiot = rig.bus.port("idiot", ())
    rig.wire.babble(idiot, can_id, FOUR, load_ratio, 0)
    return rig, idiot


def test_a_babbling_idiot_starves_higher_identifiers_and_not_lower_ones() -> None:
    rig, _ = babbling(1.0)
    for n in range(100):
        rig.ports["bcu"].send(n * MS, 0x1FF, FOUR)
        rig.ports["vobc"].send(n * MS, 0x201, FOUR)
    rig.bus.advance(200 * MS)

    carried = [node for _, _, node in rig.log]
    assert carried.count("bcu") == 100
    assert carried.count("vobc") == 0
    # A lower identifier waits for at most the frame that is on the wire.
    longest_ns = frame_bits(0x200, FOUR) * BIT_NS + frame_bits(0x1FF, FOUR) * BIT_NS
    ends_ns = [at_ns for at_ns, can_id, _ in rig.log if can_id == 0x1FF]
    assert all(end_ns - n * MS <= longest_ns for n, end_ns in enumerate(ends_ns))


def test_when_the_babbling_stops_waiting_frames_are_sent() -> None:
    rig, idiot = babbling(1.0)
    rig.ports["vobc"].send(0, 0x201, FOUR)
    rig.wire.hush(idiot, 50 * MS)
    rig.bus.advance(FAR_NS)

    assert rig.log[-1][2] == "vobc"
    assert 50 * MS < rig.log[-1][0] < 51 * MS
    assert rig.bus.statistics().waiting == 0


@pytest.mark.parametrize("load_ratio", [0.1, 0.5, 0.9, 1.0])
def test_alone_a_babbling_node_uses_its_configured_share(load_ratio: float) -> None:
    rig, _ = babbling(load_ratio)
    rig.bus.advance(1000 * MS)

    assert rig.bus.statistics().load_ratio(1000 * MS) == pytest.approx(load_ratio, rel=0.01)


def test_a_disconnected_node_neither_sends_nor_receives() -> None:
    rig = Rig()
    rig.wire.cut("vobc", 0)
    for n in range(30):
        rig.ports["vobc"].send(n * MS, 0x101, FOUR)
        rig.ports["bcu"].send(n * MS, 0x181, FOUR)
    rig.bus.advance(50 * MS)

    assert {node for _, _, node in rig.log} == {"bcu"}
    assert list(rig.ports["vobc"].receive(50 * MS)) == []
    assert rig.ports["vobc"].counters.dropped_out == 30
    rig.wire.mend("vobc", 50 * MS)
    # Alone it received no acknowledgement: it is error passive but never bus off.
    assert rig.wire.errors_of("vobc", 50 * MS).tec == 128
    rig.ports["vobc"].send(50 * MS, 0x101, FOUR)
    rig.bus.advance(FAR_NS)
    assert [node for _, _, node in rig.log[30:]] == ["vobc"]
    assert rig.wire.errors_of("vobc", FAR_NS).tec == 127


def test_a_cut_in_the_middle_of_a_frame_destroys_it() -> None:
    """The cut is at bit 25 of a frame of alternating bits.

    Bits 23 and 24 are 1 0, then all six bits of the flag are recessive. Six dominant bits of the
    receivers, delimiter and intermission follow.
    """
    rig = Rig()
    rig.ports["vobc"].send(0, 0x555, FOUR)
    rig.bus.advance(1)
    rig.wire.cut("vobc", 25 * BIT_NS)
    rig.ports["bcu"].send(30 * BIT_NS, 0x700, FOUR)
    rig.bus.advance(FAR_NS)

    free_bit = 25 + 6 + 6 + 8 + 3
    assert rig.log == [((free_bit + frame_bits(0x700, FOUR) - 3) * BIT_NS, 0x700, "bcu")]
    assert rig.wire.errors_of("bcu", FAR_NS).tec == 0
    assert rig.wire.errors_of("dcu", FAR_NS).rec == 0
    assert rig.ports["vobc"].counters.dropped_out == 1


def test_a_reconnected_node_does_not_receive_the_frame_on_the_wire() -> None:
    rig = Rig()
    rig.wire.cut("vobc", 0)
    rig.ports["bcu"].send(0, 0x101, FOUR)
    rig.ports["bcu"].send(0, 0x102, FOUR)
    rig.bus.advance(1)
    rig.wire.mend("vobc", 10 * BIT_NS)

    assert [frame.can_id for frame in rig.ports["vobc"].receive(FAR_NS)] == [0x102]


def test_a_node_alone_on_the_bus_sends_its_frame_over_and_over() -> None:
    bus = open_bus("can0", BIT_RATE)
    wire = DisturbedWire(bus)
    port = bus.port("alone")
    port.send(0, 0x101, FOUR)
    bus.advance(100 * MS)

    assert wire.errors_of("alone", 100 * MS).tec == 128
    assert wire.error_frames["alone"] > 100
    assert bus.statistics().frames == 0
    other = bus.port("other")
    assert len(other.receive(200 * MS)) == 1


@given(
    steps=STEPS,
    struck=st.sets(st.integers(1, 80), max_size=40),
    cut=st.sampled_from((*NODES, "")),
)
def test_every_lost_frame_is_counted(steps: list[Step], struck: set[int], cut: str) -> None:
    rig = Rig(lambda number, sender: number in struck)
    for number, (at_ns, _, node, can_id, data) in enumerate(steps):
        if cut and number == 10:
            rig.wire.cut(cut, at_ns)
        if cut and number == 20:
            rig.wire.mend(cut, at_ns)
        rig.ports[node].send(at_ns, can_id, data)
    if cut:
        rig.wire.mend(cut, 5 * MS)
    rig.bus.advance(FAR_NS)

    for name, port in rig.ports.items():
        offered = sum(step[2] == name for step in steps)
        carried = sum(node == name for _, _, node in rig.log)
        assert carried + port.counters.dropped_out == offered
        assert port.counters.dropped_out == 0 or name == cut
    assert rig.bus.statistics().waiting == 0
    assert sorted(rig.log, key=lambda each: each[0]) == rig.log
