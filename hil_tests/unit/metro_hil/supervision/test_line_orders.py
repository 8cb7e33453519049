"""Commands of the supervision console to masters and trains, and the reported results."""

import dataclasses

import pytest

from firmware_py.ports import RadioMessage
from hil_tests.unit.metro_hil.supervision.test_line_supervision import BEAT, LOOP, MS, REPORT, said
from hil_tests.unit.plant_emulator.wayside.test_line_decrees import Ticking
from metro_hil.supervision.console import SupervisionConsole
from metro_hil.supervision.view import LineView
from zenoh_config.codec import unpack
from zenoh_config.t2t import BROADCAST, LineOrder, OrderKind, T2tMessage, TrainReport
from zenoh_config.t2t_keys import key_of
from zenoh_config.t2t_supervision import (
    DecreeAnswer,
    LineState,
    Removal,
    RemovalAnswer,
    RemovalState,
    TrainDecree,
)


class Masters:
    """A radio with masters of two areas that send heartbeats and answer removals, each
    differently."""

    connected = True

    def __init__(self, states: dict[int, RemovalState | None], *known: int) -> None:
        self.states = states
        self.line = [line_of(*known)] if known else []
        self.heard: list[Removal] = []
        self.goes_after = 0
        """Number of removals after which a train is removed; 0 means never."""
        self._said: list[T2tMessage] = []

    def receive(self, now_ns: int) -> list[RadioMessage]:
        beats = [dataclasses.replace(BEAT, area=a, stamp_ns=now_ns) for a in self.states]
        told, self._said = [*self.line, *beats, *self._said], []
        return [said(each) for each in told]

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        removal = unpack(payload)
        assert isinstance(removal, Removal)
        assert key == key_of("loop", removal)
        self.heard.append(removal)
        if len(self.heard) == self.goes_after:
            self.states[removal.area] = RemovalState.GONE
        state = self.states[removal.area]
        if state is not None:
            head = (removal.destination, removal.source, removal.area, removal.term)
            self._said.append(RemovalAnswer(*head, 1, 1, 0, removal.train, state))


def line_of(*trains: int) -> LineState:
    """The state that a wayside with these known trains sends."""
    known = tuple([TrainDecree(train, False, False, False, 0) for train in trains])
    head = (0, BROADCAST, 0, 0, 2, 1, 0, 0, 0, DecreeAnswer.NONE)
    return LineState(*head, known, (), (), ())


def remove(
    states: dict[int, RemovalState | None], train: int = 4, known: tuple[int, ...] = (4,)
) -> tuple[int, Masters]:
    clock, masters = Ticking(), Masters(states, *known)
    desk = SupervisionConsole(clock, LineView(LOOP), masters)  # type: ignore[arg-type]
    desk.listen(0.2)
    return desk.remove(train), masters


