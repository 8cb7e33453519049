"""Jogs and the commands of supervision: hold, skip, stop next, stop now, help, creep."""

import dataclasses
import itertools
from typing import Any

import pytest

from can_dbc.vobc import AtoPhase
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from vobc.ato import Ato, AtoConfig
from vobc.ato.settings.output import OutputStage

LINE = load_line("florence")
JOG_MPS = 5.0 / 3.6
JERK_MPS3 = AtoConfig().limits.jerk_mps3
HELD = {"departure_permitted": False, "kept_at_platform": True}


def rig_at(start_m: float, names: str = "III IV", **settings: Any) -> ato_rig.Rig:
    stops = [dataclasses.replace(LINE.station(name), dwell_s=2.0) for name in names.split()]
    given = {"seed": 1, "start_scale_known": True, "brake_delay_s": None, **settings}
    # The mission still contains the stop although the train stands past it.
    return ato_rig.Rig(
        Ato(AtoConfig(), LINE, min(start_m, 3000.0), stops),
        LINE,
        ato_rig.RigSettings(**given),
        start_m,
    )


def attempts(rig: ato_rig.Rig) -> int:
    demands = rig.trace.demands
    return sum(
        before.phase is not AtoPhase.JOGGING and after.phase is AtoPhase.JOGGING
        for before, after in itertools.pairwise(demands)
    )


def reached(rig: ato_rig.Rig, front_m: float) -> None:
    rig.run(lambda rig: rig.front_m > front_m, limit_s=300.0)


def at_rest(rig: ato_rig.Rig) -> bool:
    return rig.still_s > 5.0 and rig.held


def doors_open(rig: ato_rig.Rig) -> bool:
    return rig.doors_position == 1.0


# Jogs.


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("off_m", [-4.9, -0.8, -0.4, 0.4, 0.6, 1.4, 4.9])
def test_one_slow_jog_corrects_a_missed_stop_within_reach(off_m: float, seed: int) -> None:
    rig = rig_at(3500.0 + off_m, seed=seed)
    rig.jog_back_m = 6.0

    rig.run(doors_open, limit_s=90.0)

    assert abs(rig.front_m - 3500.0) <= 0.20
    assert attempts(rig) == 1
    assert max(abs(speed_mps) for speed_mps in rig.trace.speeds_mps) <= JOG_MPS
    reverse = {demand.reverse for demand in rig.trace.demands if demand.phase is AtoPhase.JOGGING}
    assert reverse == {off_m > 0.0}


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("off_m", [0.0, 0.01, 0.04])
def test_a_short_forward_jog_corrects_a_stop_whose_tag_may_be_just_ahead(
    off_m: float, seed: int
) -> None:
    """Protection permits the jog because the position is too uncertain for door release."""
    rig = rig_at(3500.0 + off_m, seed=seed)
    rig.door_permission = False
    rig.run(lambda rig: rig.front_m > 3500.0 + off_m + 0.02 and rig.held, limit_s=60.0)
    rig.door_permission, rig.jog_permitted = True, False
    rig.run(doors_open, limit_s=30.0)

    assert rig.front_m - 3500.0 <= 0.20
    assert attempts(rig) == 1
    assert not any(demand.reverse for demand in rig.trace.demands)


@pytest.mark.parametrize("off_m", [0.0, 0.12])
def test_a_jog_to_a_tag_goes_forwards_by_enough_to_read_it(off_m: float) -> None:
    """The estimate of the place may be too far ahead by a decimetre."""
    rig = rig_at(3500.0 + off_m)
    rig.door_permission, rig.jog_to_tag = False, True
    rig.run(lambda rig: rig.front_m > 3500.0 + off_m + 0.05 and rig.held, limit_s=60.0)

    assert 0.05 < rig.front_m - 3500.0 - off_m <= 0.2
    assert attempts(rig) == 1
    assert not any(demand.reverse for demand in rig.trace.demands)


@pytest.mark.parametrize(("off_m", "back_m", "goes"), [(0.09, 0.0, True), (0.11, 0.0, False)])
def test_a_train_a_tenth_of_a_metre_past_the_stop_moves_no_further_forward(
    off_m: float, back_m: float, goes: bool
) -> None:
    rig = rig_at(3500.0 + off_m)
    rig.door_permission, rig.jog_back_m = False, back_m
    for _ in range(400):
        rig.step()

    assert (attempts(rig) > 0) is goes


