"""Control by chasing time: the rule, its states, its curve, and stops in closed loop."""

import itertools
import math
from typing import Any

import pytest

from firmware_py import settings
from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from vobc.ato import Ato, AtoConfig
from vobc.ato.laws import catch_time, notch_choice
from vobc.ato.laws.chasing_states import TRANSITIONS, Chase, ChasingState, next_state
from vobc.ato.laws.notch_choice import NotchTarget
from vobc.ato.laws.notch_ending import last_notch_mps2
from vobc.ato.motion.step_curve import StepCurve
from vobc.ato.settings.chasing import ChasingScheme
from vobc.ato.settings.output import OutputStage

LINE = load_line("florence")
DECELS_MPS2 = [0.0, 0.2, 0.4, 0.6, 0.8]
LEVELS_MPS2 = [-0.05 * notch for notch in range(17)]


def gap_after_mps(error_mps: float, decel_mps2: float, reference_mps2: float, t_s: float) -> float:
    """Speed error after `t_s`, from a replay of train and reference in small steps."""
    steps = 1000
    for _ in range(steps):
        error_mps += (reference_mps2 - decel_mps2) * t_s / steps
    return error_mps


# The rule.


@pytest.mark.parametrize(("error_mps", "decel_mps2"), [(0.5, 0.8), (-0.4, 0.2), (0.1, 0.62)])
def test_a_notch_held_for_its_catch_time_meets_the_curve(
    error_mps: float, decel_mps2: float
) -> None:
    time_s = catch_time.catch_s(error_mps, decel_mps2, reference_mps2=0.5, guard_mps2=0.01)

    assert gap_after_mps(error_mps, decel_mps2, 0.5, time_s) == pytest.approx(0.0, abs=1e-9)


def test_a_notch_that_widens_the_gap_or_hardly_differs_never_catches() -> None:
    for error_mps, decel_mps2 in ((0.5, 0.4), (-0.5, 0.6), (0.5, 0.505), (0.0, 0.8)):
        time_s = catch_time.catch_s(error_mps, decel_mps2, reference_mps2=0.5, guard_mps2=0.01)
        assert math.isinf(time_s)


@pytest.mark.parametrize("error_mps", [0.3, -0.3])
def test_the_gentlest_notch_that_closes_the_error_in_time_is_chosen(error_mps: float) -> None:
    """A milder correction closes the speed error too late, above and below the reference."""
    chosen = catch_time.gentlest(
        error_mps, DECELS_MPS2, reference_mps2=0.5, within_s=2.0, guard_mps2=0.01
    )

    assert chosen is not None
    assert DECELS_MPS2[chosen] == (0.8 if error_mps > 0.0 else 0.2)
    milder_mps2 = 0.6 if error_mps > 0.0 else 0.4
    left_mps = gap_after_mps(error_mps, milder_mps2, 0.5, 2.0)
    assert left_mps * error_mps > 0.0


def kept(error_mps: float, run_s: float, now_mps2: float, *, to_stop: bool = True) -> bool:
    """Tell whether the law keeps a notch that is weaker than the curve of 0.6 m/s²."""
    aim = NotchTarget(error_mps, 0.6, run_s, 0.0, to_stop)
    return notch_choice.picked(ChasingScheme(), aim, now_mps2, LEVELS_MPS2, 0.018) == now_mps2


def test_a_speed_error_with_time_left_to_close_changes_no_notch() -> None:
    assert kept(0.3, 8.0, -0.5)
    assert not kept(0.3, 2.0, -0.5)
    assert not kept(0.3, 8.0, -0.5, to_stop=False)


def test_on_the_stopping_curve_a_released_brake_is_applied_at_once() -> None:
    assert not kept(0.01, 8.0, 0.0)
    assert kept(0.01, 8.0, 0.0, to_stop=False)


def test_no_notch_is_chosen_when_none_is_fast_enough() -> None:
    rule = {"reference_mps2": 0.5, "within_s": 0.5, "guard_mps2": 0.01}

    assert catch_time.gentlest(1.0, DECELS_MPS2, **rule) is None
    assert catch_time.last_too_late(1.0, DECELS_MPS2, **rule) == 3


def test_the_printed_rule_takes_a_notch_that_comes_too_late() -> None:
    chosen = catch_time.last_too_late(
        0.3, DECELS_MPS2, reference_mps2=0.5, within_s=2.0, guard_mps2=0.01
    )

    assert chosen is not None
    assert gap_after_mps(0.3, DECELS_MPS2[chosen], 0.5, 2.0) > 0.0


