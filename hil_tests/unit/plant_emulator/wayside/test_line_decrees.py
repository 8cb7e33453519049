"""The messages of the supervision commands, checked against the real centre."""

from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import pytest

from can_dbc.vobc import Cause, Supervision
from firmware_py.ports import RadioMessage
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from firmware_py.trackdb.version import database_version
from hil_tests.unit.metro_hil.supervision.test_line_supervision import REPORT
from hil_tests.unit.plant_emulator.wayside.test_line_centre import STATUS
from metro_hil.supervision import command
from metro_hil.supervision.command import main
from metro_hil.supervision.console import SupervisionConsole
from metro_hil.supervision.nearby_trains import is_near
from metro_hil.supervision.view import LineView
from plant_emulator.wayside.line_centre import LineCentre
from zenoh_config import codec, keys
from zenoh_config.codec import unpack
from zenoh_config.messages import SpeedRestriction, TrainStatus
from zenoh_config.t2t import T2tMessage
from zenoh_config.t2t_keys import key_of
from zenoh_config.t2t_supervision import DecreeKind

pack = partial(codec.pack, database=database_version(load_line("loop")))


LOOP = load_areas("loop")
MS = 1_000_000


class Ticking:
    """A clock that runs whenever a caller waits."""

    def __init__(self) -> None:
        self.ns = 5 * 10**9

    def now_ns(self) -> int:
        return self.ns

    def epoch_ns(self) -> int:
        return 10**18 + self.ns

    def wait_until(self, deadline_ns: int) -> None:
        self.ns = deadline_ns


