"""One train's participation in one area: what it receives, when it applies, and what it reports."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import pytest

from firmware_py.trackdb.areas import Area, AreaMap
from hil_tests.unit.vobc.train_to_train.t2t_rig import Rig, line_of
from vobc.train_to_train.area_participant import AreaParticipant, Chance
from vobc.train_to_train.guards import LeaseGuards, TrainGuards, without
from vobc.train_to_train.master import Master
from vobc.train_to_train.message_heads import MessageHeads
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain, Role, T2tConfig
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    Phase,
    RosterAck,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncEntry,
    T2tMessage,
    TrainReport,
)
from zenoh_config.timers import TIMERS_B

MS = 1_000_000
BEGAN_NS = 10_000_000_000
OWN, BOOT, AREA, ARBITER = 5, 3, 2, 65_001
OTHER, LATER = 9, 8
"""The former master of this area, and a later one."""
THREE = (65_001, 65_002, 65_003)
SEED = 7
LINE = AreaMap("test", (Area(1, 0.0, 1000.0), Area(2, 1000.0, 3000.0), Area(3, 3000.0, 5000.0)))
PLACE = OwnTrain(
    localised=True,
    front_min_m=1498.0,
    front_max_m=1502.0,
    rear_min_m=1418.0,
    rests_m=1420.0,
    speed_mps=3.0,
    standstill=False,
    reach_m=1510.0,
    easy_m=1530.0,
    axles=16,
)


def ns(at_ms: float) -> int:
    return BEGAN_NS + round(at_ms * MS)


@dataclass
class Puppet:
    """A master that sends what the test sets, and records what it receives."""

    due_ns: int = 10**18
    has_others: bool = True
    receives_nothing: bool = False
    standby: int = NO_TRAIN
    says: list[T2tMessage] = field(default_factory=list)
    names: list[int] = field(default_factory=list)
    """Successors, one for each step."""
    heard: list[T2tMessage] = field(default_factory=list)
    away: list[bool] = field(default_factory=list)
    desk: AreaParticipant | None = None
    roster: Any = field(default_factory=lambda: SimpleNamespace(kept=()))

    @property
    def succession(self) -> SimpleNamespace:
        return SimpleNamespace(standby=self.standby)

    def next_due_ns(self) -> int:
        return self.due_ns

    def on_message(self, message: T2tMessage, now_ns: int) -> None:
        self.heard.append(message)

    def receives_from_no_train(self, now_ns: int) -> bool:
        return self.receives_nothing

    def step(self, now_ns: int, *, away: bool) -> list[T2tMessage]:
        self.away.append(away)
        if self.names and self.desk is not None:
            self.desk.lease.successor = self.names.pop(0)
        said, self.says = self.says, []
        return said


class Scene:
    """A train's participant in area 2; messages of others get their sequence numbers by
    themselves."""

    def __init__(
        self,
        *,
        arbiters: tuple[int, ...] = (ARBITER,),
        memory: AreaMemory | None = None,
        guards: TrainGuards | None = None,
        seed: int = SEED,
    ) -> None:
        self.config = T2tConfig(arbiters=arbiters)
        self.memory = memory or AreaMemory(AREA)
        self.desk = AreaParticipant(
            self.config,
            guards or TrainGuards(),
            LINE,
            AREA,
            speaker=MessageHeads(OWN, BOOT),
            memory=self.memory,
            now_ns=BEGAN_NS,
            chance=Chance(seed),
        )
        self._sequence = 100

    def step(
        self,
        at_ms: float,
        *,
        early_ns: int = 0,
        concerned: bool = True,
        relation: tuple[int, int] = (0, NO_TRAIN),
        **told: Any,
    ) -> list[T2tMessage]:
        own, now_ns = PLACE._replace(**told), ns(at_ms) - early_ns
        self.desk.member.settle(now_ns, own)
        return self.desk.step(now_ns, own, concerned=concerned, relation=relation)

    def head(
        self, source: int, term: int, to: int = OWN
    ) -> tuple[int, int, int, int, int, int, int]:
        self._sequence += 1
        return (source, to, AREA, term, 1, self._sequence, 77)

    def beats(
        self, at_ms: float, term: int = 4, *, source: int = OTHER, standby: int = NO_TRAIN
    ) -> None:
        head = self.head(source, term, BROADCAST)
        assert self.desk.on_message(Heartbeat(*head, Phase.ISSUING, standby, 1), ns(at_ms)) == []

    def authority(
        self,
        at_ms: float,
        end_m: float = 1900.0,
        *,
        term: int = 4,
        source: int = OTHER,
        rank: int = 1,
    ) -> AreaAuthority:
        head = self.head(source, term)
        return AreaAuthority(*head, BOOT, ns(at_ms), end_m, 1400.0, 1, rank, ())

    def grants(self, at_ms: float, term: int, nonce: int = 1, **told: Any) -> None:
        """Receive one arbiter's answer to one request."""
        source, granted = told.get("arbiter", ARBITER), told.get("granted", True)
        wait_ns, roster = told.get("wait_ns", 0), told.get("roster", ())
        head = self.head(source, term)
        answer = LeaseAnswer(*head, granted, nonce, 0, OWN, wait_ns, 0, 1, roster)
        assert self.desk.on_message(answer, ns(at_ms)) == []

    def switch(
        self,
        at_ms: float,
        kind: SwitchKind,
        *,
        nonce: int = 1,
        successor: int = OWN,
        term: int = 4,
        source: int = OTHER,
    ) -> list[T2tMessage]:
        step = SwitchStep(*self.head(source, term), kind, nonce, successor)
        return self.desk.on_message(step, ns(at_ms))

    def report(
        self, at_ms: float, train: int = 1, *, term: int = 4, localised: bool = True
    ) -> TrainReport:
        message = TrainReport(
            *self.head(train, term, BROADCAST),
            localised=localised,
            front_min_m=1700.0,
            front_max_m=1704.0,
            rear_min_m=1620.0,
            protected_m=1620.0,
            speed_mps=0.0,
            standstill=True,
            latent_m=1704.0,
            held_end_m=1704.0,
            easy_m=1704.0,
            held_term=0,
            held_sequence=0,
            member=False,
            behind=NO_TRAIN,
            comes_from=0,
            axles=16,
            out_of_service=False,
            ready_nonce=0,
            echo_ns=0,
        )
        assert self.desk.on_message(message, ns(at_ms)) == []
        return message

    def sync(self, at_ms: float, *entries: SyncEntry, term: int = 4) -> list[T2tMessage]:
        source = OTHER if term == 4 else LATER
        sync = StandbySync(*self.head(source, term), 1, entries)
        return self.desk.on_message(sync, ns(at_ms))

    def acks(self, at_ms: float, term: int = 1, version: int = 1) -> None:
        self.desk.on_message(RosterAck(*self.head(ARBITER, term), version), ns(at_ms))

    def plays(self, puppet: Puppet) -> Puppet:
        puppet.desk = self.desk
        self.desk.master = cast(Master, puppet)
        return puppet

    def role(self) -> Role:
        return self.desk.role


