"""A train that begins anew gets nothing by what arbiters kept of its former life, until it is clear
whether it is where it was, or left the line and came back."""

import dataclasses
from collections.abc import Sequence

import pytest

from firmware_py.trackdb.areas import Area
from hil_tests.unit.vobc.train_to_train.t2t_chair import MS, TERM, Chair, entry
from hil_tests.unit.vobc.train_to_train.t2t_one_area import BEYOND, NOW_NS, OneArea, anew, report_at
from hil_tests.unit.vobc.train_to_train.test_t2t_regressions import ROSTER, Command
from metro_hil.simulation.depot import Depot
from metro_hil.simulation.generate import draw, line_of_areas
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.protocol_nodes import LineParticipants
from metro_hil.simulation.world import Setting
from vobc.train_to_train.authority import Counted, StandingTrain
from vobc.train_to_train.occupancy import TrainRecord
from vobc.train_to_train.restart import (
    Former,
    Neighbour,
    RestartEvidence,
    RestartPlace,
    whereabouts,
)
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import OwnTrain, T2tConfig, TrainMemory
from zenoh_config.t2t import AreaAuthority, RosterEntry, TrainReport

NOTHING = RestartEvidence(sieved=False, left=False, recent=False)
BEHIND_M = 7.0


def found(rear_m: float, evidence: RestartEvidence = NOTHING, *behind: TrainRecord) -> RestartPlace:
    others = [Neighbour(each.rear_m, heard=each.report is not None) for each in behind]
    former = Former(TrainRecord(1, 1000.0, 0, boot=1), others)
    return whereabouts(former, report_at(rear_m), evidence, behind_rear_m=BEHIND_M)


@pytest.mark.parametrize("rear_m", [1000.0, 1300.0, 996.0, 989.1, 989.0])
def test_whoever_can_still_be_where_it_was_is_taken_to_be_there(rear_m: float) -> None:
    assert found(rear_m) is RestartPlace.IN_PLACE


@pytest.mark.parametrize("rear_m", [988.9, 20.0])
def test_whoever_is_farther_back_than_it_may_roll_is_not_believed_by_one_word(
    rear_m: float,
) -> None:
    assert found(rear_m) is RestartPlace.UNSURE
    assert found(rear_m, NOTHING._replace(recent=True)) is RestartPlace.UNSURE
    assert found(rear_m, NOTHING._replace(sieved=True)) is RestartPlace.GONE
    assert found(rear_m, NOTHING._replace(left=True)) is RestartPlace.GONE


def test_whoever_is_behind_a_train_that_was_behind_it_has_been_away() -> None:
    heard = TrainRecord(2, 1085.0, 0, report=report_at(1085.0, train=2), boot=1)

    assert found(1000.0, NOTHING, heard) is RestartPlace.UNSURE
    assert found(1000.0, NOTHING._replace(sieved=True), heard) is RestartPlace.GONE


def test_whoever_touches_a_train_that_was_behind_it_has_not_been_away() -> None:
    heard = TrainRecord(2, 1084.0, 0, report=report_at(1084.0, train=2), boot=1)

    assert found(1000.0, NOTHING, heard) is RestartPlace.IN_PLACE


def test_one_train_of_those_behind_is_enough_to_show_that_it_has_been_away() -> None:
    ahead = TrainRecord(2, 1085.0, 0, report=report_at(1085.0, train=2), boot=1)
    behind = TrainRecord(3, 400.0, 0, report=report_at(400.0, train=3), boot=1)

    assert found(1000.0, NOTHING, ahead, behind) is RestartPlace.UNSURE


def test_all_trains_behind_must_have_been_heard_for_their_order_to_be_known() -> None:
    heard = TrainRecord(2, 400.0, 0, report=report_at(400.0, train=2), boot=1)
    unheard = TrainRecord(3, 200.0, 0, boot=1)

    assert found(1000.0, NOTHING, heard) is RestartPlace.IN_PLACE
    assert found(1000.0, NOTHING, heard, unheard) is RestartPlace.UNSURE


