"""Commands of supervision are stored, answered, sent to trains and track, and withdrawn."""

from dataclasses import replace
from functools import partial

import pytest

from firmware_py.ports import RadioMessage
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import load_areas
from firmware_py.trackdb.version import database_version
from plant_emulator.wayside.line_centre import LineCentre
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, CentreMemory, LeaseMemory
from zenoh_config import codec, keys
from zenoh_config.codec import unpack
from zenoh_config.messages import SpeedRestriction, TrainOrders, TrainStatus
from zenoh_config.t2t import BROADCAST, Heartbeat, Phase, RosterEntry, T2tMessage, TrackStatus
from zenoh_config.t2t_keys import key_of
from zenoh_config.t2t_supervision import Decree, DecreeAnswer, DecreeKind, LeaseReason, LineState
from zenoh_config.timers import TIMERS_A

pack = partial(codec.pack, database=database_version(load_line("loop")))


MS = 1_000_000
STATUS = TrainStatus(
    *(3, 1, 1, 0, 4, 1, 0),
    localised=True,
    standstill=False,
    front_m=1000.0,
    doors_locked=True,
    open_left=False,
    open_right=False,
    passenger_alarm=False,
    fire=False,
    obstacle=False,
    alarm_raised=False,
)


class Site:
    """A wayside with a centre, whose disk may refuse."""

    def __init__(self, memory: CentreMemory | None = None) -> None:
        self.stored = memory or CentreMemory()
        self.disk_works = True
        self.now_ns = 10_000 * MS
        self.sequence = 0
        self.state: LineState | None = None
        self.tracks: list[TrackStatus] = []
        self.orders: list[TrainOrders] = []
        line = load_areas("loop")
        disks = Disks({}, {}, lambda a, m: True, lambda n, m: True, self._store)
        centre = LineCentre(load_line("loop"), boot=5, memory=memory, first_sequence=40)
        self.wayside = LineWayside(TIMERS_A, line, disks, boot=5, start_ns=0, centre=centre)

    def _store(self, memory: CentreMemory) -> bool:
        if self.disk_works:
            self.stored = memory
        return self.disk_works

    def step(self, *messages: RadioMessage, ms: int = 10) -> None:
        self.now_ns += ms * MS
        for _, payload in self.wayside.step(self.now_ns, messages, WaysideTruth({})):
            heard = unpack(payload)
            if isinstance(heard, LineState):
                self.state = heard
            elif isinstance(heard, TrackStatus):
                self.tracks.append(heard)
            elif isinstance(heard, TrainOrders):
                self.orders.append(heard)

    def tells(self, front_m: float = 1000.0) -> None:
        """The train sends its status."""
        self.sequence += 1
        status = replace(STATUS, sequence=self.sequence, stamp_ns=self.now_ns, front_m=front_m)
        self.step(RadioMessage(0, keys.status("loop", 3), pack(status)))

    def decree(
        self, kind: DecreeKind, train: int = 3, *, source: int = 65_100, late_ms: int = 0
    ) -> DecreeAnswer:
        return self.says(kind, train, (0.0, 0.0, 0.0), source=source, late_ms=late_ms)

    def says(
        self,
        kind: DecreeKind,
        train: int,
        stretch: tuple[float, float, float],
        *,
        source: int = 65_100,
        late_ms: int = 0,
    ) -> DecreeAnswer:
        self.sequence += 1
        echo_ns = self.now_ns - late_ms * MS
        head = (source, 0, 0, 0, 9, self.sequence, 0, echo_ns)
        decree = Decree(*head, kind, train, *stretch)
        self.step(said(decree))
        assert self.state is not None
        if self.state.answered != self.sequence:
            return DecreeAnswer.NONE
        return self.state.answer


def said(message: T2tMessage) -> RadioMessage:
    return RadioMessage(0, key_of("loop", message), pack(message))


def known() -> Site:
    site = Site()
    site.tells()
    return site


def test_a_train_is_held_until_released_and_every_answer_to_it_shows_this() -> None:
    site = known()
    assert not site.orders[-1].hold

    assert site.decree(DecreeKind.HOLD) is DecreeAnswer.DONE
    site.tells()
    held = site.orders[-1]
    assert site.decree(DecreeKind.LET_GO) is DecreeAnswer.DONE
    site.tells()

    assert held.hold
    assert not site.orders[-1].hold
    assert [each.sequence for each in site.orders] == [41, 42, 43]