def standby(**told: Any) -> Scene:
    """A scene whose train is the standby, named by the heartbeat of the master of term 4 at 0
    ms."""
    scene = Scene(**told)
    scene.step(0)
    scene.beats(0, standby=OWN)
    scene.step(0)
    assert scene.role() is Role.STANDBY
    return scene


def candidate(**told: Any) -> Scene:
    """A scene whose unregistered train applies at 400 ms under term 1."""
    scene = Scene(**told)
    scene.step(0)
    scene.step(400)
    assert scene.role() is Role.CANDIDATE
    return scene


def requests(said: list[T2tMessage]) -> list[LeaseRequest]:
    return [each for each in said if isinstance(each, LeaseRequest)]


def reports(said: list[T2tMessage]) -> list[TrainReport]:
    return [each for each in said if isinstance(each, TrainReport)]


# Entering and leaving the area.


def test_it_begins_outside_with_the_stored_state_and_is_due_at_once() -> None:
    memory = AreaMemory(AREA, seen_term=6, owner=OTHER, tried_term=5)
    desk = Scene(memory=memory).desk

    assert (desk.role, desk.master, desk.refused, desk.area.number) == (Role.OUTSIDE, None, [], 2)
    assert desk.stored is memory
    assert desk.member.memory is memory
    assert desk.next_due_ns(BEGAN_NS) == BEGAN_NS