def test_as_long_as_a_train_behind_was_never_heard_nobody_knows_their_order() -> None:
    unheard = TrainRecord(2, 400.0, 0, boot=1)

    assert found(1000.0, NOTHING, unheard) is RestartPlace.UNSURE
    assert found(1000.0, NOTHING._replace(recent=True), unheard) is RestartPlace.IN_PLACE


@pytest.mark.parametrize(
    ("ahead", "found"),
    [
        ([], RestartPlace.IN_PLACE),
        ([Neighbour(1084.0, True, 1090.0), Neighbour(2000.0, False)], RestartPlace.IN_PLACE),
        ([Neighbour(500.0, True, 999.9)], RestartPlace.GONE),
        ([Neighbour(2000.0, True, 2010.0), Neighbour(500.0, True, 600.0)], RestartPlace.GONE),
        ([Neighbour(500.0, True, 1000.0)], RestartPlace.UNSURE),
        ([Neighbour(1083.9, True, 1090.0)], RestartPlace.UNSURE),
        ([Neighbour(2000.0, True, 2010.0), Neighbour(500.0, False)], RestartPlace.UNSURE),
    ],
)
def test_whoever_is_before_a_train_that_was_ahead_of_it_has_been_away(
    ahead: Sequence[Neighbour], found: RestartPlace
) -> None:
    """If that one surely is not farther on by now: who is not heard may be."""
    former = Former(TrainRecord(1, 900.0, 0, boot=1), (), ahead)

    def judged(evidence: RestartEvidence) -> RestartPlace:
        return whereabouts(former, report_at(1000.0), evidence, behind_rear_m=BEHIND_M)

    gone = found is RestartPlace.GONE
    assert judged(NOTHING) is (RestartPlace.UNSURE if gone else found)
    assert judged(NOTHING._replace(sieved=True)) is found
    assert judged(NOTHING._replace(left=True)) is found
    # Nobody passes another by hand so soon.
    recent = judged(NOTHING._replace(recent=True))
    assert recent is (RestartPlace.UNSURE if gone else RestartPlace.IN_PLACE)


AREA_4 = Area(4, 0.0, 1000.0)
ANEW = (1, 900.0)
"""The train that begins anew in what follows, where nothing else is said, and its former rear."""


OCCUPIED = (Counted(0.0, 3000.0, True, 32),)
"""By more than one train of 16 axles."""


def test_what_a_train_tells_anew_is_kept_until_it_is_forgotten() -> None:
    area = OneArea()
    area.on_message(anew(900.0))
    area.on_message(anew(901.0), age_ns=-3)
    area.on_message(anew(500.0, train=2))

    assert area.newborns.told() == [(anew(901.0), NOW_NS + 3), (anew(500.0, train=2), NOW_NS)]

    area.newborns.forgets(1)
    area.newborns.forgets(7)
    assert area.newborns.told() == [(anew(500.0, train=2), NOW_NS)]


def test_for_a_switch_those_are_ready_that_said_so_within_half_the_life_of_an_authority() -> None:
    area = OneArea()
    area.on_message(anew(900.0), age_ns=500_000_000)
    area.on_message(anew(500.0, train=2), age_ns=500_000_001)

    assert area.newborns.ready(area.known, NOW_NS) == [(1, 41)]


def test_a_train_that_is_where_it_was_is_renewed_in_its_place_and_begins_with_nothing() -> None:
    area = OneArea((6, 1500.0), ANEW, (2, 400.0))
    area.heard_of_life_before(1, age_ns=0)
    area.known.records[1].issued(7, 1400.0, life_ns=0)
    area.on_message(anew(898.0), age_ns=20)

    order, gone = area.settles()

    assert order == (area.order[0], RosterEntry(1, 898.0, True, 2), area.order[2])
    assert gone == []
    assert area.newborns.told() == []
    record = area.known.records[1]
    assert (record.boot, record.rear_m, record.received_at_ns) == (2, 898.0, NOW_NS - 20)
    assert record.sent == []


