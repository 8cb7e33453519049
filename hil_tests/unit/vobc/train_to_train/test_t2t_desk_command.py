"""A train that commands one area: how its command begins and ends, and what it obeys itself."""

from typing import Any

import pytest

from hil_tests.unit.vobc.train_to_train.test_t2t_desk import (
    ARBITER,
    AREA,
    BOOT,
    LATER,
    OTHER,
    OWN,
    THREE,
    Puppet,
    Scene,
    candidate,
    ns,
    reports,
    requests,
)
from vobc.train_to_train.lease import LeaseState
from vobc.train_to_train.vocabulary import AreaMemory, Role
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    Admission,
    AdmissionState,
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    LeaseKind,
    LeaseRequest,
    ObjectClaim,
    Phase,
    RosterCommit,
    RosterEntry,
    SwitchKind,
    SwitchStep,
    SyncEntry,
    T2tMessage,
)


def fencing(**told: Any) -> tuple[Scene, list[T2tMessage]]:
    """A scene with the lease requested at 400 ms and granted at 405 ms, and the messages that it
    then sends."""
    scene = candidate(**told)
    scene.grants(405, 1)
    said = scene.step(405)
    assert scene.role() is Role.FENCING
    return scene, said


def master(**told: Any) -> Scene:
    """A scene whose train is master; its roster is committed at 410 ms."""
    scene, _ = fencing(**told)
    scene.acks(410)
    scene.step(410)
    assert scene.role() is Role.MASTER
    return scene


def played(**told: Any) -> tuple[Scene, Puppet]:
    """A scene whose master, from 410 ms on, sends what the test sets."""
    scene = master()
    return scene, scene.plays(Puppet(**told))


def own_head(scene: Scene, to: int = BROADCAST) -> tuple[int, int, int, int, int, int, int]:
    return (OWN, to, AREA, scene.desk.lease.term, BOOT, 1000, ns(420))


# How a command begins.


def test_a_train_with_a_new_lease_sends_under_its_term_in_the_same_step() -> None:
    scene, said = fencing(memory=AreaMemory(AREA, seen_term=0, owner=0, tried_term=0))

    (report,) = reports(said)
    (beat,) = [each for each in said if isinstance(each, Heartbeat)]
    (commit,) = [each for each in said if isinstance(each, RosterCommit)]
    assert (report.term, report.stamp_ns) == (1, ns(405)), "though it reported 5 ms ago"
    assert report.echo_ns == ns(405), "it is on its way to itself for no time"
    assert (beat.term, beat.phase) == (1, Phase.FENCING)
    assert (commit.term, commit.destination) == (1, ARBITER)
    assert scene.desk.member.memory == AreaMemory(AREA, seen_term=1, owner=OWN, tried_term=1)
    assert requests(said) == []


def test_it_is_master_once_its_roster_is_committed() -> None:
    scene, _ = fencing()
    scene.step(409)
    assert scene.role() is Role.FENCING
    began = scene.desk.master

    scene.acks(410)
    said = scene.step(410)

    assert scene.role() is Role.MASTER
    assert scene.desk.master is began
    assert requests(said) == []


def test_a_master_goes_on_beating_and_reporting() -> None:
    scene = master()

    said = scene.step(505)

    assert [each.phase for each in said if isinstance(each, Heartbeat)] == [Phase.ISSUING]
    assert len(reports(said)) == 1
    assert scene.role() is Role.MASTER


def test_a_later_masters_message_to_its_standby_does_not_change_this_masters_records() -> None:
    """The message carries the later term and applies only to it."""
    scene = candidate()
    scene.grants(405, 1, roster=(RosterEntry(1, 1200.0, True, 1),))
    scene.step(405)
    scene.sync(406, SyncEntry(1, 1500.0, 1700.0, 1), term=7)

    assert scene.desk.master is not None
    assert scene.desk.master._known.records[1].rear_m == 1200.0


def test_its_master_receives_each_of_its_own_reports_once() -> None:
    scene, puppet = played()
    assert puppet.heard == []

    (report,) = reports(scene.step(505))
    assert puppet.heard == [report]
    assert reports(scene.step(510)) == []

    assert puppet.heard == [report]


