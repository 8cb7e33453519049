"""Shadow trains between a train and the next one, from axle counts and known positions."""

from dataclasses import replace

import pytest

from hil_tests.unit.vobc.train_to_train.test_t2t_conclusions import (
    NOW_NS,
    SILENT_NS,
    TERM,
    conclusions,
    report,
    track,
)
from vobc.train_to_train.authority import Bar, BarredTrack
from vobc.train_to_train.occupancy import TrainRecord
from zenoh_config.t2t import RosterEntry, TrainReport


@pytest.mark.parametrize(
    ("age_ns", "within_m"), [(0, 80.0), (SILENT_NS, 100.0), (SILENT_NS + 1, 900.0)]
)
def test_a_train_is_no_farther_than_it_may_have_run_since_its_report(
    age_ns: int, within_m: float
) -> None:
    """A train runs at most 40 m/s. A silent one may be anywhere within its authority."""
    known = conclusions(report(1, 0.0, held_end_m=900.0))

    assert known.within_m(known.records[1], NOW_NS + age_ns, sure=True) == within_m
    assert known.within_m(known.records[1], NOW_NS + age_ns, sure=False) == 900.0


def test_a_train_is_no_farther_than_it_was_granted() -> None:
    known = conclusions(report(1, 0.0, held_end_m=85.0))

    assert known.within_m(known.records[1], NOW_NS + SILENT_NS, sure=True) == 85.0


def test_a_train_that_never_reported_may_be_anywhere_within_its_authority() -> None:
    known = conclusions()
    known.records[1] = TrainRecord(1, 0.0, NOW_NS, boot=1, latent_m=400.0)

    assert known.within_m(known.records[1], NOW_NS, sure=True) == 400.0


def hidden(
    occupied: tuple[bool, ...],
    *,
    ahead: TrainRecord | None = None,
    end_m: float = 5000.0,
    left: TrainRecord | None = None,
) -> list[BarredTrack]:
    """Barred track ahead of a train that stands from 0 to 80 m and was granted 100 m."""
    known = conclusions(report(1, 0.0, held_end_m=100.0))
    return known.hidden_before(known.records[1].granted_m, ahead, track(*occupied), (end_m, left))


def heard_of(rear_m: float, *, later_ns: int = 0) -> TrainRecord:
    """A record of train 2, received this long after the axle count."""
    return TrainRecord(2, rear_m, NOW_NS + later_ns, boot=1)


THIRD_OCCUPIED = (True, False, True, True)
HIDDEN = [BarredTrack(189.0, 300.0, Bar.SHUT)]
"""The third section, extended by 4 m of overhang and 7 m of rollback and jog."""


@pytest.mark.parametrize(("ahead_m", "hides"), [(307.0, True), (306.9, False), (400.0, True)])
def test_an_occupied_section_that_neither_of_two_neighbours_can_be_in_is_shut(
    ahead_m: float, *, hides: bool
) -> None:
    found = hidden(THIRD_OCCUPIED, ahead=heard_of(ahead_m))

    assert found == (HIDDEN if hides else [])


def located(ahead: TrainReport, *, age_ns: int = 0, lost: bool = False) -> bool:
    """Whether the train counts as located by an old report, and perhaps a later one without
    position."""
    told = [ahead, *([replace(ahead, localised=False)] if lost else [])]
    known = conclusions(report(1, 0.0, held_end_m=100.0))
    record = known.table.of(ahead.source, rear_m=ahead.rear_min_m, now_ns=0)
    for each in told:
        record.on_message(each, NOW_NS, term=TERM, jog_m=5.0)
    return known.is_placed(record, NOW_NS + age_ns)


def test_a_train_is_located_by_a_recent_report_under_this_term() -> None:
    assert located(report(2, 290.0))
    assert located(report(2, 290.0), age_ns=SILENT_NS)
    assert not located(report(2, 290.0), age_ns=SILENT_NS + 1)
    assert not located(report(2, 290.0, term=TERM - 1))
    assert not located(replace(report(2, 290.0), echo_ns=0))
    assert not located(report(2, 290.0), lost=True)