@pytest.mark.parametrize(
    ("age_ns", "gone"),
    [(0, True), (500_000_000, True), (500_000_001, False)],
)
def test_only_a_train_that_said_just_now_where_it_is_can_have_been_passed(
    age_ns: int, *, gone: bool
) -> None:
    """Its rear is at 704 m at the farthest, and has come 20 m farther in half a second."""
    area = OneArea((6, 700.0), (1, 500.0))
    area.heard_of_life_before(6, age_ns=0, echo_ns=NOW_NS - age_ns)
    area.on_message(BEYOND)

    order, _ = area.settles()

    assert [entry.train for entry in order] == ([6] if gone else [6, 1])
    assert order[-1].boot == 1


@pytest.mark.parametrize(("rear_m", "gone"), [(724.1, True), (724.0, False)])
def test_how_far_one_that_was_passed_may_have_come_is_reckoned_with(
    rear_m: float, *, gone: bool
) -> None:
    area = OneArea((6, 700.0), (1, 500.0))
    area.heard_of_life_before(6, age_ns=0, echo_ns=NOW_NS - 500_000_000)
    area.on_message(anew(rear_m))

    order, _ = area.settles()

    assert [entry.train for entry in order] == ([6] if gone else [6, 1])


@pytest.mark.parametrize("kept_only", [False, True])
def test_one_that_is_lost_or_that_only_arbiters_kept_may_have_gone_on(*, kept_only: bool) -> None:
    area = OneArea((6, 700.0), (1, 500.0))
    if not kept_only:
        area.heard_of_life_before(6, age_ns=0, echo_ns=NOW_NS)
        area.heard_of_life_before(6, age_ns=0, echo_ns=NOW_NS, localised=False)
    area.on_message(BEYOND)

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize(("age_ns", "renewed"), [(500_000_000, True), (500_000_001, False)])
def test_what_a_train_told_too_long_ago_settles_nothing(age_ns: int, *, renewed: bool) -> None:
    """However late that came."""
    area = OneArea(ANEW)
    area.on_message(dataclasses.replace(anew(900.0), echo_ns=NOW_NS - age_ns))

    order, gone = area.settles()

    assert [entry.boot for entry in order] == [2 if renewed else 1]
    assert (gone, len(area.newborns.told())) == ([], 0 if renewed else 1)


def test_whoever_does_not_know_where_it_is_or_says_nothing_keeps_its_place_as_it_was() -> None:
    area = OneArea((6, 1500.0), ANEW)
    area.on_message(anew(900.0, localised=False))

    assert area.settles() == (area.order, [])
    assert area.newborns.told() == [(anew(900.0, localised=False), NOW_NS)]
    assert [record.boot for record in area.known.records.values()] == [1, 1]


def test_whoever_may_have_been_away_keeps_its_place_and_gets_nothing() -> None:
    area = OneArea(ANEW, counted=OCCUPIED)
    area.on_message(anew(100.0))

    assert area.settles() == (area.order, [])
    assert area.newborns.told() == [(anew(100.0), NOW_NS)]
    assert area.known.records[1] == TrainRecord(1, 900.0, 0, boot=1)


CLEAR = (Counted(0.0, 904.0, True, 32), Counted(904.0, 3000.0, False, 0))
"""From where the foremost axle of a train of 15 m is, rolled and set back by 7 m."""


def test_whoever_left_is_off_the_roster_and_applies_as_a_stranger() -> None:
    area = OneArea((6, 1500.0), ANEW, (2, 400.0), counted=CLEAR)
    area.on_message(anew(100.0), age_ns=20)

    order, gone = area.settles()

    assert order == (area.order[0], area.order[2])
    assert gone == [(anew(100.0), NOW_NS - 20)]
    assert area.newborns.told() == []
    assert list(area.known.records) == [6, 2]


