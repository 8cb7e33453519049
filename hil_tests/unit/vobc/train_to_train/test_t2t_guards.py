"""Every guard of the line at its edges, in isolation."""

import dataclasses
import math

import pytest

from vobc.train_to_train import guards
from vobc.train_to_train.guards import (
    Acknowledgement,
    Attempt,
    Claimed,
    Commitment,
    Fence,
    Freshness,
    Granted,
    InLine,
    Latency,
    LeaseClock,
    LeaseGuards,
    MasterGuards,
    MemberGuards,
    Neighbours,
    Offer,
    Reach,
    Terms,
    Votes,
    answers_this_attempt,
    cannot_reach,
    cleared_after,
    comes_in_line,
    for_this_incarnation,
    granted_by_majority,
    granted_until_ns,
    has_promised,
    latent_authority_m,
    lease_runs,
    newer_than_held,
    object_confirmed,
    owner_of_term,
    placed_apart,
    report_alive,
    roster_kept,
    sieved,
    term_not_old,
    track_known,
    unused_term,
    without,
    young_enough,
)
from zenoh_config.t2t import BROADCAST, AreaAuthority, ObjectState, ObjectStatus


def offer(
    *, boot: int = 6, age_ns: int = 0, now_ns: int = 1000, term: int = 4, sequence: int = 7
) -> Offer:
    """An authority for a train in incarnation 6 that took number 7 of term 4 and accepts at most
    100 ns of age."""
    head = (9, 5, 1, term, 1, sequence, 0)
    told = AreaAuthority(*head, boot, now_ns - age_ns, 900.0, 0.0, 0, 1, ())
    return Offer(told, now_ns, 6, (4, 7), 100)


@pytest.mark.parametrize(("boot", "meant"), [(5, False), (6, True), (7, False)])
def test_an_authority_is_for_one_incarnation_of_a_train(boot: int, *, meant: bool) -> None:
    assert for_this_incarnation(offer(boot=boot)) is meant


@pytest.mark.parametrize("now_ns", [50, 1000])
@pytest.mark.parametrize(
    ("age_ns", "young"), [(-1, False), (0, True), (1, True), (99, True), (100, True), (101, False)]
)
def test_an_authority_is_as_old_as_the_report_that_it_answers(
    age_ns: int, now_ns: int, *, young: bool
) -> None:
    assert young_enough(offer(age_ns=age_ns, now_ns=now_ns)) is young


@pytest.mark.parametrize(
    ("term", "sequence", "newer"),
    [(4, 7, False), (4, 8, True), (4, 6, False), (5, 1, True), (3, 99, False)],
)
def test_authorities_are_in_order_by_term_and_then_by_number(
    term: int, sequence: int, *, newer: bool
) -> None:
    assert newer_than_held(offer(term=term, sequence=sequence)) is newer


@pytest.mark.parametrize(("term", "fits"), [(3, False), (4, True), (5, True)])
def test_no_term_below_the_highest_received_is_obeyed(term: int, *, fits: bool) -> None:
    assert term_not_old(Fence(term, 9, 4, 9)) is fits


@pytest.mark.parametrize(
    ("term", "source", "fits"),
    [(4, 9, True), (4, 8, False), (5, 9, True), (5, 8, True), (3, 8, True)],
)
def test_a_received_term_has_one_owner_and_a_newer_one_none_yet(
    term: int, source: int, *, fits: bool
) -> None:
    assert owner_of_term(Fence(term, source, 4, 9)) is fits


@pytest.mark.parametrize(
    ("before_m", "held_end_m", "reach_m", "latent_m"),
    [
        (900.0, None, 620.0, 620.0),
        (600.0, None, 620.0, 600.0),
        (400.0, None, 620.0, 500.0),
        (900.0, None, 500.0, 500.0),
        (900.0, 700.0, 620.0, 700.0),
        (900.0, 550.0, 620.0, 620.0),
        (600.0, 550.0, 620.0, 600.0),
        (520.0, 550.0, 620.0, 550.0),
        (400.0, 450.0, 620.0, 500.0),
        (math.inf, 450.0, 620.0, 620.0),
    ],
)
def test_the_farthest_point_is_the_held_end_or_the_stopping_place_of_the_former_one(
    before_m: float, held_end_m: float | None, reach_m: float, latent_m: float
) -> None:
    """The front of the train is at 500 m."""
    assert latent_authority_m(Latency(before_m, held_end_m, reach_m, 500.0)) == latent_m


@pytest.mark.parametrize(("less_ns", "until_ns"), [(0, 1300), (1, 1299), (300, 1000)])
def test_a_grant_counts_from_its_request_and_for_the_requested_time(
    less_ns: int, until_ns: int
) -> None:
    assert granted_until_ns(Granted(1000, 300, less_ns)) == until_ns


