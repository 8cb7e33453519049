"""The gateway's forwarding between two segments, with and without bus faults."""

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.buses.inproc import MAILBOX_FRAMES
from firmware_py.ports import CanFrame, LinkCounters
from metro_hil.faults.frames import FrameFaults
from metro_hil.faults.gateway import BABBLE, GatewayFaults
from metro_hil.realtime.gateway.forwarding import Forwarding
from plant_emulator.faults.declared_bus import FrameDirection
from plant_emulator.faults.plan import FaultPlan, read_faults

MS = 1_000_000
S = 1_000_000_000
BRAKE_ID = 0x101
UNKNOWN_ID = 0x7A0


class Segment:
    """One end of the gateway: returns prepared frames and records sent ones."""

    def __init__(self) -> None:
        self.counters = LinkCounters()
        self.coming: list[CanFrame] = []
        self.sent: list[tuple[int, int, bytes]] = []

    def send(self, now_ns: int, can_id: int, data: bytes) -> None:
        self.sent.append((now_ns, can_id, data))

    def receive(self, now_ns: int) -> Sequence[CanFrame]:
        coming, self.coming = self.coming, []
        return coming

    def close(self) -> None: ...


def plan_of(kind: str, **keys: object) -> FaultPlan:
    return read_faults([{"kind": kind, **keys}], "case")[0]


frames = st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=40)


@given(to_train=frames, to_vobc=frames)
def test_without_faults_both_directions_get_everything_once_in_order(
    to_train: list[tuple[int, bytes]], to_vobc: list[tuple[int, bytes]]
) -> None:
    a, b = Segment(), Segment()
    forwarding = Forwarding(a, b, FrameFaults(1))
    a.coming = [CanFrame(n, *frame) for n, frame in enumerate(to_train)]
    b.coming = [CanFrame(n, *frame) for n, frame in enumerate(to_vobc)]

    forwarding.step(100)

    assert [sent[1:] for sent in b.sent] == to_train
    assert [sent[1:] for sent in a.sent] == to_vobc


def test_frames_of_unknown_nodes_are_counted_and_not_forwarded() -> None:
    a, b = Segment(), Segment()
    forwarding = Forwarding(a, b, FrameFaults(1))
    a.coming = [CanFrame(0, 5, b"", extended=True), CanFrame(0, 5, b"", remote=True)]

    forwarding.step(0)

    assert b.sent == []
    assert forwarding.uncommon == 2


def test_a_delayed_frame_is_sent_when_it_is_due_and_not_before() -> None:
    a, b = Segment(), Segment()
    faults = FrameFaults(1)
    forwarding = Forwarding(a, b, faults)
    faults.change(plan_of("frame_delay", delay_s=0.1), True, 0)
    a.coming = [CanFrame(0, UNKNOWN_ID, b"\x01")]

    forwarding.step(5 * MS)
    assert b.sent == []
    assert forwarding.next_due_ns == 100 * MS
    forwarding.step(101 * MS)

    assert b.sent == [(101 * MS, UNKNOWN_ID, b"\x01")]
    assert forwarding.wait_us.max == 1_000, "only what is beyond the fault's own delay"


def test_a_frame_is_dropped_in_its_direction_only() -> None:
    a, b = Segment(), Segment()
    faults = FrameFaults(1)
    forwarding = Forwarding(a, b, faults)
    faults.change(plan_of("frame_drop", way="to_train"), True, 0)
    a.coming = [CanFrame(1, UNKNOWN_ID, b"\x01")]
    b.coming = [CanFrame(2, UNKNOWN_ID, b"\x02")]

    forwarding.step(MS)

    assert b.sent == []
    assert [sent[2] for sent in a.sent] == [b"\x02"]
    assert forwarding.summary()["came_to_train"] == 1
    assert forwarding.summary()["sent_to_train"] == 0


def test_how_long_frames_waited_is_measured_from_their_own_instants() -> None:
    a, b = Segment(), Segment()
    forwarding = Forwarding(a, b, FrameFaults(1))
    for wait_ms in (1, 2, 40):
        a.coming = [CanFrame(S + wait_ms * S, UNKNOWN_ID, b"")]
        forwarding.step(S + wait_ms * S + wait_ms * MS)

    assert forwarding.longest_wait_us() == pytest.approx(40_000.0)
    assert forwarding.longest_wait_us() == 0.0, "only since the last call"
    assert forwarding.summary()["wait_p50_us"] == pytest.approx(2_000, rel=1 / 64)


