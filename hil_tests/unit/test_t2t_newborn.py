"""A train that begins anew gets nothing by what arbiters kept of its former life, until it is clear
whether it is where it was, or left the line and came back."""

import dataclasses

import pytest

from hil_tests.unit.test_t2t_regressions import ROSTER, Command
from metro_hil.network.crew import Cast
from metro_hil.network.depot import Depot
from metro_hil.network.line_world import LineWorld, draw, line_of_areas
from metro_hil.network.world import Setting
from vobc.t2t.authority import Counted
from vobc.t2t.newborn import Evidence, Former, Whereabouts, is_clear, whereabouts
from vobc.t2t.table import Record
from vobc.t2t.train import TrainCore
from vobc.t2t.vocabulary import OwnTrain, T2tConfig, TrainMemory
from zenoh_config.t2t import TrainReport

NOTHING = Evidence(sieved=False, clear=False, recent=False)
BEHIND_M = 7.0


def report_at(rear_m: float, *, train: int = 1, unsure_m: float = 4.0) -> TrainReport:
    front_m = rear_m + 80.0
    return TrainReport(
        *(train, 65_535, 1, 5, 2, 1, 0, True, front_m, front_m + unsure_m, rear_m, rear_m, 0.0),
        True,
        *(front_m + unsure_m, front_m + unsure_m, front_m + unsure_m, 0, 0, False, 0, 0, 16),
        *(False, 0),
    )


def found(rear_m: float, evidence: Evidence = NOTHING, *behind: Record) -> Whereabouts:
    former = Former(Record(1, 1000.0, 0, boot=1), behind)
    return whereabouts(former, report_at(rear_m), evidence, behind_rear_m=BEHIND_M)


@pytest.mark.parametrize("rear_m", [1000.0, 1300.0, 996.0, 989.1])
def test_whoever_can_still_be_where_it_was_is_taken_to_be_there(rear_m: float) -> None:
    assert found(rear_m) is Whereabouts.IN_PLACE


@pytest.mark.parametrize("rear_m", [988.9, 20.0])
def test_whoever_is_farther_back_than_it_may_roll_is_not_believed_by_one_word(
    rear_m: float,
) -> None:
    assert found(rear_m) is Whereabouts.UNSURE
    assert found(rear_m, NOTHING._replace(recent=True)) is Whereabouts.UNSURE
    assert found(rear_m, NOTHING._replace(sieved=True)) is Whereabouts.GONE
    assert found(rear_m, NOTHING._replace(clear=True)) is Whereabouts.GONE


def test_whoever_is_behind_a_train_that_was_behind_it_has_been_away() -> None:
    heard = Record(2, 1085.0, 0, report=report_at(1085.0, train=2), boot=1)

    assert found(1000.0, NOTHING, heard) is Whereabouts.UNSURE
    assert found(1000.0, NOTHING._replace(sieved=True), heard) is Whereabouts.GONE


def test_as_long_as_a_train_behind_was_never_heard_nobody_knows_their_order() -> None:
    unheard = Record(2, 400.0, 0, boot=1)

    assert found(1000.0, NOTHING, unheard) is Whereabouts.UNSURE
    assert found(1000.0, NOTHING._replace(recent=True), unheard) is Whereabouts.IN_PLACE


def test_only_sections_that_were_counted_show_that_a_place_is_empty() -> None:
    sections = [Counted(0.0, 500.0, True, 16), Counted(500.0, 1000.0, False, 0)]

    assert is_clear(sections, 500.0)
    assert not is_clear(sections, 499.0)
    assert not is_clear([], 499.0)
    assert not is_clear(None, 499.0)


def test_a_master_gives_nothing_by_an_entry_of_another_life_until_it_is_renewed() -> None:
    command = Command(roster=tuple([entry._replace(boot=7) for entry in ROSTER]))
    command.step()
    command.hears(1, 900.0)
    command.hears(2, 500.0)

    assert command.step(acks=False) == {}

    # Both are where they were, and all are heard: the entries are renewed, kept, and then used.
    issued = {}
    for _ in range(5):
        command.hears(1, 900.0)
        command.hears(2, 500.0)
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
    cast = Cast(line, T2tConfig(), (1, 2, 3))
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
