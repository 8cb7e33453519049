"""Restarted trains: they get no authority until the master knows whether they stayed in place or
left the line."""

import dataclasses
from collections.abc import Sequence

import pytest

from firmware_py.trackdb.areas import Area
from hil_tests.unit.vobc.train_to_train.t2t_chair import MS, TERM, Chair, entry
from hil_tests.unit.vobc.train_to_train.t2t_one_area import (
    BEYOND,
    NOW_NS,
    OneArea,
    report_at,
    restarted,
)
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
def test_a_restarted_train_within_reach_of_its_former_place_is_in_place(rear_m: float) -> None:
    assert found(rear_m) is RestartPlace.IN_PLACE


@pytest.mark.parametrize("rear_m", [988.9, 20.0])
def test_a_restarted_train_beyond_its_rollback_distance_needs_further_proof(
    rear_m: float,
) -> None:
    assert found(rear_m) is RestartPlace.UNSURE
    assert found(rear_m, NOTHING._replace(recent=True)) is RestartPlace.UNSURE
    assert found(rear_m, NOTHING._replace(sieved=True)) is RestartPlace.GONE
    assert found(rear_m, NOTHING._replace(left=True)) is RestartPlace.GONE


def test_a_restarted_train_behind_a_former_follower_has_been_away() -> None:
    heard = TrainRecord(2, 1085.0, 0, report=report_at(1085.0, train=2), boot=1)

    assert found(1000.0, NOTHING, heard) is RestartPlace.UNSURE
    assert found(1000.0, NOTHING._replace(sieved=True), heard) is RestartPlace.GONE


def test_a_restarted_train_that_may_touch_its_follower_has_not_been_away() -> None:
    heard = TrainRecord(2, 1084.0, 0, report=report_at(1084.0, train=2), boot=1)

    assert found(1000.0, NOTHING, heard) is RestartPlace.IN_PLACE


def test_one_former_follower_ahead_shows_that_a_restarted_train_was_away() -> None:
    ahead = TrainRecord(2, 1085.0, 0, report=report_at(1085.0, train=2), boot=1)
    behind = TrainRecord(3, 400.0, 0, report=report_at(400.0, train=3), boot=1)

    assert found(1000.0, NOTHING, ahead, behind) is RestartPlace.UNSURE


def test_the_order_is_known_only_when_all_trains_behind_have_reported() -> None:
    heard = TrainRecord(2, 400.0, 0, report=report_at(400.0, train=2), boot=1)
    unheard = TrainRecord(3, 200.0, 0, boot=1)

    assert found(1000.0, NOTHING, heard) is RestartPlace.IN_PLACE
    assert found(1000.0, NOTHING, heard, unheard) is RestartPlace.UNSURE


def test_a_train_behind_that_never_reported_leaves_the_order_unknown() -> None:
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
def test_a_restarted_train_before_its_former_predecessor_has_been_away(
    ahead: Sequence[Neighbour], found: RestartPlace
) -> None:
    """The other train must certainly not be farther on by now; a silent one may be."""
    former = Former(TrainRecord(1, 900.0, 0, boot=1), (), ahead)

    def judged(evidence: RestartEvidence) -> RestartPlace:
        return whereabouts(former, report_at(1000.0), evidence, behind_rear_m=BEHIND_M)

    gone = found is RestartPlace.GONE
    assert judged(NOTHING) is (RestartPlace.UNSURE if gone else found)
    assert judged(NOTHING._replace(sieved=True)) is found
    assert judged(NOTHING._replace(left=True)) is found
    # No train is moved past another by hand so soon.
    recent = judged(NOTHING._replace(recent=True))
    assert recent is (RestartPlace.UNSURE if gone else RestartPlace.IN_PLACE)


AREA_4 = Area(4, 0.0, 1000.0)
RESTARTED = (1, 900.0)
"""The restarted train of the following tests and its former rear."""


OCCUPIED = (Counted(0.0, 3000.0, True, 32),)
"""The whole area is occupied by more than one train of 16 axles."""


def test_the_report_of_a_restarted_train_is_kept_until_it_is_discarded() -> None:
    area = OneArea()
    area.on_message(restarted(900.0))
    area.on_message(restarted(901.0), age_ns=-3)
    area.on_message(restarted(500.0, train=2))

    assert area.newborns.told() == [
        (restarted(901.0), NOW_NS + 3),
        (restarted(500.0, train=2), NOW_NS),
    ]

    area.newborns.forgets(1)
    area.newborns.forgets(7)
    assert area.newborns.told() == [(restarted(500.0, train=2), NOW_NS)]


