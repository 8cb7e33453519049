"""A hostile train with valid keys may stop other trains. It never endangers or disables them."""

import dataclasses
import math
import random
from typing import Any

import pytest

from firmware_py.ports import RadioMessage
from firmware_py.trackdb.areas import load_areas
from hil_tests.unit.vobc.train_to_train.t2t_rig import MS, Rig, line_of
from metro_hil.simulation.insider import Knowledge, forged
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.trains_ahead import HEARD_NS, TRAINS_MAX, TrainsAhead
from vobc.train_to_train.vocabulary import OwnTrain, Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config import t2t_keys
from zenoh_config.codec import pack
from zenoh_config.t2t import (
    BROADCAST,
    TERM_MAX,
    TERM_STEP_MAX,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    Phase,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_types import T2T_TYPES

OWN, AHEAD, INSIDER, ARBITER = 2, 1, 3, 65_001
S = 1_000_000_000
MUTATIONS = 10
"""Messages of each kind. All kinds with 1000 each took 10 minutes and ended nothing."""
REAR_M = 3921.0
"""Protected rear of the train ahead."""
END_M = REAR_M - 7.0
"""Less a rollback of 2 m and a jog of 5 m."""
STANDING = OwnTrain(True, 3199.0, 3200.0, 3128.0, 3128.0, 0.0, True, 3200.0, 3200.0, 16)


def report_of(
    train: int, rear_m: float, *, sequence: int = 1, boot: int = 5, **told: Any
) -> TrainReport:
    front_m = rear_m + 80.0
    places_m = (front_m - 1.0, front_m, rear_m, rear_m)
    head = (train, BROADCAST, 2, 0, boot, sequence, 0)
    reach_m = (front_m, front_m, front_m)
    report = TrainReport(
        *head, True, *places_m, 0.0, True, *reach_m, 0, 0, False, 0, 0, 16, False, 0, 0
    )
    return dataclasses.replace(report, **told)


class Victim:
    """A train that stands at 3200 m and receives one ahead of it, as bytes."""

    def __init__(self, memory: TrainMemory | None = None) -> None:
        self.stored = memory or TrainMemory()
        self.now_ns = 2 * S
        self.number = 0
        core = TrainCore(
            T2tConfig(),
            load_areas("loop"),
            address=OWN,
            memory=self.stored,
            start_ns=self.now_ns,
        )
        self.radio = LineRadio(core, "loop", self._store)
        self.report: TrainReport | None = None
        self.step()
        self.boot = self.stored.boot

    def _store(self, memory: TrainMemory) -> bool:
        self.stored = memory
        return True

    def step(self, *heard: T2tMessage) -> None:
        self.now_ns += 10 * MS
        messages = [RadioMessage(0, t2t_keys.key_of("loop", m), pack(m)) for m in heard]
        self.radio.takes(messages)
        self.radio.step(self.now_ns, STANDING, apply=True)

    def hears_ahead(self, **told: Any) -> None:
        self.number += 1
        self.step(report_of(AHEAD, REAR_M, sequence=self.number, **told))

    def head(self, term: int, to: int = BROADCAST) -> tuple[int, int, int, int, int, int, int]:
        self.number += 1
        return INSIDER, to, 2, term, 9, self.number, self.now_ns

    def forges(self, term: int, end_m: float = 5200.0) -> None:
        """The insider announces the term and grants 2000 m."""
        beat = Heartbeat(*self.head(term), Phase.ISSUING, 0, 1)
        grant = AreaAuthority(
            *(*self.head(term, OWN), self.boot, self.now_ns, end_m, 3125.0, 0, 1, ())
        )
        self.step(beat, grant)

    @property
    def end_m(self) -> float:
        return -math.inf if self.radio.authority is None else self.radio.authority.end_m


@pytest.mark.parametrize("end_m", [END_M, END_M + 0.1, REAR_M, 4100.0, 5200.0, 9000.0])
def test_a_false_authority_ends_behind_the_train_ahead(end_m: float) -> None:
    victim = Victim()
    victim.hears_ahead()

    victim.forges(1, end_m)

    assert victim.end_m == END_M


def test_the_end_follows_the_train_ahead_without_a_new_authority() -> None:
    victim = Victim()
    victim.hears_ahead()
    victim.forges(1)

    victim.hears_ahead(protected_m=REAR_M + 3.0)
    assert victim.end_m == END_M + 3.0

    victim.hears_ahead()
    assert victim.end_m == END_M + 3.0  # A protected rear never goes back.


def test_an_authority_ends_at_the_border_of_its_area() -> None:
    areas = load_areas("loop")
    victim = Victim()

    victim.forges(1, end_m=9000.0)

    assert victim.end_m <= areas.area(2).end_m


def test_an_authority_for_all_trains_is_refused() -> None:
    victim = Victim()
    grant = AreaAuthority(*(*victim.head(1), victim.boot, victim.now_ns, 5200.0, 3125.0, 0, 1, ()))

    victim.step(grant)

    assert victim.radio.authority is None
    assert victim.radio.refused()["wrong destination"] == 1


@pytest.mark.parametrize(
    ("rear_m", "age_ns", "bound_m"),
    [
        (500.0, 0, 500.0),
        (500.0, HEARD_NS, 500.0),
        (500.0, HEARD_NS + 1, math.inf),
        (321.0, 0, 321.0),
        (320.0, 0, math.inf),
        (100.0, 0, math.inf),
    ],
)
def test_a_train_is_ahead_if_its_front_is(rear_m: float, age_ns: int, bound_m: float) -> None:
    """The own front is at 400 m at most. Trains are 80 m long."""
    own = STANDING._replace(front_max_m=400.0)
    ahead = TrainsAhead(5.0)
    ahead.on_message(report_of(1, rear_m), S)
    ahead.on_message(report_of(4, 2000.0), S + age_ns)

    assert ahead.rear_m(S + age_ns, own) == min(bound_m, 2000.0)


def test_the_newest_report_counts_and_a_restarted_train_begins_again() -> None:
    own, ahead = STANDING._replace(front_max_m=400.0), TrainsAhead(5.0)
    ahead.on_message(report_of(1, 700.0, sequence=5), S)
    ahead.on_message(report_of(1, 800.0, sequence=4), S)
    ahead.on_message(report_of(1, 600.0, sequence=6, localised=False), S)
    assert ahead.rear_m(S, own) == 700.0

    ahead.on_message(report_of(1, 600.0, sequence=1, boot=6), S)

    assert ahead.rear_m(S, own) == 600.0


def test_the_number_of_trains_that_are_remembered_is_bounded() -> None:
    own, ahead = STANDING._replace(front_max_m=400.0), TrainsAhead(5.0)
    ahead.on_message(report_of(1, 500.0), S)
    for train in range(2, TRAINS_MAX + 2):
        ahead.on_message(report_of(train, 600.0), S)

    assert ahead.rear_m(S, own) == 600.0


@pytest.mark.parametrize("term", [TERM_STEP_MAX, TERM_STEP_MAX + 1, TERM_MAX])
def test_a_term_far_beyond_the_confirmed_ones_is_refused_now_and_after_a_restart(
    term: int,
) -> None:
    victim = Victim()

    victim.forges(term)

    accepted = term <= TERM_STEP_MAX
    assert (victim.radio.authority is not None) == accepted
    assert victim.stored.of_area(2).seen_term == (term if accepted else 0)
    again = Victim(victim.stored)
    for _ in range(200):
        again.step()
    assert again.stored.of_area(2).tried_term == victim.stored.of_area(2).seen_term + 1


def test_the_term_that_an_arbiter_confirms_is_the_measure() -> None:
    victim, far = Victim(), 1_000_000
    answer = LeaseAnswer(ARBITER, OWN, 2, far, 1, 1, 0, False, 1, 0, 7, 0, 0, 0, ())

    victim.step(answer)
    victim.forges(far + TERM_STEP_MAX)

    assert victim.radio.authority is not None


def test_the_arbiters_know_who_owns_a_term() -> None:
    """The insider is the first to send under it. A majority had granted it to train 7."""
    victim = Victim()
    victim.forges(4)
    assert victim.stored.of_area(2).owner == INSIDER

    victim.step(LeaseAnswer(ARBITER, OWN, 2, 4, 1, 1, 0, False, 1, 0, 7, 0, 0, 0, ()))
    assert victim.stored.of_area(2).owner == 7

    head = (7, OWN, 2, 4, 3, 2, victim.now_ns)
    victim.step(AreaAuthority(*head, victim.boot, victim.now_ns, 3500.0, 3125.0, 0, 1, ()))
    assert victim.end_m == 3500.0


@pytest.mark.parametrize("kind", T2T_TYPES, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("commands", [False, True])
def test_no_message_of_a_hostile_train_ends_a_controller(
    kind: type[T2tMessage], *, commands: bool
) -> None:
    """Neither a follower nor a master raises. Nor does it pass the train that it receives ahead."""
    rng = random.Random(f"{kind.__name__} {commands}")
    victim = Victim()
    places_m = (3128.0, 3200.0, REAR_M, REAR_M + 80.0, 5200.0, 9000.0)
    for number in range(MUTATIONS):
        victim.hears_ahead()
        area = rng.choice((1, 2, 3, 255))
        knows = Knowledge(
            victim.stored.of_area(2).seen_term,
            victim.boot,
            victim.now_ns,
            (OWN, AHEAD, INSIDER),
            places_m,
        )
        head = {
            "source": INSIDER,
            "destination": rng.choice((OWN, BROADCAST)),
            "area": 2 if commands else area,
            "boot": 9,
            "sequence": 1000 + number,
            "stamp_ns": victim.now_ns,
        }
        if commands:
            _elect(victim)
        message = forged(kind, rng, head, knows)
        if message is not None:
            victim.step(message)
        assert victim.end_m <= END_M

    again = Victim(victim.stored)
    for _ in range(50):
        again.step()
    assert again.radio.roles.get(2) in (Role.CANDIDATE, Role.APPLICANT, Role.MEMBER)


def _elect(victim: Victim) -> None:
    """Grant the lease that the victim asks for."""
    desk = victim.radio._core.desk(2)
    assert desk is not None
    victim.number += 1
    term, nonce = desk.lease.term, desk.lease._nonce
    head = (ARBITER, OWN, 2, term, 1, victim.number, 0)
    victim.step(LeaseAnswer(*head, True, nonce, 0, OWN, 0, 0, 0, ()))


def test_a_line_goes_on_after_a_hostile_train_has_ended() -> None:
    """It claims each next term and grants too much. No train is let into the one ahead."""
    rig = Rig(line_of(0.0, 3000.0))
    for n in range(3):
        rig.start_train(n + 1, 1400.0 - 400.0 * n)
    rig.run(3000)
    rig.kill(2)
    for number in range(1, 60):
        rig.run(50)
        term = max(train.memory.of_area(1).seen_term for train in rig.trains.values())
        head = (2, BROADCAST, 1, term + number % 2, 50, number, 0)
        rig.say(Heartbeat(*head, Phase.ISSUING, 0, 1))
        for to in (1, 3):
            train = rig.trains[to]
            grant = (train.memory.boot, rig.now_ns, 2900.0, 0.0, 0, 1, ())
            rig.say(AreaAuthority(2, to, 1, term, 50, 1000 + number, 0, *grant))
    assert rig.trains[3].rear_m < 600.0

    def has_authority(train: int) -> bool:
        held = rig.trains[train].held
        return held is not None and rig.now_ns - held.echo_ns < 500 * MS

    assert rig.run_until(lambda: has_authority(1), 10_000) < 5000
