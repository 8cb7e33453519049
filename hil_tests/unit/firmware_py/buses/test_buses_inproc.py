"""The bus in virtual time, against an oracle that examines every offered frame at every start."""

import itertools
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.buses.inproc import INBOX_FRAMES, MAILBOX_FRAMES, VirtualPort, open_bus
from firmware_py.buses.timing import frame_bits
from firmware_py.ports import CanFrame
from hil_tests.native_rig import in_both_languages  # noqa: F401

BIT_RATE = 250_000
BIT_NS = 4_000
INTERMISSION_NS = 3 * BIT_NS
NODES = ("bcu", "dcu", "tcu", "vobc")
FAR_NS = 10**12


@dataclass(frozen=True)
class Offer:
    at_ns: int
    node: str
    can_id: int
    data: bytes


@dataclass(frozen=True)
class Sent:
    """One frame on the bus, as the oracle or the recorder saw it."""

    end_ns: int
    node: str
    can_id: int
    data: bytes

    @property
    def start_ns(self) -> int:
        bits = frame_bits(self.can_id, self.data)
        return self.end_ns - (bits - 3) * BIT_NS


def arbitrate_by_hand(offers: list[Offer], leaver: str = "", leaves_ns: int = 0) -> list[Sent]:
    """Whenever the bus is idle, send the lowest identifier of all offered frames.

    A node that leaves withdraws its frames that have not started by then.
    """
    left = [(offer.can_id, offer.node, number, offer) for number, offer in enumerate(offers)]
    sent: list[Sent] = []
    idle_ns = 0
    while left:
        start_ns = max(idle_ns, min(offer.at_ns for *_, offer in left))
        if leaver and start_ns >= leaves_ns:
            left = [entry for entry in left if entry[1] != leaver]
            leaver = ""
            continue
        winner = min(entry for entry in left if entry[3].at_ns <= start_ns)
        left.remove(winner)
        offer = winner[3]
        idle_ns = start_ns + frame_bits(offer.can_id, offer.data) * BIT_NS
        sent.append(Sent(idle_ns - INTERMISSION_NS, offer.node, offer.can_id, offer.data))
    return sent


class Recorded:
    """A bus with four nodes that records all its frames and everything each node received."""

    def __init__(self, order: tuple[str, ...] = NODES) -> None:
        self.log: list[Sent] = []
        self.bus = open_bus("can0", BIT_RATE, self._note)
        self.ports: dict[str, VirtualPort] = {name: self.bus.port(name) for name in order}
        self.heard: dict[str, list[CanFrame]] = {name: [] for name in order}

    def _note(self, frame: CanFrame, node: str) -> None:
        self.log.append(Sent(frame.stamp_ns, node, frame.can_id, frame.data))

    def play(self, offers: list[Offer], looks: list[tuple[int, str]]) -> None:
        """Send and receive in order of time; at equal instants receive before, between and
        after."""
        steps: list[tuple[int, Offer | str]] = [(at_ns, who) for at_ns, who in looks]
        for offer in offers:
            steps.append((offer.at_ns, offer))
            steps += [(at_ns, who) for at_ns, who in looks if at_ns == offer.at_ns]
        for at_ns, step in sorted(steps, key=lambda timed: timed[0]):
            if isinstance(step, Offer):
                self.ports[step.node].send(at_ns, step.can_id, step.data)
            else:
                self.look(at_ns, step)
        for name in NODES:
            self.look(FAR_NS, name)

    def look(self, now_ns: int, node: str) -> None:
        frames = self.ports[node].receive(now_ns)
        assert all(frame.stamp_ns <= now_ns for frame in frames)
        self.heard[node] += frames


