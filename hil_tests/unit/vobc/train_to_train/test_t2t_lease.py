"""One train's lease, vote by vote: when it is held, until when, and when it is lost."""

import itertools
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vobc.train_to_train.guards import LeaseGuards, without
from vobc.train_to_train.lease import ArbiterRequest, Lease, LeaseState
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import LeaseAnswer, LeaseKind, RosterEntry

MS = 1_000_000
LEASE_NS = 299_400_000
"""300 ms as measured by a holder whose clock may be slow by 0.2 %, ns."""
OWN = 5
ONE = T2tConfig()
THREE = T2tConfig(arbiters=(65_001, 65_002, 65_003))
FIVE = T2tConfig(arbiters=(65_001, 65_002, 65_003, 65_004, 65_005))
A, B, C, D = 65_001, 65_002, 65_003, 65_004
YOUNG = (RosterEntry(7, 500.0, True),)
OLD = (RosterEntry(8, 100.0, False),)


def lease_of(config: T2tConfig = ONE, guards: LeaseGuards | None = None) -> Lease:
    return Lease(config, guards or LeaseGuards())


class Kept(NamedTuple):
    """The roster that an arbiter reports."""

    term: int = 0
    version: int = 0
    roster: tuple[RosterEntry, ...] = ()


def grant(
    request: ArbiterRequest,
    arbiter: int = A,
    *,
    term: int | None = None,
    nonce: int | None = None,
    kept: Kept = Kept(),  # noqa: B008
    echo_ns: int = 0,
) -> LeaseAnswer:
    term = request.term if term is None else term
    nonce = request.nonce if nonce is None else nonce
    head = (arbiter, OWN, 1, term, 1, 1, 0)
    return LeaseAnswer(*head, True, nonce, echo_ns, OWN, 0, *kept)


def refusal(
    request: ArbiterRequest, arbiter: int = A, *, term: int | None = None, wait_ms: int = 0
) -> LeaseAnswer:
    term = request.term if term is None else term
    head = (arbiter, OWN, 1, term, 1, 1, 0)
    return LeaseAnswer(*head, False, request.nonce, 0, 9, wait_ms * MS, 0, 0, ())


def asked(lease: Lease, at_ms: int = 1000) -> ArbiterRequest:
    return lease.ask(at_ms * MS, seen_term=0, tried_term=0)


def held(config: T2tConfig = ONE, *, at_ms: int = 1000) -> tuple[Lease, ArbiterRequest]:
    """A lease that the necessary number of arbiters granted at once."""
    lease = lease_of(config)
    request = asked(lease, at_ms)
    for arbiter in config.arbiters[: config.majority]:
        lease.on_message(grant(request, arbiter), at_ms * MS)
    assert lease.state is LeaseState.HELD
    return lease, request


# Before the first request.


def test_before_the_first_request_there_is_no_lease() -> None:
    lease = lease_of()

    assert lease.state is LeaseState.NONE
    assert (lease.term, lease.confirmed_term, lease.successor) == (0, 0, 0)
    assert (lease.until_ns, lease.wait_until_ns) == (0, 0)
    assert lease.adopted == (0, 0, ())
    assert lease.beaten is False
    assert not lease.runs(-1000 * MS)
    assert not lease.lost(1000 * MS)


def test_the_times_of_a_lease_count_from_the_beginning_of_the_clock() -> None:
    lease = lease_of()

    assert lease.attempt_ends_ns() == 100 * MS
    assert lease.renewal_due_ns() == 75 * MS
    # The holder waited longer than a renewal period of 75 ms and a margin of 10 ms.
    assert lease.renew(86 * MS).less_ns == 1 * MS


# Requests.


def test_an_application_asks_for_a_whole_lease_under_an_unused_term() -> None:
    lease = lease_of()

    first = lease.ask(1000 * MS, seen_term=3, tried_term=5)
    lease.on_message(refusal(first, term=8), 1010 * MS)
    second = lease.ask(1200 * MS, seen_term=3, tried_term=6)

    assert first == ArbiterRequest(LeaseKind.ACQUIRE, term=6, nonce=1, successor=0, less_ns=0)
    assert second == ArbiterRequest(LeaseKind.ACQUIRE, term=9, nonce=2, successor=0, less_ns=0)
    assert lease.term == 9
    assert lease.state is LeaseState.ASKED


