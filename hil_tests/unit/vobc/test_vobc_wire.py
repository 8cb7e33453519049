"""The controller's wires: inputs become one image with ages, and outputs are encoded correctly."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.alarms import TrainAlarms
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.codec import Decoder, Encoder
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeHeartbeat, NodeState
from can_dbc.doors import DoorCars, DoorCommand, DoorState, DoorStatus
from can_dbc.energy import LineSupply
from can_dbc.nodes import Direction, Node
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.vobc import (
    Cause,
    EventKind,
    Intervention,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
    TargetKind,
    VobcEvent,
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
)
from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.tag_reader.telegram import HealthTelegram, TagTelegram, encode
from firmware_py.trackdb import TagKind
from hil_tests.unit.vobc.atp.heard_rig import DESK
from vobc.vocabulary import (
    NEVER_S,
    SAFE_OUTPUT,
    Ceiling,
    CycleOutput,
    Event,
    Interval,
    Motion,
    Restriction,
    Source,
    SupervisedTarget,
)
from vobc.wire import (
    RECEIVED_IDS,
    SOURCE_IDS,
    TACHO_SAMPLES_MAX,
    TAGS_MAX,
    Evidence,
    Inbox,
    RadioLink,
    Refusal,
    Refusals,
    door_cars_frame,
    door_frame,
    emergency_message,
    event_frame,
    heartbeat,
    limit_frames,
    make_encoder,
    mode_frame,
    motion_frames,
    status_frame,
    target_frames,
    vital_frames,
)
from vobc.wire.refusals import KEYS_MAX
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import (
    Message,
    MovementAuthority,
    PositionReport,
    Refused,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)

MS = 1_000_000
MOTION = Motion(
    Interval(99.0, 100.0, 101.5), Interval(9.8, 10.0, 10.2), 0.1, 50.0, False, False, True, True, ()
)
CEILING = Ceiling(15.0, 16.0, 17.0, 18.0, 400.0)
DRIVING: CycleOutput = replace(
    SAFE_OUTPUT,
    force_n=50_000.0,
    direction=Direction.FORWARD,
    traction_permitted=True,
    service_decel_mps2=0.0,
    emergency_released=True,
    holding_released=True,
    supervision=Supervision.NOMINAL,
    motion=MOTION,
    ceiling=CEILING,
    distance_to_stop_m=77.0,
)


SAMPLES: dict[Source, Any] = {
    Source.TACHO: Tacho(5, 6, Direction.FORWARD, True, True, 10.0),
    Source.DOPPLER: Doppler(3.0, 90.0, True),
    Source.IMU: Imu(0.1, True),
    Source.COLD: ColdMovement(0.0, True),
    Source.BRAKE: BrakeStatus(0.1, 0.0, False, True, False, True),
    Source.TRACTION: TractionStatus(0.0, 1.0, True, True),
    Source.DOORS: DoorStatus(True, DoorState.LOCKED, DoorState.LOCKED, True),
    Source.DESK: DESK,
    Source.TAG_READER: TagReaderHealth(True, 0, 0.0),
    Source.ALARMS: TrainAlarms(True, True),
    Source.SUPPLY: LineSupply(750.0, 100.0, True),
}


DATABASE, PARAMETERS = 11, 12


def link(max_age_s: float = 1.0) -> RadioLink:
    return RadioLink(
        line_name="florence",
        train=7,
        boot=3,
        max_age_s=max_age_s,
        train_length_m=68.59,
        database=DATABASE,
        parameters=PARAMETERS,
    )


def frames(encoder: Encoder, frame: object, stamp_ns: int) -> list[CanFrame]:
    return [CanFrame(stamp_ns, *sent) for sent in encoder.encode(frame)]  # type: ignore[arg-type]


def tacho(pulses: int, sampled_ms: int) -> Tacho:
    return Tacho(pulses, pulses + 1, Direction.FORWARD, True, True, sampled_ms % 256)


def test_before_the_first_frame_every_input_is_missing() -> None:
    image = Inbox(link()).image(5 * MS, dt_s=0.05, overruns=1)

    assert image.tacho is None
    assert image.brake is None
    assert image.authority is None
    ages_s = [image.tacho_age_s, image.brake_age_s, image.desk_age_s, image.authority_age_s]
    assert ages_s == [NEVER_S] * 4
    assert (image.dt_s, image.overruns, image.tags, image.tacho_samples) == (0.05, 1, (), ())


def test_the_image_holds_the_latest_of_each_input_with_its_age() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    old = BrakeStatus(0.1, 0.0, False, True, False, True)
    new = replace(old, applied_decel_mps2=0.5)

    inbox.take_frames(frames(encoder, old, 10 * MS) + frames(encoder, new, 60 * MS))
    image = inbox.image(100 * MS, dt_s=0.05, overruns=0)

    assert image.brake is not None
    assert image.brake.applied_decel_mps2 == pytest.approx(0.5, abs=0.01)
    assert image.brake_age_s == pytest.approx(0.040)
    later = inbox.image(150 * MS, dt_s=0.05, overruns=0)
    assert later.brake == image.brake
    assert later.brake_age_s == pytest.approx(0.090)


def test_every_tacho_sample_is_passed_on_once_and_in_order() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    for number in range(3):
        at_ms = 10 + 20 * number
        inbox.take_frames(frames(encoder, tacho(number, at_ms), at_ms * MS))

    first = inbox.image(60 * MS, dt_s=0.05, overruns=0)
    second = inbox.image(110 * MS, dt_s=0.05, overruns=0)

    assert [sample.frame.pulses_a for sample in first.tacho_samples] == [0, 1, 2]
    assert [sample.age_s for sample in first.tacho_samples] == pytest.approx([0.05, 0.03, 0.01])
    assert second.tacho_samples == ()
    assert second.tacho is not None
    assert second.tacho_age_s == pytest.approx(0.06)


def test_a_delayed_tacho_frame_is_as_old_as_its_sample() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    for number, late_ms in enumerate((0, 0, 60, 40)):
        sampled_ms = 20 * number
        received_at_ns = (sampled_ms + late_ms) * MS
        inbox.take_frames(frames(encoder, tacho(number, sampled_ms), received_at_ns))

    image = inbox.image(100 * MS, dt_s=0.05, overruns=0)

    ages_s = [sample.age_s for sample in image.tacho_samples]
    assert ages_s == pytest.approx([0.1, 0.08, 0.06, 0.04], abs=1e-4)
    assert image.tacho_age_s == pytest.approx(0.04, abs=1e-4)


def test_a_tacho_frame_that_is_too_old_is_counted_and_prevents_no_timeout() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    for number, late_ms in enumerate((0, 0, 0, 110)):
        sampled_ms = 20 * number
        received_at_ns = (sampled_ms + late_ms) * MS
        inbox.take_frames(frames(encoder, tacho(number, sampled_ms), received_at_ns))

    image = inbox.image(180 * MS, dt_s=0.05, overruns=0)

    assert inbox.late_samples == 1
    assert image.tacho_age_s == pytest.approx(0.14, abs=1e-4)


def test_no_buffer_grows_without_bound_when_images_are_not_read() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    flood = [
        frame
        for number in range(200)
        for frame in frames(encoder, tacho(number, number), number * MS)
    ]
    inbox.take_frames(flood)
    for number in range(100):
        telegram = TagTelegram(number % 256, 5, TagKind.T1, number, number, number)
        inbox.take_serial([SerialChunk(0, encode(telegram))])

    image = inbox.image(300 * MS, dt_s=0.05, overruns=0)

    assert len(image.tacho_samples) == TACHO_SAMPLES_MAX
    assert image.tacho_samples[-1].frame.pulses_a == 199
    assert len(image.tags) == TAGS_MAX
    assert inbox.overflowed == 200 - TACHO_SAMPLES_MAX + 100 - TAGS_MAX


def test_a_damaged_frame_is_counted_and_changes_nothing() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    (good,) = frames(encoder, tacho(5, 10), 10 * MS)
    flipped = good._replace(data=bytes([good.data[0] ^ 1]) + good.data[1:])
    unknown = CanFrame(10 * MS, 0x7FF, b"")
    wide = good._replace(extended=True)

    inbox.take_frames([flipped, unknown, wide, good._replace(error=True)])

    assert inbox.rejected == 3
    assert inbox.image(20 * MS, dt_s=0.05, overruns=0).tacho is None


@pytest.mark.parametrize("source", [*SAMPLES])
def test_the_evidence_of_a_frame_is_its_bytes(source: Source) -> None:
    inbox, encoder = Inbox(link()), Encoder()
    sent = [frames(encoder, SAMPLES[source], number * 20 * MS) for number in range(2)]
    assert inbox.evidence(source) is None

    for each in sent:
        inbox.take_frames(each)

    (last,) = sent[-1]
    assert inbox.evidence(source) == Evidence(source, last.can_id, last.data, last.stamp_ns)
    assert SOURCE_IDS[source] == last.can_id


def test_a_refused_frame_is_no_evidence() -> None:
    inbox, encoder = Inbox(link()), Encoder()
    (good,) = frames(encoder, SAMPLES[Source.DESK], 10 * MS)
    flipped = good._replace(data=bytes([good.data[0] ^ 1]) + good.data[1:], stamp_ns=20 * MS)

    inbox.take_frames([good, flipped])

    evidence = inbox.evidence(Source.DESK)
    assert evidence is not None
    assert evidence.payload == good.data
    (refusal,) = inbox.refusals.due(20 * MS)
    assert (refusal.number, refusal.reason, refusal.count) == (good.can_id, "WRONG_CRC", 1)
    assert flipped.data.hex(" ") in refusal.detail


def test_the_evidence_of_a_tag_is_its_telegram_and_the_right_one_of_two() -> None:
    inbox = Inbox(link())
    first = encode(TagTelegram(1, 301, TagKind.T1, 1000.0, 1030.0, 4711))
    second = encode(TagTelegram(2, 302, TagKind.T2, 1000.0, 1030.0, 4800))
    inbox.take_serial([SerialChunk(5 * MS, first), SerialChunk(6 * MS, second)])
    inbox.image(7 * MS, dt_s=0.05, overruns=0)
    inbox.image(57 * MS, dt_s=0.05, overruns=0)

    assert inbox.evidence(Source.TAG) == Evidence(Source.TAG, 302, second, 6 * MS)
    assert inbox.evidence(Source.TAG, 301) == Evidence(Source.TAG, 301, first, 5 * MS)
    assert inbox.evidence(Source.CLOCK) is None


def test_the_evidence_of_authority_and_orders_is_the_latest_message() -> None:
    radio = link()
    inbox = Inbox(radio)
    first, second = packed(authority(sequence=1)), packed(authority(sequence=2, train=8))
    told = packed(orders(sequence=5))

    radio.take(300 * MS, [RadioMessage(290 * MS, "key", each) for each in (first, second, told)])

    assert inbox.evidence(Source.AUTHORITY) == Evidence(Source.AUTHORITY, 1, first, 290 * MS)
    assert inbox.evidence(Source.ORDERS) == Evidence(Source.ORDERS, 5, told, 290 * MS)
    (refusal,) = radio.refusals.due(300 * MS)
    assert (refusal.reason, refusal.count) == ("wrong destination", 1)


def test_orders_become_orders_and_age_from_the_status_that_they_answer() -> None:
    radio = link()

    radio.take(300 * MS, heard(orders(sequence=5, hold=True)))
    radio.take(350 * MS, heard(orders(sequence=5, hold=False)))

    assert radio.orders is not None
    assert radio.orders.hold
    assert radio.orders.restrictions == (Restriction(10.0, 20.0, 8.25),)
    assert radio.received_orders is not None
    assert radio.received_orders.value is radio.orders
    assert radio.received_orders.age_s(300 * MS) == pytest.approx(0.2)
    assert radio.refused == 1


def test_restrictions_of_the_line_join_those_of_the_centre() -> None:
    radio, of_line = link(), Restriction(500.0, 600.0, 4.0)
    radio.hold(None, 0, (of_line,))
    assert radio.orders is None

    radio.take(300 * MS, heard(orders(sequence=5)))
    radio.hold(None, 0, (of_line,))
    radio.hold(None, 0, (of_line,))

    assert radio.orders is not None
    assert radio.orders.restrictions == (Restriction(10.0, 20.0, 8.25), of_line)
    radio.hold(None, 0, ())
    assert radio.orders.restrictions == (Restriction(10.0, 20.0, 8.25),)


def test_status_and_orders_carry_the_number_of_the_emergency() -> None:
    radio = link()

    radio.take(300 * MS, heard(orders(sequence=5, released_emergency=6)))
    status = unpack(radio.status(7 * MS, replace(DRIVING, emergency_number=6), None))

    assert radio.orders is not None
    assert radio.orders.released_emergency == 6
    assert isinstance(status, TrainStatus)
    assert status.emergency_number == 6


def test_a_status_describes_the_state_of_the_controller() -> None:
    radio, alarms = link(), TrainAlarms(no_obstacle=True, no_fire=False)
    image = replace(Inbox(radio).image(5 * MS, dt_s=0.05, overruns=0), alarms=alarms)
    output = replace(DRIVING, mode=OperatingMode.CREEP, emergency_cause=Cause.REMOTE)

    first, second = (unpack(radio.status(at * MS, output, image)) for at in (7, 9))

    assert isinstance(first, TrainStatus)
    assert isinstance(second, TrainStatus)
    assert (first.train, first.boot, first.sequence, first.stamp_ns) == (7, 3, 1, 7 * MS)
    assert (first.mode, first.supervision, first.cause) == (3, 1, 11)
    assert (first.localised, first.front_m, first.fire, first.obstacle) == (
        True,
        100.0,
        True,
        False,
    )
    assert second.sequence == 2
    lost = unpack(radio.status(9 * MS, SAFE_OUTPUT, None))
    assert isinstance(lost, TrainStatus)
    assert (lost.localised, lost.front_m, lost.doors_locked) == (False, 0.0, False)


def test_rejections_are_reported_once_a_second_with_their_count() -> None:
    refusals = Refusals()
    told: list[Refusal] = []
    for number in range(35):
        refusals.note(0x185, "WRONG_CRC", f"number {number}")
        told += refusals.due(number * 100 * MS)

    assert [refusal.count for refusal in told] == [1, 10, 10, 10]
    assert refusals.waiting
    assert refusals.totals[0x185, "WRONG_CRC"] == 35
    assert refusals.due(5000 * MS)[0].count == 4
    assert not refusals.waiting


def test_new_identifiers_do_not_fill_the_memory_without_bound() -> None:
    refusals = Refusals()

    for number in range(2000):
        refusals.note(number, "UNKNOWN_ID", "babble")

    assert len(refusals.totals) <= KEYS_MAX + 1
    assert refusals.totals.total() == 2000
    assert sum(refusal.count for refusal in refusals.due(0)) == 2000


def test_an_event_frame_names_the_first_two_frames_that_decided() -> None:
    sources = (Source.TAG, Source.TACHO, Source.DESK, Source.BRAKE)

    frame = event_frame(Event(EventKind.TAG_ACCEPTED, "words", sources, 204), 65536 + 3)

    assert frame == VobcEvent(EventKind.TAG_ACCEPTED, 204, 3, 0x185, 0x187)
    assert event_frame(Event(EventKind.OVERRUN, "words", (Source.CLOCK,)), 1) == VobcEvent(
        EventKind.OVERRUN, 0, 1, 0, 0
    )
    refused = event_frame(Event(EventKind.FRAME_REJECTED, "words", (), 0x182), 2)
    assert refused == VobcEvent(EventKind.FRAME_REJECTED, 0x182, 2, 0x182, 0)


def test_a_telegram_becomes_a_reading_with_its_age_at_the_antenna() -> None:
    inbox = Inbox(link())
    data = encode(TagTelegram(1, 301, TagKind.T1, stamp_ms=1000.0, sent_ms=1030.0, pulses=4711))

    inbox.take_serial([SerialChunk(100 * MS, data[:5]), SerialChunk(101 * MS, data[5:])])
    (reading,) = inbox.image(111 * MS, dt_s=0.05, overruns=0).tags

    assert (reading.tag_id, reading.pulses) == (301, 4711)
    assert reading.age_s == pytest.approx(0.030 + 0.002 + 0.010)
    assert inbox.image(161 * MS, dt_s=0.05, overruns=0).tags == ()


def sent(sequence: int, at_ms: float, fetched_ms: int) -> SerialChunk:
    """A health telegram sent by the reader at `at_ms` and fetched from the line at `fetched_ms`."""
    data = encode(HealthTelegram(sequence % 256, at_ms, True, 0, 0, 0))
    return SerialChunk(fetched_ms * MS, data)


@pytest.mark.parametrize("first_ms", [100, 160])
def test_the_readers_clock_gives_the_age_of_a_delayed_telegram(
    first_ms: int,
) -> None:
    """Any telegram that was fetched at once shows the delay of the others."""
    inbox = Inbox(link())
    tag = TagTelegram(3, 301, TagKind.T1, stamp_ms=1070.0, sent_ms=1100.0, pulses=4711)

    inbox.take_serial([sent(1, 0.0, first_ms), sent(2, 500.0, 600)])
    inbox.take_serial([SerialChunk(1290 * MS, encode(tag))])
    (reading,) = inbox.image(1300 * MS, dt_s=0.1, overruns=0).tags

    assert reading.age_s == pytest.approx(0.030 + 0.002 + 0.100, abs=0.001)
    evidence = inbox.evidence(Source.TAG)
    assert evidence is not None
    assert evidence.received_at_ns == pytest.approx(1200 * MS, abs=MS)


def test_a_restarted_reader_has_another_clock() -> None:
    inbox = Inbox(link())
    tag = TagTelegram(0, 301, TagKind.T1, stamp_ms=570.0, sent_ms=600.0, pulses=4711)

    inbox.take_serial([sent(200, 0.0, 100)])
    inbox.take_serial([SerialChunk(900 * MS, encode(tag))])
    (reading,) = inbox.image(900 * MS, dt_s=0.1, overruns=0).tags
    assert reading.age_s == pytest.approx(0.030 + 0.002 + 0.200, abs=0.001), "in sequence"

    inbox.take_serial([SerialChunk(1400 * MS, encode(replace(tag, sequence=100, sent_ms=800.0)))])
    (reading,) = inbox.image(1400 * MS, dt_s=0.1, overruns=0).tags
    assert reading.age_s == pytest.approx(0.230 + 0.002 + 0.500, abs=0.001), "in sequence"

    resent = replace(tag, sequence=90, stamp_ms=1170.0, sent_ms=1200.0)
    inbox.take_serial([SerialChunk(2100 * MS, encode(resent))])
    (reading,) = inbox.image(2100 * MS, dt_s=0.1, overruns=0).tags
    assert reading.age_s == pytest.approx(0.030 + 0.002, abs=0.001), "back in the sequence"


def test_a_telegram_closed_by_the_next_one_is_as_old_as_its_first_byte() -> None:
    """Frames may share a flag; the next one comes half a second later."""
    inbox = Inbox(link())
    first = encode(TagTelegram(1, 301, TagKind.T1, stamp_ms=1000.0, sent_ms=1030.0, pulses=4711))
    second = encode(TagTelegram(2, 302, TagKind.T2, stamp_ms=1500.0, sent_ms=1530.0, pulses=4800))

    inbox.take_serial([SerialChunk(100 * MS, first[:-1])])
    inbox.take_serial([SerialChunk(600 * MS, second)])
    late, whole = inbox.image(610 * MS, dt_s=0.05, overruns=0).tags

    assert (late.tag_id, whole.tag_id) == (301, 302)
    assert late.age_s == pytest.approx(0.030 + 0.510, abs=0.003)
    assert whole.age_s == pytest.approx(0.030 + 0.002 + 0.010)
    assert inbox.torn_telegrams == 0


def test_a_torn_telegram_is_counted_and_a_repeated_one_is_no_second_tag() -> None:
    inbox = Inbox(link())
    data = encode(TagTelegram(1, 301, TagKind.T1, 1000.0, 1030.0, 4711))
    torn = bytes([data[0], data[1] ^ 0x10]) + data[2:]

    inbox.take_serial([SerialChunk(0, data + data + torn)])

    assert len(inbox.image(MS, dt_s=0.05, overruns=0).tags) == 1
    assert inbox.torn_telegrams == 1


def told(sequence: int, at_ms: int) -> SerialChunk:
    data = encode(HealthTelegram(sequence % 256, 10.0 * at_ms, True, 0, 0, at_ms // 1000))
    return SerialChunk(at_ms * MS, data)


def gap_seen(inbox: Inbox, *chunks: SerialChunk) -> bool:
    inbox.take_serial(chunks)
    seen = inbox.image(chunks[-1].stamp_ns + MS, dt_s=0.05, overruns=0)
    again = inbox.image(chunks[-1].stamp_ns + 51 * MS, dt_s=0.05, overruns=0)
    assert not again.tag_gap, "a gap counts once"
    return seen.tag_gap


def test_a_gap_in_the_telegrams_is_reported_with_the_next_one() -> None:
    inbox = Inbox(link())

    assert gap_seen(inbox, told(1, 100)), "earlier telegrams may be missing"
    assert not gap_seen(inbox, told(2, 600))
    assert not gap_seen(inbox, told(3, 1100), told(4, 1110))
    assert gap_seen(inbox, told(6, 1600))
    assert not gap_seen(inbox, told(7, 2100))
    assert gap_seen(inbox, told(9, 2600), told(10, 2610)), "also before the last one"


@pytest.mark.parametrize(("silent_ms", "gap"), [(500, False), (1000, False), (1001, True)])
def test_the_sequence_may_have_wrapped_during_a_silence(silent_ms: int, *, gap: bool) -> None:
    inbox = Inbox(link())
    inbox.take_serial([told(1, 100), told(2, 600)])
    inbox.image(700 * MS, dt_s=0.05, overruns=0)

    assert gap_seen(inbox, told(3, 600 + silent_ms)) is gap
    assert not gap_seen(inbox, told(4, 900 + silent_ms))


def test_tag_telegrams_count_as_heartbeat_of_the_reader() -> None:
    inbox = Inbox(link())
    inbox.take_serial([told(1, 100)])
    tag = TagTelegram(2, 301, TagKind.T1, stamp_ms=1000.0, sent_ms=1030.0, pulses=4711)
    inbox.take_serial([SerialChunk(900 * MS, encode(tag))])
    inbox.image(950 * MS, dt_s=0.05, overruns=0)

    assert not gap_seen(inbox, told(3, 1700))


def test_repeated_telegrams_are_no_heartbeat() -> None:
    inbox = Inbox(link())
    inbox.take_serial([told(1, 100)])
    inbox.image(150 * MS, dt_s=0.05, overruns=0)
    same = told(1, 100).data
    assert not gap_seen(inbox, SerialChunk(600 * MS, same), SerialChunk(1000 * MS, same))

    assert gap_seen(inbox, told(2, 1101))


def test_tags_beyond_the_limit_of_a_cycle_count_as_missing() -> None:
    inbox = Inbox(link())
    inbox.take_serial([told(255, 50)])
    inbox.image(60 * MS, dt_s=0.05, overruns=0)
    many = [
        encode(TagTelegram(sequence, 301, TagKind.T1, 1000.0, 1030.0, sequence))
        for sequence in range(TAGS_MAX + 1)
    ]

    assert not gap_seen(inbox, SerialChunk(100 * MS, b"".join(many[:TAGS_MAX])))
    inbox = Inbox(link())
    inbox.take_serial([told(255, 50)])
    inbox.image(60 * MS, dt_s=0.05, overruns=0)
    assert gap_seen(inbox, SerialChunk(100 * MS, b"".join(many)))
    assert inbox.overflowed == 1


def authority(**changes: int | float) -> MovementAuthority:
    values: dict[str, int | float] = {
        "train": 7, "boot": 3, "term": 1, "sequence": 1, "echo_stamp_ns": 100 * MS, "end_m": 900.0,
        "parameters": PARAMETERS,
    }  # fmt: skip
    return MovementAuthority(**{**values, **changes})  # type: ignore[arg-type]


def orders(**changes: bool | int) -> TrainOrders:
    values: dict[str, Any] = {
        "train": 7, "boot": 3, "sequence": 1, "echo_stamp_ns": 100 * MS, "awake": True,
        "hold": False, "skip_next": False, "stop_next": False, "emergency": False, "releases": 0,
        "creep": False, "restricted": False, "doors_left": False, "doors_right": True,
        "platform_doors_locked": True, "restrictions": (SpeedRestriction(10.0, 20.0, 8.25),),
    }  # fmt: skip
    return TrainOrders(**{**values, **changes})


def packed(message: Message) -> bytes:
    return pack(message, database=DATABASE)


def heard(message: Message | bytes) -> list[RadioMessage]:
    payload = message if isinstance(message, bytes) else packed(message)
    return [RadioMessage(0, "key", payload)]


def test_the_age_of_an_authority_counts_from_the_report_that_it_answers() -> None:
    radio = link()

    radio.take(300 * MS, heard(authority()))

    assert radio.authority is not None
    assert radio.authority.end_m == 900.0
    assert radio.received_authority is not None
    assert radio.received_authority.value is radio.authority
    assert radio.received_authority.age_s(300 * MS) == pytest.approx(0.2)
    assert radio.received_authority.age_s(800 * MS) == pytest.approx(0.7)


@pytest.mark.parametrize(
    "wrong",
    [
        {"train": 8},
        {"boot": 2},
        {"sequence": 4},
        {"sequence": 5},
        {"term": 1, "sequence": 99},
        {"echo_stamp_ns": 2000 * MS, "sequence": 9},
        {"echo_stamp_ns": 1 * MS, "sequence": 9},
    ],
)
def test_an_authority_for_another_train_out_of_order_or_too_old_changes_nothing(
    wrong: dict[str, int],
) -> None:
    radio = link()
    radio.take(500 * MS, heard(authority(term=2, sequence=5)))
    held = radio.authority

    radio.take(1050 * MS, heard(authority(term=2, end_m=5000.0, **{"sequence": 6, **wrong}
               ) if "term" not in wrong else authority(end_m=5000.0, **wrong)))  # fmt: skip

    assert radio.authority is held
    assert radio.refused == 1


def test_a_shorter_authority_takes_effect_at_once() -> None:
    radio = link()

    radio.take(300 * MS, heard(authority()) + heard(authority(sequence=2, end_m=400.0)))

    assert radio.authority is not None
    assert radio.authority.end_m == 400.0


def test_noise_on_the_radio_is_counted() -> None:
    radio = link()
    report = radio.report(0, DRIVING)
    assert report is not None

    radio.take(0, [*heard(b"noise"), *heard(report)])

    assert radio.authority is None
    assert radio.refused == 2


def test_the_position_report_holds_the_safe_bounds() -> None:
    radio = link()

    first, second = radio.report(7 * MS, DRIVING), radio.report(9 * MS, DRIVING)

    assert first is not None
    assert second is not None
    report = unpack(first)
    assert report == PositionReport(
        7, 3, 1, 7 * MS, 99.0, 101.5, 99.0 - 68.59, 10.0, False, parameters=PARAMETERS
    )
    assert replace(report, sequence=2, stamp_ns=9 * MS) == unpack(second)


def test_every_message_of_the_train_carries_the_version_of_its_track_database() -> None:
    radio = link()
    report, status = radio.report(0, DRIVING), radio.status(0, DRIVING, None)

    assert report is not None
    for sent in (report, status):
        assert not isinstance(unpack(sent, database=DATABASE), Refused)
        assert isinstance(unpack(sent, database=DATABASE + 1), Refused)


@pytest.mark.parametrize("sent", [authority(), orders()], ids=["authority", "orders"])
def test_a_message_of_another_survey_is_refused_with_both_versions(
    sent: MovementAuthority | TrainOrders,
) -> None:
    radio = link()

    radio.take(300 * MS, heard(pack(sent, database=DATABASE ^ 1)))

    assert (radio.authority, radio.orders) == (None, None)
    (refusal,) = radio.refusals.due(300 * MS)
    assert refusal.reason == "of another track database"
    assert refusal.detail == "000000000000000a of the sender, 000000000000000b here"


def test_an_authority_for_other_vital_parameters_is_refused() -> None:
    radio = link()

    radio.take(300 * MS, heard(authority(parameters=PARAMETERS + 1)))

    assert radio.authority is None
    (refusal,) = radio.refusals.due(300 * MS)
    assert refusal.reason == "of other vital parameters"


def test_a_train_without_position_sends_no_position_report() -> None:
    lost = replace(DRIVING, motion=replace(MOTION, localised=False))

    assert link().report(0, lost) is None
    assert link().report(0, SAFE_OUTPUT) is None


def test_the_brake_command_comes_first_and_is_exact() -> None:
    brake, traction = vital_frames(DRIVING)

    assert brake == BrakeCommand(0.0, True, True)
    assert traction == TractionCommand(50_000.0, Direction.FORWARD, True)
    assert door_frame(replace(DRIVING, enable_right=True, open_right=True)) == DoorCommand(
        False, True, False, True
    )


def test_single_cars_are_enabled_in_their_own_frame_and_no_side_in_the_other() -> None:
    """A door unit that does not know the second frame opens nothing."""
    single = replace(DRIVING, enable_right=True, open_right=True, door_cars=0b0110)

    assert door_frame(single) == DoorCommand(False, False, False, True)
    assert door_cars_frame(single) == DoorCars(left_cars=0, right_cars=0b0110)


def test_no_single_car_is_enabled_for_a_whole_train_or_without_a_side() -> None:
    whole = replace(DRIVING, enable_left=True, enable_right=True)

    assert door_cars_frame(whole) == DoorCars(0, 0)
    assert door_cars_frame(replace(DRIVING, door_cars=0b0110)) == DoorCars(0, 0)
    assert door_cars_frame(SAFE_OUTPUT) == DoorCars(0, 0)


def test_the_safe_output_is_safe_on_the_wire() -> None:
    brake, traction = vital_frames(SAFE_OUTPUT)

    assert brake == BrakeCommand(2.0, False, False)
    assert traction == TractionCommand(0.0, Direction.NEUTRAL, False)
    assert door_frame(SAFE_OUTPUT) == DoorCommand(False, False, False, False)


def test_the_frames_that_describe_the_controller() -> None:
    assert status_frame(
        replace(DRIVING, missing=Missing.DOORS), work_us=321.0, slips=65
    ) == VobcStatus(Supervision.NOMINAL, DRIVING.ato_phase, Missing.DOORS, True, True, 321.0, 1)
    assert list(motion_frames(DRIVING)) == [
        VobcMotion(10.0, 15.0, 18.0),
        VobcPosition(100.0, pytest.approx(1.51)),  # type: ignore[arg-type]
    ]
    assert list(target_frames(DRIVING)) == [VobcTarget(77.0, 400.0)]
    assert heartbeat(NodeState.OPERATIONAL) == HEARTBEATS[Node.VOBC](NodeState.OPERATIONAL)
    assert isinstance(heartbeat(NodeState.STOPPED), NodeHeartbeat)


@pytest.mark.parametrize(
    ("front_m", "known"),
    [(-1000.0, True), (-1000.01, False), (160_000.0, True), (160_000.01, False)],
)
def test_a_place_that_its_frame_cannot_carry_is_sent_as_unknown(
    front_m: float, known: bool
) -> None:
    """The encoder clips such a place. Nothing on the bus may present the result as the place."""
    motion = replace(MOTION, front_m=Interval(front_m - 0.5, front_m, front_m + 0.5))
    output = replace(DRIVING, motion=motion)
    (_, sent) = motion_frames(output)
    status = status_frame(output, work_us=0.0, slips=0)
    decoder, encoder = Decoder((VobcPosition, VobcStatus)), make_encoder()

    (received,) = (decoder.decode(*each, 0) for each in encoder.encode(sent))

    assert isinstance(received, VobcPosition)
    assert (received.uncertainty_m < 655.35) is known
    assert isinstance(status, VobcStatus)
    assert status.localised is known


@pytest.mark.parametrize(
    ("low_mps", "best_mps", "high_mps", "told_mps"),
    [
        (9.9, 10.0, 10.29, 0.3),
        (9.9, 10.0, 10.31, 0.35),
        (9.0, 10.0, 10.02, 0.05),
        (10.0, 10.0, 10.0, 0.0),
        (-10.29, -10.0, -9.0, 0.3),
        (-0.6, 0.1, 0.3, 0.5),
        (0.0, 10.0, 11.5, 1.5),
        (0.0, 10.0, 14.0, 1.55),
        (-math.inf, 0.0, math.inf, 1.55),
        (0.0, math.nan, 0.0, 1.55),
    ],
)
def test_the_upper_speed_error_is_rounded_up(
    low_mps: float, best_mps: float, high_mps: float, told_mps: float
) -> None:
    """The value is rounded up to steps of 0.05 m/s; the largest one means "that or more, or
    unknown"."""
    speed_mps = Interval(low_mps, best_mps, high_mps)
    told = mode_frame(replace(DRIVING, motion=replace(MOTION, speed_mps=speed_mps)))

    assert isinstance(told, VobcMode)
    assert told.speed_reach_mps == pytest.approx(told_mps, abs=1e-9)