def test_a_lost_train_is_located_again_as_soon_as_it_reports_its_position() -> None:
    known = conclusions(report(2, 290.0), replace(report(2, 290.0), localised=False))
    assert not known.is_placed(known.records[2], NOW_NS)

    known.records[2].on_message(report(2, 291.0), NOW_NS, term=TERM, jog_m=5.0)

    assert known.is_placed(known.records[2], NOW_NS)


@pytest.mark.parametrize(("age_ns", "rear_m"), [(0, 294.0), (250_000_000, 304.0)])
def test_a_rear_is_bounded_by_position_uncertainty_and_maximum_speed(
    age_ns: int, rear_m: float
) -> None:
    told = replace(report(2, 290.0), front_max_m=374.0)

    assert conclusions().rear_max_m(told, NOW_NS + age_ns) == rear_m


def test_a_train_known_only_from_the_roster_is_not_located() -> None:
    known = conclusions()
    assert not known.is_placed(known.add(RosterEntry(2, 290.0, True, 1), NOW_NS), NOW_NS)


@pytest.mark.parametrize(
    ("age_ns", "granted_m", "from_m"),
    [
        (SILENT_NS, 100.0, []),
        (SILENT_NS + 1, 100.0, [189.0]),
        (SILENT_NS + 1, 195.0, [195.0]),
        (SILENT_NS + 1, 280.0, [280.0]),
        (SILENT_NS + 1, 300.1, [300.1]),
    ],
)
def test_the_section_of_a_silent_train_may_hold_another_train(
    age_ns: int, granted_m: float, from_m: list[float]
) -> None:
    """The master takes back no authority that reaches in there or comes close, and gives no
    longer one."""
    follows = replace(report(1, 0.0, held_end_m=granted_m), echo_ns=NOW_NS + age_ns)
    known = conclusions(follows, report(2, 290.0))
    behind, ahead = known.records[1], known.records[2]
    view, left = track(*THIRD_OCCUPIED), (5000.0, None)

    assert known.hidden_before(100.0, ahead, view, left) == []
    found = known.hidden(behind, 100.0, ahead, view, left, NOW_NS + age_ns)

    assert [each.start_m for each in found] == from_m
    assert all(each.end_m == max(300.0, each.start_m) for each in found)


@pytest.mark.parametrize("silent", [False, True])
def test_an_occupied_section_without_the_train_ahead_is_shut_even_within_the_authority(
    *, silent: bool
) -> None:
    now_ns = NOW_NS + SILENT_NS + silent
    follows = replace(report(1, 0.0, held_end_m=350.0), echo_ns=now_ns)
    known = conclusions(follows, report(2, 390.0))

    found = known.hidden(
        known.records[1], 100.0, known.records[2], track(*THIRD_OCCUPIED), (5000.0, None), now_ns
    )

    assert found == HIDDEN


def test_the_bar_ahead_is_the_granted_end_or_the_reported_one_of_a_deaf_train() -> None:
    receiving, deaf = report(1, 0.0, held_end_m=350.0), report(2, 0.0, held_end_m=350.0)
    known = conclusions(receiving, replace(deaf, echo_ns=NOW_NS - SILENT_NS - 1))
    for train in (1, 2):
        known.records[train].issued(9, 400.0, life_ns=0)
    known.records[3] = TrainRecord(3, 0.0, NOW_NS, boot=1, latent_m=300.0)

    bars = [known.no_farther(known.records[train], NOW_NS) for train in (1, 2, 3)]

    assert bars == [
        BarredTrack(400.0, 1_000_000.0, Bar.SHUT),
        BarredTrack(350.0, 1_000_000.0, Bar.UNSURE),
        BarredTrack(300.0, 1_000_000.0, Bar.UNSURE),
    ]