def jogged_back_to_m(ahead_m: float, from_m: float = 0.15) -> float:
    """Where a jog back ends that began that far past the stop, as distance past it."""
    rig = rig_at(3500.0 + from_m)
    rig.door_permission, rig.jog_back_m, rig.ahead_m = False, 6.0, ahead_m
    rig.run(lambda rig: attempts(rig) > 0 and rig.front_m < 3500.05 and rig.held, limit_s=60.0)
    return rig.front_m - 3500.0


def test_a_jog_back_ends_where_doors_may_open_though_no_tag_narrows_the_interval() -> None:
    """The window is 0.3 m. An interval of ±0.26 m fits it nowhere without a tag."""
    past_the_tag_m = jogged_back_to_m(0.0)

    assert past_the_tag_m == pytest.approx(-0.12, abs=0.03)
    assert jogged_back_to_m(0.11) == past_the_tag_m
    assert jogged_back_to_m(0.20) == pytest.approx(-0.05, abs=0.03)
    assert jogged_back_to_m(0.26) == past_the_tag_m


def test_a_long_jog_back_passes_the_tag_because_the_interval_widens_on_the_way() -> None:
    """Over 3 m an interval of ±0.2 m widens to ±0.5 m."""
    assert jogged_back_to_m(0.20, from_m=3.0) == jogged_back_to_m(0.0, from_m=3.0)
    assert jogged_back_to_m(0.20, from_m=0.3) > jogged_back_to_m(0.0, from_m=0.3) + 0.05


@pytest.mark.parametrize("delay_s", [0.4, 1.0])
@pytest.mark.parametrize("off_m", [-4.9, -0.6, 0.6, 4.9])
def test_a_jog_ends_in_the_window_whatever_the_brake_delay(off_m: float, delay_s: float) -> None:
    rig = rig_at(3500.0 + off_m, brake_delay_s=delay_s)
    rig.jog_back_m = 6.0

    rig.run(doors_open, limit_s=90.0)

    assert abs(rig.front_m - 3500.0) <= 0.20


@pytest.mark.parametrize(("off_m", "back_m"), [(0.6, 0.0), (0.6, 0.85), (4.0, 4.2)])
def test_a_backward_jog_stays_within_the_protected_rear(off_m: float, back_m: float) -> None:
    rig = rig_at(3500.0 + off_m)
    rig.jog_back_m = back_m
    for _ in range(400):
        demand = rig.step()
        assert not demand.reverse
        assert demand.accel_mps2 <= 0.0
    assert attempts(rig) == 0


def test_a_train_that_is_not_permitted_to_jog_stays() -> None:
    rig = rig_at(3499.0)
    rig.jog_permitted = False
    for _ in range(400):
        assert rig.step().accel_mps2 <= 0.0
    assert rig.ato.phase is AtoPhase.HOLDING


def test_a_train_that_is_never_permitted_to_jog_calls_for_a_person() -> None:
    rig = rig_at(3500.6)
    for _ in range(550):
        assert not rig.step().calls_for_help
    for _ in range(100):
        demand = rig.step()
    assert demand.calls_for_help


def test_a_jog_that_loses_its_permission_is_braked_at_once() -> None:
    rig = rig_at(3496.0)
    rig.run(lambda rig: rig.speed_mps > 0.2)
    rig.jog_permitted = False
    before_m = rig.front_m
    rig.run(at_rest)

    assert rig.front_m - before_m < 1.0


@pytest.mark.parametrize("off_m", [-0.8, 0.8])
def test_without_traction_three_attempts_time_out_and_then_a_person_is_called(
    off_m: float,
) -> None:
    rig = rig_at(3500.0 + off_m)
    rig.jog_back_m = 6.0
    rig.traction_ratio = 0.0

    rig.run(lambda rig: any(each.calls_for_help for each in rig.trace.demands[-1:]))
    for _ in range(1000):
        demand = rig.step()

    assert attempts(rig) == 3
    assert demand.calls_for_help
    assert demand.hold
    assert rig.ato.phase is AtoPhase.HOLDING


