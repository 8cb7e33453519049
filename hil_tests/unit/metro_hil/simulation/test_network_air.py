"""What the judge of the messages on the air lets pass of planned switches, and what it does not."""

from collections import Counter
from dataclasses import replace

import pytest

from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from metro_hil.simulation.authority_checks import AuthorityChecks, LeaseRules
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.node import QueuedMessage
from zenoh_config.t2t import (
    NOBODY,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    RosterAck,
    RosterCommit,
    RosterEntry,
    SwitchKind,
    SwitchStep,
    T2tMessage,
    TrainReport,
)

NS_PER_MS = 1_000_000
AREA = 2
NONCE = 9
HOLDER, SUCCESSOR, THIRD = 1, 3, 4
END_M = 2000.0
ARBITERS = (65_001, 65_002, 65_003)


class Line:
    """Two trains that take the command of one area from each other, and three arbiters. All clocks
    read the same; whatever an arbiter is asked it grants, at once."""

    def __init__(self) -> None:
        rules = LeaseRules(
            lease_ns=500 * NS_PER_MS,
            drift_ratio=0.0,
            margin_ns=20 * NS_PER_MS,
            majority=2,
            age_max_ns=1000 * NS_PER_MS,
        )
        self.air = AuthorityChecks(rules, Counter(), {AREA: END_M})
        self.now_ns = 0
        self._sequence = 0

    def ask(self, train: int, term: int, kind: LeaseKind, successor: int = NOBODY) -> LeaseRequest:
        self._sequence += 1
        self.now_ns += NS_PER_MS
        head = train, 0, AREA, term, 1, self._sequence, self.now_ns
        request = LeaseRequest(*head, kind, self._sequence, successor)
        self._said(train, (), request)
        return request

    def on_message(self, arbiter: int, *requests: LeaseRequest) -> None:
        """And answers the last of them to whom it came from, who hears that."""
        request = requests[-1]
        self._sequence += 1
        head = arbiter, request.source, AREA, request.term, 1, self._sequence, self.now_ns
        answer = LeaseAnswer(
            *head, True, request.nonce, request.stamp_ns, request.source, 0, 0, 0, ()
        )
        self.air.answered(arbiter, requests, (QueuedMessage((request.source,), answer),))
        self._said(request.source, (answer,))

    def switches(
        self,
        *reports: TrainReport,
        before: tuple[TrainReport, ...] = (),
        rosters: tuple[tuple[int, ...], ...] = (),
    ) -> None:
        """The holder hears some reports, prepares a switch, hears its successor and the others,
        proposes other rosters that nobody keeps yet, and commits."""
        self.on_reports(*before)
        head = HOLDER, SUCCESSOR, AREA, 1, 1, 1, self.now_ns
        trains = (HOLDER, SUCCESSOR, THIRD)
        roster = tuple([RosterEntry(train, 0.0, True, 1) for train in trains])
        self._said(HOLDER, (), RosterCommit(*head, 1, roster))
        for arbiter in ARBITERS:
            ack = RosterAck(arbiter, HOLDER, AREA, 1, 1, 1, 0, 1)
            self._said(HOLDER, (ack,))
        self._said(HOLDER, (), SwitchStep(*head, SwitchKind.PREPARE, NONCE, SUCCESSOR))
        back = SUCCESSOR, HOLDER, AREA, 1, 1, 1, self.now_ns
        self._said(SUCCESSOR, (), SwitchStep(*back, SwitchKind.READY, NONCE, SUCCESSOR))
        self._said(HOLDER, reports)
        commits = [
            RosterCommit(*head, 2 + at, tuple([RosterEntry(train, 0.0, True, 1) for train in each]))
            for at, each in enumerate(rosters)
        ]
        self._said(HOLDER, (), *commits, SwitchStep(*head, SwitchKind.COMMIT, NONCE, SUCCESSOR))

    def on_reports(self, *reports: TrainReport) -> None:
        """The holder does."""
        self._said(HOLDER, reports)

    def _said(self, train: int, heard: tuple[T2tMessage, ...], *out: T2tMessage) -> None:
        letters = [QueuedMessage(ARBITERS, each) for each in out]
        self.air.stepped(train, self.now_ns, self.now_ns, heard, letters)


@pytest.fixture
def line() -> Line:
    """The holder has its lease from the first two arbiters."""
    line = Line()
    acquired = line.ask(HOLDER, 1, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, acquired)
    return line


def test_nobody_gets_the_lease_of_another_that_runs(line: Line) -> None:
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.on_message(ARBITERS[0], asked)

    with pytest.raises(ViolationError, match=r"^19: train 3 gets the lease of area 2, and that of"):
        line.on_message(ARBITERS[2], asked)


def test_it_does_once_that_has_run_out(line: Line) -> None:
    line.now_ns += 500 * NS_PER_MS
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS:
        line.on_message(arbiter, asked)
    assert line.air.looked["19 lease"] == 2


