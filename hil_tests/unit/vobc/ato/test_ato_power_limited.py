"""The law of power-limited running curves: plans against a simulation in small steps, and runs."""

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.trackdb import SpeedSection, load_line
from hil_tests.unit.vobc.ato import ato_rig
from hil_tests.unit.vobc.ato.ato_rig import line_with
from vobc.ato import Ato, AtoConfig
from vobc.ato.laws.limited_way import LimitedWay, lowered
from vobc.ato.laws.power_limited import PowerLimitedRun, RunStage
from vobc.ato.laws.power_plan import PowerPlanner
from vobc.ato.motion import profile

LINE = load_line("florence")
LOAD_KG = 27_200.0
"""Half of the maximum passenger load, as in the rig."""
CONFIG = AtoConfig()
LOAD_KG = 27200.0


def planner(config: AtoConfig = CONFIG) -> PowerPlanner:
    curve = profile.curve_to_stop(config, LINE, 4500.0)
    return PowerPlanner(config, LINE, 4500.0, curve, load_kg=LOAD_KG)


def with_weight(weight_factor: float) -> AtoConfig:
    changed = dataclasses.replace(CONFIG.power_limited, weight_factor=weight_factor)
    return dataclasses.replace(CONFIG, power_limited=changed)


def driven_s(planned: PowerPlanner, off_mps: float, power_w: float) -> float:
    """Running time from III to IV in small steps: accelerate at 0.8 m/s² within the jerk limit,
    coast, brake."""
    curve = profile.curve_to_stop(CONFIG, LINE, 4500.0)
    brake = planned.brake(power_w)
    front_m, speed_mps, time_s, accel_mps2, step_s = 3500.0, 0.0, 0.0, 0.0, 0.01
    gains, brakes = True, False
    mass_kg = 130000.0 * 1.08 + LOAD_KG
    while speed_mps > 0.0 or gains:
        weight_kn = 130.0 * 9.81 + LOAD_KG * 9.81e-3
        n_per_kn = 2.0 + 0.04 * speed_mps + 0.008 * speed_mps**2
        drag_mps2 = n_per_kn * weight_kn / (weight_kn / 9.81e-3 * 1.08)
        brakes = brakes or brake.from_speed(speed_mps).way_m >= 4500.0 - front_m
        gains = gains and speed_mps + accel_mps2**2 / 1.2 < off_mps and not brakes
        if gains:
            most_mps2 = min(0.8, 2.4e6 / (mass_kg * max(1.0, speed_mps)))
            accel_mps2 = min(most_mps2, accel_mps2 + 0.6 * step_s)
        elif brakes:
            limited_mps2 = power_w / (mass_kg * max(speed_mps, 0.1)) + drag_mps2
            accel_mps2 = -min(curve.at_speed(speed_mps).decel_mps2, limited_mps2)
        elif accel_mps2 > 0.0:
            accel_mps2 = max(-drag_mps2, accel_mps2 - 0.6 * step_s)
        else:
            accel_mps2 = -drag_mps2
        speed_mps = max(0.0, speed_mps + accel_mps2 * step_s)
        front_m += speed_mps * step_s
        time_s += step_s
        assert time_s < 400.0
    return time_s


@pytest.mark.parametrize("left_s", [88.0, 100.0, 120.0])
@pytest.mark.parametrize("weight_factor", [0.0, 30.0])
def test_a_plan_takes_the_time_that_it_says(left_s: float, weight_factor: float) -> None:
    planned = planner(with_weight(weight_factor))
    plan = planned.plan(3500.0, 0.0, left_s, 18.9)

    assert plan.time_s == pytest.approx(left_s, abs=0.3)
    assert driven_s(planned, plan.notch_off_mps, plan.power_w) == pytest.approx(left_s, abs=2.0)


@settings(max_examples=25, deadline=None)
@given(left_s=st.floats(88.0, 130.0), weights=st.tuples(st.floats(0.0, 40.0), st.floats(0.0, 40.0)))
def test_more_weight_never_plans_more_power(left_s: float, weights: tuple[float, float]) -> None:
    low, high = (
        planner(with_weight(weight)).plan(3500.0, 0.0, left_s, 18.9) for weight in sorted(weights)
    )

    assert high.power_w <= low.power_w * 1.04
    assert high.notch_off_mps >= low.notch_off_mps - 1e-9


