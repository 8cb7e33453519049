"""What a master may conclude from the reports of its trains, and from missing ones."""

from dataclasses import replace
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb.areas import ObjectKind, ObjectSite
from vobc.train_to_train.authority import Counted, SeenSection
from vobc.train_to_train.axle_counting import TrackView
from vobc.train_to_train.guards import MasterGuards, Reach
from vobc.train_to_train.inference import Conclusions
from vobc.train_to_train.occupancy import OUTSTANDING_MAX, TrainRecord, TrainTable
from vobc.train_to_train.roster import Order
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import RosterEntry, SectionState, SyncEntry, TrainReport
from zenoh_config.timers import TIMERS_A, TIMERS_B, LineTimers

TERM = 5
NOW_NS = 60_000_000_000
SILENT_NS = 500_000_000
"""Half of the second for which an authority is valid."""


def report(
    train: int, rear_m: float, *, term: int = TERM, boot: int = 1, held_end_m: float = 0.0
) -> TrainReport:
    """A report of a train of 80 m that holds its authority."""
    front_m = rear_m + 80.0
    held_m = max(front_m, held_end_m)
    return TrainReport(
        *(train, 65_535, 1, term, boot, 1, 0, True, front_m, front_m, rear_m, rear_m, 0.0, True),
        *(held_m, held_m, front_m, term, 1, held_end_m > 0.0, 0, 0, 16, False, 0, NOW_NS),
    )


def conclusions(*told: TrainReport, received_at_ns: int = NOW_NS) -> Conclusions:
    """The conclusions of the master of term 5 from these reports."""
    known = Conclusions(TERM, TrainTable(), T2tConfig(), MasterGuards())
    for each in told:
        record = known.table.of(each.source, rear_m=each.rear_min_m, now_ns=0)
        record.on_message(each, received_at_ns, term=TERM, jog_m=5.0)
    return known


def order_of(*trains: int) -> Order:
    return tuple([RosterEntry(train, 0.0, True, 1) for train in trains])


# The known trains and their incarnations.


def test_a_master_begins_with_the_trains_of_the_roster_only() -> None:
    known = conclusions(report(9, 300.0))

    known.begin_with((RosterEntry(1, 900.0, True, 3), RosterEntry(2, 500.0, False, 4)), 77)

    assert known.records == {
        1: TrainRecord(1, 900.0, 77, boot=3),
        2: TrainRecord(2, 500.0, 77, boot=4),
    }


@pytest.mark.parametrize(("kept_m", "rear_m"), [(300.0, 400.0), (400.0, 400.0), (500.0, 500.0)])
def test_a_committed_rear_only_moves_a_train_forwards(kept_m: float, rear_m: float) -> None:
    known = conclusions()
    known.records[1] = TrainRecord(1, 400.0, 70, boot=2)

    record = known.add(RosterEntry(1, kept_m, True, 2), 77)

    assert record is known.records[1]
    assert record == TrainRecord(1, rear_m, 70, boot=2)


@pytest.mark.parametrize("kept_m", [300.0, 500.0])
def test_a_trains_own_report_overrides_the_committed_entry(kept_m: float) -> None:
    known = conclusions(report(1, 400.0))

    record = known.add(RosterEntry(1, kept_m, True, 1), 77)

    assert (record.rear_m, record.report) == (400.0, report(1, 400.0))


@pytest.mark.parametrize("kept_m", [300.0, 500.0])
def test_a_report_of_another_incarnation_does_not_apply_to_the_committed_one(
    kept_m: float,
) -> None:
    known = conclusions(report(1, 400.0, boot=1))

    record = known.add(RosterEntry(1, kept_m, True, 2), 77)

    assert record is known.records[1]
    assert record == TrainRecord(1, kept_m, 77, boot=2)


@pytest.mark.parametrize("boot", [1, 2])
def test_an_order_to_stop_is_taken_over_with_the_roster(boot: int) -> None:
    known = conclusions(report(1, 400.0))

    assert known.add(RosterEntry(1, 400.0, True, boot, True), 77).stopped is True
    assert known.add(RosterEntry(1, 400.0, True, boot, False), 78).stopped is False


