"""The page of a line: its state, events, stream, commands, and what a browser shows of it."""

import asyncio
import dataclasses
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import load_line
from hil_tests.serving_rig import served
from hil_tests.unit.metro_hil.supervision.test_line_supervision import (
    BEAT,
    LOOP,
    MS,
    REPORT,
    said,
    view,
)
from metro_hil.cli.vobc import main as vobc
from metro_hil.supervision.command import parser
from metro_hil.supervision.view import LineView
from metro_hil.watch.line_folder import serve_line_folder
from metro_hil.watch.line_picture import changes, head_of, picture_of
from metro_hil.watch.line_server import COMMANDS, LineServer, PageCommand
from metro_hil.watch.line_source import FolderSource, RadioSource
from metro_tools.browser import Browser
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import BROADCAST, AreaAuthority, Phase, T2tMessage
from zenoh_config.t2t_supervision import DecreeAnswer, LeaseNote, LeaseReason, LineState

STATE = LineState(
    *(WAYSIDE, BROADCAST, 0, 0, 1, 1, 10_000 * MS),
    *(0, 0, DecreeAnswer.NONE, ()),
    leases=(LeaseNote(1, 3, 7, 2, LeaseReason.RAN_OUT, 4_000 * MS),),
    restrictions=(SpeedRestriction(5000.0, 5200.0, 5.0),),
    closed=(),
)


def events(shown: LineView, *messages: T2tMessage, to_ms: int) -> list[str]:
    """Return the events from the messages, between their instant and a later one."""
    before = picture_of(shown, to_ms * MS, connected=True)
    shown.on_message([said(each) for each in messages], to_ms * MS)
    return changes(before, picture_of(shown, to_ms * MS, connected=True))


def test_the_picture_has_master_reason_authority_and_restriction() -> None:
    picture = picture_of(view(BEAT, REPORT, STATE), 100 * MS, connected=True)

    area, train = picture.areas[0], picture.trains[0]
    assert (area.master, area.standby, area.term, area.issuing) == (3, 5, 7, True)
    assert area.why == "for 6 s, because the lease of train 2 had run out"
    assert (train.train, train.authority_m, train.speed_kmh, train.age_s) == (3, 1500.0, 36.0, 0.1)
    assert picture.track.restrictions == ((5000.0, 5200.0, 18.0),)
    assert picture.areas[1].master == 0


def test_a_train_that_applies_has_no_authority() -> None:
    applies = dataclasses.replace(REPORT, member=False)

    assert picture_of(view(applies), 0, connected=True).trains[0].authority_m is None


def test_each_step_of_a_takeover_is_an_event() -> None:
    shown = view(BEAT)
    taking = dataclasses.replace(BEAT, source=5, term=8, standby=0, phase=Phase.FENCING)
    issuing = dataclasses.replace(taking, phase=Phase.ISSUING)

    assert events(shown, taking, to_ms=100) == ["area 1: train 5 takes over after train 3, term 8"]
    assert events(shown, issuing, to_ms=200) == ["area 1: train 5 commands, term 8"]
    assert events(shown, issuing, to_ms=300) == []


def test_silence_is_an_event_once_and_so_is_its_end() -> None:
    shown = view(BEAT, REPORT)
    pictures = [picture_of(shown, at * MS, connected=True) for at in (1000, 1001, 2000)]

    assert changes(pictures[0], pictures[0]) == []
    assert changes(pictures[0], pictures[1]) == [
        "area 1: its master, train 3, is silent",
        "train 3 is silent",
    ]
    assert changes(pictures[1], pictures[2]) == []
    assert events(shown, REPORT, to_ms=2000) == ["train 3 is received again"]