def test_readiness_for_a_switch_counts_for_half_the_life_of_an_authority() -> None:
    area = OneArea()
    area.on_message(restarted(900.0), age_ns=500_000_000)
    area.on_message(restarted(500.0, train=2), age_ns=500_000_001)

    assert area.newborns.ready(area.known, NOW_NS) == [(1, 41)]


def test_a_train_restarted_in_place_is_renewed_there_without_an_authority() -> None:
    area = OneArea((6, 1500.0), RESTARTED, (2, 400.0))
    area.receives_former_report(1, age_ns=0)
    area.known.records[1].issued(7, 1400.0, life_ns=0)
    area.on_message(restarted(898.0), age_ns=20)

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
def test_only_a_train_with_a_recent_position_can_have_been_passed(
    age_ns: int, *, gone: bool
) -> None:
    """The train's rear is at most at 704 m and may come 20 m farther in half a second."""
    area = OneArea((6, 700.0), (1, 500.0))
    area.receives_former_report(6, age_ns=0, echo_ns=NOW_NS - age_ns)
    area.on_message(BEYOND)

    order, _ = area.settles()

    assert [entry.train for entry in order] == ([6] if gone else [6, 1])
    assert order[-1].boot == 1


@pytest.mark.parametrize(("rear_m", "gone"), [(724.1, True), (724.0, False)])
def test_the_possible_movement_of_a_passed_train_is_included(rear_m: float, *, gone: bool) -> None:
    area = OneArea((6, 700.0), (1, 500.0))
    area.receives_former_report(6, age_ns=0, echo_ns=NOW_NS - 500_000_000)
    area.on_message(restarted(rear_m))

    order, _ = area.settles()

    assert [entry.train for entry in order] == ([6] if gone else [6, 1])


@pytest.mark.parametrize("kept_only", [False, True])
def test_a_lost_train_or_one_known_only_from_the_roster_may_have_moved_on(
    *, kept_only: bool
) -> None:
    area = OneArea((6, 700.0), (1, 500.0))
    if not kept_only:
        area.receives_former_report(6, age_ns=0, echo_ns=NOW_NS)
        area.receives_former_report(6, age_ns=0, echo_ns=NOW_NS, localised=False)
    area.on_message(BEYOND)

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize(("age_ns", "renewed"), [(500_000_000, True), (500_000_001, False)])
def test_an_old_report_of_a_restarted_train_settles_nothing(age_ns: int, *, renewed: bool) -> None:
    """This holds however late the report arrived."""
    area = OneArea(RESTARTED)
    area.on_message(dataclasses.replace(restarted(900.0), echo_ns=NOW_NS - age_ns))

    order, gone = area.settles()

    assert [entry.boot for entry in order] == [2 if renewed else 1]
    assert (gone, len(area.newborns.told())) == ([], 0 if renewed else 1)


def test_a_lost_or_silent_restarted_train_keeps_its_roster_entry_unchanged() -> None:
    area = OneArea((6, 1500.0), RESTARTED)
    area.on_message(restarted(900.0, localised=False))

    assert area.settles() == (area.order, [])
    assert area.newborns.told() == [(restarted(900.0, localised=False), NOW_NS)]
    assert [record.boot for record in area.known.records.values()] == [1, 1]


def test_a_restarted_train_that_may_have_been_away_keeps_its_entry_without_authority() -> None:
    area = OneArea(RESTARTED, counted=OCCUPIED)
    area.on_message(restarted(100.0))

    assert area.settles() == (area.order, [])
    assert area.newborns.told() == [(restarted(100.0), NOW_NS)]
    assert area.known.records[1] == TrainRecord(1, 900.0, 0, boot=1)


CLEAR = (Counted(0.0, 904.0, True, 32), Counted(904.0, 3000.0, False, 0))
"""The track from the foremost possible axle on, for a train of 15 m after 7 m of rollback and
jog."""