def test_the_limits_and_the_target_are_sent_beside_the_motion() -> None:
    target = SupervisedTarget(TargetKind.RESTRICTION, 8.34, 123.46)
    output = replace(
        DRIVING,
        ceiling=replace(CEILING, target=target),
        intervention=Intervention.WARNING,
        reason=ReasonCode.OVER_WARNING_LIMIT,
    )
    encoder, decoder = make_encoder(), Decoder((VobcLimits, VobcSupervision))

    received = [
        decoder.decode(can_id, data, 0)
        for frame in limit_frames(output)
        for can_id, data in encoder.encode(frame)
    ]

    assert received == [
        VobcLimits(16.0, 17.0),
        VobcSupervision(
            Intervention.WARNING,
            ReasonCode.OVER_WARNING_LIMIT,
            TargetKind.RESTRICTION,
            pytest.approx(8.34),  # type: ignore[arg-type]
            pytest.approx(123.5),  # type: ignore[arg-type]
        ),
    ]


def test_without_a_place_only_the_intervention_is_sent() -> None:
    nothing = VobcSupervision(
        Intervention.EMERGENCY_BRAKE, ReasonCode.CONTROLLER_ENDS, TargetKind.NONE, 0.0, math.inf
    )

    assert list(limit_frames(SAFE_OUTPUT)) == [nothing]
    assert list(limit_frames(replace(SAFE_OUTPUT, motion=MOTION))) == [nothing]