def test_stamps_of_two_segments_that_cross_do_not_turn_the_faults_time_back() -> None:
    a, b = Segment(), Segment()
    forwarding = Forwarding(a, b, FrameFaults(1))
    a.coming = [CanFrame(10 * MS, BRAKE_ID, bytes(8))]
    forwarding.step(11 * MS)

    b.coming = [CanFrame(9 * MS, BRAKE_ID, bytes(8))]
    forwarding.step(12 * MS)

    assert len(a.sent) == len(b.sent) == 1


def crowded(load_ratio: float = 1.0, can_id: int = 0) -> tuple[GatewayFaults, FaultPlan]:
    """A babbling idiot from the start on."""
    faults, idiot = (
        GatewayFaults(1),
        plan_of("babbling_idiot", can_id=can_id, load_ratio=load_ratio),
    )
    faults.change(idiot, True, 0)
    return faults, idiot


def genuine(taken: Sequence[tuple[int, int, bytes]]) -> list[tuple[int, bytes]]:
    return [(can_id, data) for _, can_id, data in taken if data != BABBLE]


def test_a_babbling_idiot_with_the_lowest_identifier_blocks_all_other_nodes() -> None:
    """The segments are virtual and would have room for all frames."""
    faults, idiot = crowded()
    for step in range(100):
        faults.offer(step * MS, FrameDirection.TO_TRAIN, BRAKE_ID, bytes([step]))
        assert genuine(faults.take(step * MS, FrameDirection.TO_TRAIN)) == []

    faults.change(idiot, False, 100 * MS)
    came = genuine(faults.take(200 * MS, FrameDirection.TO_TRAIN))

    assert came == [(BRAKE_ID, bytes([step])) for step in range(100)]
    faults.offer(201 * MS, FrameDirection.TO_TRAIN, BRAKE_ID, b"x")
    assert faults.take(201 * MS, FrameDirection.TO_TRAIN) == [(201 * MS, BRAKE_ID, b"x")]


def test_waiting_frames_are_sent_by_identifier_and_later_ones_wait() -> None:
    faults, idiot = crowded()
    for can_id in (0x300, 0x100, 0x200):
        faults.offer(0, FrameDirection.TO_VOBC, can_id, bytes(8))
    faults.take(10 * MS, FrameDirection.TO_VOBC)
    faults.change(idiot, False, 10 * MS)

    came = faults.take(20 * MS, FrameDirection.TO_VOBC)

    assert [can_id for _, can_id, data in came if data != BABBLE] == [0x100, 0x200, 0x300]
    starts_ns = [at_ns for at_ns, _, data in came if data != BABBLE]
    # Eight bytes take at least 111 bits of 4 µs each.
    assert all(b - a >= 111 * 4_000 for a, b in itertools.pairwise(starts_ns))


@pytest.mark.parametrize(
    ("load_ratio", "can_id"),
    [(1.0, 0x7FF), (0.5, 0)],
    ids=["one who loses", "one who leaves room"],
)
def test_a_babbling_idiot_delays_lower_identifiers_by_at_most_a_frame(
    load_ratio: float, can_id: int
) -> None:
    faults, _ = crowded(load_ratio, can_id)
    for step in range(100):
        faults.take(step * 10 * MS, FrameDirection.TO_TRAIN)
        faults.offer(step * 10 * MS, FrameDirection.TO_TRAIN, BRAKE_ID, b"")
        came = faults.take(step * 10 * MS + 2 * MS, FrameDirection.TO_TRAIN)
        (at_ns,) = [at_ns for at_ns, each, _ in came if each == BRAKE_ID]
        assert at_ns - step * 10 * MS <= 2 * 160 * 4_000


def test_a_blocked_node_keeps_no_more_than_its_mailboxes_hold() -> None:
    faults, idiot = crowded()
    for step in range(2 * MAILBOX_FRAMES):
        faults.offer(step * MS, FrameDirection.TO_TRAIN, BRAKE_ID, b"")
        faults.take(step * MS, FrameDirection.TO_TRAIN)
    faults.change(idiot, False, 1 * S)

    assert len(genuine(faults.take(9 * S, FrameDirection.TO_TRAIN))) == MAILBOX_FRAMES
    assert faults.next_due_ns() is None