def test_a_train_restarted_in_place_holds_no_authority_but_stays_stopped() -> None:
    known = conclusions(report(1, 400.0, held_end_m=900.0))
    former = known.records[1]
    former.issued(7, 950.0, life_ns=0)
    former.stopped = True
    restarted = replace(report(1, 397.0, boot=2), protected_m=410.0, ready_nonce=6)

    known.reborn(restarted, 88)

    assert known.records == {
        1: TrainRecord(
            *(
                1,
                402.0,
                88,
                2,
                restarted,
                5,
                6,
                477.0,
            ),  # The protected rear reaches back by a jog only.
            served=False,
            stopped=True,
            sent=[],
        )
    }


@pytest.mark.parametrize("held_term", [4, 5])
def test_a_restarted_train_has_no_outstanding_authority_whatever_it_reports(
    held_term: int,
) -> None:
    known = conclusions(report(1, 400.0))

    known.reborn(replace(report(1, 400.0, boot=2), held_term=held_term), 88)

    assert known.records[1].granted_m == 480.0
    assert known.records[1].stopped is False


# Which trains obey.


@pytest.mark.parametrize(("term", "promised"), [(4, False), (5, True), (6, False)])
def test_a_train_obeys_this_master_if_its_own_newest_term_is_the_masters(
    term: int, *, promised: bool
) -> None:
    known = conclusions(report(1, 400.0, term=term))

    assert known.has_promised(known.records[1]) is promised


@pytest.mark.parametrize(
    ("age_ns", "alive"), [(-1, False), (0, True), (SILENT_NS, True), (SILENT_NS + 1, False)]
)
def test_a_report_counts_for_half_the_life_of_an_authority(age_ns: int, *, alive: bool) -> None:
    known = conclusions(report(1, 400.0))

    assert known.is_alive(NOW_NS, NOW_NS + age_ns) is alive
    assert known.is_fit(1, NOW_NS + age_ns) is alive


@pytest.mark.parametrize(
    ("age_ns", "recent"), [(-1, False), (0, True), (SILENT_NS, True), (SILENT_NS + 1, False)]
)
def test_the_echoed_heartbeat_gives_the_age_of_a_report(age_ns: int, *, recent: bool) -> None:
    known = conclusions()

    assert known.is_recent(report(1, 400.0), NOW_NS + age_ns) is recent
    assert known.is_recent(report(1, 400.0, term=TERM - 1), NOW_NS + age_ns) is False
    assert known.is_recent(report(1, 400.0, term=TERM + 1), NOW_NS + age_ns) is False


@pytest.mark.parametrize(("echo_ns", "recent"), [(0, False), (1, True)])
def test_a_train_without_a_heartbeat_echoes_none_even_on_a_young_clock(
    echo_ns: int, *, recent: bool
) -> None:
    told = replace(report(1, 400.0), echo_ns=echo_ns)

    assert conclusions().is_recent(told, 100) is recent


def test_a_silent_train_may_have_come_as_far_as_it_was_granted() -> None:
    told = report(1, rear_m=120.0, held_end_m=900.0)
    known = conclusions(told)
    record = known.records[1]

    assert known.farther_m(record, told, NOW_NS) == 0.0
    assert known.farther_m(record, told, NOW_NS + SILENT_NS) == 20.0, "at 40 m/s"
    assert known.farther_m(record, told, NOW_NS + SILENT_NS + 1) == 900.0 - told.front_max_m
    record.issued(8, 1200.0, life_ns=0)
    assert known.farther_m(record, told, NOW_NS + 2 * SILENT_NS) == 1200.0 - told.front_max_m
    record.term = TERM - 1
    assert known.farther_m(record, told, NOW_NS + 2 * SILENT_NS) == 1.0e6 - told.front_max_m