# Instants lie on a coarse grid, so that offers coincide, with odd ones between. There are few
# identifiers, so that they collide.
INSTANTS = st.one_of(st.integers(0, 8).map(lambda n: n * 500_000), st.integers(0, 4_000_000))
OFFERS = st.lists(
    st.builds(
        Offer,
        at_ns=INSTANTS,
        node=st.sampled_from(NODES),
        can_id=st.sampled_from([0x101, 0x102, 0x181, 0x182, 0x700]),
        data=st.binary(max_size=8),
    ),
    max_size=40,
).map(lambda offers: sorted(offers, key=lambda offer: offer.at_ns))
LOOKS = st.lists(
    st.tuples(st.one_of(INSTANTS, st.integers(0, 12_000_000)), st.sampled_from(NODES)),
    max_size=20,
)


@given(offers=OFFERS, looks=LOOKS)
def test_the_bus_sends_the_frames_that_the_oracle_sends(
    offers: list[Offer], looks: list[tuple[int, str]]
) -> None:
    recorded = Recorded()

    recorded.play(offers, looks)

    assert recorded.log == arbitrate_by_hand(offers)


@given(offers=OFFERS, looks=LOOKS)
def test_every_frame_is_recorded_once_and_received_once_by_each_other_node(
    offers: list[Offer], looks: list[tuple[int, str]]
) -> None:
    recorded = Recorded()

    recorded.play(offers, looks)

    for name in NODES:
        of_others = [
            CanFrame(sent.end_ns, sent.can_id, sent.data)
            for sent in recorded.log
            if sent.node != name
        ]
        assert recorded.heard[name] == of_others
        own = [offer for offer in offers if offer.node == name]
        assert recorded.ports[name].counters.sent == len(own)
        assert recorded.ports[name].counters.received == len(of_others)
        assert recorded.ports[name].counters.dropped_out == 0
    assert len(recorded.log) == len(offers)


@given(offers=OFFERS, looks=LOOKS)
def test_no_two_frames_overlap_and_the_intermission_is_kept(
    offers: list[Offer], looks: list[tuple[int, str]]
) -> None:
    recorded = Recorded()

    recorded.play(offers, looks)

    for earlier, later in itertools.pairwise(recorded.log):
        assert later.start_ns >= earlier.end_ns + INTERMISSION_NS


@given(offers=OFFERS, looks=LOOKS)
def test_one_nodes_frames_of_one_identifier_keep_their_order(
    offers: list[Offer], looks: list[tuple[int, str]]
) -> None:
    recorded = Recorded()

    recorded.play(offers, looks)

    for node, can_id in itertools.product(NODES, {offer.can_id for offer in offers}):
        given_data = [o.data for o in offers if (o.node, o.can_id) == (node, can_id)]
        sent_data = [s.data for s in recorded.log if (s.node, s.can_id) == (node, can_id)]
        assert sent_data == given_data


@given(offers=OFFERS, looks=LOOKS, order=st.permutations(NODES), data=st.data())
def test_the_order_of_ports_calls_and_receptions_has_no_effect(
    offers: list[Offer], looks: list[tuple[int, str]], order: list[str], data: st.DataObject
) -> None:
    """The test varies the order of ports and of nodes at one instant, and the instants of
    reception."""
    plain = Recorded()
    plain.play(offers, [])
    rank = {name: number for number, name in enumerate(data.draw(st.permutations(NODES)))}
    reordered = sorted(offers, key=lambda offer: (offer.at_ns, rank[offer.node]))

    other = Recorded(tuple(order))
    other.play(reordered, looks)

    assert other.log == plain.log
    assert other.heard == plain.heard


@given(offers=OFFERS)
def test_the_statistics_are_those_of_the_frames(offers: list[Offer]) -> None:
    recorded = Recorded()

    recorded.play(offers, [])

    statistics = recorded.bus.statistics()
    bits = sum(frame_bits(sent.can_id, sent.data) for sent in recorded.log)
    assert (statistics.frames, statistics.busy_ns) == (len(offers), bits * BIT_NS)
    assert statistics.waiting == 0
    assert statistics.load_ratio(1_000_000_000) == pytest.approx(bits / BIT_RATE)