def test_outside_an_area_it_sends_nothing_there() -> None:
    scene = Scene()

    assert scene.step(0, concerned=False) == []
    assert scene.step(500, concerned=False) == []
    assert scene.role() is Role.OUTSIDE


def test_it_listens_for_a_whole_turn_after_its_arrival() -> None:
    """The turn counts from its arrival and not from the creation of the participant."""
    scene = Scene()
    scene.step(0, concerned=False)
    scene.step(1000)
    scene.step(1400, early_ns=1)
    assert scene.role() is Role.APPLICANT

    scene.step(1400)

    assert scene.role() is Role.CANDIDATE


def test_it_listens_for_a_whole_turn_again_when_it_comes_back() -> None:
    scene = Scene()
    scene.step(0)
    scene.step(50, concerned=False)
    assert scene.role() is Role.OUTSIDE

    scene.step(1000)
    scene.step(1399)

    assert scene.role() is Role.APPLICANT


@pytest.mark.parametrize(
    ("rank", "turn_ms"), [(0, 160), (1, 220), (2, 280), (4, 400)], ids=lambda each: f"{each}"
)
def test_a_member_applies_after_the_silence_and_60_ms_for_each_rank(
    rank: int, turn_ms: int
) -> None:
    scene = Scene()
    scene.step(0)
    scene.desk.on_message(scene.authority(0, rank=rank), ns(0))
    scene.step(0)
    assert scene.role() is Role.MEMBER

    scene.step(turn_ms, early_ns=1)
    assert scene.role() is Role.MEMBER
    scene.step(turn_ms)
    assert scene.role() is Role.CANDIDATE


def test_the_standby_applies_after_the_silence_whatever_its_rank() -> None:
    scene = standby()
    scene.desk.on_message(scene.authority(0, rank=3), ns(0))

    scene.step(160, early_ns=1)
    assert scene.role() is Role.STANDBY
    scene.step(160)
    assert scene.role() is Role.CANDIDATE


def test_every_heartbeat_restarts_the_wait() -> None:
    scene = Scene()
    scene.step(0)
    scene.beats(300)

    scene.step(700, early_ns=1)
    assert scene.role() is Role.APPLICANT
    scene.step(700)
    assert scene.role() is Role.CANDIDATE


def test_a_member_whose_authority_expired_is_an_applicant_again() -> None:
    scene = Scene()
    scene.step(0)
    scene.desk.on_message(scene.authority(0), ns(0))
    scene.beats(950)
    scene.step(1000)
    assert scene.role() is Role.MEMBER

    scene.beats(1001)
    scene.step(1001)

    assert scene.role() is Role.APPLICANT


@pytest.mark.parametrize("told", [{"localised": False}, {"out_of_service": True}])
def test_a_train_that_cannot_command_does_not_apply(told: dict[str, Any]) -> None:
    scene = Scene()
    scene.step(0, **told)

    said = scene.step(5000, **told)

    assert scene.role() is Role.APPLICANT
    assert requests(said) == []


# Candidates.