def test_after_failed_jogs_a_skip_command_lets_the_train_go_on() -> None:
    rig = rig_at(3499.2)
    rig.traction_ratio = 0.0
    rig.run(lambda rig: any(each.calls_for_help for each in rig.trace.demands[-1:]))
    rig.traction_ratio = 1.0
    rig.orders = {"skip_next": True}

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == "IV"
    assert not rig.trace.demands[-1].calls_for_help


@pytest.mark.parametrize(("past_m", "station"), [(5.3, "IV"), (20.0, "IV")])
def test_a_train_beyond_the_reach_of_a_jog_goes_on_only_with_consent(
    past_m: float, station: str
) -> None:
    rig = rig_at(3500.0 + past_m)
    rig.jog_back_m = 100.0
    rig.orders = {"departure_permitted": False}
    for _ in range(400):
        demand = rig.step()
        assert demand.accel_mps2 <= 0.0
    assert demand.stopping_at_m == 3500.0

    rig.orders = {}
    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == station
    assert attempts(rig) == 0


def test_the_demand_names_the_stop_that_the_train_heads_for() -> None:
    rig = rig_at(3000.0)
    reached(rig, 3100.0)
    assert rig.trace.demands[-1].stopping_at_m == 3500.0
    rig.run(ato_rig.served(1))
    assert rig.trace.demands[-1].stopping_at_m == 3500.0
    reached(rig, 3600.0)
    assert rig.trace.demands[-1].stopping_at_m == 4500.0


def test_a_train_at_the_mark_that_may_not_open_its_doors_calls_for_a_person() -> None:
    rig = rig_at(3000.0)
    rig.door_permission = rig.jog_permitted = False
    rig.run(ato_rig.served(1))
    for _ in range(580):
        assert not rig.step().calls_for_help
    for _ in range(40):
        demand = rig.step()
    assert demand.calls_for_help
    rig.door_permission = True
    rig.run(doors_open)
    assert not rig.step().calls_for_help


@pytest.mark.parametrize("traction_ratio", [0.0, 0.01])
def test_a_train_that_cannot_depart_calls_for_a_person(
    traction_ratio: float,
) -> None:
    rig = rig_at(3000.0)
    rig.run(lambda rig: rig.ato.phase is AtoPhase.DEPARTING)
    rig.traction_ratio = traction_ratio
    for _ in range(590):
        assert not rig.step().calls_for_help
    for _ in range(100):
        demand = rig.step()
    assert demand.calls_for_help
    rig.traction_ratio = 1.0
    reached(rig, 3010.0)
    assert not rig.step().calls_for_help


# Orders.


def test_a_held_train_keeps_its_doors_open_and_departs_when_released() -> None:
    rig = rig_at(3000.0)
    rig.run(ato_rig.served(1))
    rig.run(doors_open)
    rig.orders = HELD
    for _ in range(1200):
        demand = rig.step()
        assert demand.phase is AtoPhase.DOORS_OPEN
    assert demand.open_doors

    rig.orders = {}
    reached(rig, 3600.0)


def test_a_hold_during_door_closing_keeps_the_train() -> None:
    rig = rig_at(3000.0)
    rig.run(ato_rig.served(1))
    rig.run(lambda rig: rig.ato.phase is AtoPhase.DOORS_CLOSING)
    rig.orders = HELD
    for _ in range(400):
        assert rig.step().accel_mps2 <= 0.0
    assert rig.front_m < 3500.5


def test_a_skipped_station_is_passed_and_the_next_one_is_served() -> None:
    rig = rig_at(3000.0)
    reached(rig, 3100.0)
    rig.orders = {"skip_next": True}
    reached(rig, 3400.0)
    assert rig.trace.demands[-1].stopping_at_m == 4500.0
    reached(rig, 3600.0)
    assert min(rig.trace.speeds_mps[-400:]) > 5.0

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == "IV"
    assert abs(rig.stops[0].error_m) <= 0.10


