"""The zone controller: which reports it answers, and how."""

from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import load_line
from firmware_py.trackdb.version import database_version
from plant_emulator.wayside.zone_controller import ZoneController
from zenoh_config import codec, keys
from zenoh_config.codec import unpack
from zenoh_config.messages import MovementAuthority, PositionReport, RefusedReason
from zenoh_config.sequencing import AuthorityGate

pack = partial(codec.pack, database=database_version(load_line("florence")))


LINE = load_line("florence")
NOW_NS = 7_000_000_000
REPORT = PositionReport(
    train=3,
    boot=12,
    sequence=1,
    stamp_ns=123_456_789,
    front_min_m=100.0,
    front_max_m=101.0,
    rear_min_m=31.4,
    speed_mps=10.0,
    standstill=False,
)


def zone(destination: str = "III") -> ZoneController:
    return ZoneController(LINE, LINE.station(destination))


def message(payload: bytes, train: int = 3) -> RadioMessage:
    return RadioMessage(NOW_NS, keys.report("florence", train), payload)


def answers(controller: ZoneController, *reports: PositionReport) -> list[MovementAuthority]:
    heard = [message(pack(report), report.train) for report in reports]
    found = []
    for key, payload in controller.answers(heard, NOW_NS):
        authority = unpack(payload)
        assert isinstance(authority, MovementAuthority)
        assert keys.matches(keys.authorities("florence", authority.train), key)
        found.append(authority)
    return found


def test_an_authority_answers_the_report_and_echoes_its_stamp() -> None:
    [authority] = answers(zone(), REPORT)
    assert (authority.train, authority.boot) == (3, 12)
    assert authority.echo_stamp_ns == REPORT.stamp_ns
    assert authority.term == 1
    assert authority.end_m == 3560.0


@pytest.mark.parametrize(("destination", "end_m"), [("I", 1560.0), ("IV", 4560.0)])
def test_the_authority_ends_an_overlap_behind_the_destination(
    destination: str, end_m: float
) -> None:
    assert zone(destination).end_m == end_m


def test_no_authority_reaches_the_end_of_the_line() -> None:
    short = replace(
        LINE,
        end_m=4510.0,
        speed_sections=(*LINE.speed_sections[:-1], replace(LINE.speed_sections[-1], end_m=4510.0)),
    )
    assert ZoneController(short, short.station("IV")).end_m == 4500.0


def test_the_trains_gate_accepts_every_answer() -> None:
    controller = zone()
    gate = AuthorityGate(train=3, boot=12, max_age_ns=1_000_000_000)
    for sequence in range(1, 50):
        stamp_ns = 200_000_000 * sequence
        report = replace(REPORT, sequence=sequence, stamp_ns=stamp_ns)
        [authority] = answers(controller, report)
        assert gate.check(authority, stamp_ns + 40_000_000) is None
    assert gate.accepted == 49


@pytest.mark.parametrize(
    ("second", "reason"),
    [
        (REPORT, RefusedReason.NOT_NEWER),
        (replace(REPORT, sequence=0), RefusedReason.NOT_NEWER),
        (replace(REPORT, boot=11, sequence=9), RefusedReason.WRONG_BOOT),
        (replace(REPORT, destination=8, sequence=9), RefusedReason.WRONG_DESTINATION),
    ],
)
def test_a_report_that_is_not_the_newest_gets_no_answer(
    second: PositionReport, reason: RefusedReason
) -> None:
    controller = zone()
    assert len(answers(controller, REPORT, second)) == 1
    assert controller.refusals == {reason: 1}


def test_a_restarted_train_is_answered_again() -> None:
    controller = zone()
    answers(controller, REPORT)
    [authority] = answers(controller, replace(REPORT, boot=13, sequence=1, stamp_ns=5))
    assert (authority.boot, authority.echo_stamp_ns) == (13, 5)


def test_a_report_under_the_key_of_another_train_gets_no_answer() -> None:
    controller = zone()
    assert controller.answers([message(pack(REPORT), train=4)], NOW_NS) == []
    assert controller.refusals == {RefusedReason.WRONG_SOURCE: 1}


def test_an_authority_does_not_count_as_a_report() -> None:
    controller = zone()
    foreign = MovementAuthority(3, 12, 1, 1, 5, 4000.0)
    assert controller.answers([message(pack(foreign))], NOW_NS) == []
    assert controller.refusals == {RefusedReason.UNKNOWN_TYPE: 1}


@given(payload=st.binary(max_size=120))
def test_noise_is_counted_and_never_answered(payload: bytes) -> None:
    controller = zone()
    assert controller.answers([message(payload)], NOW_NS) == []
    assert sum(controller.refusals.values()) == 1


@given(at=st.integers(0, 10_000), bit=st.integers(0, 7))
def test_a_report_with_one_flipped_bit_is_refused(at: int, bit: int) -> None:
    controller = zone()
    payload = bytearray(pack(REPORT))
    payload[at % len(payload)] ^= 1 << bit
    assert controller.answers([message(bytes(payload))], NOW_NS) == []
    assert controller.answered == 0


def test_the_farthest_authority_is_remembered() -> None:
    controller = zone()
    assert controller.farthest_end_m is None
    [authority] = answers(controller, REPORT)
    assert controller.farthest_end_m == authority.end_m
    controller.end_m -= 100.0
    answers(controller, replace(REPORT, sequence=REPORT.sequence + 1, stamp_ns=REPORT.stamp_ns + 1))
    assert controller.farthest_end_m == authority.end_m