def test_a_train_is_removed_when_every_master_has_removed_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, masters = remove({1: RemovalState.GONE, 2: RemovalState.GONE})

    assert code == 0
    assert capsys.readouterr().out == "train 4 is no longer on any roster\n"
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
            "area 2 keeps train 4: axles are counted where it may be",
        ),
        ({1: RemovalState.HEARD}, "area 1 keeps train 4: it is received, or was until just now"),
        ({1: RemovalState.COMMITTING}, "area 1 keeps train 4: its arbiters have not committed"),
        ({1: RemovalState.TOO_OLD}, "area 1 keeps train 4: the command arrived too late"),
        (
            {1: None, 2: RemovalState.HEARD},
            "area 1: train 3 does not answer; area 2 keeps train 4: it is received",
        ),
        ({}, "no train commands any area of loop"),
    ],
)
def test_the_master_that_keeps_a_train_is_reported_with_its_reason(
    states: dict[int, RemovalState | None], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _ = remove(states)

    assert code == 3
    complaint = capsys.readouterr().err
    assert complaint.startswith(f"vobc: {words}")
    assert len(complaint.splitlines()) == 1


def test_an_answer_before_the_request_does_not_count() -> None:
    clock, masters = Ticking(), Masters({1: RemovalState.GONE}, 4)
    desk = SupervisionConsole(clock, LineView(LOOP), masters)  # type: ignore[arg-type]
    desk.listen(0.2)
    assert desk.remove(4) == 0

    masters.states[1] = None
    desk.listen(0.2)
    assert desk.remove(4) == 3


class Obedient:
    """A radio with a train and a master that send messages and obey."""

    connected = True

    def __init__(
        self, *, beats: bool, reports: bool, out_of_service: bool = False, alone: bool = False
    ) -> None:
        self.alone = alone
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
            if self.beat is not None and out and not self.alone:
                self.beat = dataclasses.replace(self.beat, source=5, standby=6, term=8)


def at_the_desk(radio: Obedient) -> SupervisionConsole:
    desk = SupervisionConsole(Ticking(), LineView(LOOP), radio)  # type: ignore[arg-type]
    desk.listen(0.2)
    return desk


def test_an_order_to_switch_goes_to_the_present_master_of_the_area() -> None:
    radio = Obedient(beats=True, reports=False)

    assert at_the_desk(radio).switch(1, 5) == 0

    (order,) = radio.heard
    assert (order.source, order.destination, order.area, order.term) == (65_100, 3, 1, 7)
    assert (order.kind, order.train) == (OrderKind.SWITCH_MASTER, 5)


def test_a_train_taken_out_of_service_gets_the_command_itself_besides_its_master() -> None:
    radio = Obedient(beats=True, reports=True)
    assert radio.beat is not None
    radio.beat = dataclasses.replace(radio.beat, source=5, standby=3)

    assert at_the_desk(radio).retire(3, end=False) == 0

    told = [(each.destination, each.area, each.term) for each in radio.heard]
    assert told[:2] == [(5, 1, 7), (3, 1, 7)], "its master first"
    assert {each.kind for each in radio.heard} == {OrderKind.OUT_OF_SERVICE}
    assert radio.heard[0].sequence < radio.heard[1].sequence


def test_a_train_is_taken_back_into_service_without_a_master() -> None:
    """This also holds when the last train that could command was taken out of service, too."""
    radio = Obedient(beats=False, reports=True, out_of_service=True)

    assert at_the_desk(radio).retire(3, end=True) == 0

    told = {(each.destination, each.area, each.term, each.kind) for each in radio.heard}
    assert told == {(3, 1, 6, OrderKind.IN_SERVICE)}


@pytest.mark.parametrize(
    ("reports", "end", "words"),
    [
        (True, False, "no train commands any area of loop"),
        (False, True, "nothing is received on loop"),
    ],
)
def test_without_a_master_no_other_train_gets_the_command(
    reports: bool, end: bool, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    radio = Obedient(beats=False, reports=reports)

    assert at_the_desk(radio).retire(3, end=end) == 3

    assert capsys.readouterr().err == f"vobc: {words}\n"
    assert radio.heard == []


def test_silence_is_reported_only_on_a_silent_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert remove({}, known=())[0] == 3

    assert capsys.readouterr().err == "vobc: nothing is received on loop\n"


def test_an_unknown_train_is_not_removed(capsys: pytest.CaptureFixture[str]) -> None:
    code, masters = remove({1: RemovalState.GONE}, 7, known=(3, 4))

    assert code == 3
    assert masters.heard, "a restarted wayside may know fewer trains than the masters"
    assert capsys.readouterr() == ("", "vobc: train 7 is unknown: no program on loop knows it\n")


def test_a_train_known_only_from_a_roster_is_removed(capsys: pytest.CaptureFixture[str]) -> None:
    masters = Masters({1: RemovalState.COMMITTING}, 3)
    desk = SupervisionConsole(Ticking(), LineView(LOOP), masters)  # type: ignore[arg-type]
    desk.listen(0.2)
    masters.goes_after = 3

    assert desk.remove(7) == 0
    assert capsys.readouterr().out == "train 7 is no longer on any roster\n"


def test_an_unknown_train_is_not_taken_out_of_service(
    capsys: pytest.CaptureFixture[str],
) -> None:
    radio = Obedient(beats=True, reports=True)

    assert at_the_desk(radio).retire(9, end=False) == 3
    assert radio.heard == []
    assert capsys.readouterr() == ("", "vobc: train 9 is unknown: no program on loop knows it\n")


@pytest.mark.parametrize(("end", "words"), [(False, "out of service"), (True, "in service")])
def test_a_silent_train_is_not_reported_to_have_obeyed(
    end: bool, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The train is standby by its master's message, and the master has another one afterwards."""
    radio = Obedient(beats=True, reports=False)

    assert at_the_desk(radio).retire(5, end=end) == 3
    assert radio.heard
    assert capsys.readouterr() == ("", f"vobc: train 5 does not report that it is {words}\n")


def test_the_last_commanding_train_can_be_taken_out_of_service(
    capsys: pytest.CaptureFixture[str],
) -> None:
    radio = Obedient(beats=True, reports=True, alone=True)

    assert at_the_desk(radio).retire(3, end=False) == 0
    assert capsys.readouterr().out == (
        "train 3 is out of service; until another train takes over, it still commands area 1\n"
    )


def test_a_master_that_gave_up_its_area_is_not_reported_as_master(
    capsys: pytest.CaptureFixture[str],
) -> None:
    radio = Obedient(beats=True, reports=True, alone=True)
    desk = at_the_desk(radio)
    radio.beat = None

    assert desk.retire(3, end=False) == 0
    assert capsys.readouterr().out == "train 3 commands no area and is standby for none\n"


def test_an_area_without_a_master_cannot_be_switched(
    capsys: pytest.CaptureFixture[str],
) -> None:
    radio = Obedient(beats=True, reports=True)

    assert at_the_desk(radio).switch(2, 3) == 3
    assert radio.heard == []
    assert capsys.readouterr().err == "vobc: no train commands area 2\n"