def test_its_master_receives_messages_of_members_objects_and_successors() -> None:
    scene, puppet = played()
    report = scene.report(415, term=1)
    scene.acks(416, version=7)
    scene.switch(417, SwitchKind.READY, source=2, successor=2, term=1)

    kinds = [type(each).__name__ for each in puppet.heard]

    assert puppet.heard[0] is report
    assert kinds == ["TrainReport", "RosterAck", "SwitchStep"]


def test_its_master_ignores_messages_of_masters_and_arbiters_to_trains() -> None:
    scene, puppet = played()
    scene.beats(415)
    scene.desk.on_message(scene.authority(415), ns(415))
    scene.grants(415, 1, nonce=9)
    scene.sync(415)
    scene.switch(415, SwitchKind.PREPARE)

    assert puppet.heard == []


# The lease.


def test_it_asks_again_for_the_lease_every_75_ms_and_not_before() -> None:
    scene, _ = played()
    assert requests(scene.step(475, early_ns=1)) == []

    (renewal,) = requests(scene.step(475))

    head = (OWN, ARBITER, AREA, 1, BOOT, renewal.sequence, ns(475))
    assert renewal == LeaseRequest(*head, LeaseKind.RENEW, 2, NO_TRAIN, 0)
    assert requests(scene.step(550, early_ns=1)) == []
    assert len(requests(scene.step(550))) == 1


@pytest.mark.parametrize(("before", "after"), [(NO_TRAIN, 2), (2, NO_TRAIN), (2, 1)])
def test_arbiters_are_informed_at_once_who_may_acquire_instead(before: int, after: int) -> None:
    scene, puppet = played(names=[before, before, after, after])
    scene.step(411)
    assert requests(scene.step(412)) == []

    said = requests(scene.step(413))

    assert [(each.kind, each.successor) for each in said] == [(LeaseKind.RENEW, after)]
    assert requests(scene.step(414)) == []
    assert puppet.names == []


def test_a_master_is_due_when_it_has_to_renew() -> None:
    scene, _ = played()
    scene.report(450)

    assert scene.desk.next_due_ns(ns(450)) == ns(475)


def test_a_master_is_due_when_its_command_is_due() -> None:
    scene, _ = played(due_ns=ns(440))

    assert scene.desk.next_due_ns(ns(410)) == ns(440)


def test_a_master_is_due_when_it_would_be_deaf() -> None:
    scene, _ = played()
    for at_ms in (475, 505):
        scene.step(at_ms)
    scene.desk.lease.until_ns = ns(9000)
    scene.step(550)
    scene.step(565)

    assert scene.desk.next_due_ns(ns(565)) == ns(410 + 160)


def test_a_master_is_due_when_its_lease_runs_out() -> None:
    scene, _ = played()
    for at_ms in (475, 550, 625, 650):
        scene.step(at_ms)
    scene.report(660, term=1)

    assert scene.desk.next_due_ns(ns(660)) == ns(400 + 300 * 0.998)


# Own messages that a master obeys.


def test_a_master_obeys_the_authority_that_it_gives_itself_and_does_not_send_it() -> None:
    scene, puppet = played()
    own = AreaAuthority(*own_head(scene, OWN), BOOT, ns(410), 2900.0, 1400.0, NO_TRAIN, 1, ())
    others = AreaAuthority(*own_head(scene, 1), 1, 77, 2000.0, 1400.0, NO_TRAIN, 1, ())
    puppet.says = [own, others]

    said = scene.step(420)

    assert said == [others]
    assert scene.desk.member.held is own


def test_a_master_obeys_its_own_heartbeat_and_sends_it() -> None:
    """A standby of the former master loses that role once it has commanded itself."""
    scene, puppet = played()
    scene.desk.member.standby = OWN
    beat = Heartbeat(*own_head(scene), Phase.ISSUING, 2, 1)
    puppet.says = [beat]

    assert scene.step(420) == [beat]

    assert scene.desk.member.standby == 2
    scene.step(421)
    assert scene.role() is Role.MASTER


def test_a_master_that_prepares_a_switch_is_ready_itself() -> None:
    scene, puppet = played()
    step = SwitchStep(*own_head(scene), SwitchKind.PREPARE, 4, 2)
    puppet.says = [step]
    assert scene.step(420) == [step]
    assert scene.desk.next_due_ns(ns(420)) == ns(420)

    (report,) = reports(scene.step(421))
    assert report.ready_nonce == 4
    puppet.says = [SwitchStep(*own_head(scene), SwitchKind.ABORT, 4, NO_TRAIN)]
    scene.step(422)

    assert [each.ready_nonce for each in reports(scene.step(521))] == [0]


