"""The gateway's forwarding between two segments, with and without faults of the bus."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.ports import CanFrame, LinkCounters
from metro_hil.frame_faults import FrameFaults
from metro_hil.gateway.forwarding import Forwarding
from plant_emulator.faults.plan import FaultPlan, read_faults

MS = 1_000_000
S = 1_000_000_000
BRAKE_ID = 0x101
UNKNOWN_ID = 0x7A0


class Segment:
    """One end of the gateway: gives what is put in, notes what is sent."""

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
def test_without_faults_both_ways_get_everything_once_in_order(
    to_train: list[tuple[int, bytes]], to_vobc: list[tuple[int, bytes]]
) -> None:
    a, b = Segment(), Segment()
    forwarding = Forwarding(a, b, FrameFaults(1))
    a.coming = [CanFrame(n, *frame) for n, frame in enumerate(to_train)]
    b.coming = [CanFrame(n, *frame) for n, frame in enumerate(to_vobc)]

    forwarding.step(100)

    assert [sent[1:] for sent in b.sent] == to_train
    assert [sent[1:] for sent in a.sent] == to_vobc


def test_what_no_node_of_a_train_sends_is_counted_and_not_passed_on() -> None:
    a, b = Segment(), Segment()
    forwarding = Forwarding(a, b, FrameFaults(1))
    a.coming = [CanFrame(0, 5, b"", extended=True), CanFrame(0, 5, b"", remote=True)]

    forwarding.step(0)

    assert b.sent == []
    assert forwarding.uncommon == 2


def test_a_delayed_frame_goes_out_when_it_is_due_and_not_before() -> None:
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


def test_a_dropped_frame_is_gone_on_its_way_only() -> None:
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
