"""The arbiter: one holder for each area at a time, under terms that only grow, over restarts."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_emulator.wayside.arbiter import Arbiter
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory
from zenoh_config.t2t import (
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    RosterAck,
    RosterCommit,
    RosterEntry,
    T2tMessage,
)
from zenoh_config.timers import TIMERS_A

MS = 1_000_000
ADDRESS = 65_001
LEASE_MS = TIMERS_A.lease_ms
ROSTER = (RosterEntry(7, 100.0, True), RosterEntry(4, 10.0, False))


class Desk:
    """An arbiter that has been up long enough, and the sequence numbers of those who ask."""

    def __init__(self, memory: ArbiterMemory | None = None, *, waited: bool = True) -> None:
        self.now_ms = 0
        self.memory: ArbiterMemory | None = memory or ArbiterMemory()
        self.arbiter = Arbiter(TIMERS_A, address=ADDRESS, memory=self.memory, start_ns=0)
        self.sequence = 0
        if waited:
            self.now_ms = LEASE_MS + 1

    def says(self, message: T2tMessage) -> tuple[T2tMessage, ...]:
        stepped = self.arbiter.step(self.now_ms * MS, (message,))
        self.memory = stepped.memory or self.memory
        return stepped.out

    def request(
        self,
        train: int,
        term: int,
        kind: LeaseKind = LeaseKind.ACQUIRE,
        *,
        successor: int = 0,
        less_ms: int = 0,
    ) -> LeaseRequest:
        self.sequence += 1
        head = (train, ADDRESS, 1, term, 1, self.sequence, self.now_ms * MS)
        return LeaseRequest(*head, kind, self.sequence, successor, less_ms * MS)

    def ask(
        self,
        train: int,
        term: int,
        kind: LeaseKind = LeaseKind.ACQUIRE,
        *,
        successor: int = 0,
        less_ms: int = 0,
    ) -> LeaseAnswer:
        request = self.request(train, term, kind, successor=successor, less_ms=less_ms)
        (answer,) = self.says(request)
        assert isinstance(answer, LeaseAnswer)
        return answer

    def commit(self, train: int, term: int, version: int) -> bool:
        self.sequence += 1
        head = (train, ADDRESS, 1, term, 1, self.sequence, 0)
        out = self.says(RosterCommit(*head, version, ROSTER))
        return any(isinstance(each, RosterAck) for each in out)


def test_the_first_who_asks_gets_the_lease_and_the_second_hears_how_long_to_wait() -> None:
    desk = Desk()

    assert desk.ask(1, 1).granted
    desk.now_ms += 100
    refused = desk.ask(2, 2)

    assert not refused.granted
    assert refused.term == 1
    assert refused.holder == 1
    assert refused.wait_ns == TIMERS_A.arbiter_lease_ns - 100 * MS


def test_a_lease_that_ran_out_goes_to_a_higher_term_and_not_a_tick_before() -> None:
    desk = Desk()
    desk.ask(1, 1)
    granted_ms = desk.now_ms
    desk.now_ms = granted_ms + LEASE_MS
    assert not desk.ask(2, 2).granted  # Clocks run apart: the arbiter waits a little longer.

    desk.now_ms += 1

    assert not desk.ask(2, 1).granted  # A term that was promised is never promised again.
    assert desk.ask(2, 2).granted


def test_a_holder_renews_for_as_long_as_it_likes() -> None:
    desk = Desk()
    desk.ask(1, 1)
    for _ in range(20):
        desk.now_ms += TIMERS_A.renew_ms
        assert desk.ask(1, 1, LeaseKind.RENEW).granted
        assert not desk.ask(2, 2).granted


@pytest.mark.parametrize("less_ms", [0, 1, 120])
def test_a_grant_for_less_than_a_lease_is_waited_out_and_no_tick_longer(less_ms: int) -> None:
    desk = Desk()
    desk.ask(1, 1)
    desk.now_ms += LEASE_MS
    desk.ask(1, 1, LeaseKind.RENEW, less_ms=less_ms)

    # Of a whole lease of 300.6 ms.
    desk.now_ms += 300 - less_ms
    assert not desk.ask(2, 2).granted
    desk.now_ms += 1
    assert desk.ask(2, 2).granted


@pytest.mark.parametrize("less_ms", [150, 300, 100_000])
def test_no_renewal_shortens_what_was_granted_before(less_ms: int) -> None:
    desk = Desk()
    desk.ask(1, 1)
    desk.now_ms += 100
    assert desk.ask(1, 1, LeaseKind.RENEW, less_ms=less_ms).granted

    desk.now_ms += LEASE_MS - 100
    assert not desk.ask(2, 2).granted
    desk.now_ms += 1
    assert desk.ask(2, 2).granted


def test_nobody_renews_another_ones_lease_or_a_former_term() -> None:
    desk = Desk()
    desk.ask(1, 5)

    assert not desk.ask(2, 5, LeaseKind.RENEW).granted
    assert not desk.ask(1, 4, LeaseKind.RENEW).granted


def test_a_named_successor_need_not_wait_and_ends_the_old_lease() -> None:
    desk = Desk()
    desk.ask(1, 1)
    assert not desk.ask(2, 2).granted
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)

    assert desk.ask(2, 2).granted
    assert not desk.ask(1, 1, LeaseKind.RENEW).granted


def test_a_name_that_is_taken_back_is_worth_nothing() -> None:
    desk = Desk()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)
    desk.ask(1, 1, LeaseKind.RENEW)

    assert not desk.ask(2, 2).granted


def test_a_successor_that_gives_up_does_not_free_what_the_old_master_may_still_use() -> None:
    desk = Desk()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RENEW, successor=2)
    desk.ask(2, 2)
    desk.ask(2, 2, LeaseKind.RELEASE)

    assert not desk.ask(3, 3).granted
    desk.now_ms += LEASE_MS + 1
    assert desk.ask(3, 3).granted


def test_a_lease_given_back_is_free_at_once() -> None:
    desk = Desk()
    desk.ask(1, 1)
    desk.ask(1, 1, LeaseKind.RELEASE)

    assert desk.ask(2, 2).granted


def test_a_restarted_arbiter_waits_a_whole_lease_and_remembers_terms_and_roster() -> None:
    desk = Desk()
    desk.ask(1, 7)
    assert desk.commit(1, 7, 3)

    again = Desk(desk.memory, waited=False)

    assert not again.ask(2, 8).granted
    assert again.ask(1, 7, LeaseKind.RENEW).granted
    again.now_ms += 2 * LEASE_MS
    assert not again.ask(2, 7).granted
    answer = again.ask(2, 8)
    assert (answer.roster_term, answer.roster_version, answer.roster) == (7, 3, ROSTER)


def test_an_arbiter_whose_memory_cannot_be_read_says_nothing_and_stores_nothing() -> None:
    """An empty memory would be believed at its next start, and a term granted twice."""
    arbiter = Arbiter(TIMERS_A, address=ADDRESS, memory=None, start_ns=0)
    request = Desk().request(1, 1)

    for _ in range(2):
        stepped = arbiter.step(10_000 * MS, (request,))
        assert (stepped.out, stepped.memory) == ((), None)


@pytest.mark.parametrize(("train", "term", "version"), [(2, 7, 4), (1, 6, 4), (1, 7, 2)])
def test_a_roster_of_others_of_a_former_term_or_an_older_one_is_not_kept(
    train: int, term: int, version: int
) -> None:
    desk = Desk()
    desk.ask(1, 7)
    desk.commit(1, 7, 3)

    assert not desk.commit(train, term, version)
    assert desk.arbiter.lease(1).roster_version == 3


def test_a_repeated_request_changes_nothing() -> None:
    desk = Desk()
    request = desk.request(1, 1)
    desk.says(request)
    before = desk.arbiter.memory

    assert desk.says(request) == ()
    assert desk.arbiter.memory == before


STEPS = st.lists(
    st.tuples(
        st.integers(1, 3), st.integers(1, 8), st.sampled_from(list(LeaseKind)), st.integers(0, 200)
    ),
    max_size=40,
)


@settings(max_examples=60, deadline=None)
@given(STEPS)
def test_whatever_is_asked_a_term_has_one_holder_and_leases_do_not_overlap(
    steps: list[tuple[int, int, LeaseKind, int]],
) -> None:
    """Kept beside the arbiter: who may think to hold what until when, by their own sending."""
    desk = Desk()
    owners: dict[int, int] = {}
    valid: dict[int, tuple[int, int]] = {}
    """By train: term, and the end of its lease as it counts."""

    for train, term, kind, pause_ms in steps:
        desk.now_ms += pause_ms
        answer = desk.ask(train, term, kind)
        if kind is LeaseKind.RELEASE:
            if valid.get(train, (0, 0))[0] == term:
                del valid[train]
            continue
        if not answer.granted:
            continue
        assert owners.setdefault(term, train) == train
        others = [until for other, (_, until) in valid.items() if other != train]
        assert all(until <= desk.now_ms * MS for until in others)
        valid[train] = (term, desk.now_ms * MS + TIMERS_A.holder_lease_ns)