def test_an_application_goes_to_every_arbiter_under_a_new_highest_term() -> None:
    scene = Scene(arbiters=THREE, memory=AreaMemory(AREA, seen_term=6, owner=9, tried_term=8))
    scene.step(0)

    said = scene.step(400)

    assert said[:3] == [
        LeaseRequest(
            *(OWN, arbiter, AREA, 9, BOOT, 2 + at, ns(400)),
            LeaseKind.ACQUIRE,
            1,
            NO_TRAIN,
            0,
            3,
            300,
        )
        for at, arbiter in enumerate(THREE)
    ]
    assert scene.desk.member.memory == AreaMemory(AREA, seen_term=6, owner=9, tried_term=9)
    assert scene.desk.stored == scene.memory


def test_a_candidacy_without_a_majority_ends_after_100_ms_and_returns_its_grants() -> None:
    scene = candidate(arbiters=THREE)
    scene.grants(405, 1)
    scene.step(500, early_ns=1)
    assert scene.role() is Role.CANDIDATE

    said = scene.step(500)

    assert scene.role() is Role.APPLICANT
    assert [(each.kind, each.destination, each.term) for each in requests(said)] == [
        (LeaseKind.RELEASE, arbiter, 1) for arbiter in THREE
    ]


@pytest.mark.parametrize(
    "told", [{"localised": False}, {"out_of_service": True}, {"concerned": False}]
)
def test_a_candidate_that_may_no_longer_command_gives_up(told: dict[str, Any]) -> None:
    scene = candidate()

    said = scene.step(410, **told)

    assert scene.role() in (Role.APPLICANT, Role.OUTSIDE)
    assert [each.kind for each in requests(said)] == [LeaseKind.RELEASE]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_losing_candidate_waits_between_one_and_two_random_backoffs(seed: int) -> None:
    """The wait does not depend on how long the area has been silent."""
    scene = candidate(seed=seed, arbiters=THREE)
    scene.grants(405, 1)
    scene.step(500)
    wait_ms = 80 + Chance(seed).below(80 * MS) / MS
    assert 80 <= wait_ms < 160

    scene.step(500 + wait_ms, early_ns=1)
    assert scene.role() is Role.APPLICANT
    said = scene.step(500 + wait_ms)

    assert scene.role() is Role.CANDIDATE
    assert {(each.kind, each.term) for each in requests(said)} == {(LeaseKind.ACQUIRE, 2)}


def test_the_wait_doubles_with_each_candidacy_that_fails() -> None:
    """Up to 2^5 times the first one. A master that is received begins the count again."""
    scene, chance = candidate(arbiters=THREE), Chance(SEED)
    at_ms, terms = 400.0, []
    for nonce in range(1, 9):
        scene.grants(at_ms, nonce, 2 * nonce - 1)
        scene.step(at_ms + 100)
        assert scene.role() is Role.APPLICANT
        doubled = 2 ** min(nonce - 1, 5)
        wait_ms = 80 * doubled + chance.below(80 * MS * doubled) / MS
        scene.step(at_ms + 100 + wait_ms, early_ns=1)
        assert scene.role() is Role.APPLICANT
        at_ms += 100 + wait_ms
        said = scene.step(at_ms)
        terms.append(requests(said)[0].term)

    assert terms == list(range(2, 10))


def test_leases_too_short_to_commit_a_roster_use_up_few_terms() -> None:
    """The arbiters answer just before the lease ends, time after time, for 10 s."""
    rig = Rig(line_of(0.0, 3000.0), config=T2tConfig(timers=TIMERS_B))
    rig.spoil = lambda message, to: [50]
    for n in range(3):
        rig.start_train(n + 1, 1400.0 - 400.0 * n)

    rig.run(10_000, check=False)

    tried = [train.memory.of_area(1).tried_term for train in rig.trains.values()]
    assert 3 < max(tried) < 20


