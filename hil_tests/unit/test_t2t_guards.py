"""Every guard of the line at its edges, one by one, with nothing around it."""

import pytest

from vobc.t2t.guards import (
    Attempt,
    Claimed,
    Clock,
    Commitment,
    Freshness,
    Neighbours,
    Terms,
    Votes,
    answers_this_attempt,
    cleared_after,
    granted_by_majority,
    lease_runs,
    object_confirmed,
    placed_apart,
    report_alive,
    roster_kept,
    track_known,
    unused_term,
)
from zenoh_config.t2t import BROADCAST, ObjectState, ObjectStatus


@pytest.mark.parametrize(
    ("age_ns", "alive"), [(-1, False), (0, True), (1, True), (99, True), (100, True), (101, False)]
)
def test_what_was_said_counts_from_its_very_instant_to_the_last_one_of_its_age(
    age_ns: int, *, alive: bool
) -> None:
    """Ages under 0 are of clocks that were set back."""
    assert report_alive(Freshness(age_ns, 100)) is alive
    assert track_known(Freshness(age_ns, 100)) is alive


@pytest.mark.parametrize(("age_ns", "after"), [(-1, False), (0, True), (1, True)])
def test_sections_seen_clear_at_the_instant_of_a_report_were_seen_after_it(
    age_ns: int, *, after: bool
) -> None:
    assert cleared_after(Freshness(age_ns, 0)) is after


@pytest.mark.parametrize(
    ("term", "nonce", "answers"), [(7, 3, True), (6, 3, False), (7, 2, False), (3, 7, False)]
)
def test_an_answer_is_one_to_this_attempt_by_its_term_and_its_number(
    term: int, nonce: int, *, answers: bool
) -> None:
    assert answers_this_attempt(Attempt(term, nonce, 7, 3)) is answers


@pytest.mark.parametrize(
    ("behind_m", "ahead_m", "apart"),
    [
        (100.0, 200.0, True),
        (100.1, 200.0, False),
        (100.0, 199.9, False),
        (100.1, 199.9, False),
        (0.0, 900.0, True),
    ],
)
def test_an_applicant_from_100_to_200_m_touches_no_neighbour(
    behind_m: float, ahead_m: float, *, apart: bool
) -> None:
    assert placed_apart(Neighbours(behind_m, 100.0, 200.0, ahead_m)) is apart


def status(state: ObjectState, term: int, nonce: int) -> ObjectStatus:
    return ObjectStatus(0, BROADCAST, 1, term, 1, 1, 0, 3, state, term, nonce, False)


@pytest.mark.parametrize(
    ("said", "nonce", "confirmed"),
    [
        (status(ObjectState.LOCKED, 5, 2), 2, True),
        (status(ObjectState.FREE, 5, 2), 2, False),
        (status(ObjectState.FAILED, 5, 2), 2, False),
        (status(ObjectState.LOCKED, 4, 2), 2, False),
        (status(ObjectState.LOCKED, 5, 1), 2, False),
        (status(ObjectState.LOCKED, 5, 0), 0, False),
        (None, 2, False),
    ],
)
def test_an_object_is_confirmed_by_a_lock_for_this_very_claim(
    said: ObjectStatus | None, nonce: int, *, confirmed: bool
) -> None:
    """A number of 0 is no claim, though an object that never heard one says it, too."""
    assert object_confirmed(Claimed(said, 5, nonce)) is confirmed


@pytest.mark.parametrize(("votes", "enough"), [(0, False), (1, False), (2, True), (3, True)])
def test_two_of_three_are_a_majority(votes: int, *, enough: bool) -> None:
    assert granted_by_majority(Votes(votes, 2)) is enough
    assert roster_kept(Commitment(votes, 2)) is enough


@pytest.mark.parametrize(("now_ns", "runs"), [(889, True), (890, False), (891, False)])
def test_a_lease_runs_while_what_is_decided_now_leaves_before_its_end(
    now_ns: int, *, runs: bool
) -> None:
    assert lease_runs(Clock(now_ns, 900, 10)) is runs


@pytest.mark.parametrize("terms", [Terms(7, 3, 4), Terms(3, 7, 4), Terms(4, 3, 7), Terms(7, 7, 7)])
def test_a_term_to_ask_for_is_above_all_that_was_seen_refused_or_tried(terms: Terms) -> None:
    assert unused_term(terms) == 8