@settings(max_examples=25, deadline=None)
@given(left_s=st.floats(40.0, 70.0), less_s=st.floats(0.5, 10.0), speed_mps=st.floats(12.0, 19.0))
def test_less_time_left_never_lowers_the_limit(
    left_s: float, less_s: float, speed_mps: float
) -> None:
    planned = planner()

    limit_w = planned.limit_w(3900.0, speed_mps, left_s)

    assert planned.limit_w(3900.0, speed_mps, left_s - less_s) >= limit_w
    assert limit_w <= CONFIG.power_limited.brake_power_w


def test_without_enough_time_the_plan_is_the_fastest_possible() -> None:
    plan = planner().plan(3500.0, 0.0, 20.0, 18.9)

    assert plan.notch_off_mps == 18.9
    assert plan.power_w == pytest.approx(CONFIG.power_limited.brake_power_w)
    assert plan.time_s > 20.0


# Runs.


def ride(run_s: float | None, config: AtoConfig, seed: int = 3):  # type: ignore[no-untyped-def]
    """Run 1 km on the level from III to IV."""
    line = line_with(**({} if run_s is None else {"IV": run_s}))
    stops = [dataclasses.replace(line.station("IV"), dwell_s=2.0)]
    ato = Ato(dataclasses.replace(config, strategy="power_limited"), line, 3500.0, stops)
    rig_settings = ato_rig.RigSettings(seed=seed, brake_delay_s=None, start_scale_known=True)
    rig = ato_rig.Rig(ato, line, rig_settings, 3500.0)
    powers_w: list[float] = []
    stages: set[RunStage] = set()

    def watch(now: ato_rig.Rig) -> bool:
        law = ato.strategy
        if isinstance(law, PowerLimitedRun):
            stages.add(law.stage)
            if law.stage is RunStage.BRAKING and law.plan is not None:
                asked_mps2 = max(0.0, -law._demand_mps2)
                mass_kg = 130000.0 * 1.08 + LOAD_KG
                powers_w.append(asked_mps2 * mass_kg * law.speed_mps / law.plan.power_w)
        return len(now.stops) >= 1

    rig.run(watch)
    return rig.stops[0], powers_w, stages


@pytest.mark.parametrize("run_s", [92.0, 105.0])
@pytest.mark.parametrize("weight_factor", [0.0, 5.0, 30.0])
def test_a_run_keeps_the_time_the_stopping_mark_and_the_power_limit(
    run_s: float, weight_factor: float
) -> None:
    stop, shares, stages = ride(run_s, with_weight(weight_factor))

    assert stop.leg_s == pytest.approx(run_s, abs=2.5)
    assert abs(stop.error_m) <= 0.10
    assert RunStage.GAINING in stages
    assert stages & {RunStage.COASTING, RunStage.BRAKING}
    # With weight zero the power limit may equal the motors' maximum. The stopping curve then asks
    # for less.
    assert RunStage.BRAKING in stages or weight_factor == 0.0
    assert max(shares, default=0.0) <= 1.05


def test_more_weight_brakes_longer_with_less_power_at_the_same_time() -> None:
    saving, _, _ = ride(100.0, with_weight(0.0))
    gentle, _, _ = ride(100.0, with_weight(40.0))

    assert gentle.leg_s == pytest.approx(saving.leg_s, abs=2.5)


def test_the_reference_of_a_coasting_train_does_not_accelerate() -> None:
    """Otherwise the stop's braking begins some 25 m too early, as if traction had to end first."""
    line = line_with(IV=105.0)
    stops = [dataclasses.replace(line.station("IV"), dwell_s=2.0)]
    config = dataclasses.replace(with_weight(0.0), strategy="power_limited")
    ato = Ato(config, line, 3500.0, stops)
    rig = ato_rig.Rig(ato, line, ato_rig.RigSettings(seed=3, start_scale_known=True), 3500.0)
    accels_mps2: dict[RunStage, list[float]] = {stage: [] for stage in RunStage}

    def watch(now: ato_rig.Rig) -> bool:
        law = ato.strategy
        if isinstance(law, PowerLimitedRun):
            accels_mps2[law.stage].append(law._drives._governor.accel_mps2)
        return len(now.stops) >= 1

    rig.run(watch)

    assert max(accels_mps2[RunStage.GAINING]) > 0.5
    assert len(accels_mps2[RunStage.COASTING]) > 100
    assert max(accels_mps2[RunStage.COASTING]) <= 0.0