def test_a_renewal_names_the_successor_and_is_due_a_period_after_the_last_request() -> None:
    lease, request = held()
    lease.successor = 7
    assert lease.renewal_due_ns() == 1075 * MS

    renewal = lease.renew(1080 * MS)

    assert renewal == ArbiterRequest(LeaseKind.RENEW, request.term, 2, successor=7, less_ns=0)
    assert lease.renewal_due_ns() == 1155 * MS


def test_late_answers_do_not_revive_a_returned_lease() -> None:
    lease, request = held()
    late = lease.renew(1075 * MS)

    given = lease.give_back(1080 * MS)
    lease.on_message(grant(late), 1085 * MS)
    lease.on_message(grant(request), 1085 * MS)

    assert given == ArbiterRequest(LeaseKind.RELEASE, request.term, 3, successor=0, less_ns=0)
    assert lease.state is LeaseState.NONE
    assert not lease.runs(1085 * MS)
    assert lease.until_ns == 1000 * MS + LEASE_NS


def test_no_answer_to_a_returned_lease_counts() -> None:
    """Neither a vote nor a refusal counts for the next candidacy."""
    lease, _ = held()
    given = lease.give_back(1080 * MS)

    lease.on_message(refusal(given, term=1, wait_ms=500), 1085 * MS)

    assert lease.wait_until_ns == 0


def test_a_new_application_discards_the_state_of_the_last_attempt() -> None:
    lease = lease_of()
    first = asked(lease)
    lease.on_message(grant(first, kept=Kept(3, 4, YOUNG)), 1005 * MS)
    lease.successor = 7
    renewal = lease.renew(1010 * MS)
    lease.on_message(refusal(renewal, term=first.term + 1, wait_ms=200), 1015 * MS)
    assert lease.beaten
    # The renewal took 5 ms to be refused.
    assert lease.wait_until_ns == 1_210_625_000
    assert lease.adopted.version == 4

    lease.ask(1060 * MS, seen_term=0, tried_term=0)

    assert lease.state is LeaseState.ASKED
    assert lease.adopted == (0, 0, ())
    assert (lease.successor, lease.beaten) == (0, False)
    assert (lease.until_ns, lease.wait_until_ns) == (0, 0)
    assert not lease.lost(1159 * MS)
    # No grant of this attempt is confirmed, so the train may not rely on any.
    assert lease.renew(1070 * MS).less_ns == LEASE_NS


# Votes.


def test_two_of_three_grants_make_a_lease_that_counts_from_the_request() -> None:
    lease = lease_of(THREE)
    request = asked(lease)

    lease.on_message(grant(request, A), 1010 * MS)
    lease.on_message(grant(request, A), 1011 * MS)
    assert lease.until_ns == 0  # Two grants of one arbiter count as one.
    lease.on_message(grant(request, C), 1050 * MS)

    assert lease.state is LeaseState.HELD
    assert lease.until_ns == 1000 * MS + LEASE_NS


def test_votes_for_two_requests_are_not_added_up() -> None:
    lease = lease_of(THREE)
    first = asked(lease)
    second = lease.renew(1010 * MS)

    lease.on_message(grant(first, A), 1020 * MS)
    lease.on_message(grant(second, B), 1020 * MS)

    assert lease.state is LeaseState.ASKED


@pytest.mark.parametrize("arbiter", [0, 5, 65_000, 65_002, 65_099])
def test_answers_of_unknown_arbiters_do_not_count(arbiter: int) -> None:
    lease = lease_of(ONE)
    request = asked(lease)

    lease.on_message(grant(request, arbiter), 1010 * MS)
    lease.on_message(refusal(request, arbiter, term=30, wait_ms=50), 1010 * MS)

    assert lease.state is LeaseState.ASKED
    assert not lease.lost(1010 * MS)
    assert (lease.confirmed_term, lease.wait_until_ns) == (0, 0)


