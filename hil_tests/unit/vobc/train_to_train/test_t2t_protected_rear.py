"""How close the next train may come to a moving one: a train must stand before it can jog back."""

import dataclasses
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.train_to_train.test_t2t_envelope import REPORT
from hil_tests.unit.vobc.train_to_train.test_t2t_regressions import Command
from vobc.config import load_config
from vobc.process.line_command import HARDEST_DECEL_MPS2, LineCommand
from vobc.train_to_train.occupancy import TrainRecord
from vobc.vocabulary import Interval, Motion
from zenoh_config.codec import BENCH_KEY, pack
from zenoh_config.t2t import TrainReport

JOG_M = 5.0


def report(rear_m: float, protected_m: float, *, boot: int = 2) -> TrainReport:
    return dataclasses.replace(
        REPORT,
        boot=boot,
        rear_min_m=rear_m,
        protected_m=protected_m,
        front_min_m=rear_m + 80.0,
        front_max_m=rear_m + 84.0,
    )


def heard(*reports: TrainReport) -> TrainRecord:
    record = TrainRecord(9, 0.0, 0, boot=2)
    for each in reports:
        record.on_message(each, 0, term=7, jog_m=JOG_M)
    return record


@given(rear_m=st.floats(0.0, 5000.0), ahead_m=st.floats(-20.0, 100.0))
def test_the_protected_rear_is_at_most_a_jog_ahead_of_the_rear_and_never_behind_it(
    rear_m: float, ahead_m: float
) -> None:
    protected_m = heard(report(rear_m, rear_m + ahead_m)).rear_m

    assert rear_m <= protected_m <= rear_m + JOG_M
    if 0.0 <= ahead_m <= JOG_M:
        assert protected_m == rear_m + ahead_m


def test_the_protected_rear_goes_back_only_for_another_incarnation() -> None:
    assert heard(report(100.0, 104.0), report(102.0, 102.0)).rear_m == 104.0
    assert heard(report(100.0, 104.0), report(102.0, 102.0, boot=3)).rear_m == 102.0


def test_what_the_next_train_gains_this_train_loses_for_its_jog_back() -> None:
    """Both keep apart: the room that one train gets is taken from the other."""
    ends_m = {}
    for ahead_m in (0.0, 3.0, 5.0, 50.0):
        command = Command()
        command.on_message(2, 500.0)
        command.on_message(1, 900.0)
        command.step()
        record = command.master._known.records[1]
        assert record.report is not None
        moving = dataclasses.replace(
            record.report, protected_m=820.0 + ahead_m, sequence=50, standstill=False
        )
        command.master.on_message(moving, command.now_ns)
        command.on_message(2, 500.0)
        issued = command.step()
        ends_m[ahead_m] = issued[2].end_m, issued[1].rear_m

    assert ends_m == {
        0.0: (813.0, 815.0),
        3.0: (816.0, 818.0),
        5.0: (818.0, 820.0),
        50.0: (818.0, 820.0),
    }


@pytest.mark.parametrize("protected_m", [19.9, 102.1, float("nan")])
def test_an_impossible_protected_rear_is_not_sent(protected_m: float) -> None:
    with pytest.raises(ValueError, match="protected_m"):
        pack(dataclasses.replace(REPORT, protected_m=protected_m), BENCH_KEY)


@pytest.mark.parametrize("low_mps", [-0.4, 0.0, 3.0, 12.0])
def test_the_reported_stopping_place_uses_the_lowest_possible_speed(
    low_mps: float,
) -> None:
    config = load_config("florence4")
    nobody = Mock(subscriptions=())
    command = LineCommand(nobody, nobody, config, load_line("florence"), axles=16)
    motion = Motion(
        front_m=Interval(998.0, 1000.0, 1003.0),
        speed_mps=Interval(low_mps, low_mps + 0.5, low_mps + 1.0),
        accel_mps2=0.0,
        travel_m=0.0,
        standing=False,
        standstill=False,
        localised=True,
        slip=False,
        accepted_tag_ids=(),
    )

    own = command._own(motion)

    assert own.rear_min_m == 998.0 - config.train.length_m
    way_m = max(0.0, low_mps) ** 2 / (2.0 * HARDEST_DECEL_MPS2)
    assert own.rests_m == pytest.approx(own.rear_min_m + way_m)
