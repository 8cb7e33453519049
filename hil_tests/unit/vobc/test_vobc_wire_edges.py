"""The controller's wires at their edges: first, late, unknown, at a bound, and one beyond it."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.alarms import TrainAlarms
from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import binding_of, kinds, sender
from can_dbc.codec import Encoder
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorCars, DoorCommand, DoorState, DoorStatus
from can_dbc.nodes import Node
from can_dbc.odometer import Doppler, Imu
from can_dbc.vobc import EventKind, VobcMode, VobcPosition, VobcStatus, VobcSupervision
from firmware_py.ports import SerialChunk
from firmware_py.tag_reader.telegram import HealthTelegram, TagTelegram, encode
from firmware_py.trackdb import TagKind
from hil_tests.unit.vobc.test_vobc_wire import (
    DRIVING,
    MOTION,
    MS,
    SAMPLES,
    authority,
    frames,
    heard,
    link,
    orders,
    tacho,
)
from vobc.vocabulary import (
    SAFE_OUTPUT,
    Authority,
    CurrentReference,
    CycleInput,
    Event,
    Interval,
    Source,
)
from vobc.wire import (
    SOURCE_KINDS,
    Inbox,
    Refusals,
    analogue_frame,
    door_cars_frame,
    door_frame,
    event_frame,
    limit_frames,
    make_encoder,
    mode_frame,
    motion_frames,
    status_frame,
)
from vobc.wire.frames import SENT_KINDS
from vobc.wire.inbox import RECEIVED_KINDS
from vobc.wire.refusals import EVERY_NS, KEYS_MAX
from zenoh_config.codec import unpack
from zenoh_config.messages import TrainStatus

FIELDS: dict[str, Any] = {
    "tacho": Source.TACHO,
    "doppler": Source.DOPPLER,
    "imu": Source.IMU,
    "traction": Source.TRACTION,
    "brake": Source.BRAKE,
    "doors": Source.DOORS,
    "desk": Source.DESK,
    "tag_reader": Source.TAG_READER,
    "supply": Source.SUPPLY,
    "alarms": Source.ALARMS,
    "cold": Source.COLD,
}


def image(inbox: Inbox, now_ms: int) -> CycleInput:
    return inbox.image(now_ms * MS, dt_s=0.05, overruns=0)


def test_the_encoder_knows_every_frame_that_the_train_bus_expects_of_the_controller() -> None:
    expected = {kind for kind in kinds() if sender(kind) == Node.VOBC.name}

    assert set(SENT_KINDS) == expected
    assert set(make_encoder()._send) == expected


def test_every_source_has_its_frame_and_every_frame_its_place_in_the_image() -> None:
    assert {source: type(sample) for source, sample in SAMPLES.items()} == dict(SOURCE_KINDS)
    assert {*SOURCE_KINDS.values(), TcmsStatus} == set(RECEIVED_KINDS)
    inbox, encoder = Inbox(link()), Encoder()
    load = TcmsStatus(load_kg=20_000.0, cars=4)
    for sample in (*SAMPLES.values(), load):
        inbox.take_frames(frames(encoder, sample, 10 * MS))

    seen = image(inbox, 35)

    for name, source in FIELDS.items():
        assert type(getattr(seen, name)) is SOURCE_KINDS[source]
        assert getattr(seen, f"{name}_age_s") == pytest.approx(0.025)
    assert seen.load is not None
    assert seen.load.load_kg == pytest.approx(20_000.0, rel=0.01)
    assert seen.load_age_s == pytest.approx(0.025)


@pytest.mark.parametrize(("sample", "name"), [(Doppler(3.0, 90.0, True), "doppler"),
                                              (Imu(0.1, True), "imu")])  # fmt: skip
def test_a_delayed_frame_of_radar_or_accelerometer_is_as_old_as_its_sample(
    sample: Doppler | Imu, name: str
) -> None:
    inbox, encoder = Inbox(link()), Encoder()
    for number, late_ms in enumerate((0, 0, 40)):
        inbox.take_frames(frames(encoder, sample, (50 * number + late_ms) * MS))

    assert getattr(image(inbox, 150), f"{name}_age_s") == pytest.approx(0.05, abs=1e-4)


def test_before_the_first_telegram_there_is_no_tag_and_no_gap() -> None:
    inbox = Inbox(link())

    assert inbox.evidence(Source.TAG) is None
    assert inbox.evidence(Source.AUTHORITY) is None
    assert inbox.evidence(Source.ORDERS) is None
    assert not image(inbox, 5).tag_gap


@pytest.mark.parametrize(
    ("kind", "counted"),
    [({"remote": True}, 1), ({"extended": True}, 1), ({"error": True}, 0),
     ({"error": True, "extended": True}, 0)],
)  # fmt: skip
def test_a_frame_that_is_no_data_frame_of_11_bits_is_not_taken(
    kind: dict[str, bool], counted: int
) -> None:
    inbox = Inbox(link())
    (good,) = frames(Encoder(), tacho(5, 10), 10 * MS)

    inbox.take_frames([good._replace(**kind)])  # type: ignore[arg-type]

    assert image(inbox, 20).tacho is None
    assert inbox.rejected == counted
    refusals = [(each.number, each.reason) for each in inbox.refusals.due(20 * MS)]
    assert refusals == [(good.can_id, "UNKNOWN_ID")] * counted


@pytest.mark.parametrize(("sent", "beyond"), [(64, 0), (65, 1)])
def test_a_cycle_takes_64_tacho_samples(sent: int, beyond: int) -> None:
    inbox, encoder = Inbox(link()), Encoder()
    inbox.take_frames(
        [each for number in range(sent) for each in frames(encoder, tacho(number, number), number)]
    )

    samples = image(inbox, 300).tacho_samples

    assert [each.frame.pulses_a for each in samples] == list(range(beyond, sent))
    assert inbox.overflowed == beyond


@pytest.mark.parametrize(("sent", "beyond"), [(32, 0), (33, 1)])
def test_a_cycle_takes_32_tags(sent: int, beyond: int) -> None:
    inbox = Inbox(link())
    for number in range(sent):
        telegram = TagTelegram(number, 100 + number, TagKind.T1, 1000.0, 1030.0, number)
        inbox.take_serial([SerialChunk(0, encode(telegram))])

    assert [each.tag_id for each in image(inbox, 10).tags] == list(range(100 + beyond, 100 + sent))
    assert inbox.overflowed == beyond


def test_the_last_tag_counts_unless_another_one_is_named() -> None:
    inbox = Inbox(link())
    for sequence, tag_id in ((1, 1), (2, 2)):
        data = encode(TagTelegram(sequence, tag_id, TagKind.T1, 1000.0, 1030.0, 4711))
        inbox.take_serial([SerialChunk(5 * MS, data)])
    image(inbox, 7)

    last, *named = inbox.evidence(Source.TAG), *(inbox.evidence(Source.TAG, id_) for id_ in (1, 2))

    assert [each.number for each in (last, *named) if each is not None] == [2, 1, 2]


def test_a_telegram_without_its_closing_flag_counts_from_its_first_byte_and_2_ms() -> None:
    """The opening flag of the next telegram closes it 600 ms later."""
    inbox = Inbox(link())
    first = encode(TagTelegram(1, 301, TagKind.T1, 1000.0, 1030.0, 4711))
    second = encode(HealthTelegram(2, 1630.0, True, 0, 0, 1))

    inbox.take_serial([SerialChunk(100 * MS, first[:-1]), SerialChunk(700 * MS, second)])
    image(inbox, 701)

    evidence = inbox.evidence(Source.TAG)
    assert evidence is not None
    assert evidence.received_at_ns == 102 * MS


def test_after_a_restart_of_the_reader_its_new_clock_shows_what_comes_late() -> None:
    """The reader restarts at 2000 ms. Its third telegram since then waits for 200 ms."""
    inbox = Inbox(link())
    for sequence, sent_ms, read_ms in ((100, 1000, 1000), (101, 1500, 1500), (0, 0, 2000)):
        life = HealthTelegram(sequence, float(sent_ms), True, 0, 0, 0)
        inbox.take_serial([SerialChunk(read_ms * MS, encode(life))])
    for sequence, sent_ms, read_ms in ((1, 500, 2500), (2, 700, 2900)):
        tag = TagTelegram(sequence, 300 + sequence, TagKind.T1, sent_ms, sent_ms, 4711)
        inbox.take_serial([SerialChunk(read_ms * MS, encode(tag))])

    prompt, late = image(inbox, 2900).tags

    assert prompt.age_s == pytest.approx(0.4 + 0.002, abs=0.001)
    assert late.age_s == pytest.approx(0.2 + 0.002, abs=0.001)


@pytest.mark.parametrize("sides", [(True, False), (False, True), (True, True), (False, False)])
def test_single_cars_of_a_side_are_in_one_frame_and_whole_sides_in_the_other(
    sides: tuple[bool, bool],
) -> None:
    left, right = sides
    whole = replace(DRIVING, enable_left=left, enable_right=right)
    single = replace(whole, door_cars=0b0101)

    assert door_frame(whole) == DoorCommand(left, right, False, False)
    assert door_cars_frame(whole) == DoorCars(0, 0)
    assert door_frame(single) == DoorCommand(False, False, False, False)
    assert door_cars_frame(single) == DoorCars(0b0101 * left, 0b0101 * right)


def test_without_currents_the_analogue_frame_has_the_safe_ones() -> None:
    given = replace(DRIVING, currents=CurrentReference(traction_ma=12.0, brake_ma=6.0))

    assert analogue_frame(SAFE_OUTPUT) == AnalogueCommand(traction_ma=3.8, brake_ma=18.0)
    assert analogue_frame(given) == AnalogueCommand(traction_ma=12.0, brake_ma=6.0)


@pytest.mark.parametrize("localised", [True, False])
@pytest.mark.parametrize("slip", [True, False])
def test_the_status_says_whether_place_and_wheels_are_sure(*, localised: bool, slip: bool) -> None:
    motion = replace(MOTION, localised=localised, slip=slip)

    status = status_frame(replace(DRIVING, motion=motion), work_us=0.0, slips=0)

    assert isinstance(status, VobcStatus)
    assert (status.localised, status.slip_detected) == (localised, slip)


def test_half_of_motion_and_ceiling_is_not_sent() -> None:
    for half in (replace(DRIVING, motion=None), replace(DRIVING, ceiling=None)):
        assert list(motion_frames(half)) == []
        (supervised,) = limit_frames(half)
        assert isinstance(supervised, VobcSupervision)


@pytest.mark.parametrize(("low_m", "high_m", "told_m"), [(97.0, 101.0, 3.01), (99.0, 102.5, 2.51)])
def test_the_uncertainty_reaches_to_the_farther_end(
    low_m: float, high_m: float, told_m: float
) -> None:
    motion = replace(MOTION, front_m=Interval(low_m, 100.0, high_m))
    (_, position) = motion_frames(replace(DRIVING, motion=motion))

    assert isinstance(position, VobcPosition)
    assert position.uncertainty_m == pytest.approx(told_m)


def test_a_speed_error_that_is_not_known_is_the_greatest_one() -> None:
    unknown = replace(MOTION, speed_mps=Interval(-math.inf, 1.0, math.inf))
    mode = mode_frame(replace(DRIVING, motion=unknown))

    assert isinstance(mode, VobcMode)
    assert mode.speed_reach_mps == max(
        each.maximum for each in binding_of(VobcMode).fields if each.name == "speed_reach_mps"
    )


@pytest.mark.parametrize(
    ("sources", "ids"),
    [((Source.TACHO,), (0x185, 0)), ((Source.TACHO, Source.BRAKE), (0x185, 0x182))],
)
def test_an_event_of_one_or_two_frames_names_just_these(
    sources: tuple[Source, ...], ids: tuple[int, int]
) -> None:
    frame = event_frame(Event(EventKind.OVERRUN, "words", sources), 1)

    assert (frame.frame_a, frame.frame_b) == ids  # type: ignore[attr-defined]


def test_keys_and_subscriptions_name_line_and_train() -> None:
    radio = link()

    assert "florence" in radio.report_key
    assert len({radio.report_key, radio.status_key, *radio.subscriptions}) == 4
    for key in (radio.report_key, radio.status_key, *radio.subscriptions):
        assert "7" in key.split("/")


def test_the_radio_link_remembers_the_highest_term() -> None:
    radio = link()
    assert radio.seen_term == 0

    radio.take(300 * MS, heard(authority(term=5)))
    radio.take(310 * MS, heard(authority(term=4, sequence=9)))

    assert radio.seen_term == 5
    (refusal,) = radio.refusals.due(310 * MS)
    assert (refusal.number, refusal.count) == (0, 1)


def test_an_authority_of_another_source_replaces_the_one_of_the_zone_controller() -> None:
    radio, own = link(), Authority(700.0, 3, 4)
    radio.take(300 * MS, heard(authority()))

    radio.hold(own, 250 * MS, ())

    assert radio.authority is own
    assert radio.received_authority is not None
    assert radio.received_authority.received_at_ns == 250 * MS
    radio.hold(None, 0, ())
    assert radio.received_authority is None


@pytest.mark.parametrize(("age_ms", "taken"), [(5000, True), (5001, False)])
def test_orders_older_than_5_s_are_refused_on_arrival(age_ms: int, *, taken: bool) -> None:
    radio = link()

    radio.take((100 + age_ms) * MS, heard(orders()))

    assert (radio.orders is not None) is taken


@pytest.mark.parametrize("standstill", [True, False])
@pytest.mark.parametrize("localised", [True, False])
def test_the_status_of_a_train_without_a_place_has_no_chainage(
    *, localised: bool, standstill: bool
) -> None:
    motion = replace(MOTION, localised=localised, standstill=standstill)

    status = unpack(link().status(0, replace(DRIVING, motion=motion), None))

    assert isinstance(status, TrainStatus)
    assert (status.localised, status.standstill) == (localised, standstill)
    assert status.front_m == (100.0 if localised else 0.0)


@pytest.mark.parametrize(("gone_ns", "told"), [(EVERY_NS - 1, 0), (EVERY_NS, 1)])
def test_a_refusal_is_reported_again_after_just_a_second(gone_ns: int, told: int) -> None:
    refusals = Refusals()
    assert EVERY_NS == 1_000_000_000
    for at_ns in (MS, MS + gone_ns):
        refusals.note(0x185, "WRONG_CRC", f"at {at_ns}")
        found = refusals.due(at_ns)

    assert len(found) == told


def test_the_64_first_keys_are_counted_alone_and_all_others_together() -> None:
    refusals = Refusals()
    for number in range(KEYS_MAX + 2):
        refusals.note(number, "UNKNOWN_ID", f"detail {number}", count=2)

    refusals.note(0, "UNKNOWN_ID", "again")

    assert KEYS_MAX == 64
    assert len(refusals.totals) == 65
    assert refusals.totals[63, "UNKNOWN_ID"] == 2
    assert refusals.totals[0, "of further kinds"] == 4
    first, *_, others = refusals.due(0)
    assert (first.number, first.count, first.detail) == (0, 3, "again")
    assert (others.number, others.reason, others.count) == (0, "of further kinds", 4)
    assert others.detail == "detail 65"


@pytest.mark.parametrize("good", [True, False])
def test_the_status_reports_doors_and_alarms_as_their_units_do(*, good: bool) -> None:
    radio = link()
    seen = replace(
        image(Inbox(radio), 5),
        doors=DoorStatus(good, DoorState.LOCKED, DoorState.LOCKED, True),
        desk=replace(SAMPLES[Source.DESK], no_passenger_alarm=good),
        alarms=TrainAlarms(no_obstacle=True, no_fire=good),
    )

    status, other, blind = (
        unpack(radio.status(0, DRIVING, each))
        for each in (seen, replace(seen, alarms=TrainAlarms(not good, True)), None)
    )

    assert isinstance(status, TrainStatus)
    assert (status.doors_locked, status.passenger_alarm, status.fire) == (good, not good, not good)
    assert not status.obstacle
    assert isinstance(other, TrainStatus)
    assert (other.fire, other.obstacle) == (False, good)
    assert isinstance(blind, TrainStatus)
    assert not any((blind.doors_locked, blind.passenger_alarm, blind.fire, blind.obstacle))