def test_a_skip_that_is_ordered_while_the_train_dwells_is_for_the_next_station() -> None:
    rig = rig_at(1500.0, "II III IV")
    rig.run(ato_rig.served(1))
    rig.run(doors_open)
    rig.orders = {"skip_next": True}

    rig.run(ato_rig.served(2))

    assert [stop.station for stop in rig.stops] == ["II", "IV"]


def test_one_order_skips_one_station() -> None:
    rig = rig_at(1500.0, "II III IV")
    rig.orders = {"skip_next": True}

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == "III"


def test_the_last_stop_is_not_skipped() -> None:
    rig = rig_at(3000.0, "III")
    rig.orders = {"skip_next": True}

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == "III"


@pytest.mark.parametrize(("taken_back_m", "station"), [(3150.0, "III"), (3440.0, "IV")])
def test_a_withdrawn_skip_counts_only_while_the_train_can_still_stop(
    taken_back_m: float, station: str
) -> None:
    rig = rig_at(3000.0)
    rig.orders = {"skip_next": True}
    reached(rig, taken_back_m)
    rig.orders = {}

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == station
    assert abs(rig.stops[0].error_m) <= 0.10


def test_an_unplanned_station_is_served_on_command_and_held_until_the_command_ends() -> None:
    rig = rig_at(3000.0, "IV")
    reached(rig, 3100.0)
    rig.orders = {"stop_next": True}
    rig.run(ato_rig.served(1))
    assert rig.stops[0].station == "III"
    rig.run(doors_open)
    for _ in range(1000):
        assert rig.step().open_doors
    rig.orders = {}

    rig.run(lambda rig: rig.front_m > 3600.0, limit_s=120.0)


def test_a_stop_command_that_comes_too_late_is_for_the_following_station() -> None:
    rig = rig_at(1500.0, "IV")
    reached(rig, 2950.0)
    rig.orders = {"stop_next": True}

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == "III"


def test_a_stop_now_command_brings_the_train_to_rest_and_its_end_lets_it_go_on() -> None:
    rig = rig_at(3000.0)
    reached(rig, 3200.0)
    rig.orders = {"stop_now": True}
    rig.run(at_rest)
    for _ in range(200):
        assert rig.step().accel_mps2 <= 0.0
    assert rig.front_m < 3500.0
    rig.orders = {}

    rig.run(ato_rig.served(1))

    assert abs(rig.stops[0].error_m) <= 0.10


def test_a_stop_now_that_ends_in_motion_is_followed_by_an_exact_stop() -> None:
    rig = rig_at(3000.0)
    reached(rig, 3200.0)
    for order in ({"stop_now": True}, {"protection_brakes": True}):
        rig.orders = order
        for _ in range(40):
            rig.step()
        rig.orders = {}
        for _ in range(60):
            rig.step()

    rig.run(ato_rig.served(1))

    assert abs(rig.stops[0].error_m) <= 0.10


def test_a_help_request_reopens_closing_doors_and_loses_no_stop() -> None:
    rig = rig_at(3000.0)
    rig.run(ato_rig.served(1))
    rig.run(lambda rig: rig.ato.phase is AtoPhase.DEPARTING)
    rig.orders = {**HELD, "keep_doors_open": True}
    rig.run(doors_open, limit_s=30.0)
    for _ in range(400):
        assert rig.step().open_doors
    rig.orders = {}

    rig.run(ato_rig.served(2))

    assert [stop.station for stop in rig.stops] == ["III", "IV"]


# Creep.


def test_a_creeping_train_stays_below_its_ceiling_and_stops_where_the_ceiling_ends() -> None:
    rig = rig_at(3000.0)
    rig.orders = {"creep": True}
    rig.ceiling_mps = 15.0 / 3.6
    reached(rig, 3200.0)
    assert rig.ato.phase is AtoPhase.CREEPING
    assert max(rig.trace.speeds_mps) < 15.0 / 3.6
    assert rig.speed_mps > 3.0
    rig.ceiling_mps = 0.0

    rig.run(at_rest)

    assert rig.ato.phase is AtoPhase.HOLDING
    assert rig.stops == []


