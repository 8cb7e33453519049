"""Axle counters of the emulated track, and the command that serves the wayside of a line."""

import math
import struct

import pytest

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import load_areas
from plant_emulator.cli import main
from plant_emulator.cli.wayside_parts import REFUSED_EVERY, RefusalNotes
from plant_emulator.wayside.detection import TRAINS_MAX, Detection, Place, key_of, packed
from vobc.cli.command import main as vobc

LOOP = load_areas("loop")


def encoded_position(train: int, front_m: float, *, axles: int = 16) -> RadioMessage:
    return RadioMessage(0, key_of("loop", train), packed(Place(front_m, front_m - 70.0, axles)))


def test_every_axle_of_every_train_is_counted_where_it_is() -> None:
    detection = Detection(LOOP)

    detection.on_message([encoded_position(1, 1000.0), encoded_position(2, 560.0)])

    counted = detection.axles()
    assert sum(counted.values()) == 32
    for number in counted:
        section = LOOP.sections[number - 1]
        assert section.start_m < 1000.0
        assert section.end_m > 490.0
    assert LOOP.sections[0].number not in counted


def test_a_train_over_a_joint_has_axles_on_both_sides_of_it() -> None:
    detection = Detection(LOOP)
    joint_m = LOOP.sections[8].end_m

    detection.on_message([encoded_position(1, joint_m + 35.0)])

    assert detection.axles() == {9: 8, 10: 8}


def test_a_train_without_further_reports_stays_where_it_was() -> None:
    detection = Detection(LOOP)
    detection.on_message([encoded_position(1, 1000.0)])
    before = detection.axles()

    detection.on_message([])

    assert detection.axles() == before


@pytest.mark.parametrize(
    ("front_m", "there"), [(1200.0, False), (1200.1, True), (1284.9, True), (1285.0, False)]
)
def test_an_object_is_occupied_while_any_part_of_a_train_is_in_it(
    front_m: float, there: bool
) -> None:
    detection = Detection(LOOP)

    detection.on_message([encoded_position(1, front_m)])

    assert (1 in detection.occupied()) is there


def test_invalid_positions_are_ignored_and_other_messages_are_returned() -> None:
    detection = Detection(LOOP)
    other = RadioMessage(0, "m/loop/w/1/hb/1/all", b"...")
    key = key_of("loop", 1)
    wrong = [
        RadioMessage(0, key, b"short"),
        RadioMessage(0, key, struct.pack(">ddH", math.nan, 1.0, 16)),
        RadioMessage(0, key, struct.pack(">ddH", 1.0, 2.0, 16)),
    ]

    assert detection.on_message([other, *wrong]) == [other]
    assert detection.places == {}


def test_a_flood_of_trains_is_bounded() -> None:
    detection = Detection(LOOP)

    detection.on_message([encoded_position(n, 1000.0) for n in range(1, TRAINS_MAX + 100)])

    assert len(detection.places) == TRAINS_MAX


def test_a_line_that_is_not_divided_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["wayside", "--line", "hefei"]) == 2
    assert vobc(["--line", "hefei", "--line-radio", "tcp/127.0.0.1:1"]) == 2

    told_by = capsys.readouterr().err.splitlines()
    assert len(told_by) == 2
    assert all("hefei" in line for line in told_by)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--line-peer"], "--line-peer: peers find each other at the wayside"),
        (
            ["--line-radio", "tcp/127.0.0.1:1", "--line-peer", "--secure", "secure"],
            "--line-peer: not with --secure",
        ),
    ],
)
def test_a_peer_without_a_wayside_or_beside_rules_is_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(["device", "--line", "loop", *words]) == 2

    assert said in capsys.readouterr().err


def test_the_wayside_reports_each_reason_at_first_and_then_from_time_to_time() -> None:
    refused = RefusalNotes()

    assert refused.looks({}) == []
    assert refused.looks({"too old": 3}) == ["refused: 3 messages, too old"]
    words = [refused.looks({"too old": 3 + look}) for look in range(1, REFUSED_EVERY)]
    assert words == [[]] * (REFUSED_EVERY - 1)
    both = refused.looks({"too old": 13, "wrong source": 1})
    assert both == ["refused: 10 messages, too old", "refused: 1 message, wrong source"]
    assert [refused.looks({"too old": 13}) for _ in range(30)] == [[]] * 30


def test_a_report_of_refused_messages_names_the_last_sender() -> None:
    said = RefusalNotes().looks({"too old": 2}, {"too old": "train 3"})

    assert said == ["refused: 2 messages, too old; the last from train 3"]


def test_an_invalid_endpoint_is_refused_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["wayside", "--line-radio", "nowhere"]) == 2

    assert "nowhere: not an endpoint" in capsys.readouterr().err