def test_orders_for_the_track_and_a_lost_session_are_events() -> None:
    shown = view(STATE)
    lifted = dataclasses.replace(STATE, restrictions=(), closed=(SpeedRestriction(1.0, 2.0, 1.0),))
    lost = picture_of(shown, 0, connected=False)

    assert changes(picture_of(shown, 0, connected=True), lost) == [
        "the session with the line is lost"
    ]
    assert events(shown, lifted, to_ms=0) == [
        "at most 18 km/h from 5000 to 5200 m no longer holds",
        "closed from 1 to 2 m",
    ]


@pytest.mark.parametrize("end", [False, True])
def test_the_command_line_takes_every_command_of_the_page(end: bool) -> None:
    verbs = get_args(get_type_hints(PageCommand)["verb"])
    assert set(verbs) == set(COMMANDS)

    for verb in verbs:
        command = PageCommand(verb, 3, 2, -100.0, 5200.5, 20.0, end)
        parsed = parser().parse_args(command.words())
        assert parsed.verb == verb
        assert getattr(parsed, "end", end) is end
        assert getattr(parsed, "number", 3) == 3
        assert getattr(parsed, "area", 2) == 2
        assert getattr(parsed, "start_m", -100.0) == -100.0
        assert getattr(parsed, "end_m", 5200.5) == 5200.5
        assert (
            getattr(parsed, "limit_kmh", 20.0) == (20.0 if not end else None) or verb != "restrict"
        )


class OneLine:
    """A session that receives the same messages again and again."""

    connected = True

    def __init__(self, *messages: T2tMessage) -> None:
        self.messages = [said(each) for each in messages]

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        return self.messages


class SteppingClock:
    """A clock that goes on by the time between two states whenever it is read."""

    def __init__(self) -> None:
        self.at_ns = 10_000 * MS

    def now_ns(self) -> int:
        self.at_ns += 100 * MS
        return self.at_ns

    def epoch_ns(self) -> int:
        return self.now_ns() + 1_800_000_000_000 * MS


@contextmanager
def running(*messages: T2tMessage, commands: bool) -> Iterator[str]:
    """Serve the page of a line, and yield its address."""
    server = LineServer(
        *(LineView(LOOP), RadioSource(OneLine(*messages), SteppingClock())),
        head_of(load_line("loop"), LOOP),
        command_line=["--line", "loop"] if commands else None,
    )
    with served(server) as address:
        yield address


def viewer(address: str) -> ClientConnection:
    origin = Origin(address.split("/", 3)[0] + "//" + address.split("/", 3)[2])
    return connect(address.replace("http", "ws") + "stream", origin=origin, max_size=None)


def event_of(stream: ClientConnection, kind: str) -> str:
    """Wait for the next event of a kind, and return its text."""
    while True:
        told = json.loads(stream.recv(timeout=20))
        for each in told["events"]:
            if each["kind"] == kind:
                return str(each["text"])


def test_a_viewer_gets_the_line_and_then_its_events() -> None:
    with running(BEAT, REPORT, commands=False) as address:
        with viewer(address) as stream:
            head = json.loads(stream.recv(timeout=20))
            if not head["events"]:
                event_of(stream, "line")
        with viewer(address) as late:
            past = json.loads(late.recv(timeout=20))
        with pytest.raises(InvalidStatus):
            connect(address.replace("http", "ws") + "stream", origin=Origin("http://evil"))

    assert (head["kind"], head["version"], head["line"]) == ("snapshot", 1, "loop")
    assert head["areas"][0] == [1, -120.0, 2800.0]
    assert head["commands"] == {}
    first = [each["text"] for each in past["events"]]
    assert first == ["area 1: train 3 commands, term 7", "train 3 is received"]
    assert past["samples"][0][1] == [[3, 1000.0]]


def test_the_latency_is_the_time_from_report_to_authority() -> None:
    answer = AreaAuthority(
        *(5, 3, 1, 7, 1, 1, 0),
        to_boot=1,
        echo_ns=REPORT.stamp_ns,
        end_m=1500.0,
        rear_m=900.0,
        behind=0,
        rank=0,
        restrictions=(),
    )
    shown = view(REPORT)
    for at_ms in (70, 90):
        shown.on_message([said(answer)._replace(stamp_ns=at_ms * MS)], at_ms * MS)
    train = picture_of(shown, 100 * MS, connected=True).trains[0]

    assert (train.latency_ms, train.latency_max_ms) == (70.0, 70.0)
    assert picture_of(view(REPORT), 0, connected=True).trains[0].latency_ms is None