@pytest.mark.parametrize("front_m", [3060.0, 3200.0])
def test_a_creeping_train_with_a_new_authority_makes_its_next_stop(front_m: float) -> None:
    rig = rig_at(3000.0)
    rig.orders = {"creep": True}
    rig.ceiling_mps = 15.0 / 3.6
    reached(rig, front_m)
    rig.orders = {}
    rig.ceiling_mps = 100.0

    rig.run(ato_rig.served(1))

    assert rig.stops[0].station == "III"
    assert abs(rig.stops[0].error_m) <= 0.10


def test_a_creeping_train_heads_for_no_stop() -> None:
    rig = rig_at(3000.0)
    rig.orders = {"creep": True}
    reached(rig, 3020.0)

    assert rig.trace.demands[-1].stopping_at_m is None


# What traction can give.


@pytest.mark.parametrize("strategy", ["predictive", "pid", "chasing", "timing", "pid_literal"])
def test_the_demand_follows_available_traction_without_a_jolt(strategy: str) -> None:
    """The power limit follows the measured speed, which jumps where a tag corrects the wheel
    size."""
    config = AtoConfig(strategy=strategy)
    stops = [dataclasses.replace(LINE.station("III"), dwell_s=2.0)]
    settings = ato_rig.RigSettings(seed=1, start_scale_known=True)
    rig = ato_rig.Rig(Ato(config, LINE, 3000.0, stops), LINE, settings, 3000.0)
    rig.traction_most_mps2 = 0.60
    rig.run(lambda rig: rig.speed_mps > 4.0)
    before = len(rig.trace.demands)

    for most_mps2 in (0.60, 0.30, 0.45, 0.50):
        rig.traction_most_mps2 = most_mps2
        for _ in range(14):
            rig.step()
        assert rig.trace.demands[-1].accel_mps2 <= most_mps2 + 1e-9

    asked_mps2 = [demand.accel_mps2 for demand in rig.trace.demands]
    assert min(asked_mps2[before:]) > 0.2
    changes_mps2 = [abs(after - this) for this, after in itertools.pairwise(asked_mps2)]
    assert max(changes_mps2) <= config.limits.jerk_mps3 * rig.cycle_s + 1e-9


def test_no_traction_is_demanded_when_none_is_available() -> None:
    rig = rig_at(3000.0)
    rig.run(lambda rig: rig.speed_mps > 4.0)
    rig.traction_ratio = 0.0

    for _ in range(60):
        rig.step()

    assert rig.trace.demands[-1].accel_mps2 <= 0.0


@pytest.mark.parametrize("seed", range(1, 7))
def test_a_traction_notch_does_not_dwell_where_braking_must_begin(seed: int) -> None:
    """Each dwell in a traction notch costs distance. With a weak brake the train would overrun
    the platform by a metre."""
    notches = OutputStage(stage="notches")
    stops = [dataclasses.replace(LINE.station("III"), dwell_s=2.0)]
    settings = ato_rig.RigSettings(seed=seed, start_scale_known=True)
    rig = ato_rig.Rig(Ato(AtoConfig(output=notches), LINE, 3000.0, stops), LINE, settings, 3000.0)

    rig.run(ato_rig.served(1))

    phases = [demand.phase for demand in rig.trace.demands]
    began = phases.index(AtoPhase.APPROACHING)
    asked_mps2 = [demand.accel_mps2 for demand in rig.trace.demands[began:]]
    coming_off_mps2 = list(itertools.takewhile(lambda asked: asked > 0.0, asked_mps2))
    assert coming_off_mps2[0] > 0.3, "the brake comes on straight after traction"
    assert len(coming_off_mps2) * rig.cycle_s <= coming_off_mps2[0] / JERK_MPS3 + 0.2


@pytest.mark.parametrize(("late_s", "cycles"), [(0.0, 1), (0.1, 3), (1.95, 40), (3600.0, 40)])
@pytest.mark.sources
def test_a_law_makes_up_for_missed_cycles_but_not_for_a_clock_that_was_set(
    late_s: float, cycles: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_at(3000.0, "III")
    rig.step()
    law = rig.ato.strategy
    assert law is not None
    observed: list[int] = []
    monkeypatch.setattr(type(law), "observe", lambda _, __, count: observed.append(count))

    rig.told_late_s = late_s
    rig.step()

    assert observed == [cycles]