def test_an_unknown_silent_withdrawn_or_outdated_train_is_not_fit_to_command() -> None:
    out_of_service = replace(report(3, 400.0), out_of_service=True)
    known = conclusions(report(1, 900.0), report(2, 500.0, term=4), out_of_service)
    known.records[4] = TrainRecord(4, 100.0, NOW_NS, boot=1, term=TERM)

    assert [train for train in range(6) if known.is_fit(train, NOW_NS)] == [1]
    assert known.is_fit(4, NOW_NS) is False


OWN = 9


@pytest.mark.parametrize(
    ("ages_ms", "silent"),
    [
        ((320, 320), True),
        ((320, 400), True),
        ((319, 5000), False),
        ((5000, 319), False),
        ((0, 0), False),
        ((5000,), False),  # A single silent train may have its own fault.
        ((), False),
        ((320, 320, 320), True),
        ((320, 320, 319), False),
    ],
)
def test_a_master_is_deaf_if_all_of_several_others_are_silent_for_320_ms(
    ages_ms: tuple[int, ...], *, silent: bool
) -> None:
    known = conclusions(*[report(train, 400.0) for train in range(1, 1 + len(ages_ms))])
    for train, age_ms in enumerate(ages_ms, start=1):
        known.records[train].received_at_ns = NOW_NS - age_ms * 1_000_000

    assert known.all_silent(OWN, NOW_NS) is silent


def test_the_last_nanosecond_before_320_ms_is_not_silence_yet() -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0), received_at_ns=NOW_NS)

    assert known.all_silent(OWN, NOW_NS + 320_000_000) is True
    assert known.all_silent(OWN, NOW_NS + 319_999_999) is False


def test_a_masters_own_messages_do_not_count_as_received() -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0), report(OWN, 100.0))
    known.records[1].received_at_ns = known.records[2].received_at_ns = 0

    assert known.all_silent(OWN, NOW_NS)
    assert not known.all_silent(1, NOW_NS)
    del known.records[2]
    assert not known.all_silent(OWN, 2 * NOW_NS)


def test_a_train_that_never_reported_counts_neither_as_silent_nor_as_received() -> None:
    known = conclusions(report(1, 900.0), received_at_ns=0)
    known.records[2] = TrainRecord(2, 500.0, 0, boot=1)

    assert not known.all_silent(OWN, NOW_NS)

    known = conclusions(report(1, 900.0), report(3, 300.0), received_at_ns=0)
    known.records[2] = TrainRecord(2, 500.0, NOW_NS, boot=1)

    assert known.all_silent(OWN, NOW_NS)


# How far trains may come.


def test_no_train_comes_farther_than_one_ahead_of_it_that_obeys_this_master() -> None:
    known = conclusions(
        report(1, 900.0, held_end_m=1500.0, term=4),
        report(2, 700.0, held_end_m=850.0),
        report(3, 500.0, held_end_m=950.0),
        report(4, 300.0, held_end_m=1600.0, term=4),
        report(5, 100.0, held_end_m=250.0),
    )
    known.records[5].issued(1, 290.0, life_ns=0)

    assert known.reserved_m(order_of(1, 2, 3, 4, 5)) == {
        1: 1_000_000.0,
        2: 850.0,
        3: 950.0,
        4: 850.0,
        5: 290.0,
    }


def test_a_train_with_an_unknown_authority_comes_no_farther_than_the_train_ahead() -> None:
    never = replace(report(2, 500.0), latent_m=1e6)
    known = conclusions(report(1, 900.0, held_end_m=1500.0), never, report(3, 300.0, term=4))

    assert known.reserved_m(order_of(1, 2, 3)) == {1: 1500.0, 2: 1500.0, 3: 1500.0}


