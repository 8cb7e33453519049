"""A train in an area that it does not command: what it receives, acknowledges and reports, and
when."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.unit.vobc.train_to_train.test_t2t_desk import (
    AREA,
    BOOT,
    LATER,
    MS,
    OTHER,
    OWN,
    SEED,
    Scene,
    candidate,
    ns,
    reports,
    requests,
    standby,
)
from vobc.train_to_train.area_participant import Chance
from vobc.train_to_train.vocabulary import Role
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    LeaseKind,
    RosterEntry,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    SyncEntry,
    TrainReport,
)

# What it receives.


def test_refused_authorities_are_reported_with_the_reason() -> None:
    scene = Scene()
    scene.step(0)
    first, second = scene.authority(0), scene.authority(0)

    for heard in (second, first):
        assert scene.desk.on_message(heard, ns(10)) == []

    assert scene.desk.refused == ["repeated or out of order"]
    assert scene.desk.member.held is second


def test_a_sync_is_acknowledged_to_the_master_by_its_number() -> None:
    scene = standby()
    sync = StandbySync(OTHER, OWN, AREA, 4, 1, 212, 77, 1, ())

    (ack,) = scene.desk.on_message(sync, ns(10))

    assert ack == SyncAck(OWN, OTHER, AREA, 4, BOOT, 3, ns(10), 212)


def test_a_sync_before_the_very_first_step_is_acknowledged_too() -> None:
    """A restarted train may still be the standby of its former incarnation."""
    (ack,) = Scene().sync(0, SyncEntry(1, 1500.0, 1700.0))

    assert isinstance(ack, SyncAck)


def test_a_sync_or_a_switch_of_an_old_term_is_ignored() -> None:
    scene = standby()
    scene.beats(10, 6, source=LATER, standby=OWN)
    scene.step(10)

    assert scene.sync(20, SyncEntry(1, 1500.0, 1700.0)) == []
    assert scene.switch(20, SwitchKind.PREPARE) == []
    assert scene.switch(20, SwitchKind.RESIGN) == []
    scene.step(20)

    assert scene.role() is Role.STANDBY


def rear_known_m(scene: Scene, at_ms: float, term: int, *, boot: int = 1) -> float:
    """The rear of train 1 in the records of this candidate, with the roster that arbiters
    committed."""
    scene.grants(at_ms, term, roster=(RosterEntry(1, 1200.0, True, boot),))
    scene.step(at_ms)
    assert scene.desk.master is not None
    return scene.desk.master._known.records[1].rear_m


def test_a_standby_takes_over_with_the_synchronised_records() -> None:
    scene = standby()
    scene.sync(10, SyncEntry(1, 1500.0, 1700.0, 1))
    scene.step(160)

    assert rear_known_m(scene, 165, 5) == 1500.0


def test_a_sync_before_the_heartbeat_that_names_the_standby_counts_too() -> None:
    """Both messages leave together and arrive in any order."""
    scene = Scene()
    scene.step(0)
    scene.sync(0, SyncEntry(1, 1500.0, 1700.0, 1))
    scene.beats(0, standby=OWN)
    scene.step(0)
    scene.step(160)

    assert rear_known_m(scene, 165, 5) == 1500.0


def test_a_train_that_is_no_longer_standby_discards_its_records() -> None:
    scene = standby()
    scene.desk.on_message(scene.authority(0, rank=0), ns(0))
    scene.sync(0, SyncEntry(1, 1500.0, 1700.0, 1))
    scene.beats(10, standby=2)
    scene.step(10)
    assert scene.role() is Role.MEMBER
    scene.step(170)

    assert rear_known_m(scene, 175, 5) == 1200.0


def test_a_standby_records_the_reports_of_trains() -> None:
    scene = standby()
    scene.report(10)
    scene.step(160)

    assert rear_known_m(scene, 165, 5) == 1620.0
    assert scene.desk.master is not None
    assert scene.desk.master._known.records[1].report is not None


@pytest.mark.parametrize("boot", [0, 1])
def test_a_standby_learns_no_place_from_a_train_that_is_lost(boot: int) -> None:
    """This also holds when the arbiters do not know its incarnation."""
    scene = standby()
    scene.report(10, localised=False)
    scene.step(160)

    assert rear_known_m(scene, 165, 5, boot=boot) == 1200.0


def test_only_the_standby_records_reports() -> None:
    scene = Scene()
    scene.step(0)
    scene.beats(0)
    scene.report(10)
    scene.step(400)

    assert rear_known_m(scene, 405, 5) == 1200.0


# Planned switches in all trains except the master.


def ready_after(scene: Scene, at_ms: float) -> list[int]:
    """The ready numbers in the reports of this step."""
    return [each.ready_nonce for each in reports(scene.step(at_ms))]


def test_a_train_reports_at_once_and_only_once_that_it_is_ready_for_a_switch() -> None:
    scene = Scene()
    scene.step(0)
    scene.beats(0)
    assert ready_after(scene, 0) == [0]

    assert scene.switch(10, SwitchKind.PREPARE, nonce=2, successor=7) == []
    assert ready_after(scene, 10) == [2]
    scene.switch(20, SwitchKind.PREPARE, nonce=2, successor=7)
    assert ready_after(scene, 20) == []
    scene.switch(30, SwitchKind.PREPARE, nonce=3, successor=7)
    assert ready_after(scene, 30) == [3]


def test_the_standby_named_as_successor_answers_that_it_is_ready() -> None:
    scene = standby()

    (ready,) = scene.switch(10, SwitchKind.PREPARE, nonce=2)

    head = (OWN, OTHER, AREA, 4, BOOT, 3, ns(10))
    assert ready == SwitchStep(*head, SwitchKind.READY, 2, OWN)
    assert scene.switch(20, SwitchKind.PREPARE, nonce=2) != [], "again, as answers may be lost"


def test_a_standby_does_not_answer_when_another_is_named_as_successor() -> None:
    assert standby().switch(10, SwitchKind.PREPARE, successor=7) == []


def test_a_successor_that_is_no_standby_yet_does_not_answer() -> None:
    scene = Scene()
    scene.step(0)

    assert scene.switch(10, SwitchKind.PREPARE) == []


def test_the_successor_applies_as_soon_as_the_switch_is_committed() -> None:
    scene = standby()
    scene.switch(10, SwitchKind.PREPARE, nonce=2)
    assert scene.switch(20, SwitchKind.COMMIT, nonce=2) == []

    said = scene.step(20)

    assert scene.role() is Role.CANDIDATE
    assert [(each.kind, each.term) for each in requests(said)] == [(LeaseKind.ACQUIRE, 5)]


@pytest.mark.parametrize(("nonce", "successor"), [(3, OWN), (2, 7)])
def test_a_commit_of_another_switch_or_for_another_train_has_no_effect(
    nonce: int, successor: int
) -> None:
    scene = standby()
    scene.switch(10, SwitchKind.PREPARE, nonce=2)
    scene.switch(20, SwitchKind.COMMIT, nonce=nonce, successor=successor)
    scene.step(20)

    assert scene.role() is Role.STANDBY


@pytest.mark.parametrize("aborted", [False, True])
@pytest.mark.parametrize("nonce", [0, 1])
def test_a_commit_of_an_unprepared_or_aborted_switch_has_no_effect(
    nonce: int, *, aborted: bool
) -> None:
    scene = Scene()
    scene.step(0)
    scene.beats(0, 1, standby=OWN)
    if aborted:
        scene.switch(10, SwitchKind.PREPARE, term=1)
        scene.switch(10, SwitchKind.ABORT, term=1, successor=NO_TRAIN)
    scene.switch(20, SwitchKind.COMMIT, term=1, nonce=nonce)
    scene.step(20)

    assert scene.role() is Role.STANDBY


def test_an_abort_withdraws_readiness_and_call() -> None:
    scene = standby()
    scene.switch(10, SwitchKind.PREPARE, nonce=2)
    scene.switch(10, SwitchKind.COMMIT, nonce=2)
    assert scene.switch(20, SwitchKind.ABORT, nonce=2, successor=NO_TRAIN) == []

    assert ready_after(scene, 100) == [0]
    assert scene.role() is Role.STANDBY


def test_the_standby_applies_at_once_when_its_master_resigns() -> None:
    scene = standby()
    assert scene.switch(10, SwitchKind.RESIGN, nonce=0) == []

    scene.step(10)

    assert scene.role() is Role.CANDIDATE


def test_a_resignation_calls_only_the_standby() -> None:
    scene = Scene()
    scene.step(0)
    scene.switch(10, SwitchKind.RESIGN, nonce=0)

    scene.step(10)

    assert scene.role() is Role.APPLICANT


def test_it_stays_called_by_a_commit_when_the_master_resigns_too() -> None:
    scene = Scene()
    scene.step(0)
    scene.switch(10, SwitchKind.PREPARE)
    scene.switch(10, SwitchKind.COMMIT)
    scene.switch(10, SwitchKind.RESIGN)

    scene.step(10)

    assert scene.role() is Role.CANDIDATE


def test_a_called_train_that_lost_is_no_longer_called() -> None:
    scene = standby()
    scene.switch(10, SwitchKind.RESIGN, nonce=0)
    scene.step(10)
    scene.grants(110, 5, granted=False)
    scene.step(110)
    assert scene.role() is Role.STANDBY

    scene.step(115)

    assert scene.role() is Role.STANDBY


# Reports.


def test_a_report_holds_the_whole_state_of_the_train() -> None:
    scene = Scene()

    (report,) = scene.step(0, relation=(1, 6))

    assert report == TrainReport(
        *(OWN, BROADCAST, AREA, 0, BOOT, 1, ns(0)),
        localised=True,
        front_min_m=1498.0,
        front_max_m=1502.0,
        rear_min_m=1418.0,
        protected_m=1420.0,
        speed_mps=3.0,
        standstill=False,
        latent_m=1510.0,
        held_end_m=1502.0,
        easy_m=1530.0,
        held_term=0,
        held_sequence=0,
        member=False,
        behind=6,
        comes_from=1,
        axles=16,
        out_of_service=False,
        ready_nonce=0,
        echo_ns=0,
    )


def test_a_report_echoes_the_newest_heartbeat() -> None:
    scene = Scene()
    scene.step(0)
    scene.beats(50)

    (report,) = reports(scene.step(100))

    assert (report.term, report.echo_ns) == (4, 77)


def test_a_members_report_holds_its_authority() -> None:
    scene = Scene()
    scene.step(0)
    held = scene.authority(0)
    scene.desk.on_message(held, ns(100))

    (report,) = reports(scene.step(100))

    assert (report.term, report.held_term, report.held_sequence) == (4, 4, held.sequence)
    assert (report.member, report.held_end_m, report.latent_m) == (True, 1900.0, 1900.0)


@pytest.mark.parametrize(
    ("rests_m", "protected_m"), [(1422.9, 1422.9), (1423.0, 1423.0), (1423.1, 1423.0)]
)
def test_the_protected_rear_is_its_stopping_place_but_at_most_a_jog_ahead(
    rests_m: float, protected_m: float
) -> None:
    (report,) = reports(Scene().step(0, rests_m=rests_m))

    assert report.protected_m == protected_m


def test_a_train_that_never_knew_where_it_is_may_come_anywhere() -> None:
    (report,) = reports(Scene().step(0, localised=False))

    assert (report.localised, report.latent_m) == (False, 1.0e6)


def test_it_reports_every_100_ms_and_at_once_to_acknowledge_a_new_term() -> None:
    scene = Scene()

    def said(at_ms: float, early_ns: int = 0) -> list[int]:
        return [each.term for each in reports(scene.step(at_ms, early_ns=early_ns))]

    assert said(0) == [0]
    assert said(100, early_ns=1) == []
    assert said(100) == [0]
    scene.beats(150)
    assert said(150) == [4]
    assert said(151) == []
    assert said(250, early_ns=1) == []
    assert said(250) == [4]


@pytest.mark.parametrize(("nonce", "prepared_term"), [(2, 4), (4, 3), (4, 5)])
def test_readiness_is_reported_to_the_master_of_its_term_only(
    nonce: int, prepared_term: int
) -> None:
    scene = Scene()
    scene.step(0)
    scene.switch(10, SwitchKind.PREPARE, nonce=nonce, term=prepared_term)
    assert ready_after(scene, 10) == [nonce]

    if prepared_term == 3:
        scene.beats(20, 4)
        assert ready_after(scene, 20) == [0]


# When it is due.


def test_the_standby_is_due_when_its_turn_comes_before_its_next_report() -> None:
    scene = standby()
    scene.step(100)

    assert scene.desk.next_due_ns(ns(100)) == ns(160)
    scene.beats(100, standby=OWN)
    assert scene.desk.next_due_ns(ns(100)) == ns(200)


@pytest.mark.parametrize("told", [{"out_of_service": True}, {"localised": False}])
def test_a_train_that_may_not_apply_is_due_for_its_next_report(told: dict[str, Any]) -> None:
    """Otherwise the train would run steps without a pause and without effect."""
    scene = standby()
    scene.step(160, **told)
    assert scene.role() is Role.STANDBY

    assert scene.desk.next_due_ns(ns(159)) == ns(160)
    assert scene.desk.next_due_ns(ns(160)) == ns(260)


def test_a_losing_candidate_is_not_due_before_it_may_try_again() -> None:
    scene = candidate()
    scene.grants(500, 1, granted=False)
    scene.step(500)

    assert scene.desk.next_due_ns(ns(500)) == ns(580) + Chance(SEED).below(80 * MS)


def test_a_candidate_is_due_when_it_asks_again_and_when_its_attempt_ends() -> None:
    scene = standby()
    scene.step(160)
    scene.switch(200, SwitchKind.PREPARE, successor=7)
    scene.step(200)
    assert scene.desk.next_due_ns(ns(200)) == ns(235)

    scene.step(235)

    assert scene.desk.next_due_ns(ns(235)) == ns(260)


# Random numbers.


def seed_of(state: int) -> int:
    """The seed from which the generator begins with this state."""
    odd, more = 0x9E3779B97F4A7C15, 0x2545F4914F6CDD1D
    return (state - more) * pow(odd, -1, 2**64) % 2**64


@pytest.mark.parametrize("state", [1, 0])
def test_chance_follows_the_published_generator(state: int) -> None:
    """The reference is xorshift64* from state 1, without its 16 lowest bits. State 0 would give
    only zeros."""
    published = (
        0x47E4CE4B896CDD1D,
        0xABCFA6A8E079651D,
        0xB9D10D8FEB731F57,
        0x4DB418A0BB1B019D,
        0xE6199B04D5AA600,
        0xC8674BCB42E3AAD9,
    )
    chance = Chance(seed_of(state))

    assert [chance.below(2**64) for _ in published] == [each >> 16 for each in published]


@given(st.integers(0, 2**40), st.integers(1, 10**9))
def test_chance_stays_below_its_limit(seed: int, limit: int) -> None:
    chance = Chance(seed)

    assert all(0 <= chance.below(limit) < limit for _ in range(10))