@pytest.mark.parametrize("wait_ns", [0, 1, 50 * MS])
def test_a_candidate_that_lost_against_a_lease_also_waits_for_its_end(wait_ns: int) -> None:
    scene = candidate()
    scene.grants(420, 1, granted=False, wait_ns=wait_ns)
    scene.step(420)
    assert scene.role() is Role.APPLICANT
    # The answer took 20 ms. The next request takes as long, so most of that wait is over.
    left_ns = max(0, wait_ns - 20 * MS + 2_500_000) if wait_ns else 0
    tries_ms = 420 + 80 + (left_ns + Chance(SEED).below(80 * MS)) / MS

    scene.step(tries_ms, early_ns=1)
    assert scene.role() is Role.APPLICANT
    scene.step(tries_ms)
    assert scene.role() is Role.CANDIDATE


@pytest.mark.parametrize("wait_ns", [10 * MS + 1, 50 * MS])
def test_the_standby_asks_again_so_that_it_arrives_after_the_blocking_lease_expired(
    wait_ns: int,
) -> None:
    """The first request took 10 ms there and back. An eighth of that and 1 ms are added."""
    scene = standby()
    scene.step(160)
    scene.grants(170, 5, granted=False, wait_ns=wait_ns)
    scene.step(170)
    assert scene.role() is Role.STANDBY

    scene.step(162.25 + wait_ns / MS, early_ns=1)
    assert scene.role() is Role.STANDBY
    scene.step(162.25 + wait_ns / MS)
    assert scene.role() is Role.CANDIDATE


def test_the_standby_without_a_blocking_lease_waits_like_the_others() -> None:
    scene = standby()
    scene.step(160)
    scene.grants(170, 5, granted=False, wait_ns=0)
    scene.step(170)
    tries_ms = 250 + Chance(SEED).below(80 * MS) / MS

    scene.step(tries_ms, early_ns=1)
    assert scene.role() is Role.STANDBY
    scene.step(tries_ms)
    assert scene.role() is Role.CANDIDATE


@pytest.mark.parametrize(
    ("term", "role"), [(4, Role.CANDIDATE), (5, Role.CANDIDATE), (6, Role.STANDBY)]
)
def test_a_candidate_is_beaten_by_the_heartbeat_of_a_higher_term_only(
    term: int, role: Role
) -> None:
    """The candidate asks for term 5; only the arbiters decide which train gets it."""
    scene = standby()
    scene.step(160)
    source = OTHER if term == 4 else LATER

    scene.beats(170, term, source=source, standby=OWN)
    scene.step(170)

    assert scene.role() is role


@pytest.mark.parametrize(
    ("term", "role"), [(4, Role.CANDIDATE), (5, Role.CANDIDATE), (6, Role.STANDBY)]
)
def test_a_candidate_is_beaten_by_any_acknowledgement_of_a_higher_term(
    term: int, role: Role
) -> None:
    scene = standby()
    scene.step(160)

    scene.report(170, term=term)
    scene.step(170)

    assert scene.role() is role


def test_the_defeat_of_one_candidacy_does_not_affect_the_next() -> None:
    scene = standby()
    scene.step(160)
    scene.report(170, term=6)
    scene.step(170)

    scene.step(400)
    assert scene.role() is Role.CANDIDATE
    scene.step(410)
    assert scene.role() is Role.CANDIDATE


def test_a_lease_that_needs_no_answer_makes_a_master_in_the_same_step() -> None:
    """This happens only without the guard for majorities, before any answer arrives."""
    guards = TrainGuards(lease=without(LeaseGuards(), "granted_by_majority"))
    scene = Scene(guards=guards)
    scene.step(0)

    said = scene.step(400)

    assert scene.role() is Role.FENCING
    assert any(isinstance(each, Heartbeat) for each in said)
    scene.desk.lease.until_ns = ns(9000)
    assert scene.desk.next_due_ns(ns(159)) == ns(160), "when it would be deaf"
    assert scene.desk.next_due_ns(ns(160)) == ns(450), "no standby waits: for its next heartbeat"
