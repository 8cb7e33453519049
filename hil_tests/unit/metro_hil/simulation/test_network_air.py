"""The judge of radio messages: which planned switches it permits and which it rejects."""

from collections import Counter
from dataclasses import replace

import pytest

from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from metro_hil.simulation.authority_checks import AuthorityChecks, LeaseRules
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.node import QueuedMessage
from zenoh_config.t2t import (
    NO_TRAIN,
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
    """Two trains that take the command of one area from each other, and three arbiters.

    All clocks read the same, and an arbiter grants every request at once.
    """

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

    def ask(
        self, train: int, term: int, kind: LeaseKind, successor: int = NO_TRAIN
    ) -> LeaseRequest:
        self._sequence += 1
        self.now_ns += NS_PER_MS
        head = train, 0, AREA, term, 1, self._sequence, self.now_ns
        request = LeaseRequest(*head, kind, self._sequence, successor)
        self._said(train, (), request)
        return request

    def on_message(self, arbiter: int, *requests: LeaseRequest) -> None:
        """Deliver requests to an arbiter and its answer to the sender of the last one."""
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
        """Run a planned switch.

        The holder receives reports, prepares the switch, and receives those of its successor and
        the others. It proposes other rosters, which no arbiter commits, and commits the switch.
        """
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
        """Deliver reports to the holder."""
        self._said(HOLDER, reports)

    def _said(self, train: int, heard: tuple[T2tMessage, ...], *out: T2tMessage) -> None:
        letters = [QueuedMessage(ARBITERS, each) for each in out]
        self.air.stepped(train, self.now_ns, self.now_ns, heard, letters)


@pytest.fixture
def line() -> Line:
    """A line whose holder has its lease from the first two arbiters."""
    line = Line()
    acquired = line.ask(HOLDER, 1, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, acquired)
    return line


def test_no_train_gets_the_running_lease_of_another(line: Line) -> None:
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.on_message(ARBITERS[0], asked)

    with pytest.raises(ViolationError, match=r"^19: train 3 gets the lease of area 2, and that of"):
        line.on_message(ARBITERS[2], asked)


def test_another_train_gets_an_expired_lease(line: Line) -> None:
    line.now_ns += 500 * NS_PER_MS
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS:
        line.on_message(arbiter, asked)
    assert line.air.looked["19 lease"] == 2


def test_the_named_successor_gets_the_running_lease(line: Line) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, named)

    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, asked)
    assert line.air.looked["19 lease"] == 2

    # Late answers give no lease to the holder's next incarnation (simulation seed 314860).
    line.air.booted(HOLDER)
    for arbiter in ARBITERS[::-1]:
        line.on_message(arbiter, named)
    assert line.air.looked["19 lease"] == 2


def test_the_holders_withdrawal_counts_only_at_arbiters_that_received_it(line: Line) -> None:
    """A message in transit does not count: arbiters admit the successor named in the last
    request they received (simulation seed 24471)."""
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, named)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.ask(HOLDER, 1, LeaseKind.RENEW)

    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, asked)


@pytest.mark.parametrize("together", [True, False])
def test_an_arbiter_that_received_the_withdrawal_admits_no_successor(
    line: Line, *, together: bool
) -> None:
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


def test_a_late_old_request_names_no_successor(line: Line) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    back = line.ask(HOLDER, 1, LeaseKind.RENEW)
    for arbiter in ARBITERS[:2]:
        line.on_message(arbiter, back)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)
    line.on_message(ARBITERS[0], named, asked)

    with pytest.raises(ViolationError, match=r"^19: "):
        line.on_message(ARBITERS[1], named, asked)


def test_an_arbiter_without_a_part_in_the_running_lease_needs_no_successor(line: Line) -> None:
    named = line.ask(HOLDER, 1, LeaseKind.RENEW, SUCCESSOR)
    line.on_message(ARBITERS[0], named)
    asked = line.ask(SUCCESSOR, 2, LeaseKind.ACQUIRE)

    for arbiter in (ARBITERS[0], ARBITERS[2]):
        line.on_message(arbiter, asked)


def test_leases_are_not_compared_after_a_clock_step(line: Line) -> None:
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
def test_a_switch_is_not_committed_while_a_reporting_train_is_not_ready(
    line: Line, rear_m: float, *, localised: bool
) -> None:
    report = ready(THIRD, NONCE - 1, rear_m, localised=localised)

    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 8"):
        line.switches(ready(SUCCESSOR, NONCE), report)


def test_a_train_that_left_the_area_need_not_be_ready(line: Line) -> None:
    """The master of a train that left removes it from the roster in the same step (simulation
    seed 32420)."""
    line.switches(ready(SUCCESSOR, NONCE), ready(THIRD, NONCE - 1, END_M))


def test_a_removed_train_need_not_be_ready(line: Line) -> None:
    """The train had restarted elsewhere and was removed from its place in that step (simulation
    seed 285155)."""
    line.switches(
        ready(SUCCESSOR, NONCE), ready(THIRD, 0), rosters=((HOLDER, THIRD), (HOLDER, SUCCESSOR))
    )


def test_a_readmitted_train_must_be_ready(line: Line) -> None:
    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 0"):
        line.switches(
            ready(SUCCESSOR, NONCE), ready(THIRD, 0), rosters=((HOLDER,), (HOLDER, THIRD))
        )


def test_a_silent_train_need_not_be_ready(line: Line) -> None:
    line.switches(ready(SUCCESSOR, NONCE))


@pytest.mark.parametrize("sequence", [6, 7])
def test_a_late_copy_of_an_older_report_does_not_count(line: Line, sequence: int) -> None:
    """The train was killed meanwhile and sends no more reports (simulation seed 43352)."""
    before = replace(ready(THIRD, 0), sequence=7)
    line.switches(ready(SUCCESSOR, NONCE), replace(before, sequence=sequence), before=(before,))


def test_a_newer_report_counts(line: Line) -> None:
    before = replace(ready(THIRD, 0), sequence=7)

    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 0"):
        line.switches(
            ready(SUCCESSOR, NONCE),
            *(replace(before, sequence=n) for n in (8, 6)),
            before=(before,),
        )


def test_a_restarted_master_accepts_all_reports_again(line: Line) -> None:
    before = replace(ready(THIRD, 0), sequence=7)
    line.on_reports(before)
    line.air.booted(HOLDER)

    with pytest.raises(ViolationError, match=r"^26: .* train 4 is ready for 0"):
        line.switches(ready(SUCCESSOR, NONCE), before)