@pytest.mark.parametrize(
    ("wanted", "back", "another"),
    [
        (DecreeKind.HOLD, DecreeKind.LET_GO, DecreeKind.SKIP),
        (DecreeKind.SKIP, DecreeKind.CALL, DecreeKind.HOLD),
    ],
)
def test_a_command_that_was_not_given_cannot_be_withdrawn(
    wanted: DecreeKind, back: DecreeKind, another: DecreeKind
) -> None:
    site = known()
    assert site.decree(back) is DecreeAnswer.NOT_THERE

    assert site.decree(another) is DecreeAnswer.DONE
    assert site.decree(back) is DecreeAnswer.NOT_THERE

    assert site.decree(wanted) is DecreeAnswer.DONE
    assert site.decree(back) is DecreeAnswer.DONE
    assert site.decree(back) is DecreeAnswer.NOT_THERE


def test_only_one_station_is_skipped() -> None:
    site = known()
    assert site.decree(DecreeKind.SKIP) is DecreeAnswer.DONE
    site.tells(1599.0)
    before = site.orders[-1].skip_next
    site.tells(1630.0)
    site.tells(1640.0)

    assert before
    assert not site.orders[-1].skip_next
    assert site.stored.trains[0].skip is False


def test_an_emergency_brake_stays_until_it_is_released_once() -> None:
    site = known()
    site.decree(DecreeKind.EMERGENCY)
    site.tells()
    on = site.orders[-1]
    site.decree(DecreeKind.RELEASE)
    site.tells()
    off = site.orders[-1]

    assert (on.emergency, on.releases) == (True, 0)
    assert (off.emergency, off.releases) == (False, 1)


def test_a_command_survives_a_restart() -> None:
    site = known()
    site.decree(DecreeKind.EMERGENCY)
    site.says(DecreeKind.CLOSE, 0, (2000.0, 2100.0, 0.0))

    again = Site(site.stored)
    again.tells()

    assert again.orders[-1].emergency
    assert again.wayside.track.closed == (SpeedRestriction(2000.0, 2100.0, 1.0),)


def test_a_command_that_cannot_be_stored_does_not_take_effect() -> None:
    site = known()
    site.disk_works = False

    answer = site.says(DecreeKind.CLOSE, 0, (2000.0, 2100.0, 0.0))

    assert answer is DecreeAnswer.NOT_STORED
    assert site.wayside.track.closed == ()


def test_masters_receive_restrictions_and_closed_stretches() -> None:
    site = known()
    assert site.says(DecreeKind.RESTRICT, 0, (1000.0, 1200.0, 5.0)) is DecreeAnswer.DONE
    assert site.says(DecreeKind.CLOSE, 0, (2000.0, 2100.0, 0.0)) is DecreeAnswer.DONE

    site.step(said(Heartbeat(3, BROADCAST, 1, 7, 1, 1, 0, Phase.ISSUING, 0, 1)))

    assert site.tracks[-1].restrictions == (SpeedRestriction(1000.0, 1200.0, 5.0),)
    assert [(each.start_m, each.end_m) for each in site.tracks[-1].closed] == [(2000.0, 2100.0)]


@pytest.mark.parametrize("limit_mps", [0.0, 5.0])
def test_a_restriction_is_withdrawn_by_its_stretch_whatever_its_limit(limit_mps: float) -> None:
    site = known()
    site.says(DecreeKind.RESTRICT, 0, (1000.0, 1200.0, 5.0))

    assert site.says(DecreeKind.LIFT, 0, (1000.0, 1100.0, limit_mps)) is DecreeAnswer.NOT_THERE
    assert site.says(DecreeKind.LIFT, 0, (1200.0, 1000.0, limit_mps)) is DecreeAnswer.NO_STRETCH
    assert site.says(DecreeKind.LIFT, 0, (1000.0, 1200.0, limit_mps)) is DecreeAnswer.DONE
    assert site.stored.restrictions == ()
    assert site.says(DecreeKind.LIFT, 0, (1000.0, 1200.0, limit_mps)) is DecreeAnswer.NOT_THERE


@pytest.mark.parametrize(
    ("stretch", "answer"),
    [
        ((1200.0, 1000.0, 5.0), DecreeAnswer.NO_STRETCH),
        ((7600.0, 9000.0, 5.0), DecreeAnswer.NO_STRETCH),
        ((1000.0, 1200.0, -1.0), DecreeAnswer.NO_STRETCH),
        ((1000.0, 1200.0, 0.0), DecreeAnswer.NO_STRETCH),
    ],
)
def test_an_invalid_stretch_is_refused(
    stretch: tuple[float, float, float], answer: DecreeAnswer
) -> None:
    assert known().says(DecreeKind.RESTRICT, 0, stretch) is answer


