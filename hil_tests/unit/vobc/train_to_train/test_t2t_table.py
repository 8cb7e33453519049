"""A master's records of trains: where each certainly is, what it may hold, and their order."""

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from vobc.train_to_train.guards import MasterGuards, without
from vobc.train_to_train.lease import Kept
from vobc.train_to_train.occupancy import OUTSTANDING_MAX, TrainRecord, TrainTable, cleared_to_m
from vobc.train_to_train.roster import Roster, placed
from zenoh_config.t2t import RosterAck, RosterEntry, SectionState, SyncEntry, TrainReport

TERM = 7
LIFE_NS = 1000
"""Life of an authority, ns."""


def report(rear_m: float = 100.0, **others: Any) -> TrainReport:
    fields = {"boot": 2, "rear_min_m": rear_m, "protected_m": rear_m, "localised": True}
    return replace(REPORT, **{**fields, "echo_ns": 0, **others})


def record(*, boot: int = 2, rear_m: float = 0.0) -> TrainRecord:
    return TrainRecord(4, rear_m, 0, boot=boot)


def heard(told: TrainRecord, *reports: TrainReport, now_ns: int = 0) -> TrainRecord:
    for each in reports:
        told.on_message(each, now_ns, term=TERM, jog_m=5.0)
    return told


def test_for_a_train_known_only_by_its_rear_the_worst_is_assumed() -> None:
    fresh = TrainRecord(4, 120.0, 33)

    assert fresh == TrainRecord(
        train=4,
        rear_m=120.0,
        received_at_ns=33,
        boot=0,
        report=None,
        term=0,
        ready_nonce=None,
        latent_m=1_000_000.0,
        served=False,
        stopped=False,
        sent=[],
    )
    assert fresh.granted_m == 1_000_000.0


def test_a_report_sets_arrival_time_acknowledged_term_and_reserve() -> None:
    told = report(100.0, term=9, ready_nonce=12, latent_m=400.0)

    after = heard(record(), told, now_ns=55)

    assert after == TrainRecord(4, 100.0, 55, 2, told, 9, 12, 400.0)


def test_a_report_without_position_updates_term_and_reserve_only() -> None:
    placed_at = report(100.0)
    lost = report(700.0, boot=3, localised=False, term=9, ready_nonce=12, latent_m=400.0)

    after = heard(record(), placed_at, lost, now_ns=55)

    assert (after.rear_m, after.report, after.boot) == (100.0, placed_at, 2)
    assert (after.received_at_ns, after.term, after.ready_nonce, after.latent_m) == (
        55,
        9,
        12,
        400.0,
    )


@pytest.mark.parametrize(
    ("protected_m", "rear_m"),
    [(90.0, 100.0), (100.0, 100.0), (103.0, 103.0), (105.0, 105.0), (105.1, 105.0)],
)
def test_a_moving_train_is_protected_from_where_it_rests_at_most_a_jog_ahead(
    protected_m: float, rear_m: float
) -> None:
    assert heard(record(), report(100.0, protected_m=protected_m)).rear_m == rear_m


@pytest.mark.parametrize(
    ("boot_before", "boot", "rear_m"),
    [(2, 2, 300.0), (0, 2, 300.0), (1, 2, 100.0), (2, 3, 100.0), (0, 1, 300.0)],
)
def test_a_rear_goes_back_only_with_another_incarnation(
    boot_before: int, boot: int, rear_m: float
) -> None:
    after = heard(record(boot=boot_before, rear_m=300.0), report(100.0, boot=boot))

    assert (after.rear_m, after.boot) == (rear_m, boot)


def test_a_rear_advances_with_every_report() -> None:
    assert heard(record(rear_m=50.0), report(100.0), report(101.0)).rear_m == 101.0


def served(*ends_m: float) -> TrainRecord:
    """A record with authorities 11, 12, ... up to these ends, and no farther point."""
    told = heard(record(), report(latent_m=0.0, held_term=0))
    for sequence, end_m in enumerate(ends_m, start=11):
        told.issued(sequence, end_m, life_ns=LIFE_NS)
    return told


def test_every_outstanding_authority_counts_until_the_train_holds_a_newer_one() -> None:
    told = served(500.0, 400.0)
    assert told.served
    assert told.sent == [(11, 500.0, LIFE_NS), (12, 400.0, LIFE_NS)]
    assert told.granted_m == 500.0