def test_a_restarted_train_that_left_is_removed_and_applies_like_an_unregistered_one() -> None:
    area = OneArea((6, 1500.0), RESTARTED, (2, 400.0), counted=CLEAR)
    area.on_message(restarted(100.0), age_ns=20)

    order, gone = area.settles()

    assert order == (area.order[0], area.order[2])
    assert gone == [(restarted(100.0), NOW_NS - 20)]
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
def test_a_report_farther_back_does_not_count_while_axles_may_be_at_the_former_place(
    counted: tuple[Counted, ...],
) -> None:
    area = OneArea(RESTARTED, counted=counted)
    area.on_message(restarted(100.0))

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize("before", [None, Area(4, 0.0, 1000.0)])
def test_without_axle_counters_a_report_farther_back_is_sufficient(
    before: Area | None,
) -> None:
    area = OneArea(RESTARTED, before=before, start_m=0.0 if before is None else 1000.0)
    area.on_message(restarted(100.0))

    assert area.settles() == ((), [(restarted(100.0), NOW_NS)])


@pytest.mark.parametrize(
    ("ahead_m", "axles", "left"),
    [(None, 16, True), (None, 32, False), (2000.0, 16, True), (2000.1, 16, False)],
)
def test_a_departure_is_proven_when_all_axles_belong_to_the_train_waiting_behind(
    ahead_m: float | None, axles: int, *, left: bool
) -> None:
    """The check reaches to the next train ahead (simulation seed 10570). The restarted train
    runs elsewhere."""
    there = (Counted(0.0, 500.0, True, 16), Counted(500.0, 2000.0, True, axles))
    beyond = Counted(2000.0, 3000.0, ahead_m is not None, 0 if ahead_m is None else 16)
    trains = [RESTARTED, (2, 700.0)] if ahead_m is None else [(6, ahead_m), RESTARTED, (2, 700.0)]
    area = OneArea(*trains, counted=(*there, beyond))
    area.at_rest = (StandingTrain(700.0, 784.0, 16), StandingTrain(100.0, 184.0, 16))
    area.on_message(restarted(100.0, standstill=False))

    _, gone = area.settles()

    assert bool(gone) is left


def test_a_departure_is_proven_even_with_a_committed_train_close_ahead() -> None:
    area = OneArea((6, 902.0), RESTARTED, counted=CLEAR)
    area.on_message(restarted(100.0))

    assert area.settles() == (area.order[:1], [(restarted(100.0), NOW_NS)])


@pytest.mark.parametrize(("axles", "gone"), [(32, True), (48, False)])
def test_a_new_place_is_proven_even_beside_an_unregistered_train(axles: int, *, gone: bool) -> None:
    """Another train may stand where it was."""
    beside = (Counted(0.0, 500.0, True, axles), Counted(500.0, 800.0, False, 0))
    area = OneArea(RESTARTED, counted=(*beside, Counted(800.0, 3000.0, True, 16)))
    area.unregistered = (StandingTrain(300.0, 384.0, 16),)
    area.on_message(restarted(100.0))

    assert [report for report, _ in area.settles()[1]] == ([restarted(100.0)] if gone else [])


def test_the_report_of_a_restarted_train_that_fell_silent_is_discarded() -> None:
    area = OneArea((6, 1500.0), RESTARTED)
    area.on_message(restarted(900.0), age_ns=500_000_001)

    assert area.settles() == (area.order, [])
    assert area.newborns.told() == []


@pytest.mark.parametrize(("axles", "left"), [(16, True), (32, False)])
def test_a_departure_is_proven_when_all_axles_belong_to_a_waiting_unregistered_train(
    axles: int, *, left: bool
) -> None:
    """The two trains waited for each other (simulation seed 130561)."""
    area = OneArea(RESTARTED, counted=(Counted(800.0, 3000.0, True, axles),))
    area.unregistered = (StandingTrain(1200.0, 1280.0, 16),)
    area.on_message(restarted(100.0))

    assert area.settles() == (((), [(restarted(100.0), NOW_NS)]) if left else (area.order, []))


def test_no_departure_is_proven_while_axles_ahead_may_be_the_train() -> None:
    counted = (Counted(0.0, 2000.0, False, 0), Counted(2000.0, 3000.0, True, 16))
    area = OneArea(RESTARTED, counted=counted)
    area.on_message(restarted(100.0, standstill=False))

    assert area.settles() == (area.order, [])


def test_the_foremost_axle_is_searched_however_close_the_train_ahead_was() -> None:
    counted = (Counted(0.0, 903.0, False, 0), Counted(903.0, 3000.0, True, 16))
    area = OneArea((6, 902.0), RESTARTED, counted=counted)
    area.on_message(restarted(100.0, standstill=False))

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize(
    ("axles", "standstill", "left"), [(16, True, True), (32, True, False), (16, False, False)]
)
def test_a_departure_is_proven_by_its_own_axles_at_the_reported_place(
    axles: int, *, standstill: bool, left: bool
) -> None:
    """This holds although another vehicle stands where the train was."""
    counted = (Counted(0.0, 500.0, True, axles), Counted(500.0, 800.0, False, 0))
    area = OneArea(RESTARTED, counted=(*counted, Counted(800.0, 3000.0, True, 16)))
    area.on_message(restarted(100.0, standstill=standstill))

    _, gone = area.settles()

    assert bool(gone) is left