def test_a_master_never_names_itself_as_successor() -> None:
    """This also holds for a switch that it prepared."""
    scene, puppet = played(has_others=False)
    puppet.says = [SwitchStep(*own_head(scene), SwitchKind.PREPARE, 4, OWN)]
    scene.step(420)
    puppet.says = [SwitchStep(*own_head(scene, OWN), SwitchKind.COMMIT, 4, OWN)]
    scene.step(420)
    scene.step(421, localised=False)
    assert scene.role() is Role.APPLICANT

    scene.step(422)

    assert scene.role() is Role.APPLICANT


def test_a_master_does_not_obey_its_messages_to_others() -> None:
    scene, puppet = played()
    claim = ObjectClaim(*own_head(scene, WAYSIDE), 3, ClaimKind.CLAIM, 1)
    waits = Admission(*own_head(scene, 4), AdmissionState.WAITS, 1)
    mine = Admission(*own_head(scene, OWN), AdmissionState.WAITS, 1)
    prepare = SwitchStep(*own_head(scene, 2), SwitchKind.PREPARE, 4, 2)
    puppet.says = [claim, waits, mine, prepare]

    assert scene.step(420) == [claim, waits, prepare]

    assert reports(scene.step(421)) == []
    assert [each.ready_nonce for each in reports(scene.step(505))] == [0]


# How a command ends.


@pytest.mark.parametrize(
    ("told", "away"),
    [
        ({}, False),
        ({"localised": False}, True),
        ({"out_of_service": True}, True),
        ({"concerned": False}, True),
    ],
)
def test_a_master_prepares_to_leave_when_it_is_no_longer_fit(
    told: dict[str, Any], *, away: bool
) -> None:
    scene, puppet = played()

    scene.step(420, **told)

    assert puppet.away == [away]
    assert scene.role() is Role.MASTER, "for as long as others are there"


@pytest.mark.parametrize("told", [{"localised": False}, {"concerned": False}])
def test_a_master_that_leaves_no_train_behind_returns_the_area(told: dict[str, Any]) -> None:
    scene, _ = played(has_others=False)
    scene.step(419)
    assert scene.role() is Role.MASTER

    said = scene.step(420, **told)

    assert scene.role() in (Role.APPLICANT, Role.OUTSIDE)
    assert scene.desk.master is None
    assert scene.desk.lease.state is LeaseState.NONE
    head = (OWN, ARBITER, AREA, 1, BOOT, said[0].sequence, ns(420))
    assert said == [LeaseRequest(*head, LeaseKind.RELEASE, 2, NO_TRAIN, 0)]


def test_it_returns_the_lease_to_every_arbiter() -> None:
    scene = candidate(arbiters=THREE)
    scene.grants(405, 1)
    scene.grants(405, 1, arbiter=65_003)
    scene.step(405)
    assert scene.role() is Role.FENCING

    said = scene.step(410, concerned=False)

    assert [each.destination for each in requests(said)] == list(THREE)


def test_a_resigning_master_calls_its_standby_after_informing_the_arbiters() -> None:
    scene, _ = played(standby=2)

    said = scene.step(570)

    assert scene.role() is Role.APPLICANT
    assert [each.kind for each in requests(said[:1])] == [LeaseKind.RELEASE]
    head = (OWN, 2, AREA, 1, BOOT, said[0].sequence + 1, ns(570))
    assert said[1] == SwitchStep(*head, SwitchKind.RESIGN, 0, 2)


def steps_of_a_switch(said: list[T2tMessage]) -> list[T2tMessage]:
    return [each for each in said if isinstance(each, SwitchStep)]


def test_a_master_without_standby_calls_no_successor() -> None:
    scene, _ = played(has_others=False)

    said = scene.step(420, localised=False)

    assert scene.role() is Role.APPLICANT
    assert steps_of_a_switch(said) == []


def test_a_train_out_of_service_commands_itself_until_another_takes_over() -> None:
    """Without the authority that it gives itself it would brake."""
    scene, puppet = played(has_others=False)
    scene.step(420, out_of_service=True)

    assert scene.role() is Role.MASTER
    assert puppet.away == [True], "the next fit train is to take over"