@pytest.mark.parametrize(
    ("held_term", "held_sequence", "sent"),
    [
        (7, 10, [(11, 500.0, LIFE_NS), (12, 400.0, LIFE_NS), (13, 300.0, LIFE_NS)]),
        (7, 11, [(12, 400.0, LIFE_NS), (13, 300.0, LIFE_NS)]),
        (7, 12, [(13, 300.0, LIFE_NS)]),
        (7, 13, []),
        (6, 12, [(11, 500.0, LIFE_NS), (12, 400.0, LIFE_NS), (13, 300.0, LIFE_NS)]),
        (8, 12, [(11, 500.0, LIFE_NS), (12, 400.0, LIFE_NS), (13, 300.0, LIFE_NS)]),
    ],
)
def test_an_authority_not_newer_than_the_held_one_is_no_longer_outstanding(
    held_term: int, held_sequence: int, sent: list[tuple[int, float, int]]
) -> None:
    told = served(500.0, 400.0, 300.0)

    heard(told, report(held_term=held_term, held_sequence=held_sequence, localised=False))

    assert told.sent == sent


def test_the_reported_farthest_point_counts_as_granted() -> None:
    told = heard(served(500.0), report(latent_m=600.0, held_term=0))

    assert told.granted_m == 600.0
    heard(told, report(latent_m=200.0, held_term=0))
    assert told.granted_m == 500.0


REST_M = [float(each) for each in range(100, 99 + 64)]


def test_sixty_four_outstanding_authorities_are_kept_separately() -> None:
    ends_m = [900.0, *REST_M]

    assert served(*ends_m).sent == [(n, end_m, LIFE_NS) for n, end_m in enumerate(ends_m, start=11)]


@pytest.mark.parametrize(("first_m", "second_m"), [(900.0, 800.0), (800.0, 900.0)])
def test_beyond_that_the_two_oldest_authorities_merge_conservatively(
    first_m: float, second_m: float
) -> None:
    told = heard(record(), report(latent_m=0.0))
    for sequence, end_m in enumerate((first_m, second_m, *REST_M), start=11):
        heard(told, report(latent_m=0.0), now_ns=sequence)
        told.issued(sequence, end_m, life_ns=LIFE_NS)

    assert told.sent == [(n, m, n + LIFE_NS) for n, m in enumerate((900.0, *REST_M), start=12)]


@pytest.mark.parametrize(
    ("echo_ns", "term", "granted_m"),
    [
        (1099, TERM, 500.0),
        (1100, TERM, 400.0),
        (1199, TERM, 400.0),
        (1200, TERM, 50.0),
        (1200, TERM + 1, 500.0),
        (0, TERM, 500.0),
    ],
)
def test_an_authority_too_old_at_the_time_of_the_report_does_not_count_as_granted(
    echo_ns: int, term: int, granted_m: float
) -> None:
    """The train's report answers heartbeats received at 100 and 200 ns. By then the authority is
    too old, and the reported farthest point is from that time, too."""
    told = record()
    for sequence, (end_m, at_ns) in enumerate(((500.0, 100), (400.0, 200)), start=11):
        heard(told, report(latent_m=50.0), now_ns=at_ns)
        told.issued(sequence, end_m, life_ns=LIFE_NS)

    heard(told, report(latent_m=50.0, term=term, echo_ns=echo_ns, localised=False))

    assert told.granted_m == granted_m


@given(
    ends_m=st.lists(st.integers(0, 1000).map(float), min_size=1, max_size=90),
    taken=st.integers(0, 90),
)
def test_no_acceptable_authority_exceeds_the_granted_end(ends_m: list[float], taken: int) -> None:
    told = served(*ends_m)

    heard(told, report(latent_m=0.0, held_term=TERM, held_sequence=10 + taken))

    assert told.granted_m >= max([0.0, *ends_m[taken:]])
    assert len(told.sent) <= OUTSTANDING_MAX


def test_a_members_authority_proves_how_far_the_train_ahead_had_come() -> None:
    member = heard(record(), report(member=True, held_end_m=900.0, latent_m=900.0))
    applicant = heard(record(), report(member=False, held_end_m=900.0))

    assert member.rear_ahead_m(7.0) == 907.0
    assert applicant.rear_ahead_m(7.0) == -1_000_000.0
    assert record().rear_ahead_m(7.0) == -1_000_000.0


def test_a_lost_trains_authority_proves_no_more_than_its_reported_farthest_point() -> None:
    """The authority was shortened since, and another train was placed between the two
    (simulation seed 209865)."""
    told = heard(record(), report(member=True, held_end_m=900.0, latent_m=900.0))

    heard(told, report(localised=False, member=True, held_end_m=300.0, latent_m=400.0))

    assert told.rear_ahead_m(7.0) == 407.0


