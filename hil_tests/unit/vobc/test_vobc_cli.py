"""The command line of the bare controller: its arguments, and its messages about wrong ones."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from firmware_py.settings import SettingsError
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.trackdb import load_line
from vobc.cli import (
    EXIT_ENVIRONMENT,
    EXIT_USAGE,
    DevicePlan,
    PatientLine,
    main,
    parser,
    plan,
)
from vobc.config import load_config
from vobc.process.identity import identity_of
from vobc.vocabulary import PlaceProof

EPOCH_NS = 1_700_000_000_000_000_000
BUS = ["--bus", "embedded:nowhere"]
FLORENCE = load_line("florence")


def stood(*, standing: bool = True, front_m: float = 3000.4) -> NvramRecord:
    """The memory of a controller of florence4 that was switched off on the Florence line."""
    record = NvramRecord(boot_count=5, front_m=front_m, standing=standing, highest_term=7)
    return identity_of(load_config("florence4"), FLORENCE).stamped(record)


@pytest.mark.parametrize("words", [["device"], []])
def test_the_name_of_the_program_may_be_left_out(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--bus", "nosuch"]) == EXIT_ENVIRONMENT

    (error,) = capsys.readouterr().err.splitlines()
    assert "nosuch" in error


def test_without_arguments_the_train_stands_at_the_first_station_and_runs_to_the_last() -> None:
    planned = plan(parser().parse_args(BUS), EPOCH_NS)

    assert planned.mission.start.name == "Start"
    assert planned.mission.stops[-1].name == "IV"
    assert planned.config.cycle_ms == 50.0
    assert planned.start is None
    assert planned.nvram.record.boot_count == 1_700_000_000


def test_a_train_that_was_switched_off_resumes_where_it_stood(tmp_path: Path) -> None:
    memory = tmp_path / "nvram"
    Nvram(memory).put(stood())

    planned = plan(parser().parse_args([*BUS, "--nvram", str(memory)]), EPOCH_NS)

    assert planned.mission.start.name == "II"
    assert planned.start is not None
    assert planned.start.front_m == 3000.4
    assert planned.nvram.record.boot_count == 5


def remembered(
    folder: Path, *said: str, standing: bool = True, front_m: float = 3000.4
) -> DevicePlan:
    """The device plan of a controller whose memory holds a position, given these arguments."""
    memory = folder / "nvram"
    Nvram(memory).put(stood(standing=standing, front_m=front_m))
    return plan(parser().parse_args([*BUS, "--nvram", str(memory), *said]), EPOCH_NS)


def test_without_a_memory_the_given_position_counts(
    tmp_path: Path,
) -> None:
    words = [*BUS, "--nvram", str(tmp_path / "nvram"), "--from", "I"]
    planned = plan(parser().parse_args(words), EPOCH_NS)

    assert (planned.mission.start.name, planned.start, planned.note) == ("I", None, "")


def test_a_remembered_position_overrides_the_given_one_with_a_message(tmp_path: Path) -> None:
    planned = remembered(tmp_path, "--from", "I")

    assert planned.mission.start.name == "II"
    assert planned.start is not None
    assert planned.start.front_m == 3000.4
    assert planned.note == (
        f"--from I is ignored: by {tmp_path}/nvram it was switched off at 3000.4 m, nearest "
        f"to II; remove {tmp_path}/nvram only after checking on site that the "
        "train stands at I"
    )


@pytest.mark.parametrize(("front_m", "agrees"), [(0.5, True), (-0.5, True), (0.6, False)])
def test_a_given_position_that_agrees_with_the_memory_counts(
    tmp_path: Path, front_m: float, *, agrees: bool
) -> None:
    stop_m = load_line("florence").stations[1].stop_m
    planned = remembered(tmp_path, "--from", "I", front_m=stop_m + front_m)

    assert planned.mission.start.name == "I"
    assert (planned.start is None) is agrees
    assert (planned.note == "") is agrees


def test_a_train_switched_off_in_motion_may_stand_anywhere_whatever_the_arguments(
    tmp_path: Path,
) -> None:
    planned = remembered(tmp_path, "--from", "I", standing=False)

    assert planned.mission.start.name == "I"
    assert planned.start is not None
    assert planned.start.proof is PlaceProof.UNKNOWN
    assert planned.note == (
        f"--from I is ignored: the train may stand anywhere: {tmp_path}/nvram: the last run "
        f"did not end at a proven standstill; remove {tmp_path}/nvram only after checking on site "
        "that the train stands at I"
    )


def test_without_a_given_position_there_is_no_message(tmp_path: Path) -> None:
    assert remembered(tmp_path, standing=False).note == ""
    assert remembered(tmp_path).note == ""


def test_a_mission_that_cannot_begin_at_the_position_names_the_reason(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"^--to II: .*; --from I is ignored: by "):
        remembered(tmp_path, "--from", "I", "--to", "II")


def test_an_overridden_position_is_reported_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    memory = tmp_path / "nvram"
    Nvram(memory).put(stood(standing=False))

    assert main([*BUS, "--nvram", str(memory), "--from", "I"]) == EXIT_ENVIRONMENT

    assert capsys.readouterr().err.startswith("vobc: --from I is ignored: ")


@pytest.mark.parametrize(
    ("change", "words", "why"),
    [
        ({}, ["--line", "hefei"], "it belongs to line florence, this is line hefei"),
        ({"database": 1}, [], "it belongs to another survey of line florence: 00000000, this is "),
        ({"train": 9}, [], "it belongs to train 9, this is train 1"),
        ({"parameters": 1}, [], "it belongs to other vital parameters: 00000000, these are "),
        ({"software": "0.0.1"}, [], "software 0.0.1 stored it, this is "),
    ],
)
def test_the_memory_of_another_line_survey_train_or_version_gives_no_place(
    tmp_path: Path, change: dict[str, Any], words: list[str], why: str
) -> None:
    memory = tmp_path / "nvram"
    Nvram(memory).put(replace(stood(), **change))

    planned = plan(parser().parse_args([*BUS, "--nvram", str(memory), *words]), EPOCH_NS)

    assert planned.start is not None
    assert planned.start.proof is PlaceProof.UNKNOWN
    assert planned.start.bound_m > 1000.0
    assert planned.note.startswith(f"the train may stand anywhere: {memory}: {why}")


@pytest.mark.parametrize("said", [[], ["--from", "I"]])
def test_a_train_whose_memory_is_damaged_may_stand_anywhere(
    tmp_path: Path, said: list[str]
) -> None:
    """The operator's position does not replace a damaged memory."""
    memory = tmp_path / "nvram"
    Nvram(memory).put(stood())
    stored = memory.read_bytes()
    memory.write_bytes(stored[:20] + bytes([stored[20] ^ 1]) + stored[21:])

    planned = plan(parser().parse_args([*BUS, "--nvram", str(memory), *said]), EPOCH_NS)

    assert planned.start is not None
    reach_m = (planned.start.front_m, planned.start.bound_m)
    line = planned.line
    assert reach_m == ((line.start_m + line.end_m) / 2.0, (line.end_m - line.start_m) / 2.0)
    assert planned.nvram.record.boot_count == 1_700_000_000


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        (["--consist", "florence5"], "florence4", EXIT_USAGE),
        (["--consist", "missing.toml"], "missing.toml: no such file", EXIT_USAGE),
        (["--line", "florance"], "florence", EXIT_USAGE),
        (["--from", "V"], "--from V", EXIT_USAGE),
        (["--from", "III", "--to", "II"], "--to II", EXIT_USAGE),
        (["--bus", "vcan0"], "no kind", EXIT_ENVIRONMENT),
        (["--bus", "socketcan:nocan9"], "nocan9", EXIT_ENVIRONMENT),
        (["--bus", "embedded:nowhere"], "nowhere", EXIT_ENVIRONMENT),
    ],
)
def test_every_error_is_one_line_and_an_exit_code(
    words: list[str], said: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*BUS, *words]) == code

    error = capsys.readouterr().err
    assert error.startswith("vobc: ")
    assert said in error
    assert "Traceback" not in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["--cycle-ms", "4"],
        ["--cycle-ms", "fast"],
        ["--cycle-ms", "nan"],
        ["--priority", "100"],
        ["--duration", "-1"],
    ],
)
def test_an_impossible_number_is_refused_at_once(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*BUS, *words])

    assert ended.value.code == EXIT_USAGE
    assert words[1] in capsys.readouterr().err


def test_the_controller_waits_for_a_missing_tag_line_and_reports_it_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = PatientLine(str(tmp_path / "tags"))

    for second in range(5):
        assert list(line.receive(second * 1_000_000_000)) == []

    said = capsys.readouterr().err
    assert said.count("waits for the tag reader") == 1
    assert "no such device" in said
    assert line.counters.errors == 5


def test_a_tag_line_that_appears_later_is_used(tmp_path: Path) -> None:
    link = tmp_path / "tags"
    line = PatientLine(str(link))
    line.receive(0)
    master, slave = os.openpty()
    link.symlink_to(os.ttyname(slave))

    assert list(line.receive(1_000_000_000)) == []
    os.write(master, b"hello")
    chunks = list(line.receive(1_100_000_000))

    assert b"".join(chunk.data for chunk in chunks) == b"hello"
    line.close()
    os.close(master)
    os.close(slave)