@pytest.mark.parametrize(
    ("age_ns", "renewed"), [(10_000_000_000, True), (10_000_000_001, False), (0, True)]
)
def test_a_train_restarted_within_ten_seconds_cannot_have_left_the_line(
    age_ns: int, *, renewed: bool
) -> None:
    """So it does not matter that trains behind have not reported yet."""
    area = OneArea(RESTARTED, (2, 400.0))
    area.receives_former_report(1, age_ns=age_ns)
    area.on_message(restarted(900.0))

    order, _ = area.settles()

    assert [entry.boot for entry in order] == [2 if renewed else 1, 1]


@pytest.mark.parametrize("echo_ns", [NOW_NS - 10_000_000_001, 0])
def test_a_report_of_the_former_incarnation_may_be_old(echo_ns: int) -> None:
    """The echoed heartbeat dates the report; without one its age is unknown."""
    area = OneArea(RESTARTED, (2, 400.0))
    area.receives_former_report(1, age_ns=0, echo_ns=echo_ns)
    area.on_message(restarted(900.0))

    assert area.settles() == (area.order, [])


def test_an_incarnation_that_never_reported_to_this_master_is_not_recent() -> None:
    area = OneArea(RESTARTED, (2, 400.0))
    area.known.records[1].received_at_ns = NOW_NS
    area.on_message(restarted(900.0))

    assert area.settles() == (area.order, [])


def settled(behind: TrainReport, *, kept_m: float = 400.0) -> list[int]:
    """Incarnations on the roster after the reports of the first train and of this one behind it.

    The train behind cannot be renewed itself, because it follows one that is not on the roster.
    """
    area = OneArea((1, 1900.0), (2, kept_m), before=AREA_4, start_m=1000.0, counted=OCCUPIED)
    area.on_message(restarted(1900.0))
    area.on_message(dataclasses.replace(behind, comes_from=4, behind=3))
    return [entry.boot for entry in area.settles()[0]]


def test_restarted_trains_in_a_row_do_not_wait_for_each_other() -> None:
    """Four restarted trains once waited for each other (simulation seed 21751).

    Two were in the area and one before its border. The last one followed a train that was not on
    the roster yet.
    """
    assert settled(restarted(900.0, train=2)) == [2, 1]


def test_a_train_behind_in_its_committed_incarnation_counts_as_known() -> None:
    area = OneArea(RESTARTED, (2, 400.0))
    area.receives_former_report(2, age_ns=20_000_000_000)
    area.on_message(restarted(900.0))

    order, _ = area.settles()

    assert [entry.boot for entry in order] == [2, 1]


def test_the_place_of_a_train_behind_counts_only_if_recent_and_localised() -> None:
    lately = dataclasses.replace(restarted(900.0, train=2), echo_ns=NOW_NS - 500_000_000)
    assert settled(lately) == [2, 1]
    assert settled(dataclasses.replace(lately, echo_ns=NOW_NS - 500_000_001)) == [1, 1]
    assert settled(restarted(900.0, train=2, localised=False)) == [1, 1]


def test_a_train_behind_that_was_recorded_ahead_shows_that_one_was_away() -> None:
    """The front is at 1984 m at most."""
    assert settled(restarted(900.0, train=2), kept_m=1984.1)[0] == 1
    assert settled(restarted(890.0, train=2), kept_m=890.0)[0] == 2


def test_a_train_is_in_place_only_ahead_of_all_restarted_trains_behind_it() -> None:
    """The rear of a restarted train is uncertain by 4 m."""
    assert settled(restarted(1895.9, train=2), kept_m=400.0)[0] == 2
    assert settled(restarted(1896.0, train=2), kept_m=400.0)[0] == 1
    assert settled(restarted(1984.1, train=2), kept_m=400.0)[0] == 1


def test_silent_trains_ahead_do_not_matter_for_a_restart() -> None:
    area = OneArea((7, 2000.0), (6, 1500.0), RESTARTED)
    area.on_message(restarted(900.0))

    order, _ = area.settles()

    assert order[2].boot == 2