def test_the_time_to_the_target_is_that_of_a_steady_deceleration() -> None:
    time_s = catch_time.run_time_s(100.0, speed_mps=15.0, target_mps=5.0)

    assert (15.0 + 5.0) / 2.0 * time_s == pytest.approx(100.0)
    assert catch_time.run_time_s(-1.0, speed_mps=15.0, target_mps=5.0) == 0.0
    assert catch_time.run_time_s(1.0, speed_mps=0.0, target_mps=0.0) == 0.0


# States.


def test_every_state_can_be_left_and_reached() -> None:
    assert set(TRANSITIONS) == set(ChasingState)
    assert {target for rows in TRANSITIONS.values() for _, target in rows} == set(ChasingState)


def test_traction_and_brake_follow_each_other_only_when_needed() -> None:
    assert next_state(ChasingState.BRAKE, Chase(braked=True, too_slow=True)) is ChasingState.COAST
    assert next_state(ChasingState.TRACTION, Chase(near_curve=True)) is ChasingState.COAST
    assert (
        next_state(ChasingState.COAST, Chase(near_curve=True, too_slow=True)) is ChasingState.COAST
    )
    assert (
        next_state(ChasingState.COAST, Chase(on_curve=True, near_curve=True)) is ChasingState.BRAKE
    )
    assert next_state(ChasingState.COAST, Chase(too_slow=True)) is ChasingState.TRACTION
    assert next_state(ChasingState.CRUISE, Chase(too_fast=True)) is ChasingState.BRAKE
    assert next_state(ChasingState.BRAKE, Chase(on_curve=True, braked=True)) is ChasingState.BRAKE


# The curve.


@pytest.mark.parametrize("speed_mps", [0.1, 0.5, 1.5, 3.0, 15.0])
def test_a_train_that_runs_the_curve_stops_at_its_end(speed_mps: float) -> None:
    curve = StepCurve((0.05, 0.2, 0.6), (0.3, 2.0))
    point = curve.at_speed(speed_mps)

    v_mps, run_m, dt_s = speed_mps, 0.0, 1e-3
    while v_mps > 0.0:
        v_mps -= (0.05 if v_mps <= 0.3 else 0.2 if v_mps <= 2.0 else 0.6) * dt_s
        run_m += max(0.0, v_mps) * dt_s

    assert point.distance_m == pytest.approx(run_m, abs=0.02)
    assert curve.speed_at_mps(point.distance_m) == pytest.approx(speed_mps)
    assert curve.speed_at_mps(-1.0) == 0.0


def test_a_reserve_moves_the_fast_part_of_the_curve_away_from_the_stop() -> None:
    plain = StepCurve((0.07, 0.6), (0.17,))
    kept = StepCurve((0.07, 0.6), (0.17,), 3.0)

    for speed_mps in (0.1, 0.17):
        assert kept.at_speed(speed_mps).distance_m == plain.at_speed(speed_mps).distance_m
    for speed_mps in (0.5, 15.0):
        away_m = kept.at_speed(speed_mps).distance_m - plain.at_speed(speed_mps).distance_m
        assert away_m == pytest.approx(3.0)
        room_m = kept.at_speed(speed_mps).distance_m
        assert kept.speed_at_mps(room_m) == pytest.approx(speed_mps)


def test_the_last_notch_exceeds_the_fall_of_the_track() -> None:
    config = AtoConfig()

    assert last_notch_mps2(config, 0.0) == 0.05
    assert last_notch_mps2(config, 0.2) == 0.05
    assert last_notch_mps2(config, -0.12) > 0.12
    assert last_notch_mps2(config, -5.0) == config.output.brake_levels_mps2[-1]


# In closed loop.


def run(
    strategy: str = "chasing", *, scheme: ChasingScheme | None = None, **given: Any
) -> ato_rig.Rig:
    config = AtoConfig(strategy=strategy, chasing=scheme or ChasingScheme())
    return ato_rig.run_line(config, **{"brake_delay_s": None, "odometer_error": None} | given)


def test_the_whole_line_is_driven_and_every_stop_is_within_thirty_centimetres() -> None:
    errors_m = [stop.error_m for seed in range(2) for stop in run(seed=seed).stops]

    assert len(errors_m) == 8
    assert max(map(abs, errors_m)) <= 0.30


@pytest.mark.parametrize(("gain", "delay_s"), [(0.8, 1.8), (1.2, 0.5)])
def test_it_identifies_a_brake_that_it_does_not_expect(gain: float, delay_s: float) -> None:
    """With gain and dead time as assumed, these brakes stop the train metres off."""
    rig = ato_rig.Rig(
        Ato(AtoConfig(strategy="chasing"), LINE, 3000.0, [LINE.station("III")]),
        LINE,
        ato_rig.RigSettings(seed=1, brake_delay_s=delay_s, brake_gain=gain),
        3000.0,
    )

    rig.run(lambda rig: rig.now_s > 30.0 and rig.still_s > 1.0)

    assert abs(rig.front_m - 3500.0) <= 0.30