@pytest.mark.parametrize(
    "counted",
    [
        (),
        (Counted(0.0, 904.1, True, 32), Counted(904.1, 3000.0, False, 0)),
        (Counted(904.1, 3000.0, False, 0),),
        (Counted(0.0, 500.0, True, 32), Counted(500.0, 3000.0, True, 16)),
    ],
)
def test_one_word_of_a_train_that_went_back_is_not_believed_while_it_may_be_where_it_was(
    counted: tuple[Counted, ...],
) -> None:
    area = OneArea(ANEW, counted=counted)
    area.on_message(anew(100.0))

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize("before", [None, Area(4, 0.0, 1000.0)])
def test_where_no_axles_are_counted_the_word_of_a_train_that_went_back_is_all_there_is(
    before: Area | None,
) -> None:
    area = OneArea(ANEW, before=before, start_m=0.0 if before is None else 1000.0)
    area.on_message(anew(100.0))

    assert area.settles() == ((), [(anew(100.0), NOW_NS)])


@pytest.mark.parametrize(
    ("ahead_m", "axles", "left"),
    [(None, 16, True), (None, 32, False), (2000.0, 16, True), (2000.1, 16, False)],
)
def test_that_a_train_left_is_seen_where_all_axles_are_of_one_that_waits_behind_it(
    ahead_m: float | None, axles: int, *, left: bool
) -> None:
    """Up to the next train ahead (seed 10570). Here it runs on elsewhere."""
    there = (Counted(0.0, 500.0, True, 16), Counted(500.0, 2000.0, True, axles))
    beyond = Counted(2000.0, 3000.0, ahead_m is not None, 0 if ahead_m is None else 16)
    trains = [ANEW, (2, 700.0)] if ahead_m is None else [(6, ahead_m), ANEW, (2, 700.0)]
    area = OneArea(*trains, counted=(*there, beyond))
    area.at_rest = (StandingTrain(700.0, 784.0, 16), StandingTrain(100.0, 184.0, 16))
    area.on_message(anew(100.0, standstill=False))

    _, gone = area.settles()

    assert bool(gone) is left


def test_that_a_train_left_is_seen_also_where_the_next_one_is_kept_close_before_it() -> None:
    area = OneArea((6, 902.0), ANEW, counted=CLEAR)
    area.on_message(anew(100.0))

    assert area.settles() == (area.order[:1], [(anew(100.0), NOW_NS)])


@pytest.mark.parametrize(("axles", "gone"), [(32, True), (48, False)])
def test_that_a_train_is_elsewhere_is_seen_also_where_axles_beside_it_are_a_strangers(
    axles: int, *, gone: bool
) -> None:
    """Where it was somebody else may be."""
    beside = (Counted(0.0, 500.0, True, axles), Counted(500.0, 800.0, False, 0))
    area = OneArea(ANEW, counted=(*beside, Counted(800.0, 3000.0, True, 16)))
    area.strangers = (StandingTrain(300.0, 384.0, 16),)
    area.on_message(anew(100.0))

    assert [report for report, _ in area.settles()[1]] == ([anew(100.0)] if gone else [])


def test_of_one_that_fell_silent_nothing_is_kept_that_it_told_anew() -> None:
    area = OneArea((6, 1500.0), ANEW)
    area.on_message(anew(900.0), age_ns=500_000_001)

    assert area.settles() == (area.order, [])
    assert area.newborns.told() == []


@pytest.mark.parametrize(("axles", "left"), [(16, True), (32, False)])
def test_that_a_train_left_is_seen_where_all_axles_are_of_a_stranger_that_waits_for_that(
    axles: int, *, left: bool
) -> None:
    """The two waited for each other (seed 130561)."""
    area = OneArea(ANEW, counted=(Counted(800.0, 3000.0, True, axles),))
    area.strangers = (StandingTrain(1200.0, 1280.0, 16),)
    area.on_message(anew(100.0))

    assert area.settles() == (((), [(anew(100.0), NOW_NS)]) if left else (area.order, []))


def test_nobody_left_before_whom_somebody_may_be_it_up_to_the_end_of_the_area() -> None:
    counted = (Counted(0.0, 2000.0, False, 0), Counted(2000.0, 3000.0, True, 16))
    area = OneArea(ANEW, counted=counted)
    area.on_message(anew(100.0, standstill=False))

    assert area.settles() == (area.order, [])