@pytest.mark.parametrize(
    ("term", "nonce"), [(0, 2), (1, 2), (3, 2), (2, 1), (2, 3), (2, 99), (1, 1), (2, 0)]
)
def test_a_grant_for_another_term_or_another_request_does_not_count_as_a_vote(
    term: int, nonce: int
) -> None:
    lease = lease_of()
    first = asked(lease)
    second = lease.ask(1200 * MS, seen_term=0, tried_term=first.term)
    assert (second.term, second.nonce) == (2, 2)

    lease.on_message(
        grant(second, term=term, nonce=nonce, echo_ns=1200 * MS, kept=Kept(1, 1, OLD)), 1210 * MS
    )

    assert lease.state is LeaseState.ASKED
    assert lease.until_ns == 0
    assert lease.adopted == (0, 0, ())


def test_answers_to_requests_older_than_the_last_eight_do_not_count() -> None:
    """The time that an answer itself reports does not count."""
    lease, first = held()
    renewals = [lease.renew((1000 + n) * MS) for n in range(1, 10)]

    for late in (first, renewals[0]):
        lease.on_message(grant(late, echo_ns=5000 * MS), 1020 * MS)
        assert lease.until_ns == 1000 * MS + LEASE_NS
    lease.on_message(grant(renewals[1]), 1020 * MS)
    assert lease.until_ns == 1002 * MS + LEASE_NS


def test_a_late_grant_of_an_older_request_shortens_nothing() -> None:
    lease, first = held(THREE)
    renewal = lease.renew(1075 * MS)
    lease.on_message(grant(renewal, A), 1080 * MS)
    lease.on_message(grant(renewal, B), 1080 * MS)
    assert lease.until_ns == 1075 * MS + LEASE_NS

    lease.on_message(grant(first, C), 1090 * MS)

    assert lease.until_ns == 1075 * MS + LEASE_NS


@given(
    steps=st.lists(
        st.one_of(
            st.integers(1, 120),
            st.tuples(st.integers(0, 9), st.sampled_from(FIVE.arbiters)),
        ),
        max_size=40,
    )
)
def test_a_lease_ends_with_the_newest_request_that_a_majority_granted(
    steps: list[int | tuple[int, int]],
) -> None:
    """The oracle counts the answers arbiter by arbiter, whatever comes in whatever order."""
    lease = lease_of(FIVE)
    now_ms = 1000
    requests = [(now_ms, asked(lease, now_ms))]
    voters: dict[int, set[int]] = {}
    until_ns = 0
    for step in steps:
        if isinstance(step, int):
            now_ms += step
            requests.append((now_ms, lease.renew(now_ms * MS)))
            continue
        back, arbiter = step
        if back >= min(len(requests), 8):
            continue
        sent_ms, request = requests[-1 - back]
        lease.on_message(grant(request, arbiter), now_ms * MS)
        voters.setdefault(request.nonce, set()).add(arbiter)
        ends_ns = sent_ms * MS + LEASE_NS - request.less_ns
        if len(voters[request.nonce]) >= 3 and (until_ns or now_ms * MS + 10 * MS < ends_ns):
            until_ns = max(until_ns, ends_ns)

    assert lease.until_ns == until_ns
    assert (lease.state is LeaseState.HELD) == (until_ns > 0)
    assert lease.runs(until_ns - 10 * MS - 1) == (until_ns > 0)
    assert not lease.runs(until_ns - 10 * MS)


# The roster that comes with a grant.


@pytest.mark.parametrize(
    ("first", "second", "adopted"),
    [
        (Kept(3, 4, OLD), Kept(3, 5, YOUNG), (3, 5, YOUNG)),
        (Kept(3, 9, OLD), Kept(4, 1, YOUNG), (4, 1, YOUNG)),
        (Kept(3, 5, YOUNG), Kept(3, 4, OLD), (3, 5, YOUNG)),
        (Kept(4, 1, YOUNG), Kept(3, 9, OLD), (4, 1, YOUNG)),
        (Kept(4, 1, YOUNG), Kept(4, 1, OLD), (4, 1, YOUNG)),
        (Kept(0, 0, OLD), Kept(0, 1, YOUNG), (0, 1, YOUNG)),
    ],
)
def test_a_candidate_adopts_the_newest_roster_by_term_and_then_by_version(
    first: Kept, second: Kept, adopted: tuple[int, int, tuple[RosterEntry, ...]]
) -> None:
    lease = lease_of(THREE)
    request = asked(lease)

    lease.on_message(grant(request, A, kept=first), 1010 * MS)
    lease.on_message(grant(request, B, kept=second), 1010 * MS)

    assert lease.state is LeaseState.HELD
    assert lease.adopted == adopted