def test_without_a_timetable_it_is_as_fast_as_the_predictive_law() -> None:
    free, shares, stages = ride(None, CONFIG)

    assert shares == []
    assert stages == {RunStage.FREE}
    assert free.leg_s < 90.0


def test_a_late_train_raises_its_power_limit_and_then_brakes_normally() -> None:
    planned = planner()
    early_w = planned.limit_w(3900.0, 17.0, 75.0)
    late_w = planned.limit_w(3900.0, 17.0, 45.0)

    assert early_w < late_w
    assert math.isclose(late_w, CONFIG.power_limited.brake_power_w, rel_tol=1e-3)
    stop, _, _ = ride(60.0, CONFIG)
    free, _, _ = ride(None, CONFIG)
    assert stop.leg_s == pytest.approx(free.leg_s, abs=4.0)
    assert abs(stop.error_m) <= 0.10


FLAT = (SpeedSection(LINE.start_m, LINE.end_m, 19.4),)
SLOW_LINE = dataclasses.replace(
    LINE,
    speed_sections=(
        SpeedSection(LINE.start_m, 3900.0, 19.4),
        SpeedSection(3900.0, 4100.0, 12.0),
        SpeedSection(4100.0, LINE.end_m, 19.4),
    ),
)


def limited_planner() -> PowerPlanner:
    curve = profile.curve_to_stop(CONFIG, SLOW_LINE, 4500.0)
    return PowerPlanner(CONFIG, SLOW_LINE, 4500.0, curve, load_kg=LOAD_KG)


def limited_way() -> LimitedWay:
    curve = profile.curve_to_stop(CONFIG, SLOW_LINE, 4500.0)
    return LimitedWay(
        CONFIG, SLOW_LINE, 3500.0, 4500.0, curve, drag_mps2=(0.02, 0.0004, 8e-5), mass_kg=1.6e5
    )


@pytest.mark.parametrize(
    ("front_m", "stop_m", "lower"),
    [
        (3500.0, 4500.0, True),
        (3899.0, 4500.0, True),
        (3901.0, 4500.0, False),
        (4150.0, 4500.0, False),
        (3500.0, 3850.0, False),
    ],
)
def test_a_limit_is_lower_only_after_a_higher_one(
    front_m: float, stop_m: float, lower: bool
) -> None:
    assert lowered(CONFIG, SLOW_LINE, front_m, stop_m) is lower
    assert not lowered(CONFIG, dataclasses.replace(LINE, speed_sections=FLAT), front_m, stop_m)


@settings(max_examples=8, deadline=None)
@given(left_s=st.floats(100.0, 150.0))
def test_a_plan_past_a_lower_limit_takes_its_time_with_the_least_energy(left_s: float) -> None:
    way = limited_way()
    best = way.plan(0.0, left_s, low_mps=8.0, top_mps=18.9)

    assert best is not None
    # Where a train that coasts a little sooner would stall, the plan is early.
    assert left_s - 2.0 < best.time_s <= left_s
    for held_mps in (10.0, 13.0, 17.0, 18.9):
        other = way.in_time(0.0, held_mps, left_s)
        if other is not None:
            assert best.energy_m2_per_s2 <= other.energy_m2_per_s2 * 1.03


@settings(max_examples=8, deadline=None)
@given(held_mps=st.floats(9.0, 18.9), places_m=st.tuples(*(st.floats(3550.0, 4500.0),) * 2))
def test_coasting_later_is_never_slower_and_never_cheaper(
    held_mps: float, places_m: tuple[float, float]
) -> None:
    soon, late = (limited_way().run(0.0, held_mps, place_m) for place_m in sorted(places_m))

    assert late.time_s <= soon.time_s + 1e-9
    assert late.energy_m2_per_s2 >= soon.energy_m2_per_s2 - 1e-9


def test_without_enough_time_past_a_lower_limit_the_plan_is_the_fastest_run() -> None:
    plan = limited_planner().plan(3500.0, 0.0, 30.0, 18.9)

    assert plan.time_s > 60.0
    assert (plan.notch_off_mps, plan.coast_from_m) == (18.9, 4500.0)
    assert limited_planner().coast_from_m(3500.0, 0.0, 30.0, 18.9) is None