class WallOf:
    """A clock of the machine on which a run goes on."""

    def __init__(self, folder: Path) -> None:
        self.log, self.at_ns = folder / "line.log", 0

    def now_ns(self) -> int:
        return self.at_ns

    def epoch_ns(self) -> int:
        return self.log.stat().st_mtime_ns + self.at_ns


def line_log(folder: Path, *stamps_s: float) -> None:
    topic, payload = said(BEAT).key, said(BEAT).payload.hex()
    rows = [f"{at_s:.6f},rx,{topic},{payload}\n" for at_s in stamps_s]
    with (folder / "line.log").open("a") as log:
        log.writelines(rows)


def test_a_run_is_read_in_steps_with_its_events_at_their_time(tmp_path: Path) -> None:
    (tmp_path / "line.log").write_text("t_s,direction,key,payload\n")
    line_log(tmp_path, 5.0, 5.05, 5.3)
    (tmp_path / "story.txt").write_text(
        "    0.02 s  first\n    0.30 s  second\n    9.00 s  third\n"
    )
    clock = WallOf(tmp_path)
    source = FolderSource(tmp_path, clock, real_time=True)

    first = [
        (source.shown_s(step.now_ns), len(step.messages), step.notes) for step in source.steps()
    ]
    clock.at_ns = 2_000 * MS
    second = [(source.shown_s(step.now_ns), step.notes) for step in source.steps()]
    clock.at_ns = 11_000 * MS
    assert list(source.steps())[-1].messages == ()

    assert first == [(0.05, 2, [(0.02, "first")]), (0.3, 1, [(0.3, "second")])]
    assert second == [(2.3, [(9.0, "third")])]
    assert source.remark.startswith("The run wrote nothing for 10 s and left no results.json")
    assert source.results.text == ""


def test_a_run_that_ended_no_longer_ages_and_names_damage(tmp_path: Path) -> None:
    line_log(tmp_path, 5.0)
    with (tmp_path / "line.log").open("a") as log:
        log.write("5.1,rx,m/loop,no hex\n")
    told = {"verdict": "failed", "exit_reason": "duration over", "complaints": ["too near"]}
    (tmp_path / "results.json").write_text(json.dumps({**told, "trains": [{"train": 1}]}))
    clock = WallOf(tmp_path)
    source = FolderSource(tmp_path, clock, real_time=True)
    for at_s in (0, 60):
        clock.at_ns = at_s * 1_000 * MS
        steps = list(source.steps())

    assert source.results.text == "The run has ended: failed, duration over; too near"
    assert source.results.trains == [{"train": 1}]
    assert "line.log: 1 damaged lines are left out" in source.remark
    assert source.shown_s(steps[-1].now_ns) == 0.0


def test_a_command_runs_by_the_command_line_and_its_outcome_is_an_event() -> None:
    with running(commands=True) as address, viewer(address) as stream:
        stream.send("no JSON")
        stream.send('{"verb": "line"}')
        stream.send('{"verb": "hold", "train": "1 --line-radio tcp/evil:1"}')
        stream.send('{"verb": "hold", "train": 1, "line": "florence"}')
        stream.send('{"verb": "switch-master", "area": 9, "train": 3}')
        outcome = event_of(stream, "refused")

    assert outcome == "vobc switch-master --area 9 --to T3: --area 9: loop has no such area"


