"""The timetable law: the time for a distance, the speed for a time, its states and its runs."""

import dataclasses
import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py import settings
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from hil_tests.unit.vobc.ato.ato_rig import line_with
from vobc.ato import Ato, AtoConfig
from vobc.ato.laws.timing import TRANSITIONS, TimingGuard, TimingState, next_state
from vobc.ato.motion import profile
from vobc.ato.motion.running_time import RunningTime
from vobc.ato.next_stop import StopPlan
from vobc.ato.settings.timing import Timing

LINE = load_line("florence")
CONFIG = AtoConfig()
FINE_S = 0.01


def running(stop_m: float, from_m: float = 0.0) -> RunningTime:
    curve = profile.curve_to_stop(CONFIG, LINE, stop_m)
    return RunningTime(CONFIG, LINE, from_m, stop_m, curve)


def driven_s(from_m: float, stop_m: float, cruise_mps: float) -> float:
    """Running time over the same distance in small steps, without any trapezoid formula.

    The simulated driver accelerates at 0.8 m/s² and needs 1.333 s to build the acceleration up and
    ease it. He brakes at 0.8 m/s² to meet each lower limit and stops on the curve of the settings.
    """
    curve = profile.curve_to_stop(CONFIG, LINE, stop_m)
    limits = profile.SpeedLimits(CONFIG, LINE)
    margin_mps = CONFIG.speed.margin_mps
    front_m, speed_mps, time_s = from_m, 0.0, 0.0
    accel_mps2 = 0.0
    while stop_m - front_m > curve.at_speed(speed_mps).distance_m:
        wanted_mps = min(cruise_mps, limits.under_train_mps(front_m) - margin_mps)
        for section in LINE.speed_sections:
            if section.start_m > front_m:
                low_mps = min(cruise_mps, section.limit_mps - margin_mps)
                reach_m = max(0.0, section.start_m - front_m)
                wanted_mps = min(wanted_mps, math.sqrt(low_mps**2 + 2.0 * 0.7 * reach_m))
        room_mps = wanted_mps - speed_mps
        aim_mps2 = max(-0.8, min(0.8, math.copysign(math.sqrt(2 * 0.6 * abs(room_mps)), room_mps)))
        accel_mps2 += max(-0.6 * FINE_S, min(0.6 * FINE_S, aim_mps2 - accel_mps2))
        speed_mps = max(0.0, speed_mps + accel_mps2 * FINE_S)
        front_m += speed_mps * FINE_S
        time_s += FINE_S
        assert time_s < 1000.0
    return time_s + curve.at_speed(speed_mps).time_to_go_s


@pytest.mark.parametrize(
    ("from_m", "stop_m", "cruise_mps"),
    [
        (0.0, 1500.0, 18.0),
        (0.0, 1500.0, 9.0),
        (1500.0, 3000.0, 18.0),
        (1500.0, 3000.0, 10.0),
        (3000.0, 3500.0, 12.0),
        (3500.0, 4500.0, 15.0),
    ],
)
def test_the_planned_time_equals_a_simulation_in_small_steps(
    from_m: float, stop_m: float, cruise_mps: float
) -> None:
    reckoned_s = running(stop_m, from_m).time_s(from_m, 0.0, cruise_mps)

    assert reckoned_s == pytest.approx(driven_s(from_m, stop_m, cruise_mps), rel=0.03)


@given(slow_mps=st.floats(3.0, 18.0), more_mps=st.floats(0.1, 5.0), at_m=st.floats(0.0, 1000.0))
def test_a_higher_speed_never_takes_longer(slow_mps: float, more_mps: float, at_m: float) -> None:
    way = running(1500.0)

    assert way.time_s(at_m, 3.0, slow_mps + more_mps) <= way.time_s(at_m, 3.0, slow_mps) + 1e-9