def test_the_foremost_train_waits_for_a_report_of_the_next_one_behind_it() -> None:
    area = OneArea(RESTARTED, (2, 700.0), (3, 400.0))
    area.receives_former_report(3, age_ns=0)
    area.on_message(restarted(900.0))

    assert area.settles() == (area.order, [])


def test_several_restarted_trains_are_settled_at_once() -> None:
    area = OneArea((6, 1500.0), RESTARTED, (2, 400.0), (3, 200.0), counted=OCCUPIED)
    area.on_message(restarted(100.0, train=6))
    area.on_message(restarted(900.0))
    area.on_message(restarted(380.0, train=2))
    area.on_message(restarted(200.0, train=3))
    for train in (1, 2, 3):
        area.receives_former_report(train, age_ns=0)

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
def test_a_restarted_train_stays_sieved_if_recent_or_proven_again(
    age_ns: int, axles: int, *, was: bool, sieved: bool
) -> None:
    area = OneArea(RESTARTED, counted=(Counted(0.0, 3000.0, True, axles),), sieved=was)
    area.receives_former_report(1, age_ns=age_ns)
    area.on_message(restarted(900.0))

    order, _ = area.settles()

    assert order == (RosterEntry(1, 900.0, sieved, 2),)


# Trains before the border of the area, where another master commands.


@pytest.mark.parametrize(
    ("comes_from", "behind", "renewed"),
    [(4, 6, True), (4, 0, True), (4, 7, False), (4, 2, False), (3, 6, False), (0, 0, False)],
)
def test_before_the_border_a_train_is_renewed_only_in_line(
    comes_from: int, behind: int, *, renewed: bool
) -> None:
    area = OneArea((7, 2000.0), (6, 1500.0), RESTARTED, (2, 400.0), before=AREA_4, start_m=1000.0)
    area.receives_former_report(1, age_ns=0)
    area.on_message(restarted(900.0, comes_from=comes_from, behind=behind))

    order, gone = area.settles()

    kept = RosterEntry(1, 900.0, True, 2) if renewed else area.order[2]
    assert order == (*area.order[:2], kept, area.order[3])
    assert gone == []


@pytest.mark.parametrize(("behind", "renewed"), [(0, True), (2, False), (1, False)])
def test_before_the_border_the_foremost_train_has_none_ahead(behind: int, *, renewed: bool) -> None:
    area = OneArea(RESTARTED, (2, 400.0), before=AREA_4, start_m=1000.0)
    area.receives_former_report(1, age_ns=0)
    area.on_message(restarted(900.0, comes_from=4, behind=behind))

    order, _ = area.settles()

    assert order[0].boot == (2 if renewed else 1)


@pytest.mark.parametrize(
    ("rear_m", "before", "sieved"),
    [
        (916.0, AREA_4, True),  # The front may be at the border but not beyond.
        (916.1, AREA_4, False),
        (916.0, None, False),
        (900.0, None, False),
    ],
)
def test_a_train_in_the_area_needs_an_axle_count_instead_of_a_line(
    rear_m: float, before: Area | None, *, sieved: bool
) -> None:
    comes_from = 4 if sieved else 0
    area = OneArea(RESTARTED, before=before, start_m=1000.0, counted=OCCUPIED)
    area.on_message(restarted(rear_m, comes_from=comes_from))

    order, _ = area.settles()

    assert order == (RosterEntry(1, rear_m, sieved, 2),)


def test_axles_before_the_border_do_not_prove_a_departure() -> None:
    """Those sections belong to the area before; this master receives only one of them."""
    counted = (Counted(0.0, 500.0, True, 16), Counted(500.0, 800.0, False, 0))
    stays = (*counted, Counted(800.0, 3000.0, True, 16))
    area = OneArea(RESTARTED, before=AREA_4, start_m=1000.0, counted=stays)
    area.on_message(restarted(100.0, comes_from=4))

    assert area.settles() == (area.order, [])


@pytest.mark.parametrize(
    ("axles", "first_m", "left"),
    [(0, 900.0, True), (16, 900.0, False), (0, 1000.0, True), (0, 1000.1, False)],
)
def test_the_areas_own_count_proves_a_departure_from_before_the_border(
    axles: int, first_m: float, *, left: bool
) -> None:
    """The master receives only one section before the border.

    Once all trains waited for an entry that it could never remove (simulation seed 207948).
    """
    counted = (Counted(first_m, 1100.0, False, 0), Counted(1100.0, 3000.0, bool(axles), axles))
    area = OneArea((1, 600.0), before=AREA_4, start_m=1000.0, counted=counted)
    area.on_message(restarted(100.0, comes_from=4))

    assert area.settles() == (
        ((), [(restarted(100.0, comes_from=4), NOW_NS)]) if left else (area.order, [])
    )