def test_a_page_that_only_shows_takes_no_command(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[Any] = []
    monkeypatch.setattr(
        asyncio, "create_subprocess_exec", lambda *words, **_: started.append(words)
    )

    with running(BEAT, commands=False) as address, viewer(address) as stream:
        stream.send('{"verb": "switch-master", "area": 9, "train": 3}')
        stream.send('{"verb": "hold", "train": 3}')
        busy = [json.loads(stream.recv(timeout=20))["busy"] for _ in range(4)]

    assert not started
    assert busy == ["", "", "", ""]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--commands"], "--commands is for the page in the browser; add --web"),
        (["--port", "8000"], "--port is for the page in the browser; add --web"),
        (["--web", "--commands", "--listen", "192.0.2.1"], "--commands with --listen 192.0.2.1"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    words: Sequence[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert vobc(["line", *words]) == 2

    assert told in capsys.readouterr().err


def sized(browser: Browser, width: int) -> int:
    """Set the width of the page, and return how wide its content is."""
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=900,
        deviceScaleFactor=1,
        mobile=False,
    )
    browser.settle()
    return int(browser.run("document.documentElement.scrollWidth"))


def test_a_browser_shows_the_line_and_asks_before_it_sends(browser: Browser) -> None:
    with running(BEAT, REPORT, STATE, commands=True) as address:
        browser.open(address)
        browser.wait("document.querySelector('#trains tbody tr')")
        widths = [sized(browser, width) for width in (320, 1600)]
        area, train = browser.text("#areas .area"), browser.text("#trains tbody tr")
        bars = browser.run("document.querySelectorAll('#track .authority, #track .limited').length")
        browser.run(
            "(() => { $('verb').value = 'switch-master'; fields(); $('area').value = '1';"
            " $('train').value = '5'; document.querySelector('#command button').click(); })()"
        )
        asked = browser.text("#asked")
        browser.run("sent = []; socket.send = text => sent.push(text); $('no').click()")
        browser.run("document.querySelector('#command button').click(); $('yes').click()")
        sent = browser.run("sent")
        sized(browser, 1440)

    assert widths == [320, 1600]
    assert "T3" in area
    assert "term 7" in area
    assert "standby T5" in area
    assert train.split()[:4] == ["T3", "1000.0", "36.0", "1500.0"]
    assert bars == 2
    assert asked == "vobc switch-master --area 1 --to T5"
    assert [json.loads(text) for text in sent] == [{"verb": "switch-master", "area": 1, "train": 5}]
    assert not browser.log


def test_a_browser_shows_the_report_of_a_run(browser: Browser, tmp_path: Path) -> None:
    line_log(tmp_path, 5.0, 70.0)
    (tmp_path / "run.toml").write_text(
        'bench = "lockstep"\n[options]\nline = "loop"\n[line]\n'
        f'[versions]\nmetro-vobc-bench = "{version("metro-vobc-bench")}"\n'
    )
    (tmp_path / "story.txt").write_text("   61.00 s  the controller of train 2 dies\n")
    measured = {"least_gap_m": 7.5, "latency_p50_ms": 15.0, "latency_p99_ms": None}
    brakes = {"oldest_ms": 585.0, "service_brakes": 1, "struck": True, "emergencies": []}
    stops = [{"station": "S7", "error_m": -0.02}]
    train = {"train": 2, **measured, **brakes, "stops": stops}
    told = {"verdict": "passed", "exit_reason": "duration over", "trains": [train]}
    (tmp_path / "results.json").write_text(json.dumps(told))
    with served(serve_line_folder(tmp_path, host="127.0.0.1")) as address:
        browser.open(address)
        browser.wait("document.querySelector('#results tbody tr')")
        width = sized(browser, 320)
        summary, results = browser.text("#told"), browser.text("#results tbody tr")
        events = browser.text("#events")
        sized(browser, 1440)

    assert width == 320
    assert summary == "0 trains · 1:05 · The run has ended: passed, duration over · report"
    assert results.split("\t")[1:] == [
        *("7.5", "15", "–", "585", "1"),
        *("struck by a fault", "S7 -0.02 m"),
    ]
    assert "1:01the controller of train 2 dies" in events
    assert not browser.log
