"""What supervision of a line shows and says, and to whom."""

import dataclasses
from typing import Any

import pytest

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import load_areas
from metro_hil.line_desk.command import main
from metro_hil.line_desk.desk import Desk
from metro_hil.line_desk.view import LineView
from metro_hil.options import LINE_VERBS, OTHER_VERBS
from metro_hil.vobc_command import main as vobc
from zenoh_config.codec import pack, unpack
from zenoh_config.t2t import (
    BROADCAST,
    Heartbeat,
    LineOrder,
    OrderKind,
    Phase,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_keys import key_of
from zenoh_config.t2t_supervision import (
    DecreeAnswer,
    LineState,
    Removal,
    RemovalAnswer,
    RemovalState,
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
        shown.hears([said(message)], at_ms * MS)
    return shown


def said(message: T2tMessage) -> RadioMessage:
    return RadioMessage(0, key_of("loop", message), pack(message))


def test_it_says_who_commands_which_area_and_where_trains_are() -> None:
    places_m: dict[str, Any] = {
        "front_min_m": 400.0,
        "front_max_m": 402.0,
        "rear_min_m": 330.0,
        "protected_m": 330.0,
    }
    behind = dataclasses.replace(REPORT, source=4, member=False, **places_m)

    told = view(BEAT, behind, REPORT).words(100 * MS)

    assert told[0] == "area 1: train 3 commands, term 7, standby train 5"
    assert told[1] == "area 2: nobody commands"
    assert told[3] == "the wayside is not heard: nothing can be decreed"
    assert [line.split()[0] for line in told[5:]] == ["3", "4"]
    assert told[5].split() == ["3", "1000.0", "36.0", "1500.0", "7", "0.10"]
    assert told[6].split()[3] == "–"


def test_it_says_who_commanded_before_and_how_long_a_master_has_been_silent() -> None:
    shown = view(BEAT, dataclasses.replace(BEAT, source=5, term=9, standby=0))

    assert shown.words(2500 * MS)[0] == (
        "area 1: train 5 commands, term 9, standby nobody; before, train 3 did; silent for 2.5 s"
    )


def test_a_master_of_a_former_term_is_not_shown() -> None:
    shown = view(dataclasses.replace(BEAT, source=5, term=9), BEAT)

    assert shown.commands[1].heartbeat.source == 5


def test_what_is_damaged_or_under_a_wrong_key_is_not_shown() -> None:
    shown = LineView(LOOP)
    wrong = dataclasses.replace(BEAT, area=2)

    shown.hears([said(BEAT)._replace(payload=pack(wrong)), said(BEAT)._replace(payload=b"x")], 0)

    assert shown.commands == {}


@pytest.mark.parametrize(
    ("words", "code", "complaint"),
    [
        (["line", "--line", "hefei"], 2, "line hefei is not divided into areas"),
        (["master", "--line-radio", "nowhere"], 2, "nowhere: not an endpoint"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
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
def test_what_is_no_train_is_refused(train: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["out-of-service", train])

    assert f"{train} is no train" in capsys.readouterr().err


class Ticking:
    """A clock that runs as soon as somebody waits."""

    def __init__(self) -> None:
        self.ns = 5 * 10**9

    def now_ns(self) -> int:
        return self.ns

    def epoch_ns(self) -> int:
        return 10**18

    def wait_until(self, deadline_ns: int) -> None:
        self.ns = deadline_ns


class Masters:
    """A radio on which masters of two areas beat and answer removals, each in its own way."""

    connected = True

    def __init__(self, states: dict[int, RemovalState | None]) -> None:
        self.states = states
        self.heard: list[Removal] = []
        self._said: list[T2tMessage] = []

    def receive(self, now_ns: int) -> list[RadioMessage]:
        beats = [dataclasses.replace(BEAT, area=a, stamp_ns=now_ns) for a in self.states]
        told, self._said = [*beats, *self._said], []
        return [said(each) for each in told]

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        removal = unpack(payload)
        assert isinstance(removal, Removal)
        assert key == key_of("loop", removal)
        self.heard.append(removal)
        state = self.states[removal.area]
        if state is not None:
            head = (removal.destination, removal.source, removal.area, removal.term)
            self._said.append(RemovalAnswer(*head, 1, 1, 0, removal.train, state))


def remove(states: dict[int, RemovalState | None], train: int = 4) -> tuple[int, Masters]:
    clock, masters = Ticking(), Masters(states)
    desk = Desk(clock, LineView(LOOP), masters)  # type: ignore[arg-type]
    desk.listen(0.2)
    return desk.remove(train), masters


def test_a_train_is_removed_when_every_master_has_taken_it_off(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, masters = remove({1: RemovalState.GONE, 2: RemovalState.GONE})

    assert code == 0
    assert capsys.readouterr().out == "train 4 is on no roster any more\n"
    first = masters.heard[0]
    assert (first.source, first.destination, first.area, first.term) == (65_100, 3, 1, 7)
    assert {each.area for each in masters.heard} == {1, 2}
    assert first.echo_ns == first.stamp_ns
    assert [each.sequence for each in masters.heard] == sorted(
        {each.sequence for each in masters.heard}
    )


@pytest.mark.parametrize(
    ("states", "words"),
    [
        (
            {1: RemovalState.GONE, 2: RemovalState.AXLES},
            "area 2 keeps train 4: where it may be axles are counted",
        ),
        ({1: RemovalState.HEARD}, "area 1 keeps train 4: it is heard, or was until just now"),
        ({1: RemovalState.COMMITTING}, "area 1 keeps train 4: its arbiters do not keep"),
        ({1: RemovalState.TOO_OLD}, "area 1 keeps train 4: the order came too late"),
        (
            {1: None, 2: RemovalState.HEARD},
            "area 1: train 3 does not answer; area 2 keeps train 4: it is heard",
        ),
        ({}, "nobody is heard on loop"),
    ],
)
def test_who_keeps_a_train_and_why_is_said(
    states: dict[int, RemovalState | None], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _ = remove(states)

    assert code == 3
    complaint = capsys.readouterr().err
    assert complaint.startswith(f"vobc: {words}")
    assert len(complaint.splitlines()) == 1


def test_what_was_answered_before_it_was_asked_does_not_count() -> None:
    clock, masters = Ticking(), Masters({1: RemovalState.GONE})
    desk = Desk(clock, LineView(LOOP), masters)  # type: ignore[arg-type]
    desk.listen(0.2)
    assert desk.remove(4) == 0

    masters.states[1] = None
    desk.listen(0.2)
    assert desk.remove(4) == 3


class Obedient:
    """A radio on which a train and a master are heard, and do as they are told."""

    connected = True

    def __init__(self, *, beats: bool, reports: bool, out_of_service: bool = False) -> None:
        self.beat = BEAT if beats else None
        self.report: TrainReport | None = None
        if reports:
            self.report = dataclasses.replace(REPORT, term=6, out_of_service=out_of_service)
        self.heard: list[LineOrder] = []

    def receive(self, now_ns: int) -> list[RadioMessage]:
        told = [each for each in (self.beat, self.report) if each is not None]
        return [
            said(dataclasses.replace(each, stamp_ns=now_ns, sequence=now_ns // MS)) for each in told
        ]

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        order = unpack(payload)
        assert isinstance(order, LineOrder)
        assert key == key_of("loop", order)
        self.heard.append(order)
        if order.destination == 3 and order.kind is OrderKind.SWITCH_MASTER:
            assert self.beat is not None
            self.beat = dataclasses.replace(self.beat, source=order.train, term=8)
        elif order.destination == order.train:
            out = order.kind is OrderKind.OUT_OF_SERVICE
            if self.report is not None:
                self.report = dataclasses.replace(self.report, out_of_service=out)
            if self.beat is not None and out:
                self.beat = dataclasses.replace(self.beat, source=5, standby=6, term=8)


def at_the_desk(radio: Obedient) -> Desk:
    desk = Desk(Ticking(), LineView(LOOP), radio)  # type: ignore[arg-type]
    desk.listen(0.2)
    return desk


def test_an_order_to_switch_goes_to_whoever_commands_the_area_now() -> None:
    radio = Obedient(beats=True, reports=False)

    assert at_the_desk(radio).switch(1, 5) == 0

    (order,) = radio.heard
    assert (order.source, order.destination, order.area, order.term) == (65_100, 3, 1, 7)
    assert (order.kind, order.train) == (OrderKind.SWITCH_MASTER, 5)


def test_a_train_out_of_service_is_told_itself_besides_its_master() -> None:
    radio = Obedient(beats=True, reports=True)
    assert radio.beat is not None
    radio.beat = dataclasses.replace(radio.beat, source=5, standby=3)

    assert at_the_desk(radio).retire(3, end=False) == 0

    told = [(each.destination, each.area, each.term) for each in radio.heard]
    assert told[:2] == [(5, 1, 7), (3, 1, 7)], "its master first"
    assert {each.kind for each in radio.heard} == {OrderKind.OUT_OF_SERVICE}
    assert radio.heard[0].sequence < radio.heard[1].sequence


def test_a_train_is_taken_back_into_service_where_nobody_commands() -> None:
    """When the last one that could was taken out of service, too."""
    radio = Obedient(beats=False, reports=True, out_of_service=True)

    assert at_the_desk(radio).retire(3, end=True) == 0

    told = {(each.destination, each.area, each.term, each.kind) for each in radio.heard}
    assert told == {(3, 1, 6, OrderKind.IN_SERVICE)}


@pytest.mark.parametrize(("reports", "end"), [(True, False), (False, True)])
def test_where_nobody_commands_no_other_train_is_told(
    reports: bool, end: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    radio = Obedient(beats=False, reports=reports)

    assert at_the_desk(radio).retire(3, end=end) == 3

    assert "nobody is heard on loop" in capsys.readouterr().err
    assert radio.heard == []


def test_who_is_on_a_roster_and_says_nothing_is_shown() -> None:
    places = tuple(RosterPlace(*each) for each in ((1, 9), (2, 9)))
    nothing = (0, 0, DecreeAnswer.NONE, (), (), (), ())
    state = LineState(0, BROADCAST, 0, 0, 2, 1, 0, *nothing, places)
    words = "train 9 is silent, on the roster of area 1 and 2: others wait behind it"

    assert view(state, REPORT).words(0)[-1] == words
    assert "silent" not in "".join(view(dataclasses.replace(state, silent=()), REPORT).words(0))