def test_its_foremost_axle_is_looked_for_however_near_the_next_train_was() -> None:
    counted = (Counted(0.0, 903.0, False, 0), Counted(903.0, 3000.0, True, 16))
    area = OneArea((6, 902.0), ANEW, counted=counted)
    area.on_message(anew(100.0, standstill=False))

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize(
    ("axles", "standstill", "left"), [(16, True, True), (32, True, False), (16, False, False)]
)
def test_that_a_train_left_is_believed_if_it_stands_with_its_axles_where_it_says(
    axles: int, *, standstill: bool, left: bool
) -> None:
    """Although somebody is where it was."""
    counted = (Counted(0.0, 500.0, True, axles), Counted(500.0, 800.0, False, 0))
    area = OneArea(ANEW, counted=(*counted, Counted(800.0, 3000.0, True, 16)))
    area.on_message(anew(100.0, standstill=standstill))

    _, gone = area.settles()

    assert bool(gone) is left


@pytest.mark.parametrize(
    ("age_ns", "renewed"), [(10_000_000_000, True), (10_000_000_001, False), (0, True)]
)
def test_nobody_leaves_the_line_and_comes_back_within_ten_seconds(
    age_ns: int, *, renewed: bool
) -> None:
    """So that it does not matter that trains behind were not heard yet."""
    area = OneArea(ANEW, (2, 400.0))
    area.heard_of_life_before(1, age_ns=age_ns)
    area.on_message(anew(900.0))

    order, _ = area.settles()

    assert [entry.boot for entry in order] == [2 if renewed else 1, 1]


@pytest.mark.parametrize("echo_ns", [NOW_NS - 10_000_000_001, 0])
def test_what_comes_of_a_former_life_may_have_been_long_on_its_way(echo_ns: int) -> None:
    """It says when by the heartbeat that it echoes; or it does not say."""
    area = OneArea(ANEW, (2, 400.0))
    area.heard_of_life_before(1, age_ns=0, echo_ns=echo_ns)
    area.on_message(anew(900.0))

    assert area.settles() == (area.order, [])


def test_a_life_that_this_master_never_heard_of_is_not_recent_however_young_its_record() -> None:
    area = OneArea(ANEW, (2, 400.0))
    area.known.records[1].received_at_ns = NOW_NS
    area.on_message(anew(900.0))

    assert area.settles() == (area.order, [])


def settled(behind: TrainReport, *, kept_m: float = 400.0) -> list[int]:
    """Incarnations on the roster after the first train told of its new life, and this one that is
    behind it and cannot be renewed itself: it follows one that is not on the roster.
    """
    area = OneArea((1, 1900.0), (2, kept_m), before=AREA_4, start_m=1000.0, counted=OCCUPIED)
    area.on_message(anew(1900.0))
    area.on_message(dataclasses.replace(behind, comes_from=4, behind=3))
    return [entry.boot for entry in area.settles()[0]]


def test_trains_that_began_anew_one_behind_the_other_do_not_wait_for_each_other() -> None:
    """In seed 21751 two trains in the area, the next one before its border, and behind a train that
    was not on the roster yet the last one of it: all four had begun anew, and nobody moved on."""
    assert settled(anew(900.0, train=2)) == [2, 1]


def test_a_train_behind_that_is_heard_in_the_life_that_arbiters_kept_need_not_begin_anew() -> None:
    area = OneArea(ANEW, (2, 400.0))
    area.heard_of_life_before(2, age_ns=20_000_000_000)
    area.on_message(anew(900.0))

    order, _ = area.settles()

    assert [entry.boot for entry in order] == [2, 1]


def test_where_a_train_behind_is_counts_only_if_it_said_so_lately_and_knows_it() -> None:
    lately = dataclasses.replace(anew(900.0, train=2), echo_ns=NOW_NS - 500_000_000)
    assert settled(lately) == [2, 1]
    assert settled(dataclasses.replace(lately, echo_ns=NOW_NS - 500_000_001)) == [1, 1]
    assert settled(anew(900.0, train=2, localised=False)) == [1, 1]


def test_a_train_behind_that_was_seen_ahead_before_shows_that_one_was_away() -> None:
    """The front is at 1984 m at most."""
    assert settled(anew(900.0, train=2), kept_m=1984.1)[0] == 1
    assert settled(anew(890.0, train=2), kept_m=890.0)[0] == 2