@pytest.mark.parametrize("silent_ahead", [False, True])
@pytest.mark.parametrize(("front_m", "doubtful"), [(80.0, True), (200.0, True), (200.1, False)])
def test_sections_within_the_authority_of_a_deaf_train_may_hold_it_or_another(
    front_m: float, *, doubtful: bool, silent_ahead: bool
) -> None:
    """The master cannot know whether the train took its authority, so it gives no more for the
    moment."""
    deaf = replace(report(1, 0.0, held_end_m=350.0), front_max_m=front_m, echo_ns=1)
    ahead = replace(report(2, 390.0), echo_ns=1) if silent_ahead else report(2, 390.0)
    known = conclusions(deaf, ahead)
    record, view = known.records[1], track(True, False, True, False)

    beyond_m = known.within_m(record, NOW_NS, sure=True)
    found = known.hidden(record, beyond_m, known.records[2], view, (5000.0, None), NOW_NS)

    assert beyond_m == 350.0
    assert found == ([HIDDEN[0]._replace(bar=Bar.UNSURE)] if doubtful else [])


@pytest.mark.parametrize(
    ("before_ms", "rear_m", "hides"),
    [(100, 307.0, True), (50, 307.0, True), (49, 307.0, False), (100, 306.9, False)],
)
def test_a_train_that_reported_before_the_count_was_not_in_a_section_that_it_had_left(
    before_ms: int, rear_m: float, *, hides: bool
) -> None:
    """The train reports the same again 50 ms after the count, in which it may have run 2 m
    (simulation seed 239837)."""
    known = conclusions(report(1, 0.0, held_end_m=100.0))
    ahead = known.table.of(2, rear_m=rear_m, now_ns=0)
    for received_at_ns in (NOW_NS - before_ms * 1_000_000, NOW_NS):
        ahead.on_message(report(2, rear_m), received_at_ns, term=TERM, jog_m=5.0)
    view = track(*THIRD_OCCUPIED, seen_ns=NOW_NS - 50_000_000)

    assert known.hidden_before(100.0, ahead, view, (5000.0, None)) == (HIDDEN if hides else [])


def test_a_shadow_train_before_the_foremost_train_is_found_once() -> None:
    known = conclusions(report(1, 0.0, held_end_m=100.0))
    view, left = track(*THIRD_OCCUPIED), (5000.0, None)

    assert known.hidden(known.records[1], 100.0, None, view, left, NOW_NS) == HIDDEN


@pytest.mark.parametrize(("end_m", "hides"), [(300.0, True), (299.9, False), (400.0, True)])
def test_before_the_foremost_train_every_occupied_section_is_shut(
    end_m: float, *, hides: bool
) -> None:
    found = hidden(THIRD_OCCUPIED, end_m=end_m)

    assert found == (HIDDEN if hides else [])


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize(
    ("later_ns", "bar"), [(1_000_000_000, Bar.SHUT), (1_000_000_001, Bar.UNSURE)]
)
def test_the_axles_in_a_section_may_belong_to_the_train_that_is_ahead_now(
    later_ns: int, bar: Bar, *, left: bool
) -> None:
    """At 40 m/s the train comes 40 m farther in a second; the vehicle may also be another one."""
    other = heard_of(347.0, later_ns=later_ns)
    ahead = None if left else other
    found = hidden(THIRD_OCCUPIED, ahead=ahead, end_m=340.0, left=other if left else None)

    assert found == [HIDDEN[0]._replace(bar=bar)]


@pytest.mark.parametrize(("rear_m", "hides"), [(310.9, False), (311.0, True), (370.0, True)])
def test_a_train_that_left_the_area_does_not_account_for_a_section_it_left_long_before(
    rear_m: float, *, hides: bool
) -> None:
    """The train ran on unheard or restarted elsewhere. It reports 0.1 s after the count, in
    which it may have run 4 m (simulation seed 299316)."""
    left = heard_of(rear_m, later_ns=100_000_000)

    assert hidden(THIRD_OCCUPIED, end_m=300.0, left=left) == (HIDDEN if hides else [])


def test_sections_beyond_the_area_are_not_examined() -> None:
    left = heard_of(900.0)

    assert hidden((True, False, False, True), end_m=300.0, left=left) == []
    assert hidden((True, False, False, True), end_m=400.0, left=left) != []


def test_without_occupied_sections_or_axle_counters_there_is_no_shadow_train() -> None:
    known = conclusions(report(1, 0.0, held_end_m=100.0))

    assert hidden((True, False, False, False), end_m=400.0) == []
    assert known.hidden_before(100.0, None, None, (400.0, None)) == []