@pytest.mark.parametrize(("reported", "promised"), [(3, False), (4, True), (5, False)])
def test_a_train_acknowledges_exactly_the_masters_term(reported: int, *, promised: bool) -> None:
    assert has_promised(Acknowledgement(reported, 4)) is promised


@pytest.mark.parametrize(
    ("line", "comes"),
    [
        (InLine(True, True, 7, 7), True),
        (InLine(True, True, 0, 7), True),
        (InLine(True, True, 0, 0), True),
        (InLine(True, True, 8, 7), False),
        (InLine(True, True, 7, 0), False),
        (InLine(True, False, 7, 7), False),
        (InLine(True, False, 0, 7), False),
        (InLine(False, False, 8, 7), True),
        (InLine(False, True, 8, 7), True),
    ],
)
def test_a_train_over_the_border_must_follow_the_last_train_here(
    line: InLine, *, comes: bool
) -> None:
    """A train without one ahead may come up to the border. Its authority there must name the
    same train ahead."""
    assert comes_in_line(line) is comes


@pytest.mark.parametrize(
    ("reserved_m", "rear_m", "never"),
    [
        (500.0, 0.0, True),
        (500.1, 0.0, False),
        (900.0, 519.9, False),
        (900.0, 520.0, True),
        (900.0, 510.0, False),
        (510.0, 400.0, False),
        (400.0, 300.0, True),
        (900.0, 600.0, True),
    ],
)
def test_an_object_from_500_to_520_m_is_out_of_reach_past_its_end_or_before_its_start(
    reserved_m: float, rear_m: float, *, never: bool
) -> None:
    assert cannot_reach(Reach(reserved_m, rear_m, 500.0, 520.0)) is never


@pytest.mark.parametrize("shown", [True, False])
def test_a_train_is_sieved_when_axle_counts_prove_it(*, shown: bool) -> None:
    assert sieved(shown) is shown


def test_a_removed_guard_passes_everything_and_the_others_stay() -> None:
    member = without(MemberGuards(), "young_enough", "term_not_old")

    assert member.young_enough(offer(age_ns=101)) is True
    assert member.term_not_old(Fence(3, 9, 4, 9)) is True
    assert member.for_this_incarnation(offer(boot=5)) is False
    assert member.owner_of_term(Fence(4, 8, 4, 9)) is False
    assert MemberGuards().young_enough(offer(age_ns=101)) is False


@pytest.mark.parametrize("of", [MemberGuards, LeaseGuards, MasterGuards])
def test_every_guard_stands_under_its_own_name(
    of: type[MemberGuards] | type[LeaseGuards] | type[MasterGuards],
) -> None:
    for field in dataclasses.fields(of):
        assert getattr(of(), field.name) is getattr(guards, field.name)


@pytest.mark.parametrize(
    ("age_ns", "alive"), [(-1, False), (0, True), (1, True), (99, True), (100, True), (101, False)]
)
def test_a_report_counts_from_its_instant_to_its_maximum_age_inclusive(
    age_ns: int, *, alive: bool
) -> None:
    """Negative ages come from clocks that were set back."""
    assert report_alive(Freshness(age_ns, 100)) is alive
    assert track_known(Freshness(age_ns, 100)) is alive


@pytest.mark.parametrize(("age_ns", "after"), [(-1, False), (0, True), (1, True)])
def test_sections_seen_clear_at_the_instant_of_a_report_count_as_seen_after_it(
    age_ns: int, *, after: bool
) -> None:
    assert cleared_after(age_ns) is after


@pytest.mark.parametrize(
    ("term", "nonce", "answers"), [(7, 3, True), (6, 3, False), (7, 2, False), (3, 7, False)]
)
def test_an_answer_belongs_to_this_attempt_by_term_and_number(
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
    """A number of 0 is no claim, although an object that received none sends it too."""
    assert object_confirmed(Claimed(said, 5, nonce)) is confirmed


@pytest.mark.parametrize(("votes", "enough"), [(0, False), (1, False), (2, True), (3, True)])
def test_two_of_three_are_a_majority(votes: int, *, enough: bool) -> None:
    assert granted_by_majority(Votes(votes, 2)) is enough
    assert roster_kept(Commitment(votes, 2)) is enough


@pytest.mark.parametrize(("now_ns", "runs"), [(889, True), (890, False), (891, False)])
def test_a_lease_counts_while_a_message_decided_now_leaves_before_its_end(
    now_ns: int, *, runs: bool
) -> None:
    assert lease_runs(LeaseClock(now_ns, 900, 10)) is runs


@pytest.mark.parametrize("terms", [Terms(7, 3, 4), Terms(3, 7, 4), Terms(4, 3, 7), Terms(7, 7, 7)])
def test_a_requested_term_exceeds_every_seen_refused_or_tried_one(terms: Terms) -> None:
    assert unused_term(terms) == 8
