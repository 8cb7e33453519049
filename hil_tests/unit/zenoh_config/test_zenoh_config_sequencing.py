"""Receivers accept each message once, in order, in time, and only when it is for them."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_config.messages import (
    MovementAuthority,
    PositionReport,
    Refused,
    RefusedReason,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sequencing import AuthorityGate, OrdersGate, ReportGate

MS = 1_000_000
NOW_NS = 10_000 * MS
MAX_AGE_NS = 1000 * MS
AUTHORITY = MovementAuthority(7, 3, term=2, sequence=50, echo_stamp_ns=NOW_NS - 300 * MS, end_m=9.0)
REPORT = PositionReport(7, 3, 50, NOW_NS, 10.0, 11.0, -60.0, 1.0, False)
ORDERS = TrainOrders(
    7, 3, 50, NOW_NS - 300 * MS, True, False, False, False, False, 0, False, False, False, False,
    True,
)  # fmt: skip
STATUS = TrainStatus(
    7, 3, 50, NOW_NS, 4, 1, 0, True, False, 10.0, True, False, False, False, False, False, False
)  # fmt: skip


def authority_gate(seen_term: int = 0) -> AuthorityGate:
    return AuthorityGate(train=7, boot=3, max_age_ns=MAX_AGE_NS, seen_term=seen_term)


def reason(refused: Refused | None) -> RefusedReason | None:
    return None if refused is None else refused.reason


def test_an_authority_is_accepted_once() -> None:
    gate = authority_gate()

    assert gate.check(AUTHORITY, NOW_NS) is None
    assert reason(gate.check(AUTHORITY, NOW_NS)) is RefusedReason.NOT_NEWER
    assert (gate.accepted, gate.refusals.total(), gate.seen_term) == (1, 1, 2)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"train": 8}, RefusedReason.WRONG_DESTINATION),
        ({"source": 9}, RefusedReason.WRONG_SOURCE),
        ({"boot": 2}, RefusedReason.WRONG_BOOT),
        ({"boot": 4}, RefusedReason.WRONG_BOOT),
        ({"term": 1}, RefusedReason.OLD_TERM),
        ({"term": 1, "sequence": 99}, RefusedReason.OLD_TERM),
        ({"sequence": 50}, RefusedReason.NOT_NEWER),
        ({"sequence": 49}, RefusedReason.NOT_NEWER),
        ({"sequence": 51}, None),
        ({"term": 3, "sequence": 0}, None),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS}, None),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS + 1}, RefusedReason.FROM_THE_FUTURE),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS - MAX_AGE_NS}, None),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS - MAX_AGE_NS - 1}, RefusedReason.TOO_OLD),
    ],
)
def test_after_one_authority_the_next_must_be_newer_for_this_train_and_fresh(
    change: dict[str, int], expected: RefusedReason | None
) -> None:
    gate = authority_gate()
    gate.check(AUTHORITY, NOW_NS)

    refused = gate.check(replace(AUTHORITY, **change), NOW_NS)

    assert reason(refused) is expected
    assert gate.refusals == ({} if expected is None else {expected: 1})


def test_terms_received_before_a_restart_still_fence() -> None:
    gate = authority_gate(seen_term=3)

    assert reason(gate.check(AUTHORITY, NOW_NS)) is RefusedReason.OLD_TERM
    assert gate.check(replace(AUTHORITY, term=3, sequence=0), NOW_NS) is None


def leap(sequence: int, age_ms: int, term: int = 2**32 - 1) -> MovementAuthority:
    return replace(AUTHORITY, term=term, sequence=sequence, echo_stamp_ns=NOW_NS - age_ms * MS)


def test_one_authority_with_a_wrong_last_term_does_not_lock_later_ones_out() -> None:
    gate = authority_gate()
    gate.check(AUTHORITY, NOW_NS)

    assert reason(gate.check(leap(1, 100), NOW_NS)) is RefusedReason.TERM_LEAPS
    assert gate.check(replace(AUTHORITY, sequence=51), NOW_NS) is None
    assert reason(gate.check(leap(2, 50), NOW_NS)) is RefusedReason.TERM_LEAPS
    assert gate.seen_term == 2


@pytest.mark.parametrize(
    ("second", "accepted"),
    [
        (leap(2, 99), True),
        (leap(1, 99), False),
        (leap(2, 100), False),
        (leap(2, 99, term=2**32 - 2), False),
    ],
)
def test_a_second_authority_of_the_same_term_confirms_a_leap(
    second: MovementAuthority, accepted: bool
) -> None:
    gate = authority_gate(seen_term=5)
    assert reason(gate.check(leap(1, 100), NOW_NS)) is RefusedReason.TERM_LEAPS

    assert (gate.check(second, NOW_NS) is None) is accepted


@pytest.mark.parametrize(("step", "accepted"), [(1000, True), (1001, False)])
def test_a_step_of_the_term_needs_no_confirmation(step: int, accepted: bool) -> None:
    gate = authority_gate(seen_term=5)

    assert (gate.check(leap(1, 100, 5 + step), NOW_NS) is None) is accepted


def test_a_refused_authority_changes_nothing() -> None:
    gate = authority_gate()
    too_old = replace(AUTHORITY, term=9, sequence=99, echo_stamp_ns=0)

    gate.check(too_old, NOW_NS)

    assert gate.seen_term == 0
    assert gate.check(AUTHORITY, NOW_NS) is None


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5)), max_size=40))
def test_accepted_authorities_only_grow_whatever_the_order_of_arrival(
    arrivals: list[tuple[int, int]],
) -> None:
    gate = authority_gate()

    accepted = [
        (term, sequence)
        for term, sequence in arrivals
        if gate.check(replace(AUTHORITY, term=term, sequence=sequence), NOW_NS) is None
    ]

    assert accepted == sorted(set(accepted))
    if arrivals:
        assert accepted[0] == arrivals[0]
        assert accepted[-1] == max(arrivals)
    assert gate.accepted + gate.refusals.total() == len(arrivals)


def orders_gate() -> OrdersGate:
    return OrdersGate(train=7, boot=3, max_age_ns=MAX_AGE_NS)


def test_orders_are_accepted_once() -> None:
    gate = orders_gate()

    assert gate.check(ORDERS, NOW_NS) is None
    assert reason(gate.check(ORDERS, NOW_NS)) is RefusedReason.NOT_NEWER
    assert (gate.accepted, gate.refusals.total()) == (1, 1)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"train": 8}, RefusedReason.WRONG_DESTINATION),
        ({"source": 9}, RefusedReason.WRONG_SOURCE),
        ({"boot": 2}, RefusedReason.WRONG_BOOT),
        ({"boot": 4}, RefusedReason.WRONG_BOOT),
        ({"sequence": 50}, RefusedReason.NOT_NEWER),
        ({"sequence": 49}, RefusedReason.NOT_NEWER),
        ({"sequence": 51}, None),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS}, None),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS + 1}, RefusedReason.FROM_THE_FUTURE),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS - MAX_AGE_NS}, None),
        ({"sequence": 51, "echo_stamp_ns": NOW_NS - MAX_AGE_NS - 1}, RefusedReason.TOO_OLD),
    ],
)
def test_after_some_orders_the_next_must_be_newer_for_this_train_and_fresh(
    change: dict[str, int], expected: RefusedReason | None
) -> None:
    gate = orders_gate()
    gate.check(ORDERS, NOW_NS)

    refused = gate.check(replace(ORDERS, **change), NOW_NS)  # type: ignore[arg-type]

    assert reason(refused) is expected
    assert gate.refusals == ({} if expected is None else {expected: 1})


def test_refused_orders_change_nothing() -> None:
    gate = orders_gate()

    gate.check(replace(ORDERS, sequence=99, echo_stamp_ns=0), NOW_NS)

    assert gate.check(ORDERS, NOW_NS) is None


@given(st.lists(st.integers(0, 9), min_size=1, max_size=40))
def test_accepted_orders_only_grow_whatever_the_order_of_arrival(arrivals: list[int]) -> None:
    gate = orders_gate()

    accepted = [
        sequence
        for sequence in arrivals
        if gate.check(replace(ORDERS, sequence=sequence), NOW_NS) is None
    ]

    assert accepted == sorted(set(accepted))
    assert (accepted[0], accepted[-1]) == (arrivals[0], max(arrivals))
    assert gate.accepted + gate.refusals.total() == len(arrivals)


@pytest.mark.parametrize("report", [REPORT, STATUS], ids=["position", "status"])
def test_a_gate_for_statuses_behaves_like_one_for_reports(
    report: PositionReport | TrainStatus,
) -> None:
    gate = ReportGate()

    assert gate.check(report) is None
    assert reason(gate.check(report)) is RefusedReason.NOT_NEWER
    assert reason(gate.check(replace(report, destination=1))) is RefusedReason.WRONG_DESTINATION
    assert reason(gate.check(replace(report, boot=2, sequence=99))) is RefusedReason.WRONG_BOOT
    assert gate.check(replace(report, boot=4, sequence=0)) is None


def test_a_report_is_accepted_once() -> None:
    gate = ReportGate()

    assert gate.check(REPORT) is None
    assert reason(gate.check(REPORT)) is RefusedReason.NOT_NEWER


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"destination": 1}, RefusedReason.WRONG_DESTINATION),
        ({"boot": 2, "sequence": 99}, RefusedReason.WRONG_BOOT),
        ({"boot": 4, "sequence": 0, "stamp_ns": 0}, None),
        ({"sequence": 49}, RefusedReason.NOT_NEWER),
        ({"sequence": 51, "stamp_ns": NOW_NS - 1}, RefusedReason.NOT_NEWER),
        ({"sequence": 51}, None),
        ({"train": 8, "sequence": 0, "stamp_ns": 0}, None),
    ],
)
def test_after_one_report_the_next_must_be_newer_and_for_us(
    change: dict[str, int], expected: RefusedReason | None
) -> None:
    gate = ReportGate()
    gate.check(REPORT)

    refused = gate.check(replace(REPORT, **change))  # type: ignore[arg-type]

    assert reason(refused) is expected
    assert gate.refusals == ({} if expected is None else {expected: 1})


def test_messages_of_an_ended_incarnation_are_refused() -> None:
    gate = ReportGate()
    gate.check(REPORT)
    gate.check(replace(REPORT, boot=4, sequence=0))

    assert reason(gate.check(replace(REPORT, sequence=51))) is RefusedReason.WRONG_BOOT
    assert gate.check(replace(REPORT, boot=4, sequence=1)) is None