def test_unknown_values_are_sent_as_unknown() -> None:
    mode = mode_frame(SAFE_OUTPUT)
    assert isinstance(mode, VobcMode)
    assert mode.speed_reach_mps == 0.0
    assert list(motion_frames(SAFE_OUTPUT)) == []
    assert list(target_frames(SAFE_OUTPUT)) == []


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_an_emergency_message_of_its_own(cause: Cause) -> None:
    kind = EMERGENCIES[Node.VOBC]

    assert emergency_message(cause) == kind(0xFF01, 0x81, int(cause))
    assert emergency_message(None) == kind(0, 0, 0)


def test_everything_that_the_controller_sends_can_be_encoded() -> None:
    encoder = make_encoder()
    endless = replace(DRIVING, distance_to_stop_m=math.inf)

    for output in (SAFE_OUTPUT, DRIVING, endless):
        for frame in (
            *vital_frames(output),
            door_frame(output),
            status_frame(output, work_us=1e9, slips=1000),
            *motion_frames(output),
            *target_frames(output),
            heartbeat(NodeState.BOOT_UP),
            mode_frame(output),
            *limit_frames(output),
            emergency_message(output.emergency_cause),
        ):
            assert encoder.encode(frame)


def test_the_controller_does_not_listen_to_itself() -> None:
    encoder = make_encoder()
    own = {
        can_id
        for frame in (*vital_frames(DRIVING), door_frame(DRIVING), *motion_frames(DRIVING))
        for can_id, _ in encoder.encode(frame)
    }

    assert not own & RECEIVED_IDS
