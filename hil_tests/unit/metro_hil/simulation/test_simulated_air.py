"""The judge of radio messages keeps the incarnations of a train apart."""

from collections import Counter
from dataclasses import replace

import pytest

from metro_hil.simulation.authority_checks import ANSWERS_MAX, AuthorityChecks, LeaseRules
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.node import QueuedMessage
from zenoh_config.t2t import (
    AreaAuthority,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    RosterAck,
    RosterCommit,
    RosterEntry,
    TrainReport,
)

MS = 1_000_000
RULES = LeaseRules(300 * MS, 0.002, 10 * MS, majority=2, age_max_ns=1000 * MS)
ARBITERS = (65_001, 65_002, 65_003)


class Line:
    """Trains that send requests, arbiters that grant at once, and the judge."""

    def __init__(self, rules: LeaseRules = RULES) -> None:
        self.now_ns = 0
        self.judge = AuthorityChecks(rules, Counter())

    def asks(self, train: int, term: int, nonce: int, arbiters: tuple[int, ...]) -> None:
        head = (train, ARBITERS[0], train, term, 1, nonce, self.now_ns)
        request = LeaseRequest(*head, LeaseKind.RENEW, nonce, 0)
        self._stepped(train, [], [QueuedMessage(ARBITERS, request)])
        for arbiter in arbiters:
            self.answers(train, term, nonce, arbiter)

    def answers(self, train: int, term: int, nonce: int, arbiter: int) -> None:
        head = (arbiter, train, train, term, 1, nonce, 0)
        answer = LeaseAnswer(*head, True, nonce, self.now_ns, train, 0, 0, 0, ())
        self._stepped(train, [answer], [])

    def keeps_roster(self, train: int, term: int) -> None:
        roster = (RosterEntry(train, 0.0, True, 1),)
        head = (train, ARBITERS[0], train, term, 1, 1, 0)
        self._stepped(train, [], [QueuedMessage(ARBITERS, RosterCommit(*head, 1, roster))])
        for arbiter in ARBITERS:
            self._stepped(train, [RosterAck(arbiter, train, train, term, 1, 1, 0, 1)], [])

    def issues(self, train: int, term: int) -> None:
        head = (train, train, train, term, 1, 1, self.now_ns)
        authority = AreaAuthority(*head, 1, self.now_ns, 100.0, 0.0, 0, 1, ())
        self._stepped(train, [], [QueuedMessage((train,), authority)])

    def on_authority(self, train: int, term: int, sequence: int, echo_ns: int) -> None:
        head = (2, train, train, term, 1, sequence, self.now_ns)
        authority = AreaAuthority(*head, 1, echo_ns, 100.0, 0.0, 0, 1, ())
        self._stepped(train, [authority], [])

    def holds(self, train: int, term: int, sequence: int) -> None:
        """The train reports which authority it holds."""
        head = (train, 2, train, term, 1, sequence, self.now_ns)
        place = (50.0, 51.0, 0.0, 0.0, 0.0)
        ends = (100.0, 100.0, 60.0, term, sequence)
        report = TrainReport(*head, True, *place, True, *ends, True, 0, 0, 4, False, 0, 0)
        self._stepped(train, [], [QueuedMessage((2,), report)])

    def _stepped(self, train: int, heard: list[object], letters: list[QueuedMessage]) -> None:
        self.judge.stepped(train, self.now_ns, self.now_ns, heard, letters)


def test_request_numbers_restart_with_every_incarnation() -> None:
    """Entries of an earlier incarnation were once dropped first when the memory was full (seed
    1195)."""
    line = Line()
    for nonce in range(1, ANSWERS_MAX + 1):
        line.asks(1, 5, nonce, ARBITERS)
        line.now_ns += 75 * MS
    line.judge.booted(1)
    line.keeps_roster(1, 6)
    for nonce in (1, 2, 3):
        line.now_ns += 200 * MS
        line.asks(1, 6, nonce, ARBITERS[:1])
        line.asks(2, 5, nonce, ARBITERS)
        line.answers(1, 6, nonce, ARBITERS[1])
        line.issues(1, 6)


def test_only_the_hostile_train_may_issue_to_trains_of_no_committed_roster() -> None:
    """In seed 600061 the hostile train commanded, and committed a forged roster of its own area."""
    line = Line(replace(RULES, hostile=1))
    line.issues(1, 6)

    with pytest.raises(ViolationError, match="train 2 issues to train 2 in area 2, which is not"):
        line.issues(2, 6)


def test_a_late_second_copy_does_not_affect_the_accepted_first_one() -> None:
    """In seed 2314 the message was doubled and delayed by more than a second."""
    line = Line()
    line.now_ns = 5000 * MS
    line.on_authority(1, 6, 1, echo_ns=4000 * MS)
    line.holds(1, 6, 1)
    line.now_ns += 1
    line.on_authority(1, 6, 1, echo_ns=4000 * MS)
    line.holds(1, 6, 1)

    line.on_authority(1, 6, 2, echo_ns=4000 * MS)
    with pytest.raises(ViolationError, match="late on arrival"):
        line.holds(1, 6, 2)
