"""`vobc explain` on handmade run folders: its output, its omissions and its refusals."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from can_dbc.cab import CabMode, Desk
from can_dbc.codec import Encoder
from firmware_py.tag_reader.telegram import TagTelegram, encode
from firmware_py.trackdb import TagKind
from metro_hil.cli.vobc import main
from metro_hil.report.explain.answer import OUTCOMES, WEIGHTS, answer
from metro_hil.report.explain.choose import chosen, kinds_of
from metro_hil.report.explain.event_log import KINDS, LoggedSource, RunEventsError, read_story
from metro_hil.report.explain.known import cycle_at, heard_until
from metro_hil.report.explain.meaning import source_words
from zenoh_config.codec import pack
from zenoh_config.messages import MovementAuthority

PRESSED = Desk(CabMode.AUTO, 0.0, False, True, False, False, False, False)
((DESK_ID, DESK_BYTES),) = Encoder().encode(PRESSED)
TOLD = {"start_ns": 1_000_000_000, "line": {"name": "florence"},
        "mission": {"start": "II", "stops": ["III", "IV"]}}  # fmt: skip


def event(number: int, t_s: float, kind: str = "MODE", **changes: Any) -> dict[str, Any]:
    entry = {"t_s": t_s, "number": number, "kind": kind, "words": f"event {number}", "value": 0,
             "sources": []}  # fmt: skip
    return {**entry, **changes}


BUTTON = event(
    2, 4.0, "EMERGENCY_APPLIED", words="emergency brake: button", value=7,
    sources=[
        {"source": "DESK", "id": DESK_ID, "payload": DESK_BYTES.hex(), "heard_s": 3.96},
        {"source": "clock"},
    ],
)  # fmt: skip
EVENTS = [event(1, 0.0), BUTTON, event(3, 9.5, "SUPERVISION")]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a run of ten seconds with three events."""
    path = tmp_path / "run1"
    path.mkdir()
    write(path, EVENTS)
    (path / "results.json").write_text('{"exit_reason": "arrived"}', encoding="utf-8")
    lines = [f"start {json.dumps({'version': 1, 'told': TOLD})}"]
    for number in range(3):
        at_ns = 1_000_000_000 + number * 50_000_000
        ((_, desk),) = Encoder().encode(PRESSED)
        lines += [
            f"run control {at_ns} 0",
            f"rx can {at_ns - 1000} {DESK_ID:03X} {desk.hex().upper()}",
        ]
    (path / "ports.log").write_text("\n".join(lines) + "\nend 7\n", encoding="utf-8")
    rows = "t_s,front_m,mode\n0,100.5,standby\n0.05,,authorised\n0.1,101.5,authorised\n"
    (path / "cycles.csv").write_text(rows, encoding="utf-8")
    return path


def write(folder: Path, events: list[dict[str, Any]], torn: str = "") -> None:
    text = "".join(json.dumps(each) + "\n" for each in events) + torn
    (folder / "events.jsonl").write_text(text, encoding="utf-8")