class Line:
    """A radio with the centre of a line and a train that obeys it."""

    connected = True

    def __init__(self, status: TrainStatus = STATUS) -> None:
        self.clock = Ticking()
        self.status = status
        self.speaks = True
        self.reports: list[T2tMessage] = []
        self.decreed: list[T2tMessage] = []
        self._centre = LineCentre(load_line("loop"), boot=5)
        self._heard: list[T2tMessage] = []

    def receive(self, now_ns: int) -> list[RadioMessage]:
        status = replace(self.status, sequence=now_ns // MS, stamp_ns=now_ns)
        told = RadioMessage(0, keys.status("loop", 3), pack(status))
        self._centre.answer(told, status, now_ns)
        heard, self._heard = self._heard, []
        states = self._centre.step(now_ns, heard).out
        for each in self._centre.memory.trains:
            if each.emergency:
                self.status = replace(status, supervision=Supervision.EMERGENCY)
            elif each.releases:
                self.status = replace(status, supervision=Supervision.NO_AUTHORITY, cause=0)
        told_now = [told] if self.speaks else []
        return [*told_now, *[said(replace(m, stamp_ns=now_ns)) for m in (*states, *self.reports)]]

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        decree = unpack(payload)
        assert isinstance(decree, T2tMessage)
        assert key == key_of("loop", decree)
        self._heard.append(decree)
        self.decreed.append(decree)


def said(message: T2tMessage) -> RadioMessage:
    return RadioMessage(0, key_of("loop", message), pack(message))


def at_the_desk(line: Line) -> SupervisionConsole:
    desk = SupervisionConsole(line.clock, LineView(LOOP), line)  # type: ignore[arg-type]
    desk.listen(0.7)
    return desk


def test_a_restriction_is_withdrawn_without_its_limit() -> None:
    line = Line()
    desk = at_the_desk(line)
    assert desk.decree(DecreeKind.RESTRICT, start_m=3500.0, end_m=3700.0, limit_mps=5.0) == 0

    assert at_the_desk(line).decree(DecreeKind.LIFT, start_m=3500.0, end_m=3700.0) == 0


REACH = "no such stretch on loop, which reaches from -120 to 7700 m"


@pytest.mark.parametrize(
    ("kind", "stretch", "words"),
    [
        (
            DecreeKind.RESTRICT,
            (5000.0, 99_999.0, 5.0),
            f"at most 18 km/h from 5000 to 99999 m: {REACH}",
        ),
        (DecreeKind.CLOSE, (5000.0, 99_999.0, 0.0), f"from 5000 to 99999 m: {REACH}"),
        (
            DecreeKind.LIFT,
            (5000.0, 5200.0, 0.0),
            "from 5000 to 5200 m: no such command is in force",
        ),
    ],
)
def test_a_refusal_names_the_requested_stretch(
    kind: DecreeKind,
    stretch: tuple[float, float, float],
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    start_m, end_m, limit_mps = stretch

    code = at_the_desk(Line()).decree(kind, start_m=start_m, end_m=end_m, limit_mps=limit_mps)

    assert code == 3
    assert capsys.readouterr().err == f"vobc: {words}\n"


@pytest.mark.parametrize(
    ("train", "front_m", "words"),
    [
        (4, 1000.0, "train 4: no such train sends its status to the wayside"),
        (3, 7690.0, "train 3: no station is ahead of the train, or the train is not localised"),
    ],
)
def test_a_refusal_names_the_requested_train(
    train: int, front_m: float, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = Line(replace(STATUS, front_m=front_m))

    assert at_the_desk(line).decree(DecreeKind.SKIP, train=train) == 3

    assert capsys.readouterr().err == f"vobc: {words}\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("restrict 5200 5000 --limit 20", "restrict: START 5200 END 5000: the stretch must end"),
        ("restrict 5200 5000 --end", "restrict: START 5200 END 5000: the stretch must end"),
        ("close 7000 7000", "close: START 7000 END 7000: the stretch must end beyond its start"),
        ("restrict 5000 5200", "restrict: --limit KMH is missing; --end takes a restriction back"),
    ],
)
def test_an_impossible_stretch_is_refused_before_a_session_is_opened(
    words: str, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """No centre is running: the command fails before it opens a session."""
    assert main([*words.split(), "--line-radio", "tcp/127.0.0.1:1"]) == 2

    assert capsys.readouterr().err.startswith(f"vobc: {complaint}")


@pytest.mark.parametrize("limit", ["0", "-5", "nan", "x"])
def test_an_impossible_limit_is_refused_before_a_session_is_opened(
    limit: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["restrict", "5000", "5200", "--limit", limit])

    assert ended.value.code == 2
    assert f"{limit} is not a number in 1.." in capsys.readouterr().err


def test_an_emergency_brake_without_a_command_is_not_released(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = Line()

    assert at_the_desk(line).decree(DecreeKind.RELEASE, train=3) == 3

    assert line.decreed == []
    told = "vobc: train 3: no emergency brake is commanded, and none is applied\n"
    assert capsys.readouterr() == ("", told)


def test_the_release_of_a_silent_train_never_claims_that_it_does_not_brake(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = Line()
    desk = at_the_desk(line)
    desk.listen(0.6)
    line.speaks = False
    later = SupervisionConsole(line.clock, LineView(LOOP), line)  # type: ignore[arg-type]
    later.listen(0.7)

    assert later.decree(DecreeKind.RELEASE, train=3) == 3
    told = "vobc: train 3: no emergency brake is commanded, and the train is not received\n"
    assert capsys.readouterr().err == told


def test_a_commanded_emergency_brake_is_released(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = Line()
    assert at_the_desk(line).decree(DecreeKind.EMERGENCY, train=3) == 0
    assert "train 3: emergency brake applied" in capsys.readouterr().out

    assert at_the_desk(line).decree(DecreeKind.RELEASE, train=3) == 0
    assert "train 3: emergency brake released" in capsys.readouterr().out


def test_a_train_that_brakes_by_itself_is_reset() -> None:
    line = Line(replace(STATUS, supervision=Supervision.EMERGENCY, cause=Cause.OVERSHOT))

    assert at_the_desk(line).decree(DecreeKind.RELEASE, train=3) == 0


def test_the_release_of_an_unknown_train_is_left_to_the_wayside(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert at_the_desk(Line()).decree(DecreeKind.RELEASE, train=5) == 3
    told = "vobc: train 5: no such train sends its status to the wayside\n"
    assert capsys.readouterr().err == told


def test_ctrl_c_ends_watching_with_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "load_areas", Mock(side_effect=KeyboardInterrupt))

    assert main(["line", "--watch"]) == 0


@pytest.mark.parametrize("words", ["line", "hold T3", "remove-train T3"])
def test_ctrl_c_ends_every_other_command_without_success(
    words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "load_areas", Mock(side_effect=KeyboardInterrupt))

    with pytest.raises(KeyboardInterrupt):
        main(words.split())


RUNNING = replace(
    REPORT,
    front_min_m=3431.0,
    front_max_m=3433.0,
    rear_min_m=3360.0,
    protected_m=3360.0,
    latent_m=4200.0,
    held_end_m=4200.0,
    easy_m=3700.0,
    speed_mps=67.0 / 3.6,
)
"""A user restricted the track ahead of this train, and it applied the emergency brake."""


@pytest.mark.parametrize(
    ("stretch", "near"),
    [
        ((3500.0, 3700.0, 20.0 / 3.6), True),
        ((3750.0, 3800.0, 20.0 / 3.6), True),
        ((3752.0, 3800.0, 20.0 / 3.6), False),
        ((3752.0, 3800.0, 0.0), True),
        ((3778.0, 3800.0, 0.0), False),
        ((3400.0, 3700.0, 60.0 / 3.6), True),
        ((3400.0, 3700.0, 67.0 / 3.6), False),
        ((3000.0, 3361.0, 20.0 / 3.6), True),
        ((3000.0, 3360.0, 20.0 / 3.6), False),
    ],
)
def test_a_train_is_near_if_it_cannot_slow_down_in_time(
    stretch: tuple[float, float, float], near: bool
) -> None:
    """The limit is a deceleration of 0.6 m/s² after 3 s."""
    assert is_near(RUNNING, SpeedRestriction(*stretch)) is near


def test_a_train_that_stands_or_does_not_know_where_it_is_is_not_near() -> None:
    closed = SpeedRestriction(3400.0, 3700.0, 0.0)

    assert not is_near(replace(RUNNING, standstill=True), closed)
    assert not is_near(replace(RUNNING, localised=False), closed)


@pytest.mark.parametrize(
    ("kind", "start_m", "words"),
    [
        (DecreeKind.RESTRICT, 3500.0, "67 m before it with 67 km/h"),
        (DecreeKind.CLOSE, 3400.0, "in it with 67 km/h"),
        (DecreeKind.RESTRICT, 3900.0, None),
    ],
)
def test_a_command_too_close_ahead_of_a_train_gives_a_warning(
    kind: DecreeKind, start_m: float, words: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    line = Line()
    desk = at_the_desk(line)
    line.reports = [RUNNING]
    limit_mps = 20.0 / 3.6 if kind is DecreeKind.RESTRICT else 0.0

    assert desk.decree(kind, start_m=start_m, end_m=4000.0, limit_mps=limit_mps) == 0

    warning = (
        "" if words is None else f"vobc: train 3 may apply its emergency brake: it is {words}\n"
    )
    assert capsys.readouterr().err == warning


def test_a_withdrawn_or_refused_command_gives_no_warning(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = Line()
    at_the_desk(line).decree(DecreeKind.CLOSE, start_m=3500.0, end_m=3700.0)
    line.reports = [RUNNING]

    assert at_the_desk(line).decree(DecreeKind.OPEN, start_m=3500.0, end_m=3700.0) == 0
    assert at_the_desk(line).decree(DecreeKind.CLOSE, start_m=3500.0, end_m=99_999.0) == 3
    assert "emergency" not in capsys.readouterr().err


def test_a_train_with_an_old_report_gives_no_warning(
    capsys: pytest.CaptureFixture[str],
) -> None:
    line = Line()
    line.reports = [RUNNING]
    desk = at_the_desk(line)
    line.reports = []
    desk.listen(1.0)

    assert desk.decree(DecreeKind.CLOSE, start_m=3500.0, end_m=3700.0) == 0
    assert capsys.readouterr().err == ""