@pytest.mark.parametrize("fence", ["heartbeat", "report", "refusal"])
def test_a_master_that_receives_a_higher_term_resigns_and_calls_no_successor(fence: str) -> None:
    """Another master commands already."""
    scene, _ = played(standby=2)
    if fence == "heartbeat":
        scene.beats(420, 2, source=LATER)
    elif fence == "report":
        scene.report(420, term=2)
    else:
        scene.grants(420, 2, granted=False)

    said = scene.step(420)

    assert scene.role() is Role.APPLICANT
    assert [each.kind for each in requests(said)] == [LeaseKind.RELEASE]
    assert steps_of_a_switch(said) == []


def test_messages_of_its_own_or_an_older_term_do_not_end_a_command() -> None:
    scene = Scene(memory=AreaMemory(AREA, seen_term=4, owner=OTHER))
    scene.step(0)
    scene.step(400)
    scene.grants(405, 5)
    scene.step(405)
    scene.acks(410, 5)
    scene.step(410)
    for term in (4, 5):
        scene.report(415, term=term)
        scene.beats(415, term)

    scene.step(420)

    assert scene.role() is Role.MASTER


def test_any_message_of_a_later_term_ends_its_command() -> None:
    """Here this is a switch of its successor's successor."""
    scene, _ = played()
    scene.switch(415, SwitchKind.PREPARE, term=7, source=LATER, successor=2)

    scene.step(420)

    assert scene.role() is Role.APPLICANT


def test_a_master_resigns_before_its_lease_expires_by_the_sending_margin() -> None:
    """The lease was requested at 400 ms for 300 ms, less 0.2 % and a margin of 10 ms."""
    scene, _ = played()
    end_ms = 400 + 299.4 - 10
    scene.report(600, term=1)
    scene.step(end_ms, early_ns=1)
    assert scene.role() is Role.MASTER

    scene.step(end_ms)

    assert scene.role() is Role.APPLICANT


@pytest.mark.parametrize(
    ("standby", "receives_nothing", "early_ns", "deaf"),
    [
        (2, False, 1, False),
        (2, False, 0, True),
        (2, True, 1, True),
        (NO_TRAIN, False, 0, False),
        (NO_TRAIN, True, 0, False),
    ],
)
def test_a_master_is_deaf_after_160_ms_without_messages_or_without_trains(
    standby: int, early_ns: int, *, receives_nothing: bool, deaf: bool
) -> None:
    """A standby must wait to take its place."""
    scene, _ = played(standby=standby, receives_nothing=receives_nothing)

    scene.step(410 + 160, early_ns=early_ns)

    assert scene.role() is (Role.APPLICANT if deaf else Role.MASTER)


def test_any_message_of_the_area_shows_that_a_master_is_not_deaf() -> None:
    scene, _ = played(standby=2)
    scene.report(500, term=1)

    scene.step(570)

    assert scene.role() is Role.MASTER


def applies_at_ms(scene: Scene, from_ms: float) -> int:
    """The instant of the next application, ms."""
    at_ms = int(from_ms)
    while scene.role() is not Role.CANDIDATE:
        assert at_ms < 5000
        at_ms += 1
        scene.step(at_ms)
    return at_ms


def test_a_deaf_master_does_not_apply_for_two_leases() -> None:
    """Renewals of a deaf master would only obstruct a candidate that receives messages."""
    scene, _ = played(standby=2)
    scene.step(570)
    assert scene.role() is Role.APPLICANT

    assert applies_at_ms(scene, 570) == 570 + 600


def test_a_master_that_was_not_deaf_only_waits_for_its_turn() -> None:
    """The wait counts from the time at which it commanded itself."""
    scene, _ = played(standby=2, receives_nothing=True)
    scene.step(570, early_ns=1)
    assert scene.role() is Role.APPLICANT

    assert applies_at_ms(scene, 569) == 570 + 400


def test_the_next_command_of_the_same_train_has_a_higher_term() -> None:
    scene, _ = played(has_others=False)
    scene.step(420, localised=False)

    said = scene.step(820)

    assert [(each.kind, each.term) for each in requests(said)] == [(LeaseKind.ACQUIRE, 2)]