def test_the_position_at_an_instant_follows_from_the_reports_up_to_then() -> None:
    told = record()
    for at_ns, rear_m in ((100, 50.0), (200, 60.0), (300, 55.0), (400, 70.0)):
        heard(told, report(rear_m), now_ns=at_ns)
    heard(told, report(90.0, localised=False), now_ns=500)

    assert [told.rear_then_m(at_ns) for at_ns in (99, 100, 199, 200, 300, 399, 400, 900)] == [
        *(-1_000_000.0, 50.0, 50.0, 60.0, 60.0, 60.0, 70.0, 70.0)
    ]


def test_the_newest_eight_reports_of_one_incarnation_count_for_that() -> None:
    told = record()
    for at_ns in range(1, 10):
        heard(told, report(10.0 * at_ns), now_ns=at_ns)

    assert [told.rear_then_m(at_ns) for at_ns in (1, 2, 9)] == [-1_000_000.0, 20.0, 90.0]
    heard(told, report(30.0, boot=3), now_ns=10)
    assert [told.rear_then_m(at_ns) for at_ns in (9, 10)] == [-1_000_000.0, 30.0]


def test_a_record_is_made_once() -> None:
    table = TrainTable()

    first = table.of(4, rear_m=120.0, now_ns=33)

    assert first == TrainRecord(4, 120.0, 33)
    assert table.of(4, rear_m=500.0, now_ns=99) is first
    assert table.records == {4: first}


def test_records_of_departed_trains_are_removed() -> None:
    table = TrainTable()
    for train in (1, 2, 3):
        table.of(train, rear_m=0.0, now_ns=0)

    table.forget_but(iter([3, 1, 9]))

    assert set(table.records) == {1, 3}


def table_with(told: TrainRecord) -> TrainTable:
    table = TrainTable()
    table.records[told.train] = told
    return table


def synced(told: TrainRecord | None, rear_m: float, boot: int) -> TrainRecord:
    table = table_with(told) if told is not None else TrainTable()
    table.takes_sync([SyncEntry(4, rear_m, 800.0, boot)], 44)
    assert set(table.records) == {4}
    return table.records[4]


@pytest.mark.parametrize("boot", [0, 1, 2])
def test_a_train_unknown_to_the_standby_is_taken_from_the_masters_record(boot: int) -> None:
    assert synced(None, 250.0, boot) == TrainRecord(4, 250.0, 44, boot)


@pytest.mark.parametrize(
    ("told_m", "boot", "rear_m"),
    [(250.0, 2, 250.0), (150.0, 2, 200.0), (250.0, 1, 200.0), (150.0, 1, 200.0)],
)
def test_a_rear_moves_on_by_the_same_incarnation_only_and_never_back(
    told_m: float, boot: int, rear_m: float
) -> None:
    known = record(boot=2, rear_m=200.0)

    assert synced(known, told_m, boot) is known
    assert known == TrainRecord(4, rear_m, 0, 2)


@pytest.mark.parametrize(("told_m", "boot"), [(250.0, 2), (150.0, 2), (250.0, 1), (250.0, 0)])
def test_a_trains_own_report_overrides_the_masters_record(told_m: float, boot: int) -> None:
    known = heard(record(boot=2), report(200.0), now_ns=5)
    before = replace(known)

    assert synced(known, told_m, boot) is known
    assert known == before


@pytest.mark.parametrize("told_m", [250.0, 150.0])
def test_a_later_incarnation_begins_with_the_masters_record(told_m: float) -> None:
    known = heard(record(boot=2), report(200.0), now_ns=5)

    assert synced(known, told_m, 3) == TrainRecord(4, told_m, 44, 3)


def clear(start_m: float, end_m: float) -> tuple[float, float, SectionState]:
    return start_m, end_m, SectionState(1, False, 0)


def taken(start_m: float, end_m: float) -> tuple[float, float, SectionState]:
    return start_m, end_m, SectionState(1, True, 4)


@pytest.mark.parametrize(
    ("sections", "rear_m"),
    [
        ([], 150.0),
        # The train is past a clear section, but an occupied section may hold it.
        ([clear(100.0, 200.0)], 196.0),
        ([taken(100.0, 200.0)], 150.0),
        ([clear(100.0, 200.0), clear(200.0, 300.0), taken(300.0, 400.0)], 296.0),
        ([clear(100.0, 200.0), taken(200.0, 300.0), clear(300.0, 400.0)], 196.0),
        # Sections behind the train prove nothing.
        ([taken(0.0, 100.0), clear(100.0, 200.0)], 196.0),
        ([taken(0.0, 150.0), clear(150.0, 200.0)], 196.0),
        ([clear(0.0, 100.0), taken(100.0, 200.0)], 150.0),
        ([clear(0.0, 150.0), taken(150.0, 200.0)], 150.0),
        ([taken(50.0, 100.0), clear(100.0, 140.0)], 150.0),
        # An unreported section may hold the train.
        ([clear(160.0, 200.0)], 150.0),
        ([clear(150.0, 200.0)], 196.0),
        ([clear(100.0, 200.0), clear(201.0, 300.0)], 196.0),
        # The overhang does not move the train back.
        ([clear(100.0, 153.0)], 150.0),
        ([clear(100.0, 154.5)], 150.5),
    ],
)
def test_a_silent_train_is_past_the_clear_sections_ahead_of_its_rear(
    sections: list[tuple[float, float, SectionState]], rear_m: float
) -> None:
    assert cleared_to_m(150.0, sections, overhang_m=4.0) == rear_m