def explained(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["explain", *words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert isinstance(document, dict)
    return document


def test_the_event_log_has_a_head_and_every_event(folder: Path) -> None:
    story = read_story(folder)

    assert (story.head.name, story.head.line, story.head.ended) == ("run1", "florence", "arrived")
    assert story.head.stations == ("II", "III", "IV")
    assert [each.number for each in story.events] == [1, 2, 3]
    assert read_story(folder / "events.jsonl") == story


def test_each_event_is_shown_with_the_values_of_its_frame(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", str(folder), "-v"]) == 0

    text = " ".join(capsys.readouterr().out.split())
    assert "florence: II → III → IV" in text
    assert "4.000 s emergency applied emergency brake: button" in text
    assert "from 187 DESK, 40 ms old: lever_percent 0 %, mode AUTO" in text
    assert "emergency_released FALSE" in text
    assert text.index("event 1") < text.index("emergency brake: button") < text.index("event 3")


def test_the_answer_comes_first_and_names_the_emergency(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = [event(number, 0.1 * number, "TAG_ACCEPTED") for number in range(1, 30)]
    button = {**BUTTON, "number": 30}
    write(folder, [*quiet, button, event(31, 9.0, "EMERGENCY_RELEASED")])

    assert main(["explain", str(folder)]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "The emergency brake came at 4.000 s: button"
    assert lines[1].startswith("run1, florence: II → III → IV, arrived")
    told = [line for line in lines if re.match(r" +\d+\.\d{3} s ", line)]
    assert len(told) == 10
    assert "emergency applied" in told[-2]
    assert "emergency released" in told[-1]
    assert "from" not in "".join(told)
    assert lines[-1] == "10 of 31 events; -v shows all of them with their frames"


@pytest.mark.parametrize(
    ("ended", "events", "said"),
    [
        ("arrived", [event(1, 1.0)], "The train arrived."),
        ("arrived", [event(1, 1.0, "SERVICE_BRAKE")], "The train arrived."),
        ("over", [event(1, 1.0, "SERVICE_BRAKE", words="brakes: speed")],
         "ATP applied the service brake at 1.000 s: speed"),
        ("over", [event(1, 1.0, "LOCALISATION_LOST", words="lost"),
                  event(2, 2.0, "LOCALISATION_LOST", words="lost")],
         "The train lost its position 2 times, first at 1.000 s: lost"),
        ("over", [event(1, 1.0, "DEPARTURE_INHIBITED", words="doors")],
         "The train may not depart since 1.000 s: doors"),
        ("over", [event(1, 1.0, "DEPARTURE_INHIBITED"), event(2, 2.0, "DEPARTURE_PERMITTED")],
         "Neither the emergency brake nor a loss of position occurred."),
        ("", [], "Neither the emergency brake nor a loss of position occurred."),
    ],
)  # fmt: skip
def test_the_headline_is_the_gravest_thing_that_happened(
    folder: Path, ended: str, events: list[dict[str, Any]], said: str
) -> None:
    write(folder, events)
    (folder / "results.json").write_text(json.dumps({"exit_reason": ended}), encoding="utf-8")

    assert answer(read_story(folder)).startswith(said)


def test_the_weights_name_kinds_of_events() -> None:
    assert set(WEIGHTS) | {kind for kind, _ in OUTCOMES} <= set(KINDS)


def test_a_chosen_part_has_frames_only_when_asked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", str(folder), "--from", "4"]) == 0
    assert "187 DESK" not in capsys.readouterr().out
    assert main(["explain", str(folder), "--from", "4", "-v"]) == 0
    assert "187 DESK" in capsys.readouterr().out


def test_json_holds_the_same_with_the_frame_bytes(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = explained(capsys, str(folder))

    assert document["arrived"]
    desk, clock = document["events"][1]["sources"]
    assert (desk["name"], desk["payload"]) == ("187 DESK", DESK_BYTES.hex())
    assert "emergency_released FALSE" in desk["values"]
    assert clock["id"] is None


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ((), [1, 2, 3]),
        (("--from", "4"), [2, 3]),
        (("--to", "4"), [1, 2]),
        (("--from", "0.1", "--to", "3.9"), []),
        (("--only", "mode"), [1]),
        (("--only", "emergency-applied, SUPERVISION"), [2, 3]),
        (("--only", "mode", "--from", "1"), []),
    ],
)
def test_a_part_of_the_event_log_can_be_shown(
    folder: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], numbers: list[int]
) -> None:
    document = explained(capsys, str(folder), *words)

    assert [each["number"] for each in document["events"]] == numbers


def test_a_part_without_an_event_is_reported_as_such(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", str(folder), "--only", "jog_began"]) == 0

    assert "no event is of that kind and time" in capsys.readouterr().out


def test_the_inputs_at_an_instant_are_the_cycle_and_the_latest_frames(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = explained(capsys, str(folder), "--at", "0.07")

    assert document["cycle"] == {"t_s": "0.05", "front_m": "", "mode": "authorised"}
    (heard,) = document["heard"]
    assert heard["what"] == "187 DESK"
    assert heard["at_s"] == pytest.approx(0.05, abs=1e-5)
    assert main(["explain", str(folder), "--at", "0.07"]) == 0
    shown = capsys.readouterr().out
    assert "cycle at 0.050 s" in shown
    assert "event 1" in shown
    assert "event 3" not in shown


def test_later_frames_are_not_among_the_inputs(folder: Path) -> None:
    before = heard_until(folder / "ports.log", 0.05)
    after = heard_until(folder / "ports.log", 0.1)

    assert before[0].at_s < after[0].at_s
    assert cycle_at(folder / "cycles.csv", 0.0)["front_m"] == "100.5"
    assert cycle_at(folder / "cycles.csv", 1e9)["front_m"] == "101.5"


def test_a_restarted_controller_begins_its_own_time(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(folder, [event(1, 0.0), event(2, 5.0), event(1, 0.0), event(2, 1.0)])

    assert [each.controller for each in read_story(folder).events] == [0, 0, 1, 1]
    assert main(["explain", str(folder)]) == 0
    assert "the controller restarted" in capsys.readouterr().out


@pytest.mark.parametrize("torn", ['{"t_s": 9.6, "num', "[]\n", '{"t_s": 1}\n', "noise\n"])
def test_a_torn_line_is_left_out_and_counted(folder: Path, torn: str) -> None:
    write(folder, EVENTS, torn)

    story = read_story(folder)

    assert (len(story.events), story.torn_lines) == (3, 1)


@pytest.mark.parametrize("name", ["results.json", "ports.log", "cycles.csv"])
def test_the_event_log_is_shown_without_the_other_files(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (folder / name).unlink()

    assert main(["explain", str(folder)]) == 0
    assert "emergency brake: button" in capsys.readouterr().out


def test_an_unusable_folder_is_one_line_that_names_the_path(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    (campaign / "campaign.json").write_text("{}", encoding="utf-8")
    old = tmp_path / "old"
    old.mkdir()
    (old / "cycles.csv").write_text("t_s\n", encoding="utf-8")
    for words, said in [
        ([str(tmp_path / "nowhere")], "nowhere: no such run folder"),
        ([str(campaign)], f"name one of its cases below {campaign / 'cases'}"),
        ([str(old)], f"{old / 'events.jsonl'}: no events; this run was made by an older version"),
        ([str(tmp_path)], "is not the folder of a run"),
        ([str(folder), "--only", "emergncy_applied"], "nearest is EMERGENCY_APPLIED"),
        ([str(folder), "--at", "-1"], "its first cycle is at 0.000 s"),
    ]:
        if said == "is not the folder of a run":
            (folder / "events.jsonl").rename(folder / "moved.jsonl")
        assert main(["explain", *words]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
        if said == "is not the folder of a run":
            (folder / "moved.jsonl").rename(folder / "events.jsonl")


def test_a_damaged_recording_is_an_error_of_the_instant_only(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "ports.log").write_text("start {\nrun control x\n", encoding="utf-8")

    assert main(["explain", str(folder)]) == 0
    capsys.readouterr()
    assert main(["explain", str(folder), "--at", "1"]) == 2
    assert "ports.log: cannot be read" in capsys.readouterr().err


def test_tags_and_messages_are_decoded_as_well() -> None:
    telegram = encode(TagTelegram(1, 301, TagKind.T1, 1000.0, 1030.0, 4711))
    authority = pack(MovementAuthority(7, 3, 2, 500, 1, 1450.0, 0, 99, 1300.0))

    tag = source_words(LoggedSource("tag telegram", 301, telegram, 1.0))
    message = source_words(LoggedSource("movement authority", 500, authority, 1.0))

    assert tag[0] == "tag 301"
    assert "pulses 4711" in tag[1]
    assert message[0] == "movement authority 500"
    assert "end_m 1450" in message[1]
    assert source_words(LoggedSource("orders", None, b"", None)) == ("orders", "never received")


def test_kinds_are_found_in_any_spelling() -> None:
    assert kinds_of(" tag_accepted,Jog-Ended,") == {"TAG_ACCEPTED", "JOG_ENDED"}
    assert kinds_of("") == frozenset()
    with pytest.raises(RunEventsError, match="--only doors: no kind of event"):
        kinds_of("doors")


def test_both_ends_of_the_time_are_shown(folder: Path) -> None:
    events = read_story(folder).events

    assert len(chosen(events, from_s=0.0, to_s=9.5, only=frozenset())) == 3
    assert len(chosen(events, from_s=0.001, to_s=9.499, only=frozenset())) == 1