def test_a_lease_holder_adopts_no_other_roster() -> None:
    """From then on its own roster is the newest, whatever a slow arbiter still reports."""
    lease = lease_of(THREE)
    request = asked(lease)
    lease.on_message(grant(request, A, kept=Kept(3, 4, OLD)), 1010 * MS)
    lease.on_message(grant(request, B, kept=Kept(3, 4, OLD)), 1010 * MS)

    lease.on_message(grant(request, C, kept=Kept(3, 5, YOUNG)), 1020 * MS)
    lease.on_message(grant(request, C, kept=Kept(2, 1, YOUNG)), 1020 * MS)

    assert lease.adopted == (3, 4, OLD)


# Refusals.


def test_the_longest_wait_of_all_refusals_counts() -> None:
    lease = lease_of(FIVE)
    request = asked(lease)

    lease.on_message(refusal(request, A, wait_ms=40), 1010 * MS)
    assert lease.wait_until_ns == 1_041_250_000
    lease.on_message(refusal(request, B, wait_ms=10), 1011 * MS)
    assert lease.wait_until_ns == 1_041_250_000
    lease.on_message(refusal(request, C, wait_ms=90), 1012 * MS)
    assert lease.wait_until_ns == 1_091_500_000


def test_a_wait_that_is_over_when_the_refusal_arrives_ends_at_once() -> None:
    """The next request takes as long to the arbiter as this one did."""
    lease = lease_of()
    request = asked(lease)

    lease.on_message(refusal(request, wait_ms=40), 1200 * MS)

    assert lease.wait_until_ns == 1200 * MS


def test_only_the_term_of_a_refusal_of_another_attempt_counts() -> None:
    lease = lease_of()
    first = asked(lease)
    lease.ask(1200 * MS, seen_term=0, tried_term=first.term)

    lease.on_message(refusal(first, term=30, wait_ms=500), 1210 * MS)

    assert lease.confirmed_term == 30
    assert lease.wait_until_ns == 0
    assert not lease.lost(1210 * MS)
    lease.on_message(refusal(first, term=20), 1220 * MS)
    assert lease.confirmed_term == 30


@pytest.mark.parametrize(
    ("config", "refused_by", "lost"),
    [
        (ONE, (A,), True),
        (THREE, (), False),
        (THREE, (A,), False),
        (THREE, (A, A), False),
        (THREE, (A, B), True),
        (THREE, (A, B, C), True),
        (FIVE, (A, B), False),
        (FIVE, (A, B, C), True),
        (FIVE, (A, B, C, D), True),
    ],
)
def test_a_candidacy_is_lost_as_soon_as_no_majority_is_left(
    config: T2tConfig, refused_by: tuple[int, ...], *, lost: bool
) -> None:
    lease = lease_of(config)
    request = asked(lease)

    for arbiter in refused_by:
        lease.on_message(refusal(request, arbiter), 1005 * MS)

    assert lease.lost(1005 * MS) is lost


@pytest.mark.parametrize(("after_ns", "lost"), [(99_999_999, False), (100_000_000, True)])
def test_a_candidacy_with_some_grants_and_no_majority_is_lost_after_100_ms(
    after_ns: int, *, lost: bool
) -> None:
    lease = lease_of(THREE)
    lease.on_message(grant(asked(lease)), 1010 * MS)

    assert lease.attempt_ends_ns() == 1100 * MS
    assert lease.lost(1000 * MS + after_ns) is lost


@pytest.mark.parametrize("answer_ms", [20, 50, 51, 120, 400])
def test_a_candidate_waits_for_a_majority_twice_as_long_as_an_arbiter_takes(
    answer_ms: int,
) -> None:
    lease = lease_of(THREE)
    request = asked(lease)

    lease.on_message(refusal(request), (1000 + answer_ms) * MS)

    lost_ms = 1000 + max(100, 2 * answer_ms)
    assert not lease.lost(lost_ms * MS - 1)
    assert lease.lost(lost_ms * MS)