def test_the_number_of_restrictions_is_limited_to_one_message() -> None:
    site = known()
    for n in range(8):
        assert site.says(DecreeKind.CLOSE, 0, (n * 10.0, n * 10.0 + 5.0, 0.0)) is DecreeAnswer.DONE

    assert site.says(DecreeKind.CLOSE, 0, (200.0, 210.0, 0.0)) is DecreeAnswer.FULL


def test_a_train_that_never_reported_cannot_be_held() -> None:
    assert known().decree(DecreeKind.HOLD, 4) is DecreeAnswer.UNKNOWN_TRAIN


def test_a_delayed_command_is_refused() -> None:
    assert known().decree(DecreeKind.HOLD, late_ms=4000) is DecreeAnswer.TOO_OLD


def test_a_command_from_another_sender_than_supervision_has_no_effect() -> None:
    site = known()

    assert site.decree(DecreeKind.HOLD, source=7) is DecreeAnswer.NONE
    assert site.stored == CentreMemory()


def test_a_repeated_command_is_executed_once() -> None:
    site = known()
    head = (65_100, 0, 0, 0, 9, 77, 0, site.now_ns)
    release = Decree(*head, DecreeKind.RELEASE, 3, 0.0, 0.0, 0.0)
    for _ in range(3):
        site.step(said(release))

    assert site.stored.trains[0].releases == 1


def keeps(version: tuple[int, int], *trains: int, area: int = 1) -> LeaseMemory:
    roster = tuple(RosterEntry(train, 100.0, True, 1) for train in trains)
    return LeaseMemory(area, 5, 4, 0, *version, roster)


def silent(site: Site, after_ms: int = 1001) -> tuple[tuple[int, int], ...]:
    """The trains that the centre reports as silent, this much later."""
    site.now_ns += after_ms * MS
    site.step()
    assert site.state is not None
    return site.state.silent


def test_it_reports_the_silent_trains_of_the_newest_committed_roster() -> None:
    site = known()
    centre = site.wayside.centre
    assert centre is not None
    for kept in (keeps((5, 2), 4, 5), keeps((5, 1), 9), keeps((4, 7), 8), keeps((5, 2), 4, 5)):
        centre.granted(None, kept, site.now_ns)
    centre.granted(None, keeps((1, 1), 2, area=2), site.now_ns)
    assert silent(site, 990) == ()
    assert silent(site) == ((1, 4), (1, 5), (2, 2))

    centre.granted(None, keeps((5, 3), 5), site.now_ns)
    assert silent(site) == ((1, 5), (2, 2))


def test_a_train_that_sends_its_status_is_not_silent_for_a_second() -> None:
    site = known()
    assert site.wayside.centre is not None
    site.wayside.centre.granted(None, keeps((5, 2), 3), site.now_ns)
    assert silent(site) == ((1, 3),)
    site.tells(1500.0)
    assert silent(site, 900) == ()
    assert silent(site, 600) == ((1, 3),)


def test_entries_beyond_one_message_are_left_out() -> None:
    site = known()
    centre = site.wayside.centre
    assert centre is not None
    for area in range(1, 101):
        centre.granted(None, keeps((5, 1), *range(1, 101), area=area), site.now_ns)

    assert len(silent(site)) == 64
    assert site.state is not None
    assert len(site.state.leases) == 56
    assert isinstance(unpack(pack(site.state)), LineState)


@pytest.mark.parametrize(
    ("before", "reason"),
    [
        (None, LeaseReason.FIRST),
        (LeaseMemory(1, 3, 2, 4), LeaseReason.HANDED_OVER),
        (LeaseMemory(1, 3, 2, 0), LeaseReason.RAN_OUT),
        (LeaseMemory(1, 3, 4, 0), LeaseReason.AGAIN),
    ],
)
def test_it_reports_why_a_train_commands(before: LeaseMemory | None, reason: LeaseReason) -> None:
    site = known()
    assert site.wayside.centre is not None
    site.wayside.centre.granted(before, LeaseMemory(1, 5, 4), site.now_ns)
    site.step()

    assert site.state is not None
    (note,) = site.state.leases
    assert (note.train, note.granted_term, note.reason) == (4, 5, reason)
    assert note.before == (0 if before is None else before.holder)
    assert ArbiterMemory().areas == ()