@pytest.mark.parametrize(("rear_m", "own_m"), [(893.0, 980.0), (892.9, 1e6), (100.0, 1e6)])
def test_a_restarted_train_is_bounded_by_its_former_place_and_bounds_no_train_behind(
    rear_m: float, own_m: float
) -> None:
    """The train may have left the line and come back behind trains that were behind it
    (simulation seed 66510)."""
    known = conclusions(report(2, 500.0, held_end_m=650.0), report(3, 300.0, term=4))
    known.add(RosterEntry(1, 900.0, True, 1), NOW_NS)
    known.on_restarted_report(replace(report(1, rear_m, boot=2), latent_m=980.0))

    assert known.reserved_m(order_of(1, 2, 3)) == {1: own_m, 2: 650.0, 3: 650.0}
    assert known.reserved_m(order_of(1, 3)) == {1: own_m, 3: 1e6}


def test_a_restarted_train_without_position_bounds_nothing() -> None:
    known = conclusions()
    known.add(RosterEntry(1, 900.0, True, 1), NOW_NS)
    lost = replace(report(1, 900.0, boot=2), latent_m=990.0, localised=False)
    known.on_restarted_report(lost)

    assert known.reserved_m(order_of(1)) == {1: 1e6}

    known.on_restarted_report(report(1, 900.0, boot=2))
    assert known.reserved_m(order_of(1)) == {1: 980.0}
    known.on_restarted_report(lost)
    assert known.reserved_m(order_of(1)) == {1: 990.0}


def test_the_rear_of_a_restarted_train_includes_its_position_uncertainty() -> None:
    known = conclusions()
    known.add(RosterEntry(1, 900.0, True, 1), NOW_NS)
    sure = report(1, 890.0, boot=2)
    known.on_restarted_report(replace(sure, front_max_m=sure.front_min_m + 2.9))
    assert known.reserved_m(order_of(1)) == {1: 1e6}

    known.on_restarted_report(replace(sure, front_max_m=sure.front_min_m + 3.0))
    assert known.reserved_m(order_of(1)) == {1: 970.0}


class Life(NamedTuple):
    """One train of the roster, sampled from the foremost to the last."""

    gap_m: float
    """Distance from its front to the rear of the train ahead, or to the end of the line."""
    granted: float
    """Share of that gap that the train may still use."""
    known: float
    """Share of the travelled distance up to the master's record of the rear, 0 to 1."""
    word: str
    """What the master has received from the train."""


LIVES = st.builds(
    Life,
    gap_m=st.floats(0.0, 2000.0),
    granted=st.floats(0.0, 1.0),
    known=st.floats(0.0, 1.0),
    word=st.sampled_from(("promised", "former term", "nothing", "restarted", "left and came back")),
)


@given(lives=st.lists(LIVES, min_size=1, max_size=6), back_m=st.floats(-500.0, 3000.0))
def test_no_train_can_come_farther_than_is_reserved_for_it(
    lives: list[Life], back_m: float
) -> None:
    """A train that left the line ran as far as it liked and may have come back anywhere."""
    known, ahead_m, may_m = conclusions(), 20_000.0, dict[int, float]()
    for train, life in enumerate(lives, 1):
        rear_m = ahead_m - life.gap_m - 80.0
        may_m[train] = rear_m + 80.0 + life.granted * life.gap_m
        known.add(RosterEntry(train, -5000.0 + life.known * (rear_m + 5000.0), True, 1), 0)
        told = replace(report(train, rear_m), latent_m=may_m[train])
        if life.word in ("promised", "former term"):
            term = TERM if life.word == "promised" else TERM - 1
            record = known.records[train]
            record.on_message(replace(told, term=term), NOW_NS, term=TERM, jog_m=5.0)
        elif life.word != "nothing":
            at_m = rear_m if life.word == "restarted" else back_m
            may_m[train] = at_m + 80.0
            known.on_restarted_report(replace(report(train, at_m, boot=2), latent_m=may_m[train]))
        ahead_m = rear_m
    order = order_of(*may_m)

    reserved_m = known.reserved_m(order)

    for train, reach_m in may_m.items():
        assert reserved_m[train] >= reach_m


SITE = ObjectSite(3, ObjectKind.CROSSING, 700.0, 720.0)


