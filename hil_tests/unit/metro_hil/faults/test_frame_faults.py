"""Faults of frames: which frames come out when, and how a decoder judges them."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from can_dbc.binding import Frame, MessageProtection, binding_of, kinds
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder, Encoder, Rejected
from can_dbc.nodes import Node
from can_dbc.odometer import Tacho
from can_dbc.rejection import Reason
from firmware_py.settings import SettingsError
from metro_hil.faults.frames import FrameFaults, check_bus_fault
from metro_hil.faults.gateway import RECOVERY_NS, GatewayFaults
from metro_hil.model.frame_names import known_messages
from plant_emulator.faults.declared_bus import FrameDirection
from plant_emulator.faults.plan import FaultPlan, read_faults

MS = 1_000_000
S = 1000 * MS
SEED = 5
COMMAND = BrakeCommand(service_decel_mps2=0.5, emergency_released=True, holding_released=True)
GUARDED = [kind for kind in kinds() if binding_of(kind).protection is not MessageProtection.NONE]
BRAKE_ID, TWIN_ID = (each.frame_id for each in binding_of(BrakeCommand).messages)
Timed = tuple[int, int, bytes]


def plans(*tables: dict[str, Any]) -> tuple[FaultPlan, ...]:
    return read_faults(tables, "test")


def plan(kind: str, **parameters: Any) -> FaultPlan:
    return plans({"kind": kind, **parameters})[0]


def genuine(kind: type[Frame], payload: int) -> Frame | None:
    """A valid frame made of these bits, or None if they give none."""
    bound = binding_of(kind)
    size = bound.message.length - (0 if bound.protection is MessageProtection.NONE else 3)
    from can_dbc.packing import unpacker

    return unpacker(kind)(payload % (1 << 8 * size))


def stream(count: int = 40, period_ms: int = 50) -> list[Timed]:
    """Brake commands as the controller sends them."""
    encoder = Encoder()
    return [
        (n * period_ms * MS, can_id, data)
        for n in range(count)
        for can_id, data in encoder.encode(COMMAND)
    ]


def through(
    faults: FrameFaults | GatewayFaults,
    frames: list[Timed],
    acting: tuple[FaultPlan, ...],
    way: FrameDirection = FrameDirection.TO_TRAIN,
    until_ns: int = 1 * S,
) -> list[Timed]:
    """All frames that come out; the faults act from the first instant until `until_ns`."""
    for each in acting:
        faults.change(each, True, 0)
    out: list[Timed] = []
    ended = False
    for at_ns, can_id, data in frames:
        if at_ns >= until_ns and not ended:
            ended = True
            out += faults.take(until_ns, way)
            for each in acting:
                faults.change(each, False, until_ns)
        faults.offer(at_ns, way, can_id, data)
        out += faults.take(at_ns, way)
    return out + faults.take(1000 * S, way)


def decoded(frames: list[Timed], kind: type[Frame] = BrakeCommand) -> list[Frame | Rejected]:
    decoder = Decoder([kind])
    heard = (decoder.decode(can_id, data, at_ns) for at_ns, can_id, data in frames)
    return [each for each in heard if each is not None]


def test_without_a_fault_everything_passes_unchanged() -> None:
    faults = FrameFaults(SEED)

    assert through(faults, stream(), ()) == stream()
    assert not faults.done


@given(loss_ratio=st.floats(0.0, 1.0), seed=st.integers(0, 50))
def test_dropped_frames_are_counted_and_only_while_the_fault_acts(
    loss_ratio: float, seed: int
) -> None:
    faults = FrameFaults(seed)
    sent = stream()

    came = through(faults, sent, plans({"kind": "frame_drop", "loss_ratio": loss_ratio}))

    assert len(came) + sum(faults.done.values()) == len(sent)
    assert came[-40:] == sent[-40:]
    assert sum(faults.done.values()) <= 40
    assert len(faults.events) == sum(faults.done.values())


def test_a_pattern_affects_only_matching_frames() -> None:
    faults = FrameFaults(SEED)

    came = through(faults, stream(), plans({"kind": "frame_drop", "frames": "BRAKE_CMD"}))

    assert len(came) == 60
    assert faults.done == {("frame_drop", "BRAKE_CMD"): 20}
    refused = [each.reason for each in decoded(came) if isinstance(each, Rejected)]
    assert refused == [Reason.TWIN_MISMATCH] * 20


def test_a_fault_of_one_direction_does_not_affect_the_other() -> None:
    faults = FrameFaults(SEED)

    came = through(faults, stream(), plans({"kind": "frame_drop", "way": "to_vobc"}))

    assert came == stream()


@given(delay_s=st.floats(0.0, 0.5), jitter_s=st.floats(0.0, 0.5), seed=st.integers(0, 50))
def test_a_delay_keeps_the_order_even_after_its_end(
    delay_s: float, jitter_s: float, seed: int
) -> None:
    faults = FrameFaults(seed)
    sent = stream()

    came = through(
        faults, sent, plans({"kind": "frame_delay", "delay_s": delay_s, "jitter_s": jitter_s})
    )

    assert [each[1:] for each in came] == [each[1:] for each in sent]
    for (due_ns, _, _), (at_ns, _, _) in zip(came[:40], sent[:40], strict=True):
        assert at_ns + delay_s * S - 1 <= due_ns <= 950 * MS + (delay_s + jitter_s) * S + 1
    assert came[-1][0] == max(sent[-1][0], came[-3][0])


def test_a_delay_without_jitter_is_exact() -> None:
    came = through(FrameFaults(SEED), stream(20), plans({"kind": "frame_delay", "delay_s": 0.03}))

    assert [due_ns for due_ns, _, _ in came] == [at_ns + 30 * MS for at_ns, _, _ in stream(20)]


@given(share_ratio=st.floats(0.0, 1.0), hold_s=st.floats(0.0, 0.3), seed=st.integers(0, 50))
def test_reordering_permutes_and_loses_nothing(
    share_ratio: float, hold_s: float, seed: int
) -> None:
    faults = FrameFaults(seed)
    sent = stream()

    came = through(
        faults,
        sent,
        plans({"kind": "frame_reorder", "share_ratio": share_ratio, "hold_s": hold_s}),
    )

    assert sorted(each[1:] for each in came) == sorted(each[1:] for each in sent)
    assert [each[0] for each in came] == sorted(each[0] for each in came)


def test_copies_follow_at_their_gap_and_a_decoder_refuses_them() -> None:
    acting = plans({"kind": "frame_duplicate", "copies": 2, "gap_s": 0.004})
    came = through(FrameFaults(SEED), stream(20), acting)

    assert len(came) == 120
    assert [each[0] for each in came if each[1:] == stream(1)[0][1:]] == [0, 4 * MS, 8 * MS]
    assert sum(isinstance(each, BrakeCommand) for each in decoded(came)) == 20


def test_a_replay_repeats_the_last_second_with_its_timing() -> None:
    faults = FrameFaults(SEED)
    sent = stream(80)
    replay = plan("frame_replay", memory_s=1.0)
    for at_ns, can_id, data in sent[:80]:
        faults.offer(at_ns, FrameDirection.TO_TRAIN, can_id, data)
    faults.take(2 * S - 1, FrameDirection.TO_TRAIN)

    faults.change(replay, True, 2 * S)
    came = faults.take(4 * S, FrameDirection.TO_TRAIN)

    last_second = [each for each in sent[:80] if 1 * S < each[0] <= 2 * S]
    assert len(last_second) == 38
    once = [(at_ns + 1 * S, can_id, data) for at_ns, can_id, data in last_second]
    again = [(at_ns + 2 * S, can_id, data) for at_ns, can_id, data in last_second]
    assert came == once + again
    faults.change(replay, False, 4 * S)
    assert faults.take(100 * S, FrameDirection.TO_TRAIN) == []
    assert faults.next_due_ns() is None


@settings(max_examples=200)
@given(
    kind=st.sampled_from(GUARDED),
    payload=st.integers(0, (1 << 64) - 1),
    bits=st.integers(1, 64),
    seed=st.integers(0, 1000),
)
def test_no_frame_corrupted_after_its_crc_is_ever_accepted(
    kind: type[Frame], payload: int, bits: int, seed: int
) -> None:
    frame = genuine(kind, payload)
    if frame is None:
        return
    faults = FrameFaults(seed)
    way = FrameDirection.TO_VOBC
    acting = plans({"kind": "frame_corrupt", "bits": bits, "damage": "after_crc"})
    sent = [(0, can_id, data) for can_id, data in Encoder().encode(frame)]

    came = through(faults, sent, acting, way)

    assert len(came) == len(sent)
    heard = decoded(came, kind)
    assert heard
    assert all(isinstance(each, Rejected) for each in heard)


@settings(max_examples=200)
@given(
    kind=st.sampled_from(GUARDED),
    payload=st.integers(0, (1 << 64) - 1),
    bits=st.integers(1, 8),
    seed=st.integers(0, 1000),
)
def test_every_frame_corrupted_before_its_crc_is_accepted_with_a_wrong_value(
    kind: type[Frame], payload: int, bits: int, seed: int
) -> None:
    frame = genuine(kind, payload)
    if frame is None:
        return
    faults = FrameFaults(seed)
    acting = plans({"kind": "frame_corrupt", "bits": bits, "damage": "before_crc"})
    encoder = Encoder()
    sent = [(n * MS, can_id, data) for n in range(3) for can_id, data in encoder.encode(frame)]

    came = through(faults, sent, acting, FrameDirection.TO_VOBC)

    heard = decoded(came, kind)
    assert len(heard) == 3
    for each in heard:
        assert isinstance(each, kind)
        assert each != frame


def test_a_pair_whose_first_half_passed_before_the_fault_is_unchanged() -> None:
    faults = FrameFaults(SEED)
    corrupt = plan("frame_corrupt", damage="before_crc")
    first, second = Encoder().encode(COMMAND)
    faults.offer(0, FrameDirection.TO_TRAIN, *first)
    faults.change(corrupt, True, 1)
    faults.offer(2, FrameDirection.TO_TRAIN, *second)

    assert decoded(faults.take(2, FrameDirection.TO_TRAIN)) == [COMMAND]


def test_a_masquerading_node_is_accepted_when_the_genuine_sender_is_silent() -> None:
    faults = FrameFaults(SEED)
    values = {"service_decel_mps2": 0.0, "emergency_released": 1.0}
    mask = plan("masquerade", frame="BRAKE_CMD", values=values, period_s=0.05)
    genuine_frames = stream(3)
    for at_ns, can_id, data in genuine_frames:
        faults.offer(at_ns, FrameDirection.TO_TRAIN, can_id, data)
    before = faults.take(149 * MS, FrameDirection.TO_TRAIN)
    faults.change(mask, True, 150 * MS)
    came = faults.take(399 * MS, FrameDirection.TO_TRAIN)

    assert [at_ns // MS for at_ns, can_id, _ in came if can_id == BRAKE_ID] == [
        150,
        200,
        250,
        300,
        350,
    ]
    heard = decoded(before + came)
    assert heard[:3] == [COMMAND] * 3
    assert heard[3:] == [BrakeCommand(0.0, True, True)] * 5


def test_beside_the_genuine_sender_a_masquerading_node_is_detected_by_its_counter() -> None:
    faults = FrameFaults(SEED)
    mask = plan("masquerade", frame="BRAKE_CMD", values={"service_decel_mps2": 0.0})

    came = through(faults, stream(), (mask,))

    refused = [each.reason for each in decoded(came) if isinstance(each, Rejected)]
    assert Reason.STUCK_COUNTER in refused


def test_a_masquerading_node_without_the_twin_is_never_accepted() -> None:
    faults = FrameFaults(SEED)
    mask = plan("masquerade", frame="BRAKE_CMD", twins=False)
    faults.offer(0, FrameDirection.TO_TRAIN, *stream(1)[0][1:])
    faults.take(0, FrameDirection.TO_TRAIN)
    faults.change(mask, True, 1)

    came = faults.take(1 * S, FrameDirection.TO_TRAIN)

    assert {can_id for _, can_id, _ in came} == {BRAKE_ID}
    assert all(isinstance(each, Rejected) for each in decoded(came))


def test_a_masquerading_node_that_received_nothing_sends_nothing() -> None:
    faults = FrameFaults(SEED)
    faults.change(plan("masquerade"), True, 0)

    assert faults.take(1 * S, FrameDirection.TO_TRAIN) == []


def test_the_next_due_instant_is_reported() -> None:
    faults = FrameFaults(SEED)
    faults.change(plan("frame_delay", delay_s=0.1), True, 0)
    assert faults.next_due_ns() is None
    faults.offer(5 * MS, FrameDirection.TO_TRAIN, BRAKE_ID, b"")
    assert faults.next_due_ns() == 105 * MS
    assert faults.take(105 * MS - 1, FrameDirection.TO_TRAIN) == []
    assert faults.take(105 * MS, FrameDirection.TO_VOBC) == []
    assert faults.take(105 * MS, FrameDirection.TO_TRAIN) == [(105 * MS, BRAKE_ID, b"")]


EVERYTHING = (
    {"kind": "frame_drop", "loss_ratio": 0.1},
    {"kind": "frame_corrupt", "share_ratio": 0.2, "bits": 3},
    {"kind": "frame_corrupt", "share_ratio": 0.2, "damage": "before_crc"},
    {"kind": "frame_delay", "delay_s": 0.01, "jitter_s": 0.02},
    {"kind": "frame_reorder", "share_ratio": 0.2},
    {"kind": "frame_duplicate", "share_ratio": 0.2},
    {"kind": "masquerade", "values": {"service_decel_mps2": 0.0}},
)


def test_the_same_seed_gives_the_same_frames_and_another_one_does_not() -> None:
    def run(seed: int) -> list[Timed]:
        return through(FrameFaults(seed), stream(), plans(*EVERYTHING))

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_another_fault_does_not_change_the_samples_of_the_first() -> None:
    alone = plans({"kind": "frame_drop", "loss_ratio": 0.5})
    both = plans(
        {"kind": "frame_drop", "loss_ratio": 0.5},
        {"kind": "frame_reorder", "share_ratio": 0.5, "hold_s": 0.001},
    )

    first = through(FrameFaults(SEED), stream(), alone)
    second = through(FrameFaults(SEED), stream(), both)

    assert sorted(each[1:] for each in first) == sorted(each[1:] for each in second)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "frame_drop", "frames": "BRAKE_CMDD"}, ["frames", "BRAKE_CMDD", "BRAKE_CMD"]),
        ({"kind": "frame_delay", "frames": "TACHOO*"}, ["TACHOO*", "TACHO"]),
        ({"kind": "frame_drop", "frames": "TACHO*", "way": "to_train"}, ["way", "to_vobc"]),
        ({"kind": "masquerade", "frame": "BRAKE_CMD_INV"}, ["frame", "BRAKE_CMD"]),
        (
            {"kind": "masquerade", "values": {"service_decel": 1.0}},
            ["values.service_decel", "service_decel_mps2"],
        ),
        (
            {"kind": "masquerade", "values": {"emergency_released": 0.5}},
            ["emergency_released", "0.5", "0 or 1"],
        ),
        (
            {"kind": "masquerade", "frame": "TRACTION_CMD", "values": {"direction": 3}},
            ["direction", "0 NEUTRAL, 1 FORWARD, 2 REVERSE"],
        ),
    ],
)
def test_a_fault_of_unknown_frames_is_refused(table: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(SettingsError) as refused:
        check_bus_fault(plans(table)[0])

    assert all(word in str(refused.value) for word in ["fault[0]", *words])


@pytest.mark.parametrize("table", [*EVERYTHING, {"kind": "bus_off"}, {"kind": "wheel_slip"}])
def test_a_fault_of_existing_frames_is_accepted(table: dict[str, Any]) -> None:
    check_bus_fault(plans(table)[0])


def test_every_message_has_a_sender_and_a_direction() -> None:
    assert len(known_messages()) >= 30
    assert {each.sender for each in known_messages().values()} == {node.name for node in Node}
    status = known_messages()[binding_of(BrakeStatus).message.frame_id]
    assert (status.name, status.sender, status.way) == (
        "BRAKE_STATUS",
        "BCU",
        FrameDirection.TO_VOBC,
    )


# A gateway between two segments.


def test_a_gateway_forwards_nothing_of_a_bus_off_controller_until_its_recovery() -> None:
    faults = GatewayFaults(SEED)
    off = plan("bus_off")
    faults.change(off, True, 0)
    faults.offer(1, FrameDirection.TO_TRAIN, BRAKE_ID, b"a")
    faults.offer(1, FrameDirection.TO_VOBC, 0x182, b"b")
    faults.change(off, False, 1 * S)
    faults.offer(1 * S + RECOVERY_NS - 1, FrameDirection.TO_TRAIN, BRAKE_ID, b"c")
    faults.offer(1 * S + RECOVERY_NS, FrameDirection.TO_TRAIN, BRAKE_ID, b"d")

    assert [data for _, _, data in faults.take(2 * S, FrameDirection.TO_TRAIN)] == [b"d"]
    assert faults.take(2 * S, FrameDirection.TO_VOBC) == []
    assert RECOVERY_NS == 128 * 11 * 4000
    assert sum(faults.done.values()) == 3


def test_a_gateway_disconnects_one_node_of_the_train_in_both_directions() -> None:
    faults = GatewayFaults(SEED)
    faults.change(plan("link_cut", node="bcu"), True, 0)
    tacho_id = binding_of(Tacho).message.frame_id
    for way, can_id in (
        (FrameDirection.TO_VOBC, 0x182),
        (FrameDirection.TO_VOBC, tacho_id),
        (FrameDirection.TO_TRAIN, BRAKE_ID),
    ):
        faults.offer(1, way, can_id, b"")

    assert [can_id for _, can_id, _ in faults.take(1, FrameDirection.TO_VOBC)] == [tacho_id]
    assert faults.take(1, FrameDirection.TO_TRAIN) == []
    assert faults.done["link_cut", "BRAKE_CMD"] == 1


def test_a_gateway_babbles_at_its_rate_on_both_sides() -> None:
    faults = GatewayFaults(SEED)
    idiot = plan("babbling_idiot", can_id=1, load_ratio=0.25)
    faults.change(idiot, True, 0)
    came = dict.fromkeys((FrameDirection.TO_TRAIN, FrameDirection.TO_VOBC), 0)
    for step in range(1000):
        for way in came:
            came[way] += len(faults.take(step * MS, way))

    # 8 bytes take some 115 bits of 4 µs, so 2170 frames a second would fill the bus.
    assert (
        came[FrameDirection.TO_TRAIN]
        == came[FrameDirection.TO_VOBC]
        == pytest.approx(0.25 * 2170, rel=0.05)
    )
    faults.change(idiot, False, 1 * S)
    assert faults.take(10 * S, FrameDirection.TO_TRAIN) == []


def test_a_gateway_makes_frames_destroyed_on_the_wire_late() -> None:
    faults = GatewayFaults(SEED)
    acting = plans({"kind": "frame_corrupt", "damage": "on_wire", "share_ratio": 0.5})

    came = through(faults, stream(20), acting)

    assert len(came) == 40
    late_ns = sum(came[n][0] for n in range(40)) - sum(at_ns for at_ns, _, _ in stream(20))
    assert 0 < late_ns < 40 * 5 * MS
    assert sum(isinstance(each, BrakeCommand) for each in decoded(came)) >= 19