def test_the_lowest_identifier_wins_when_nodes_offer_at_one_instant() -> None:
    recorded = Recorded()
    recorded.ports["bcu"].send(1000, 0x182, b"")
    recorded.ports["vobc"].send(1000, 0x101, b"")
    recorded.ports["tcu"].send(1000, 0x103, b"")

    recorded.look(FAR_NS, "dcu")

    assert [sent.can_id for sent in recorded.log] == [0x101, 0x103, 0x182]


def test_a_started_frame_is_not_interrupted_by_a_lower_identifier() -> None:
    recorded = Recorded()
    recorded.ports["bcu"].send(1000, 0x700, bytes(8))
    recorded.ports["vobc"].send(1001, 0x001, b"")

    recorded.look(FAR_NS, "dcu")

    assert [sent.can_id for sent in recorded.log] == [0x700, 0x001]


def test_a_frame_is_received_at_its_last_bit_and_not_before() -> None:
    recorded = Recorded()
    recorded.ports["vobc"].send(1000, 0x101, b"\x12\x34")
    end_ns = 1000 + (frame_bits(0x101, b"\x12\x34") - 3) * BIT_NS

    assert recorded.ports["bcu"].receive(end_ns - 1) == ()
    assert recorded.bus.statistics().waiting == 1
    assert recorded.ports["bcu"].receive(end_ns) == [CanFrame(end_ns, 0x101, b"\x12\x34")]


def test_a_frame_is_received_at_its_last_bit_without_earlier_receptions() -> None:
    recorded = Recorded()
    recorded.ports["vobc"].send(1000, 0x101, b"\x12\x34")
    end_ns = 1000 + (frame_bits(0x101, b"\x12\x34") - 3) * BIT_NS

    assert recorded.ports["bcu"].receive(end_ns) == [CanFrame(end_ns, 0x101, b"\x12\x34")]


def test_a_reception_does_not_exclude_later_offers_at_the_same_instant() -> None:
    recorded = Recorded()
    recorded.ports["bcu"].send(1000, 0x182, b"")
    recorded.look(1000, "dcu")
    recorded.ports["vobc"].send(1000, 0x101, b"")

    recorded.look(FAR_NS, "dcu")

    assert [sent.can_id for sent in recorded.log] == [0x101, 0x182]


@given(offers=OFFERS, leaver=st.sampled_from(NODES), leaves_ns=INSTANTS)
def test_a_leaving_node_withdraws_only_frames_that_have_not_started(
    offers: list[Offer], leaver: str, leaves_ns: int
) -> None:
    offers = [offer for offer in offers if offer.node != leaver or offer.at_ns < leaves_ns]
    before = [offer for offer in offers if offer.at_ns < leaves_ns]
    recorded = Recorded()
    for offer in before:
        recorded.ports[offer.node].send(offer.at_ns, offer.can_id, offer.data)
    recorded.bus.advance(leaves_ns)

    recorded.ports[leaver].close()
    recorded.play([offer for offer in offers if offer.at_ns >= leaves_ns], [])

    assert recorded.log == arbitrate_by_hand(offers, leaver, leaves_ns)
    of_leaver = [sent for sent in recorded.log if sent.node == leaver]
    own = [offer for offer in offers if offer.node == leaver]
    assert recorded.ports[leaver].counters.dropped_out == len(own) - len(of_leaver)
    assert all(frame.stamp_ns <= leaves_ns for frame in recorded.heard[leaver])


def test_the_next_frame_starts_after_the_intermission() -> None:
    recorded = Recorded()
    recorded.ports["vobc"].send(0, 0x101, b"")
    recorded.ports["bcu"].send(5, 0x182, b"")

    recorded.look(FAR_NS, "dcu")

    first, second = recorded.log
    assert second.start_ns == first.end_ns + INTERMISSION_NS


def test_only_accepted_identifiers_are_delivered() -> None:
    bus = open_bus("can0", BIT_RATE)
    sender, brake, deaf = bus.port("vobc"), bus.port("bcu", [0x101]), bus.port("tag", [])
    sender.send(0, 0x101, b"")
    sender.send(0, 0x103, b"")

    assert [frame.can_id for frame in brake.receive(FAR_NS)] == [0x101]
    assert deaf.receive(FAR_NS) == ()