def test_before_an_object_is_released_every_train_of_the_roster_is_held_against_it() -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0, held_end_m=650.0), report(3, 400.0))

    assert known.reaches(SITE, order_of(1, 2)) == [
        Reach(980.0, 893.0, 700.0, 720.0),
        Reach(650.0, 493.0, 700.0, 720.0),
    ]


@pytest.mark.parametrize(
    ("rear_m", "needed"),
    [(-580.1, False), (-580.0, True), (0.0, True), (710.0, True), (726.9, True), (727.0, False)],
)
def test_an_object_is_needed_from_1200_m_before_it_until_no_train_can_come_back_to_it(
    rear_m: float, *, needed: bool
) -> None:
    known = conclusions(report(1, rear_m))
    known.records[2] = TrainRecord(2, 650.0, 0, boot=1)  # The train may still be near.

    assert known.is_needed(SITE) is needed
    far = conclusions(report(1, rear_m), report(3, 5000.0))
    assert far.is_needed(SITE) is needed


def test_an_object_without_a_train_near_it_is_not_needed() -> None:
    assert conclusions().is_needed(SITE) is False


@pytest.mark.parametrize("timers", [TIMERS_A, TIMERS_B])
def test_an_authority_is_void_after_twice_the_age_at_which_trains_refuse_it(
    timers: LineTimers,
) -> None:
    """Clocks differ by less than a tenth, and the master can tell all authorities apart that are
    still valid."""
    life_ns = Conclusions(TERM, TrainTable(), T2tConfig(timers=timers), MasterGuards()).life_ns

    assert life_ns == 2 * timers.authority_ms * 1_000_000
    assert life_ns <= (OUTSTANDING_MAX - 10) * timers.cycle_ms * 1_000_000


# How far trains must have come, judged by the authorities of others.


def falls_silent(known: Conclusions, train: int) -> None:
    """Its last report was under another master."""
    record = known.records[train]
    assert record.report is not None
    record.report = replace(record.report, echo_ns=0)


def test_no_authority_contradicts_a_train_that_reports_its_own_place() -> None:
    """A hostile master sends train 2 beyond train 1, which would then wait for ever."""
    known = conclusions(report(1, 900.0), report(2, 500.0, held_end_m=950.0))

    known.take_proofs(order_of(1, 2), NOW_NS)

    assert known.records[1].rear_m == 900.0


@pytest.mark.parametrize(("held_end_m", "rear_m"), [(892.0, 900.0), (893.0, 900.0), (950.0, 957.0)])
def test_a_granted_authority_proves_how_far_the_train_ahead_had_come(
    held_end_m: float, rear_m: float
) -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0, held_end_m=held_end_m))
    falls_silent(known, 1)

    known.take_proofs(order_of(1, 2), NOW_NS)

    assert [each.rear_m for each in known.records.values()] == [rear_m, 500.0]


def test_each_train_proves_only_where_the_next_one_ahead_is() -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0), report(3, 300.0, held_end_m=600.0))
    falls_silent(known, 1)
    known.records[2].lost = True

    known.take_proofs(order_of(1, 2, 3), NOW_NS)

    assert [each.rear_m for each in known.records.values()] == [900.0, 607.0, 300.0]


def test_the_authority_of_a_train_that_may_obey_another_master_proves_nothing() -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0, held_end_m=950.0, term=4))
    falls_silent(known, 1)

    known.take_proofs(order_of(1, 2), NOW_NS)

    assert known.records[1].rear_m == 900.0


def test_the_authority_of_a_lost_train_under_the_next_master_proves_nothing() -> None:
    gone_over = report(2, 500.0, held_end_m=950.0, term=TERM + 1)
    known = conclusions(
        report(1, 900.0),
        report(2, 500.0, held_end_m=950.0),
        replace(gone_over, localised=False, echo_ns=0),
    )
    falls_silent(known, 1)

    known.take_proofs(order_of(1, 2), NOW_NS)

    assert known.records[1].rear_m == 900.0