def test_a_train_is_in_its_place_only_before_all_behind_it_that_began_anew() -> None:
    """The rear of such a one is unsure by 4 m."""
    assert settled(anew(1895.9, train=2), kept_m=400.0)[0] == 2
    assert settled(anew(1896.0, train=2), kept_m=400.0)[0] == 1
    assert settled(anew(1984.1, train=2), kept_m=400.0)[0] == 1


def test_trains_ahead_say_nothing_of_whether_a_train_has_been_away() -> None:
    area = OneArea((7, 2000.0), (6, 1500.0), ANEW)
    area.on_message(anew(900.0))

    order, _ = area.settles()

    assert order[2].boot == 2


def test_the_foremost_train_is_unsure_of_the_very_next_one_behind_it() -> None:
    area = OneArea(ANEW, (2, 700.0), (3, 400.0))
    area.heard_of_life_before(3, age_ns=0)
    area.on_message(anew(900.0))

    assert area.settles() == (area.order, [])


def test_several_trains_are_settled_at_once_each_by_what_it_told() -> None:
    area = OneArea((6, 1500.0), ANEW, (2, 400.0), (3, 200.0), counted=OCCUPIED)
    area.on_message(anew(100.0, train=6))
    area.on_message(anew(900.0))
    area.on_message(anew(380.0, train=2))
    area.on_message(anew(200.0, train=3))
    for train in (1, 2, 3):
        area.heard_of_life_before(train, age_ns=0)

    order, gone = area.settles()

    assert [entry.boot for entry in order] == [1, 2, 1, 2]
    assert gone == []


@pytest.mark.parametrize(
    ("was", "age_ns", "axles", "sieved"),
    [
        (True, 10_000_000_000, 32, True),
        (True, 10_000_000_001, 32, False),
        (False, 0, 32, False),
        (False, 10_000_000_001, 16, True),
        (True, 0, 16, True),
    ],
)
def test_nothing_hides_near_a_train_if_that_was_so_lately_or_is_seen_again(
    age_ns: int, axles: int, *, was: bool, sieved: bool
) -> None:
    area = OneArea(ANEW, counted=(Counted(0.0, 3000.0, True, axles),), sieved=was)
    area.heard_of_life_before(1, age_ns=age_ns)
    area.on_message(anew(900.0))

    order, _ = area.settles()

    assert order == (RosterEntry(1, 900.0, sieved, 2),)


# Over the border of the area, where another one commands it.


@pytest.mark.parametrize(
    ("comes_from", "behind", "renewed"),
    [(4, 6, True), (4, 0, True), (4, 7, False), (4, 2, False), (3, 6, False), (0, 0, False)],
)
def test_over_the_border_a_train_is_renewed_only_in_line_as_it_was_admitted(
    comes_from: int, behind: int, *, renewed: bool
) -> None:
    area = OneArea((7, 2000.0), (6, 1500.0), ANEW, (2, 400.0), before=AREA_4, start_m=1000.0)
    area.heard_of_life_before(1, age_ns=0)
    area.on_message(anew(900.0, comes_from=comes_from, behind=behind))

    order, gone = area.settles()

    kept = RosterEntry(1, 900.0, True, 2) if renewed else area.order[2]
    assert order == (*area.order[:2], kept, area.order[3])
    assert gone == []


@pytest.mark.parametrize(("behind", "renewed"), [(0, True), (2, False), (1, False)])
def test_over_the_border_the_foremost_train_has_nobody_ahead_of_it(
    behind: int, *, renewed: bool
) -> None:
    area = OneArea(ANEW, (2, 400.0), before=AREA_4, start_m=1000.0)
    area.heard_of_life_before(1, age_ns=0)
    area.on_message(anew(900.0, comes_from=4, behind=behind))

    order, _ = area.settles()

    assert order[0].boot == (2 if renewed else 1)