def test_a_candidacy_without_any_answer_goes_on() -> None:
    lease = lease_of()
    asked(lease)

    assert not lease.lost(60_000 * MS)
    assert lease.is_late(60_000 * MS)


def test_a_candidate_repeats_its_request_under_the_same_term_until_it_is_answered() -> None:
    """It asks as often as a master renews, and less and less often while no arbiter answers."""
    lease = lease_of()
    asked(lease)
    times_ms = []
    for _ in range(9):
        at_ns = lease.asks_again_ns()
        times_ms.append(at_ns / MS - 1000)
        again = lease.ask_again(at_ns)
        assert (again.kind, again.term, again.nonce) == (LeaseKind.ACQUIRE, 1, len(times_ms) + 1)

    assert times_ms[:4] == [75, 150, 225, 337.5]
    steps_ms = [after - before for before, after in itertools.pairwise(times_ms)]
    assert steps_ms == sorted(steps_ms)
    assert steps_ms[-1] == 500


def test_a_late_grant_of_any_request_of_the_attempt_counts() -> None:
    """The lease counts from the request that was granted, and only while it lasts."""
    lease = lease_of()
    first = asked(lease)
    second = lease.ask_again(1200 * MS)

    lease.on_message(grant(first), 1295 * MS)
    assert lease.until_ns == 0

    lease.on_message(grant(second), 1400 * MS)
    assert lease.state is LeaseState.HELD
    assert lease.until_ns == 1200 * MS + LEASE_NS


def test_an_arbiter_that_grants_a_repeated_request_no_longer_counts_as_refusing() -> None:
    lease = lease_of(THREE)
    lease.on_message(refusal(asked(lease), A), 1010 * MS)
    again = lease.ask_again(1075 * MS)
    lease.on_message(grant(again, A), 1085 * MS)

    lease.on_message(refusal(again, B), 1085 * MS)

    assert not lease.lost(1090 * MS)


def test_the_round_trip_follows_a_slow_answer_at_once_and_quick_ones_slowly() -> None:
    """An answer to an earlier attempt tells as much as any other."""
    lease = lease_of()
    first = asked(lease)
    lease.give_back(1100 * MS)
    lease.on_message(refusal(first), 1400 * MS)
    assert lease.round_trip_ns == 400 * MS

    second = lease.ask(1500 * MS, seen_term=0, tried_term=1)
    lease.on_message(grant(second), 1510 * MS)

    assert lease.round_trip_ns == 350 * MS


def test_a_holder_or_former_holder_cannot_lose_a_candidacy() -> None:
    lease, _ = held(THREE)
    renewal = lease.renew(1075 * MS)
    lease.on_message(refusal(renewal, A), 1080 * MS)
    lease.on_message(refusal(renewal, B), 1080 * MS)
    assert not lease.lost(5000 * MS)

    lease.give_back(5000 * MS)

    assert not lease.lost(5000 * MS)


@pytest.mark.parametrize(("term", "beaten"), [(0, False), (1, False), (2, True), (30, True)])
def test_a_holder_is_beaten_when_a_higher_term_is_acknowledged(term: int, *, beaten: bool) -> None:
    """A restarted arbiter refuses too, and may well renew the lease later."""
    lease, request = held()
    assert request.term == 1
    renewal = lease.renew(1075 * MS)

    lease.on_message(refusal(renewal, term=term), 1080 * MS)

    assert lease.beaten is beaten
    assert lease.state is LeaseState.HELD


def test_a_beaten_holder_stays_beaten() -> None:
    lease, _ = held(THREE)
    renewal = lease.renew(1075 * MS)
    lease.on_message(refusal(renewal, A, term=2), 1080 * MS)

    lease.on_message(refusal(renewal, B, term=1), 1081 * MS)

    assert lease.beaten


def test_a_candidate_is_not_beaten_before_it_holds_anything() -> None:
    lease = lease_of(THREE)
    request = asked(lease)

    lease.on_message(refusal(request, A, term=30), 1010 * MS)

    assert not lease.beaten


