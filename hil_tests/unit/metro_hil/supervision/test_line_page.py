"""The page of a line: its state, events, stream, commands, and what a browser shows of it."""

import asyncio
import dataclasses
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
from metro_hil.watch.line_picture import changes, head_of, picture_of
from metro_hil.watch.line_server import COMMANDS, LineServer, PageCommand
from metro_tools.browser import Browser
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import BROADCAST, Phase, T2tMessage
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
    """A session that received some messages once."""

    connected = True

    def __init__(self, *messages: T2tMessage) -> None:
        self.waiting = [said(each) for each in messages]

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        found, self.waiting = self.waiting, []
        return found


class StillClock:
    """A clock that stands, so that nothing that was received grows old."""

    def now_ns(self) -> int:
        return 10_000 * MS

    def epoch_ns(self) -> int:
        return 1_800_000_000_000 * MS


@contextmanager
def running(*messages: T2tMessage, commands: bool) -> Iterator[str]:
    """Serve the page of a line, and yield its address."""
    server = LineServer(
        *(LineView(LOOP), OneLine(*messages), StillClock(), head_of(load_line("loop"), LOOP)),
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
            first = event_of(stream, "line")
        with viewer(address) as late:
            past = json.loads(late.recv(timeout=20))
        with pytest.raises(InvalidStatus):
            connect(address.replace("http", "ws") + "stream", origin=Origin("http://evil"))

    assert (head["kind"], head["version"], head["line"]) == ("snapshot", 1, "loop")
    assert head["areas"][0] == [1, -120.0, 2800.0]
    assert head["commands"] == {}
    assert first == "area 1: train 3 commands, term 7"
    assert [each["text"] for each in past["events"]][:2] == [first, "train 3 is received"]
    assert past["samples"][0][1] == [[3, 1000.0]]


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