def test_a_departed_train_is_removed_without_standing_in_line() -> None:
    area = OneArea(RESTARTED, before=AREA_4, start_m=1000.0, counted=CLEAR)
    area.on_message(restarted(100.0, comes_from=0, behind=8))

    order, gone = area.settles()

    assert (order, len(gone)) == ((), 1)


def test_a_master_grants_nothing_for_an_entry_of_another_incarnation_until_renewed() -> None:
    command = Command(roster=tuple([entry._replace(boot=7) for entry in ROSTER]))
    command.step()
    command.on_message(1, 900.0)
    command.on_message(2, 500.0)

    assert command.step(acks=False) == {}

    # Both stand where they were and all report. The entries are renewed, committed, and then used.
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


def test_a_train_whose_clock_goes_back_does_not_participate_until_restarted() -> None:
    core = core_of_a_train()
    assert core.step(2_000_000_000, (), own_train(500.0)).memory is not None
    assert core.step(3_000_000_000, (), own_train(500.0)).out

    for now_ns in (2_999_999_999, 4_000_000_000, 9_000_000_000):
        stepped = core.step(now_ns, (), own_train(500.0))
        assert (stepped.authority, stepped.out) == (None, ())
    assert core.refusals["clock went back"] == 1


def test_a_train_farther_back_than_its_rollback_distance_does_not_participate() -> None:
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
        if len(left) > 3 and depot.entered >= 3 and not world.without_authority():
            break

    # The first train was commanded all the way from the beginning to the end again.
    assert len(left) > 3
    assert depot.entered >= 3
    assert world.without_authority() == []
    assert min(train.front_m for train in world.trains.values() if train.on_line) > 150.0


def test_a_train_that_follows_a_removed_one_keeps_its_entry_without_authority() -> None:
    """The train ahead went back over the border, so the train that is ahead now is not the one
    it reports."""
    counted = (Counted(0.0, 1496.0, True, 48), Counted(1496.0, 3000.0, False, 0))
    trains = ((7, 2000.0), (5, 1500.0), (1, 800.0))
    area = OneArea(*trains, before=AREA_4, start_m=1000.0, counted=counted)
    area.receives_former_report(1, age_ns=0)
    area.on_message(restarted(900.0, train=5, comes_from=4))
    area.on_message(restarted(800.0, comes_from=4, behind=5))

    order, gone = area.settles()

    assert [report.source for report, _ in gone] == [5]
    assert [(entry.train, entry.boot) for entry in order] == [(7, 1), (1, 1)]


@pytest.mark.parametrize("promised", [True, False])
def test_restarted_trains_around_a_newcomer_find_their_places(*, promised: bool) -> None:
    """The first train waited for reports of the trains behind it, and the middle one for room
    behind it.

    The last one, beyond the border, waited for the train ahead of it there. Its former authority no
    longer limits it.
    """
    first, between, last = 4, 3, 2
    chair = Chair((entry(first, 3445.0), entry(last, 1249.0)), area=2, sections=True)
    for _ in range(4):
        chair.now_ns += 200 * MS
        chair.reports(first, 3856.0, boot=8)
        chair.reports(between, 2044.0, boot=6, comes_from=1)
        restarted = {"boot": 3, "comes_from": 1, "behind": between}
        chair.reports(last, 1947.0, **restarted, term=TERM if promised else TERM - 1)
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
def test_the_bound_of_a_restarted_train(told: dict[str, int], bound_m: float) -> None:
    chair = Chair((entry(2, 1249.0, boot=2),))
    chair.reports(2, 1940.0, latent_m=1947.0, **told)

    known, order = chair.master._known, chair.master.roster.proposed
    assert known.reserved_m(order) == {2: bound_m}


def test_a_committed_entry_does_not_apply_to_a_later_incarnation() -> None:
    chair = Chair((entry(2, 1249.0, boot=2),))
    told = chair.reports(2, 1940.0, boot=3, term=TERM - 1)
    chair.master._known.on_restarted_report(dataclasses.replace(told, boot=2, term=TERM))

    assert chair.master._known.reserved_m(chair.master.roster.proposed) == {2: 1.0e6}