# Validity of a lease, and how much less a renewal asks for.


@pytest.mark.parametrize(
    ("now_ns", "runs"),
    [(1_000_000_000, True), (1_289_399_999, True), (1_289_400_000, False), (2_000_000_000, False)],
)
def test_a_lease_runs_until_a_margin_of_10_ms_before_its_end(now_ns: int, *, runs: bool) -> None:
    lease, _ = held()

    assert lease.runs(now_ns) is runs


def test_an_unanswered_renewal_does_not_lengthen_a_lease() -> None:
    lease, _ = held()

    lease.renew(1280 * MS)

    assert not lease.runs(1_289_400_000)


def test_an_application_does_not_count_as_a_running_lease() -> None:
    lease = lease_of()
    asked(lease)

    assert not lease.runs(-1000 * MS)


@pytest.mark.parametrize(
    ("answered_ms", "at_ms", "less_ms"),
    [
        (1000, 1085, 0),
        (1000, 1086, 1),
        (1030, 1115, 0),
        (1030, 1116, 1),
        (1030, 1200, 85),
        (1000, 1384, 299),
    ],
)
def test_a_renewal_asks_for_as_much_less_as_the_last_answer_is_overdue(
    answered_ms: int, at_ms: int, less_ms: int
) -> None:
    """The usual wait is 75 ms between renewals, 10 ms of margin, and the time of the last
    answer."""
    lease = lease_of()
    lease.on_message(grant(asked(lease)), answered_ms * MS)

    renewal = lease.renew(at_ms * MS)

    assert renewal.less_ns == less_ms * MS
    lease.on_message(grant(renewal), at_ms * MS)
    assert lease.until_ns == max(1000 * MS + LEASE_NS, at_ms * MS + LEASE_NS - less_ms * MS)


def test_a_request_is_never_shortened_below_zero() -> None:
    lease, _ = held()

    assert lease.renew(60_000 * MS).less_ns == LEASE_NS


def test_the_answer_time_is_that_of_the_majority_and_not_of_the_slowest() -> None:
    lease = lease_of(THREE)
    request = asked(lease)
    lease.on_message(grant(request, A), 1005 * MS)
    lease.on_message(grant(request, B), 1010 * MS)
    lease.on_message(grant(request, C), 1060 * MS)

    # 75 ms and 10 ms, and the 10 ms that the majority took.
    assert lease.renew(1100 * MS).less_ns == 5 * MS


def test_a_late_answer_to_an_older_request_does_not_change_the_answer_time() -> None:
    lease, first = held(THREE)
    renewal = lease.renew(1075 * MS)
    lease.on_message(grant(renewal, A), 1080 * MS)
    lease.on_message(grant(renewal, B), 1080 * MS)

    lease.on_message(grant(first, C), 1155 * MS)

    assert lease.renew(1166 * MS).less_ns == 1 * MS


def test_a_request_at_clock_zero_is_confirmed_like_any_other() -> None:
    lease = lease_of()
    request = lease.ask(1, seen_term=0, tried_term=0)

    lease.on_message(grant(request), 20 * MS + 1)

    assert lease.renew(105 * MS + 1).less_ns == 0
    assert lease.renew(106 * MS + 1).less_ns == 1 * MS


# A lease with a guard removed, as in simulations.


def test_without_the_majority_guard_every_request_succeeds_at_once() -> None:
    lease = lease_of(THREE, without(LeaseGuards(), "granted_by_majority"))

    asked(lease)

    assert lease.state is LeaseState.HELD
    assert lease.until_ns == 1000 * MS + LEASE_NS


def test_without_the_attempt_guard_an_unrequested_answer_counts_from_its_echo() -> None:
    """The guard exists to prevent this mistake."""
    lease = lease_of(THREE, without(LeaseGuards(), "answers_this_attempt"))
    request = asked(lease)

    lease.on_message(grant(request, A, nonce=77, echo_ns=2000 * MS), 2005 * MS)
    lease.on_message(grant(request, B, nonce=77, echo_ns=3000 * MS), 2005 * MS)

    assert lease.state is LeaseState.HELD
    assert lease.until_ns == 2000 * MS + LEASE_NS