@pytest.mark.parametrize(("age_ns", "rear_m"), [(SILENT_NS, 957.0), (SILENT_NS + 1, 900.0)])
def test_an_old_authority_proves_nothing_about_a_train_moved_since(
    age_ns: int, rear_m: float
) -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0, held_end_m=950.0))
    falls_silent(known, 1)

    known.take_proofs(order_of(1, 2), NOW_NS + age_ns)

    assert known.records[1].rear_m == rear_m


def track(*occupied: bool, seen_ns: int = NOW_NS) -> TrackView:
    """A track view with sections of 100 m."""
    told = [
        (at * 100.0, at * 100.0 + 100.0, SectionState(at, each, 16 if each else 0))
        for at, each in enumerate(occupied)
    ]
    return TrackView(
        seen_ns,
        tuple([Counted(start_m, end_m, s.occupied, s.axles) for start_m, end_m, s in told]),
        tuple([SeenSection(start_m, end_m) for start_m, end_m, s in told if s.occupied]),
        tuple(told),
        (),
        (),
    )


BEHIND_IT_CLEAR = (False, False, True, False)


@pytest.mark.parametrize(
    ("age_ns", "moved"), [(0, False), (SILENT_NS, False), (SILENT_NS + 1, True)]
)
def test_the_track_status_advances_a_train_only_while_it_is_silent(
    age_ns: int, *, moved: bool
) -> None:
    known = conclusions(report(1, 50.0))
    now_ns = NOW_NS + age_ns

    known.advance_silent(now_ns, track(*BEHIND_IT_CLEAR, seen_ns=now_ns))

    assert known.records[1].rear_m == (196.0 if moved else 50.0)


@pytest.mark.parametrize(("later_ns", "moved"), [(-1, False), (0, True), (1, True)])
def test_sections_seen_clear_before_its_report_do_not_advance_a_train(
    later_ns: int, *, moved: bool
) -> None:
    known = conclusions(report(1, 50.0))

    known.advance_silent(2 * NOW_NS, track(*BEHIND_IT_CLEAR, seen_ns=NOW_NS + later_ns))

    assert known.records[1].rear_m == (196.0 if moved else 50.0)


@pytest.mark.parametrize(
    ("other_m", "ahead_m"), [(900.0, 300.0), (250.0, 250.0), (80.0, 80.0), (79.9, 300.0)]
)
def test_a_train_that_reports_itself_ahead_counts_as_ahead_whatever_the_roster(
    other_m: float, ahead_m: float
) -> None:
    """A train with its front at 80 m, and a report ahead of it from a train that the roster has
    behind it."""
    known = conclusions(report(1, 0.0), report(2, 300.0), report(3, other_m))
    known.records[4] = TrainRecord(4, 120.0, NOW_NS, boot=1)

    assert known.ahead_m(known.records[1], report(1, 0.0), known.records[2]) == ahead_m


def test_no_train_is_ahead_of_itself_wherever_counters_saw_it_pass() -> None:
    known = conclusions(report(1, 0.0))
    known.records[1].rear_m = 400.0

    assert known.ahead_m(known.records[1], report(1, 0.0), None) is None


def test_the_foremost_train_has_no_train_ahead() -> None:
    known = conclusions(report(1, 900.0), report(2, 300.0))

    assert known.ahead_m(known.records[1], report(1, 900.0), None) is None


def test_a_standby_learns_the_place_and_possible_authority_of_every_train() -> None:
    known = conclusions(report(1, 900.0), report(2, 500.0, boot=3, held_end_m=850.0))
    known.records[2].issued(8, 880.0, life_ns=0)
    known.records[3] = TrainRecord(3, 100.0, NOW_NS, boot=4, latent_m=2_000_000.0)

    assert known.sync_entries() == (
        SyncEntry(1, 900.0, 980.0, 1),
        SyncEntry(2, 500.0, 880.0, 3),
        SyncEntry(3, 100.0, 1_000_000.0, 4),
    )
