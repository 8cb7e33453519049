"""The supervision display of a line: what it shows, and which messages it sends."""

import dataclasses
from typing import Any

import pytest
import zenoh

from can_dbc.vobc import OperatingMode
from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import load_areas
from hil_tests.unit.plant_emulator.wayside.test_line_centre import STATUS
from metro_hil.cli.vobc import main as vobc
from metro_hil.model.run_options import LINE_VERBS, OTHER_VERBS
from metro_hil.supervision.command import main
from metro_hil.supervision.view import LineView
from zenoh_config import keys
from zenoh_config.codec import pack
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import (
    BROADCAST,
    Admission,
    AdmissionState,
    Heartbeat,
    ObjectState,
    ObjectStatus,
    Phase,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_keys import key_of, of_supervision, token_of
from zenoh_config.t2t_supervision import (
    DecreeAnswer,
    LineState,
    RosterPlace,
)

LOOP = load_areas("loop")
MS = 1_000_000
BEAT = Heartbeat(3, BROADCAST, 1, 7, 1, 1, 0, Phase.ISSUING, 5, 1)
REPORT = TrainReport(
    source=3,
    destination=BROADCAST,
    area=1,
    term=7,
    boot=1,
    sequence=1,
    stamp_ns=0,
    localised=True,
    front_min_m=998.0,
    front_max_m=1000.0,
    rear_min_m=930.0,
    protected_m=935.0,
    speed_mps=10.0,
    standstill=False,
    latent_m=1500.0,
    held_end_m=1500.0,
    easy_m=1200.0,
    held_term=7,
    held_sequence=1,
    member=True,
    behind=0,
    comes_from=0,
    axles=16,
    out_of_service=False,
    ready_nonce=0,
    echo_ns=0,
)


def view(*messages: T2tMessage, at_ms: int = 0) -> LineView:
    shown = LineView(LOOP)
    for message in messages:
        shown.on_message([said(message)], at_ms * MS)
    return shown


def said(message: T2tMessage) -> RadioMessage:
    return RadioMessage(0, key_of("loop", message), pack(message))


@pytest.mark.parametrize(
    ("here_m", "next_m", "member", "late_ms", "end_m"),
    [
        (2800.0, 4000.0, True, 0, 4000.0),
        (2799.0, 4000.0, True, 0, 2799.0),
        (2800.0, 4000.0, False, 0, 2800.0),
        (2800.0, 4000.0, True, 60_000, 2800.0),
    ],
)
def test_the_end_of_an_authority_is_that_of_the_next_area_once_it_reaches_the_border(
    here_m: float, next_m: float, member: bool, late_ms: int, end_m: float
) -> None:
    here = dataclasses.replace(REPORT, held_end_m=here_m)
    there = dataclasses.replace(REPORT, area=2, held_end_m=next_m, member=member)
    shown = view(there)
    shown.on_message([said(here)], late_ms * MS)

    assert shown.authority_end(here) == end_m
    assert f" {end_m:.1f} " in shown.words(late_ms * MS)[-1]


def test_it_shows_masters_areas_and_positions() -> None:
    places_m: dict[str, Any] = {
        "front_min_m": 400.0,
        "front_max_m": 402.0,
        "rear_min_m": 330.0,
        "protected_m": 330.0,
    }
    behind = dataclasses.replace(REPORT, source=4, member=False, **places_m)

    told = view(BEAT, behind, REPORT).words(100 * MS)

    assert told[0] == "area 1: train 3 commands, term 7, standby train 5"
    assert told[1] == "area 2: no train commands"
    assert told[3] == "the wayside is not received: no command is possible"
    assert [line.split()[0] for line in told[5:]] == ["3", "4"]
    assert told[5].split() == ["3", "1000.0", "36.0", "1500.0", "7", "0.10"]
    assert told[6].split()[3] == "–"


def test_it_shows_the_former_master_and_the_silence_of_a_master() -> None:
    shown = view(BEAT, dataclasses.replace(BEAT, source=5, term=9, standby=0))

    assert shown.words(1000 * MS)[0] == (
        "area 1: train 5 commands, term 9, standby none; before, train 3 did"
    )
    assert shown.words(2500 * MS)[0] == "area 1: train 5, term 9, silent for 2.5 s"


def test_for_a_silent_train_only_silence_and_last_position_are_shown() -> None:
    shown = view(REPORT)
    status = dataclasses.replace(STATUS, train=REPORT.source)
    shown.on_message([RadioMessage(0, keys.status("loop", REPORT.source), pack(status))], 0)

    fresh, silent = (shown.words(at_ms * MS)[-1] for at_ms in (1000, 8000))

    for text in ("36.0", "1500.0", "mode"):
        assert text in fresh
        assert text not in silent
    assert silent.split()[:6] == ["3", "--", "--", "--", "7", "8.00"]
    assert "silent for 8.0 s, last at 1000.0 m" in silent


def test_old_data_of_a_silent_wayside_are_not_shown() -> None:
    nothing = (0, 0, DecreeAnswer.NONE, (), ())
    stretch = SpeedRestriction(start_m=100.0, end_m=200.0, limit_mps=5.0)
    places = (RosterPlace(1, 9),)
    state = LineState(0, BROADCAST, 0, 0, 2, 1, 0, *nothing, (stretch,), (), places)
    shown = view(state, REPORT)

    fresh, silent = ("\n".join(shown.words(at_ms * MS)) for at_ms in (1000, 8000))

    for text in ("at most 18 km/h", "train 9 is silent"):
        assert text in fresh
        assert text not in silent
    assert "the wayside has been silent for 8.0 s: no command is possible" in silent


def test_for_a_silent_object_only_its_silence_is_shown() -> None:
    shown = view(OBJECT)

    assert "object 1: locked" in shown.words(1000 * MS)
    assert "object 1: silent for 8.0 s" in shown.words(8000 * MS)


def test_a_master_of_an_earlier_term_is_not_shown() -> None:
    shown = view(dataclasses.replace(BEAT, source=5, term=9), BEAT)

    assert shown.commands[1].heartbeat.source == 5


def test_damaged_messages_and_those_under_a_wrong_key_are_not_shown() -> None:
    shown = LineView(LOOP)
    wrong = dataclasses.replace(BEAT, area=2)

    shown.on_message(
        [said(BEAT)._replace(payload=pack(wrong)), said(BEAT)._replace(payload=b"x")], 0
    )

    assert shown.commands == {}


@pytest.mark.parametrize(
    ("words", "code", "complaint"),
    [
        (["line", "--line", "hefei"], 2, "line hefei is not divided into areas"),
        (["master", "--line-radio", "nowhere"], 2, "nowhere: not an endpoint"),
    ],
)
def test_impossible_arguments_are_refused_in_one_line(
    words: list[str], code: int, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(words) == code

    told = capsys.readouterr().err
    assert complaint in told
    assert len(told.splitlines()) == 1


def test_the_program_names_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        vobc(["--help"])

    told = capsys.readouterr().out.split()
    assert {*LINE_VERBS, *OTHER_VERBS, "run"} <= set(told)


@pytest.mark.parametrize("train", ["T0", "x", "70000"])
def test_an_invalid_train_is_refused(train: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["out-of-service", train])

    assert f"{train} is no train" in capsys.readouterr().err


def test_a_silent_train_of_a_roster_is_shown() -> None:
    places = tuple(RosterPlace(*each) for each in ((1, 9), (2, 9)))
    nothing = (0, 0, DecreeAnswer.NONE, (), (), (), ())
    state = LineState(0, BROADCAST, 0, 0, 2, 1, 0, *nothing, places)
    words = "train 9 is silent, on the roster of area 1 and 2: others wait behind it"

    assert view(state, REPORT).words(0)[-1] == words
    assert "silent" not in "".join(view(dataclasses.replace(state, silent=()), REPORT).words(0))


def test_for_a_silent_train_the_display_shows_whether_its_session_exists() -> None:
    """A program that hangs keeps its session, which distinguishes it from a lost radio. No other
    rule uses this."""
    places = (RosterPlace(1, 9),)
    nothing = (0, 0, DecreeAnswer.NONE, (), (), (), ())
    shown = view(LineState(0, BROADCAST, 0, 0, 2, 1, 0, *nothing, places), REPORT)
    here, late_ns = REPORT.source, 1_000_000_001

    def told(now_ns: int, *trains: int) -> list[str]:
        shown.tokens = lambda: [token_of("loop", each) for each in trains]
        return shown.words(now_ns)

    assert told(0, here)[-1].endswith("others wait behind it; it has no session")
    assert told(0, here, 9)[-1].endswith("others wait behind it; its session exists")
    assert not told(0, here)[-2].endswith("session")
    assert told(late_ns, here)[-2].endswith("; its session exists")
    assert told(late_ns)[-2].endswith("; it has no session")
    assert told(0, here, 5, 9)[-1] == "train 5 has a session but sends nothing"


OBJECT = ObjectStatus(
    WAYSIDE, BROADCAST, 1, 7, 1, 1, 0, 1, ObjectState.LOCKED, 7, 0, release_wanted=False
)
NEWCOMER = dataclasses.replace(REPORT, source=1, member=False)
ADMISSION = Admission(3, 1, 1, 7, 1, 1, 0, AdmissionState.UNPLACED, 2)


@pytest.mark.parametrize(
    ("state", "ahead", "words"),
    [
        (
            AdmissionState.UNPLACED,
            2,
            "waits for T2 in area 1: its place among the others is not certain yet",
        ),
        (
            AdmissionState.UNPLACED,
            0,
            "waits in area 1: its place among the others is not certain yet",
        ),
        (AdmissionState.WAITS, 2, "waits for T2 in area 1: that train has to be admitted first"),
        (AdmissionState.WAITS, 0, "waits in area 1: it has no authority to its border yet"),
        (
            AdmissionState.COMMITTING,
            0,
            "waits in area 1: its arbiters have not committed the roster with the train yet",
        ),
        (AdmissionState.FULL, 0, "waits in area 1: the roster is full"),
    ],
)
def test_it_shows_why_a_train_waits(state: AdmissionState, ahead: int, words: str) -> None:
    admission = dataclasses.replace(ADMISSION, state=state, waits_for=ahead)

    assert view(NEWCOMER, admission).words(0)[-1].endswith(f"  {words}")


def test_a_wait_ends_with_admission_or_without_recent_reports() -> None:
    shown = view(NEWCOMER, ADMISSION)
    assert "waits" in shown.words(1000 * MS)[-1]
    assert "waits" not in shown.words(1001 * MS)[-1]

    admitted = dataclasses.replace(NEWCOMER, member=True)
    assert "waits" not in view(admitted, ADMISSION).words(0)[-1]


def test_a_member_of_one_area_may_wait_for_the_next() -> None:
    member = dataclasses.replace(NEWCOMER, member=True)
    full = dataclasses.replace(ADMISSION, area=2, state=AdmissionState.FULL, waits_for=0)

    assert "waits in area 2: the roster is full" in view(member, full).words(0)[-1]


def test_the_wait_of_another_train_is_not_shown() -> None:
    assert "waits" not in view(REPORT, ADMISSION).words(0)[-1]


@pytest.mark.parametrize("train", [1, 4])
def test_a_display_subscribes_to_the_wait_reasons_of_all_trains(train: int) -> None:
    key = key_of("loop", dataclasses.replace(ADMISSION, destination=train))

    assert any(zenoh.KeyExpr(each).includes(key) for each in of_supervision("loop"))


def test_the_standby_mode_of_a_train_is_not_shown_as_standby_of_an_area() -> None:
    shown = view(REPORT)
    shown.statuses[3] = dataclasses.replace(STATUS, mode=OperatingMode.STANDBY)

    assert shown.words(0)[-1].endswith("  mode standby")