@given(left_s=st.floats(20.0, 400.0), at_m=st.floats(1500.0, 2500.0), now_mps=st.floats(0.0, 15.0))
def test_the_speed_for_a_time_takes_that_time(left_s: float, at_m: float, now_mps: float) -> None:
    way = running(3000.0, 1500.0)

    speed_mps = way.speed_for_mps(at_m, now_mps, left_s, low_mps=5.0, high_mps=19.0)

    takes_s = way.time_s(at_m, now_mps, speed_mps)
    if speed_mps == 19.0 or left_s < 100.0:
        assert takes_s >= left_s - 0.05
    elif speed_mps > 5.01:
        assert takes_s == pytest.approx(left_s, abs=0.05)
    else:
        assert takes_s <= left_s + 0.05


def test_no_speed_is_planned_that_the_train_can_no_longer_reach() -> None:
    way = running(3000.0, 1500.0)

    close_mps = way.speed_for_mps(2900.0, 8.0, 5.0, low_mps=5.0, high_mps=19.0)
    far_mps = way.speed_for_mps(1600.0, 8.0, 5.0, low_mps=5.0, high_mps=19.0)

    # At 0.7 m/s² on the level, 100 m are enough to stop from less than 12 m/s.
    assert 8.0 <= close_mps <= 12.0
    assert far_mps == 19.0


def test_without_time_left_the_law_asks_for_the_highest_speed() -> None:
    assert running(1500.0).speed_for_mps(0.0, 0.0, 0.0, low_mps=5.0, high_mps=19.0) == 19.0
    assert running(1500.0).speed_for_mps(0.0, 0.0, -5.0, low_mps=5.0, high_mps=19.0) == 19.0


# The states of [Lin].


def holding(*guards: TimingGuard) -> dict[TimingGuard, bool]:
    return {guard: guard in guards for guard in TimingGuard}


def test_the_states_of_the_paper_follow_its_guards() -> None:
    state = TimingState.STATIONARY
    way = [state]
    for guard in (TimingGuard.MOVES, TimingGuard.FAST, TimingGuard.NEAR, TimingGuard.STANDS):
        state = next_state(state, holding(guard))
        way.append(state)

    assert way == [
        TimingState.STATIONARY,
        TimingState.START_UP,
        TimingState.AUTOMATIC,
        TimingState.PARKING,
        TimingState.STATIONARY,
    ]


@pytest.mark.parametrize(
    ("state", "guards", "to"),
    [
        (TimingState.AUTOMATIC, (TimingGuard.SLOW,), TimingState.START_UP),
        (TimingState.AUTOMATIC, (TimingGuard.STANDS, TimingGuard.SLOW), TimingState.STATIONARY),
        (TimingState.AUTOMATIC, (TimingGuard.NEAR, TimingGuard.SLOW), TimingState.PARKING),
        (TimingState.START_UP, (TimingGuard.NEAR, TimingGuard.FAST), TimingState.PARKING),
        (TimingState.START_UP, (TimingGuard.STANDS,), TimingState.STATIONARY),
        (TimingState.PARKING, (TimingGuard.FAR,), TimingState.START_UP),
        (
            TimingState.PARKING,
            (TimingGuard.FAST, TimingGuard.SLOW, TimingGuard.NEAR),
            TimingState.PARKING,
        ),
        (TimingState.STATIONARY, (TimingGuard.FAST, TimingGuard.NEAR), TimingState.STATIONARY),
    ],
)
def test_ways_back_and_precedence(
    state: TimingState, guards: tuple[TimingGuard, ...], to: TimingState
) -> None:
    assert next_state(state, holding(*guards)) is to


def test_every_state_is_left_and_reached() -> None:
    assert set(TRANSITIONS) == set(TimingState)
    assert {to for ways in TRANSITIONS.values() for _, to in ways} == set(TimingState)


def test_guards_that_contradict_are_refused() -> None:
    with pytest.raises(settings.SettingsError, match=r"x.toml: timing: not 0 < slowed_mps"):
        settings.build(AtoConfig, {"timing": {"slowed_mps": 2.0}}, "x.toml")
    with pytest.raises(ValueError, match=r"look_s 0\.0 is not positive"):
        Timing(look_s=0.0)