def test_a_node_that_joins_later_receives_frames_that_end_afterwards() -> None:
    bus = open_bus("can0", BIT_RATE)
    sender = bus.port("vobc")
    sender.send(0, 0x101, b"")
    bus.advance(10_000_000)
    late = bus.port("tap")
    sender.send(10_000_000, 0x101, b"now")

    assert [frame.data for frame in late.receive(FAR_NS)] == [b"now"]


def test_full_mailboxes_drop_and_count() -> None:
    recorded = Recorded()
    for _ in range(MAILBOX_FRAMES + 3):
        recorded.ports["vobc"].send(0, 0x101, b"")

    recorded.look(FAR_NS, "bcu")

    assert len(recorded.heard["bcu"]) == MAILBOX_FRAMES
    assert recorded.ports["vobc"].counters.sent == MAILBOX_FRAMES
    assert recorded.ports["vobc"].counters.dropped_out == 3


def test_only_frames_that_have_not_started_fill_a_mailbox() -> None:
    """Reception in between must not change which frames are dropped."""
    recorded = Recorded()
    for _ in range(MAILBOX_FRAMES):
        recorded.ports["vobc"].send(0, 0x101, b"")

    recorded.ports["vobc"].send(FAR_NS - 1, 0x101, b"")

    assert recorded.ports["vobc"].counters.dropped_out == 0


def test_a_full_inbox_drops_and_counts() -> None:
    bus = open_bus("can0", 1_000_000_000)
    sender, lazy, tap = bus.port("vobc"), bus.port("bcu"), bus.port("tap")
    for number in range(INBOX_FRAMES + 2):
        sender.send(number * 1000, 0x101, b"")
        tap.receive(number * 1000)

    frames = lazy.receive(FAR_NS)

    assert len(frames) == INBOX_FRAMES
    assert lazy.counters.dropped_in == 2


def test_a_leaving_node_withdraws_its_waiting_frames() -> None:
    recorded = Recorded()
    recorded.ports["vobc"].send(0, 0x101, b"")
    recorded.ports["vobc"].send(0, 0x102, b"")
    recorded.ports["bcu"].send(0, 0x182, b"")
    recorded.bus.advance(1)

    recorded.ports["vobc"].close()
    recorded.ports["vobc"].close()
    recorded.ports["vobc"].send(2, 0x103, b"")
    recorded.look(FAR_NS, "dcu")

    assert [sent.can_id for sent in recorded.log] == [0x101, 0x182]
    assert recorded.ports["vobc"].counters.dropped_out == 2
    assert recorded.ports["vobc"].receive(FAR_NS) == ()


def test_a_name_that_left_may_join_again() -> None:
    recorded = Recorded()
    recorded.ports["vobc"].close()

    again = recorded.bus.port("vobc")
    recorded.ports["bcu"].send(0, 0x182, b"")

    assert [frame.can_id for frame in again.receive(FAR_NS)] == [0x182]


def test_two_nodes_of_one_name_are_refused() -> None:
    recorded = Recorded()

    with pytest.raises(ValueError, match="'vobc' is connected already"):
        recorded.bus.port("vobc")


@pytest.mark.parametrize(("can_id", "data"), [(0x800, b""), (-1, b""), (1, bytes(9))])
def test_an_impossible_frame_is_refused_to_its_sender(can_id: int, data: bytes) -> None:
    recorded = Recorded()

    with pytest.raises(ValueError, match="frame"):
        recorded.ports["vobc"].send(0, can_id, data)

    recorded.look(FAR_NS, "bcu")
    assert recorded.log == []


def test_a_bus_without_a_bit_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="bit rate 0"):
        open_bus("can0", 0)


def test_time_that_runs_backwards_is_a_program_error() -> None:
    recorded = Recorded()
    recorded.bus.advance(1000)

    with pytest.raises(AssertionError, match="backwards"):
        recorded.bus.advance(999)
    with pytest.raises(AssertionError, match="backwards"):
        recorded.ports["vobc"].send(999, 0x101, b"")