@pytest.mark.parametrize(
    ("rear_m", "before", "sieved"),
    [
        (916.0, AREA_4, True),  # Its front may be at the border, but no farther.
        (916.1, AREA_4, False),
        (916.0, None, False),
        (900.0, None, False),
    ],
)
def test_who_is_in_the_area_needs_no_line_but_has_to_be_counted(
    rear_m: float, before: Area | None, *, sieved: bool
) -> None:
    comes_from = 4 if sieved else 0
    area = OneArea(ANEW, before=before, start_m=1000.0, counted=OCCUPIED)
    area.on_message(anew(rear_m, comes_from=comes_from))

    order, _ = area.settles()

    assert order == (RosterEntry(1, rear_m, sieved, 2),)


def test_axles_before_the_border_do_not_show_that_a_train_left() -> None:
    """They are of the area before, of which a master is told one section only."""
    counted = (Counted(0.0, 500.0, True, 16), Counted(500.0, 800.0, False, 0))
    stays = (*counted, Counted(800.0, 3000.0, True, 16))
    area = OneArea(ANEW, before=AREA_4, start_m=1000.0, counted=stays)
    area.on_message(anew(100.0, comes_from=4))

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize(
    ("axles", "first_m", "left"),
    [(0, 900.0, True), (16, 900.0, False), (0, 1000.0, True), (0, 1000.1, False)],
)
def test_that_a_train_left_from_before_the_border_is_seen_by_what_the_area_itself_counts(
    axles: int, first_m: float, *, left: bool
) -> None:
    """It is told of one section before the border only; how it is farther back, nobody told it
    (seed 207948): all waited for an entry that could never go.
    """
    counted = (Counted(first_m, 1100.0, False, 0), Counted(1100.0, 3000.0, bool(axles), axles))
    area = OneArea((1, 600.0), before=AREA_4, start_m=1000.0, counted=counted)
    area.on_message(anew(100.0, comes_from=4))

    assert area.settles() == (
        ((), [(anew(100.0, comes_from=4), NOW_NS)]) if left else (area.order, [])
    )


def test_whoever_left_need_not_stand_in_line_to_be_off_the_roster() -> None:
    area = OneArea(ANEW, before=AREA_4, start_m=1000.0, counted=CLEAR)
    area.on_message(anew(100.0, comes_from=0, behind=8))

    order, gone = area.settles()

    assert (order, len(gone)) == ((), 1)


def test_a_master_gives_nothing_by_an_entry_of_another_life_until_it_is_renewed() -> None:
    command = Command(roster=tuple([entry._replace(boot=7) for entry in ROSTER]))
    command.step()
    command.on_message(1, 900.0)
    command.on_message(2, 500.0)

    assert command.step(acks=False) == {}

    # Both are where they were, and all are heard: the entries are renewed, kept, and then used.
    issued: dict[int, AreaAuthority] = {}
    for _ in range(5):
        command.on_message(1, 900.0)
        command.on_message(2, 500.0)
        issued |= command.step()
    assert set(issued) == {1, 2}
    assert [entry.boot for entry in command.master.roster.proposed] == [1, 1]


def own_train(rear_m: float) -> OwnTrain:
    front_m = rear_m + 80.0
    return OwnTrain(
        True, front_m, front_m + 2.0, rear_m, rear_m, 0.0, True, front_m + 2.0, front_m + 2.0, 16
    )


def core_of_a_train() -> TrainCore:
    return TrainCore(
        T2tConfig(), line_of_areas(1), address=1, memory=TrainMemory(), start_ns=1_000_000_000
    )


def test_a_train_whose_clock_goes_back_takes_no_part_until_it_is_started_anew() -> None:
    core = core_of_a_train()
    assert core.step(2_000_000_000, (), own_train(500.0)).memory is not None
    assert core.step(3_000_000_000, (), own_train(500.0)).out

    for now_ns in (2_999_999_999, 4_000_000_000, 9_000_000_000):
        stepped = core.step(now_ns, (), own_train(500.0))
        assert (stepped.authority, stepped.out) == (None, ())
    assert core.refusals["clock went back"] == 1


def test_a_train_that_is_farther_back_than_it_may_roll_takes_no_part_either() -> None:
    core = core_of_a_train()
    core.step(2_000_000_000, (), own_train(500.0))
    assert core.step(3_000_000_000, (), own_train(492.0)).out

    assert not core.step(4_000_000_000, (), own_train(490.0)).out

    assert not core.step(9_000_000_000, (), own_train(600.0)).out
    assert core.refusals["place went back"] == 1