# Plans.


def test_a_station_that_is_passed_adds_its_running_time() -> None:
    line = line_with(III=60.0, IV=90.0)
    both = StopPlan(line, 3000.0, [line.station("III"), line.station("IV")], window_m=0.3)
    last = StopPlan(line, 3000.0, [line.station("IV")], window_m=0.3)

    assert both.run_s(3000.1) == 60.0
    assert last.run_s(3000.1) == 150.0


def test_a_distance_with_a_gap_in_its_plan_has_no_planned_time() -> None:
    line = line_with(IV=90.0)

    assert StopPlan(line, 3000.0, [line.station("IV")], window_m=0.3).run_s(3000.0) is None
    assert StopPlan(line, 4500.2, [], window_m=0.3).run_s(4500.2) is None


# Runs.


def legs(strategy: str, run_s: dict[str, float]) -> list[ato_rig.Stop]:
    """Run from II over III to IV; return each stop with its running time and error."""
    line = line_with(**run_s)
    stops = [dataclasses.replace(line.station(name), dwell_s=2.0) for name in ("III", "IV")]
    config = AtoConfig(strategy=strategy)
    rig = ato_rig.Rig(
        Ato(config, line, 3000.0, stops),
        line,
        ato_rig.RigSettings(seed=3, start_scale_known=True),
        3000.0,
    )
    rig.run(ato_rig.served(2))
    return rig.stops


@pytest.mark.parametrize("plan_s", [{"III": 66.0, "IV": 95.0}, {"III": 85.0, "IV": 130.0}])
def test_trains_are_on_time_even_with_a_brake_that_bites_as_late_as_expected(
    plan_s: dict[str, float],
) -> None:
    made = legs("timing", plan_s)

    for stop, planned_s in zip(made, plan_s.values(), strict=True):
        assert stop.leg_s == pytest.approx(planned_s, abs=4.0)
        assert abs(stop.error_m) <= 0.10


@pytest.mark.parametrize("plan_s", [{}, {"III": 30.0, "IV": 40.0}])
def test_without_a_plan_or_when_late_it_is_as_fast_as_without_the_law(
    plan_s: dict[str, float],
) -> None:
    for timed, free in itertools.zip_longest(legs("timing", plan_s), legs("predictive", {})):
        assert timed.leg_s == pytest.approx(free.leg_s, abs=1.0)


def test_a_train_halted_on_the_way_makes_up_the_time() -> None:
    """The plan counts from the station. A halt on the way is lost time and does not restart the
    plan."""
    planned_s, halts_s = 130.0, 30.0
    line = line_with(III=planned_s, IV=90.0)
    config = AtoConfig(strategy="timing")
    stops = [line.station("III"), line.station("IV")]
    rig = ato_rig.Rig(
        Ato(config, line, 3000.0, stops),
        line,
        ato_rig.RigSettings(seed=3, start_scale_known=True),
        3000.0,
    )
    rig.run(lambda rig: rig.front_m > 3150.0)
    left_s = rig.leg_start_s
    rig.orders = {"stop_now": True}
    rig.run(lambda rig: rig.speed_mps == 0.0)
    for _ in range(round(halts_s / 0.05)):
        rig.step()
    assert rig.front_m < 3400.0
    rig.orders = {}

    rig.run(ato_rig.served(1))

    stop = rig.stops[0]
    assert rig.leg_start_s + stop.leg_s - left_s == pytest.approx(planned_s, abs=4.0)


@pytest.mark.parametrize(("front_m", "there"), [(2999.71, True), (3000.29, True), (3000.4, False)])
def test_a_train_is_at_a_station_within_its_window(front_m: float, there: bool) -> None:
    assert StopPlan(LINE, 3000.0, [], window_m=0.3).at_station(front_m) is there