def test_the_one_whom_the_holder_named_does_for_good(line: Line) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, named)

    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, asked)
    assert line.air.looked["19 lease"] == 2

    # Late answers give the holder's next life no lease (seed 314860).
    line.air.booted(HOLDER)
    for arbiter in ARBITERS[::-1]:
        line.on_message(arbiter, named)
    assert line.air.looked["19 lease"] == 2


def test_the_holder_s_change_of_mind_counts_where_it_was_heard(line: Line) -> None:
    """On its way it is none: the arbiters let in whom the last request names that they heard (seed
    24471).
    """
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, named)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.ask(HOLDER, 1, LeaseKind.RENEW)

    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, asked)


@pytest.mark.parametrize("together", [True, False])
def test_where_it_was_heard_nobody_is_let_in_any_more(line: Line, *, together: bool) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, named)
    back = line.ask(HOLDER, 1, LeaseKind.RENEW)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.on_message(ARBITERS[0], asked)

    if not together:
        line.on_message(ARBITERS[1], back)

    with pytest.raises(ViolationError, match=r"^19: "):
        line.on_message(ARBITERS[1], *((back, asked) if together else (asked,)))


def test_an_old_request_that_comes_late_names_nobody(line: Line) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    back = line.ask(HOLDER, 1, LeaseKind.RENEW)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, back)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.on_message(ARBITERS[0], named, asked)

    with pytest.raises(ViolationError, match=r"^19: "):
        line.on_message(ARBITERS[1], named, asked)


def test_an_arbiter_that_has_no_part_in_the_lease_that_runs_needs_no_name(line: Line) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    line.on_message(ARBITERS[0], named)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)

    for arbiter in (ARBITERS[0], ARBITERS[2]):
        line.on_message(arbiter, asked)


def test_where_clocks_were_stepped_leases_are_not_held_against_each_other(line: Line) -> None:
    line.air.clocks_sound = False
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, asked)


def ready(train: int, nonce: int, rear_m: float = 100.0, *, localised: bool = True) -> TrainReport:
    told = replace(REPORT, source=train, area=AREA, boot=1, ready_nonce=nonce, rear_min_m=rear_m)
    return replace(told, localised=localised)


def test_a_switch_is_committed_when_all_on_the_roster_are_ready(line: Line) -> None:
    line.switches(ready(SUCCESSOR, NONCE), ready(THIRD, NONCE))
    assert line.air.looked["26"] == 1


@pytest.mark.parametrize(("rear_m", "localised"), [(END_M - 0.1, True), (END_M, False)])
def test_it_is_not_while_one_that_is_heard_is_not(
    line: Line, rear_m: float, *, localised: bool
) -> None:
    report = ready(THIRD, NONCE - 1, rear_m, localised=localised)

    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 8"):
        line.switches(ready(SUCCESSOR, NONCE), report)


def test_who_has_left_the_area_need_not_be_ready(line: Line) -> None:
    """Its master takes it off the roster in that very step (seed 32420)."""
    line.switches(ready(SUCCESSOR, NONCE), ready(THIRD, NONCE - 1, END_M))


def test_nor_who_is_taken_off_the_roster(line: Line) -> None:
    """It had begun anew elsewhere, and was found gone from its place in that step (seed 285155)."""
    line.switches(
        ready(SUCCESSOR, NONCE), ready(THIRD, 0), rosters=((HOLDER, THIRD), (HOLDER, SUCCESSOR))
    )


def test_who_is_put_on_it_again_has_to_be(line: Line) -> None:
    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 0"):
        line.switches(
            ready(SUCCESSOR, NONCE), ready(THIRD, 0), rosters=((HOLDER,), (HOLDER, THIRD))
        )


def test_who_is_not_heard_need_not_be_ready(line: Line) -> None:
    line.switches(ready(SUCCESSOR, NONCE))


@pytest.mark.parametrize("sequence", [6, 7])
def test_a_copy_that_comes_after_what_was_heard_before_says_nothing(
    line: Line, sequence: int
) -> None:
    """The train was killed meanwhile, and is not heard any more (seed 43352)."""
    before = replace(ready(THIRD, 0), sequence=7)
    line.switches(ready(SUCCESSOR, NONCE), replace(before, sequence=sequence), before=(before,))


def test_what_is_newer_than_what_was_heard_before_counts(line: Line) -> None:
    before = replace(ready(THIRD, 0), sequence=7)

    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 0"):
        line.switches(
            ready(SUCCESSOR, NONCE),
            *(replace(before, sequence=n) for n in (8, 6)),
            before=(before,),
        )


def test_who_begins_anew_hears_all_reports_anew(line: Line) -> None:
    before = replace(ready(THIRD, 0), sequence=7)
    line.on_reports(before)
    line.air.booted(HOLDER)

    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 0"):
        line.switches(ready(SUCCESSOR, NONCE), before)