def test_trains_that_leave_at_the_end_come_back_at_the_beginning_and_run_on() -> None:
    drawn = draw(4)
    line = line_of_areas(1, objects=False)
    cast = LineParticipants(line, T2tConfig(), (1, 2, 3))
    setting = Setting({1: 200.0, 2: 900.0, 3: 1600.0}, stops_m=(), dwell_s=5.0)
    world = LineWorld(4, dataclasses.replace(drawn, cast=cast, setting=setting))
    depot = Depot(world, world.rng)
    world.boot_all()
    left = []
    for second in range(1, 400):
        world.net.run(second * 1_000_000_000)
        if depot.leaves():
            left.append(second)

    assert len(left) >= 3
    assert depot.entered >= 3
    # Each was commanded from the beginning on to the end again.
    assert world.without_authority() == []
    assert min(train.front_m for train in world.trains.values() if train.on_line) > 150.0


def test_who_came_behind_one_that_has_left_the_roster_keeps_its_place_and_gets_nothing_by_it() -> (
    None
):
    """The one ahead went back over the border; who is ahead now is not whom it says to follow."""
    counted = (Counted(0.0, 1496.0, True, 48), Counted(1496.0, 3000.0, False, 0))
    trains = ((7, 2000.0), (5, 1500.0), (1, 800.0))
    area = OneArea(*trains, before=AREA_4, start_m=1000.0, counted=counted)
    area.heard_of_life_before(1, age_ns=0)
    area.on_message(anew(900.0, train=5, comes_from=4))
    area.on_message(anew(800.0, comes_from=4, behind=5))

    order, gone = area.settles()

    assert [report.source for report, _ in gone] == [5]
    assert [(entry.train, entry.boot) for entry in order] == [(7, 1), (1, 1)]


@pytest.mark.parametrize("promised", [True, False])
def test_all_trains_that_began_anew_around_one_that_comes_in_between_find_their_places(
    *, promised: bool
) -> None:
    """The first waited for a word of those behind it, the one in between for room behind it, and
    the last, over the border, for the one that is ahead of it there. What the last one held in its
    former life bounds it no longer.
    """
    first, between, last = 4, 3, 2
    chair = Chair((entry(first, 3445.0), entry(last, 1249.0)), area=2, sections=True)
    for _ in range(4):
        chair.now_ns += 200 * MS
        chair.reports(first, 3856.0, boot=8)
        chair.reports(between, 2044.0, boot=6, comes_from=1)
        anew = {"boot": 3, "comes_from": 1, "behind": between}
        chair.reports(last, 1947.0, **anew, term=TERM if promised else TERM - 1)
        chair.track(axles={4: 23, 5: 9, 8: 16})
        chair.step(0)
        chair.keeps()

    assert chair.order() == ([first, between, last] if promised else [first, last])


@pytest.mark.parametrize(
    ("told", "bound_m"),
    [
        ({"boot": 3, "term": TERM}, 1947.0),
        ({"boot": 3, "term": TERM - 1}, 1.0e6),
        ({"boot": 1, "term": TERM}, 1.0e6),
    ],
)
def test_what_bounds_a_train_that_began_anew(told: dict[str, int], bound_m: float) -> None:
    chair = Chair((entry(2, 1249.0, boot=2),))
    chair.reports(2, 1940.0, latent_m=1947.0, **told)

    known, order = chair.master._known, chair.master.roster.proposed
    assert known.reserved_m(order) == {2: bound_m}


def test_what_arbiters_keep_of_a_life_is_not_of_one_that_began_since() -> None:
    chair = Chair((entry(2, 1249.0, boot=2),))
    told = chair.reports(2, 1940.0, boot=3, term=TERM - 1)
    chair.master._known.on_restarted_report(dataclasses.replace(told, boot=2, term=TERM))

    assert chair.master._known.reserved_m(chair.master.roster.proposed) == {2: 1.0e6}