def test_limits_of_the_line_and_of_comfort_are_kept() -> None:
    trace = run(seed=3, odometer_error=0.0).trace

    for front_m, speed_mps in zip(trace.fronts_m, trace.speeds_mps, strict=True):
        limit_mps = LINE.least_limit_mps(front_m - ato_rig.TRAIN_LENGTH_M, front_m)
        assert speed_mps <= limit_mps + 0.05
    for before, after in itertools.pairwise(trace.demands):
        assert abs(after.accel_mps2) <= 0.8 + 1e-9
        assert abs(after.accel_mps2 - before.accel_mps2) <= 0.6 * 0.05 + 1e-9


def test_every_demand_that_lasts_is_a_notch() -> None:
    """The test counts from the first braking on. Before that, and at the platform, other parts
    than the law set the demand."""
    config = AtoConfig()
    notches = {0.0, *config.output.traction_levels_mps2}
    notches |= {-level_mps2 for level_mps2 in config.output.brake_levels_mps2}
    demands = [d for d in run(seed=2).trace.demands if d.distance_to_stop_m > 1.0]

    lasting = {
        round(a.accel_mps2, 6)
        for a, b in itertools.pairwise(demands)
        if a.accel_mps2 == b.accel_mps2 and a.phase.name in ("RUNNING", "APPROACHING", "STOPPING")
    }

    assert lasting
    assert lasting <= {round(notch_mps2, 6) for notch_mps2 in notches}


def test_the_early_transition_brakes_sooner() -> None:
    """Compare where the first brake application before the first station begins."""

    def first_brake_m(scheme: ChasingScheme) -> float:
        trace = run(scheme=scheme, seed=1).trace
        return next(
            front_m
            for front_m, demand in zip(trace.fronts_m, trace.demands, strict=True)
            if front_m > 800.0 and demand.accel_mps2 < 0.0
        )

    early_m = first_brake_m(ChasingScheme())
    late_m = first_brake_m(ChasingScheme(early_transition=False))

    assert 4.0 < late_m - early_m < 20.0


def test_the_small_brake_is_held_from_eight_to_four_km_per_hour() -> None:
    trace = run(seed=4).trace
    held = {
        round(demand.accel_mps2, 6)
        for demand, speed_mps, front_m in zip(
            trace.demands, trace.speeds_mps, trace.fronts_m, strict=True
        )
        if 1.15 < speed_mps < 2.2 and 1480.0 < front_m < 1500.0
    }

    assert held
    assert max(held) - min(held) <= 0.1 + 1e-9
    assert min(held) >= -0.35


def test_the_printed_rule_runs_past_the_stop() -> None:
    config = AtoConfig(strategy="chasing_literal")
    rig = ato_rig.Rig(
        Ato(config, LINE, 3000.0, [LINE.station("III")]),
        LINE,
        ato_rig.RigSettings(seed=1, brake_delay_s=None),
        3000.0,
    )

    rig.run(lambda rig: rig.now_s > 30.0 and rig.still_s > 1.0)

    assert rig.front_m > 3501.0


def test_it_stops_before_an_end_of_authority() -> None:
    config = AtoConfig(strategy="chasing")
    rig = ato_rig.Rig(
        Ato(config, LINE, 0.0, LINE.stations[1:]), LINE, ato_rig.RigSettings(seed=1), 0.0
    )
    rig.authority_end_m = 900.0

    rig.run(lambda rig: rig.now_s > 30.0 and rig.still_s > 5.0)

    assert 880.0 < rig.front_m < 900.0


# Settings.


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("chasing.chase_ratio", 1.5),
        ("chasing.lag_s", 0.0),
        ("chasing.dead_time_s", -0.1),
        ("chasing.small_decel_mps2", 0.7),
        ("chasing.quiet_band_mps", 0.6),
        ("chasing.last_speed_mps", 2.0),
        ("chasing.dead_time_s", 4.0),
        ("output.stage", "valve"),
        ("output.brake_levels_mps2", [0.2, 0.1]),
        ("output.traction_levels_mps2", []),
        ("output.traction_levels_mps2", [0.0, 0.1]),
    ],
)
def test_a_setting_that_makes_no_sense_is_refused(key: str, value: object) -> None:
    with pytest.raises(SettingsError, match=r"x\.toml"):
        settings.override(AtoConfig(), {key: value}, "x.toml")


def test_the_levels_of_the_controller_are_read_from_a_file() -> None:
    stage = settings.build(OutputStage, {"brake_levels_mps2": [0.1, 0.4]}, "x.toml")

    assert stage.brake_levels_mps2 == (0.1, 0.4)