ONE, TWO, THREE = (RosterEntry(n, 100.0 * n, True, boot=n) for n in (1, 2, 3))
ARBITERS = (65_001, 65_002, 65_003)


def roster(*adopted: RosterEntry, guards: MasterGuards | None = None) -> Roster:
    return Roster(TERM, Kept(6, 9, adopted), 2, guards or MasterGuards())


def ack(arbiter: int, *, term: int = TERM, version: int = 1) -> RosterAck:
    return RosterAck(arbiter, 4, 1, term, 1, 1, 0, version)


def kept_by_two(*adopted: RosterEntry) -> Roster:
    order = roster(*adopted)
    order.on_message(ack(65_001))
    order.on_message(ack(65_002))
    return order


def test_an_adopted_roster_is_version_1_of_the_new_term_and_must_be_committed_again() -> None:
    order = roster(THREE, ONE)

    assert (order.term, order.version) == (7, 1)
    assert order.proposed == (THREE, ONE)
    assert order.kept is None
    assert order.pending is True
    assert order.missing(ARBITERS) == [65_001, 65_002, 65_003]
    assert order.may_be_commanded() == set()


def test_a_roster_is_committed_once_two_of_three_arbiters_acknowledge() -> None:
    order = roster(THREE, ONE)

    order.on_message(ack(65_003))
    order.on_message(ack(65_003))
    assert (order.kept, order.missing(ARBITERS)) == (None, [65_001, 65_002])

    order.on_message(ack(65_001))
    assert (order.kept, order.missing(ARBITERS)) == ((THREE, ONE), [65_002])
    assert order.pending is False
    assert order.may_be_commanded() == {1, 3}


@pytest.mark.parametrize(("term", "version"), [(6, 1), (8, 1), (7, 0), (7, 2), (1, 7)])
def test_an_acknowledgement_of_another_roster_commits_nothing(term: int, version: int) -> None:
    order = roster(ONE)

    for arbiter in ARBITERS:
        order.on_message(ack(arbiter, term=term, version=version))

    assert order.kept is None
    assert order.missing(ARBITERS) == list(ARBITERS)


def test_a_changed_order_is_the_next_version_and_the_former_holds_until_committed() -> None:
    order = kept_by_two(ONE)

    order.propose([TWO, ONE])

    assert (order.version, order.proposed, order.kept) == (2, (TWO, ONE), (ONE,))
    assert order.pending is True
    assert order.missing(ARBITERS) == list(ARBITERS)
    assert order.may_be_commanded() == {1}
    order.on_message(ack(65_001, version=1))
    order.on_message(ack(65_001, version=2))
    assert order.pending is True
    order.on_message(ack(65_002, version=2))
    assert (order.kept, order.pending) == ((TWO, ONE), False)
    assert order.may_be_commanded() == {1, 2}
    order.propose([TWO])
    assert order.version == 3


def test_a_removed_or_restarted_train_is_no_longer_commanded() -> None:
    order = kept_by_two(ONE, TWO, THREE)

    order.propose([ONE, TWO._replace(boot=9)])

    assert order.boots() == {1: 1, 2: 9}
    assert order.may_be_commanded() == {1}


def test_proposing_an_order_before_the_last_is_committed_is_an_error() -> None:
    with pytest.raises(AssertionError):
        roster(ONE).propose([TWO])


def test_without_the_roster_guard_every_order_counts_as_committed_at_once() -> None:
    order = roster(ONE, guards=without(MasterGuards(), "roster_kept"))
    assert order.kept == (ONE,)

    order.propose([TWO, ONE])
    assert order.kept == (TWO, ONE)


@pytest.mark.parametrize(
    ("at", "order"), [(0, (THREE, ONE, TWO)), (1, (ONE, THREE, TWO)), (2, (ONE, TWO, THREE))]
)
def test_an_entry_is_placed_before_the_one_at_its_number(
    at: int, order: tuple[RosterEntry, ...]
) -> None:
    assert placed([ONE, TWO], THREE, at) == order
