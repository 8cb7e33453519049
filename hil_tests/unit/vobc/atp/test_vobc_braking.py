"""The safe braking model against motion that the test simulates step by step."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import GradientSection, LineMap, SpeedSection, Station
from vobc.atp.braking import SafeBraking
from vobc.atp.ceiling import CeilingMap
from vobc.config import load_config
from vobc.kinematics import permitted_speed_mps, stopping_distance_m
from vobc.vocabulary import Ceiling, Interval

CONFIG = load_config("florence4").atp
STEP_S = 0.001
LENGTH_M = 68.59
KMH = 1.0 / 3.6


def worst_case_end_m(
    speed_mps: float, braking: SafeBraking, fall_permille: float, *, target_mps: float = 0.0
) -> float:
    """Distance after which a worst-case train is down to the target speed."""
    fall_mps2 = 9.81 * fall_permille / 1000.0
    at_m, time_s = 0.0, 0.0
    while True:
        if time_s < braking.runaway_s:
            accel_mps2 = braking.runaway_mps2 + fall_mps2
        elif time_s < braking.runaway_s + braking.build_up_s:
            accel_mps2 = fall_mps2
        else:
            accel_mps2 = fall_mps2 - braking.guaranteed_decel_mps2
            if speed_mps <= target_mps:
                return at_m
        at_m += speed_mps * STEP_S + 0.5 * accel_mps2 * STEP_S**2
        speed_mps += accel_mps2 * STEP_S
        time_s += STEP_S


@given(
    distance_m=st.floats(5.0, 800.0),
    fall_permille=st.floats(0.0, 40.0),
    runaway_mps2=st.floats(0.0, 1.3),
    runaway_s=st.floats(0.0, 1.0),
    build_up_s=st.floats(0.0, 2.0),
)
def test_the_worst_case_train_on_the_curve_stops_exactly_at_the_target(
    distance_m: float,
    fall_permille: float,
    runaway_mps2: float,
    runaway_s: float,
    build_up_s: float,
) -> None:
    braking = SafeBraking(1.0, runaway_mps2, runaway_s, build_up_s)

    speed_mps = braking.on(-fall_permille).speed_mps(distance_m, target_mps=0.0)

    if speed_mps > 0.0:
        end_m = worst_case_end_m(speed_mps, braking, fall_permille)
        assert end_m == pytest.approx(distance_m, abs=0.05 + 2.0 * STEP_S * speed_mps)


@given(distance_m=st.floats(80.0, 600.0), target_mps=st.floats(1.0, 15.0))
def test_the_worst_case_train_on_the_curve_meets_the_target_speed_exactly_at_the_target(
    distance_m: float, target_mps: float
) -> None:
    braking = SafeBraking(1.0, 1.0, 0.48, 1.05)

    speed_mps = braking.on(0.0).speed_mps(distance_m, target_mps=target_mps)

    if speed_mps > target_mps:
        end_m = worst_case_end_m(speed_mps, braking, 0.0, target_mps=target_mps)
        assert end_m == pytest.approx(distance_m, abs=0.05 + 2.0 * STEP_S * speed_mps)


@given(lead_s=st.floats(0.1, 4.0), distance_m=st.floats(50.0, 600.0))
def test_a_lead_is_time_in_which_the_train_runs_on_at_its_speed(
    lead_s: float, distance_m: float
) -> None:
    curve = SafeBraking(1.0, 1.0, 0.48, 1.05).on(0.0)

    early_mps = curve.speed_mps(distance_m, target_mps=0.0, lead_s=lead_s)

    late_mps = curve.speed_mps(distance_m - early_mps * lead_s, target_mps=0.0)
    assert early_mps == pytest.approx(late_mps, abs=1e-6)


def test_a_climb_gives_no_credit_and_a_fall_beyond_the_brake_is_refused() -> None:
    """A climb counts as level. A model that the brake cannot hold would promise an impossible
    stop."""
    braking = SafeBraking(1.0, 1.0, 0.4, 1.0)

    assert braking.on(30.0) == braking.on(0.0)
    assert braking.on(-96.0).decel_mps2 == pytest.approx(1.0 - 9.81 * 0.096)
    with pytest.raises(ValueError, match=r"guaranteed_decel_mps2 1\.0 does not hold a train"):
        braking.on(-98.0)


def test_a_train_slower_than_the_target_needs_no_brake_even_beyond_the_point() -> None:
    curve = SafeBraking(1.0, 1.0, 0.4, 1.0).on(0.0)

    assert curve.speed_mps(-5.0, target_mps=11.0) == 11.0
    assert curve.speed_mps(-500.0, target_mps=0.0) == 0.0


@pytest.mark.parametrize("reaction_s", [0.0, 0.5, 1.5])
@pytest.mark.parametrize("distance_m", [1.0, 50.0, 800.0])
def test_distance_and_speed_of_a_plain_braking_are_inverse_functions(
    distance_m: float, reaction_s: float
) -> None:
    speed_mps = permitted_speed_mps(distance_m, decel_mps2=0.9, reaction_s=reaction_s)

    assert stopping_distance_m(speed_mps, decel_mps2=0.9, reaction_s=reaction_s) == pytest.approx(
        distance_m
    )
    assert speed_mps * reaction_s + speed_mps**2 / 1.8 == pytest.approx(distance_m)


def line(
    *limits: tuple[float, float, float], gradients: tuple[GradientSection, ...] = ()
) -> LineMap:
    sections = tuple(SpeedSection(*limit) for limit in limits)
    end_m = sections[-1].end_m
    stations = (Station("A", 100.0, 20.0, 110.0),)
    return LineMap("test", sections[0].start_m, end_m, stations, sections, gradients)


def ceiling_map(on: LineMap, cycle_s: float = 0.05) -> CeilingMap:
    braking = SafeBraking(
        CONFIG.guaranteed_decel_mps2,
        CONFIG.runaway_mps2,
        CONFIG.sensing_s + (1 + CONFIG.overruns_max) * cycle_s + CONFIG.traction_cut_s,
        CONFIG.brake_build_up_s,
    )
    return CeilingMap(CONFIG, braking, on, train_length_m=LENGTH_M)


def exact(front_m: float) -> Interval:
    return Interval(front_m, front_m, front_m)


FAR_M = 1e6
TWO_LIMITS = line((0.0, 1500.0, 70 * KMH), (1500.0, 1900.0, 40 * KMH), (1900.0, 6000.0, 70 * KMH))


def test_without_restrictions_ahead_the_published_margins_lie_above_the_civil_limit() -> None:
    ceiling = ceiling_map(TWO_LIMITS).at(exact(600.0), FAR_M)

    assert ceiling.permitted_mps == pytest.approx(70 * KMH)
    assert ceiling.warning_mps == pytest.approx(73 * KMH)
    assert ceiling.emergency_mps == pytest.approx(78 * KMH)


def test_a_lower_limit_holds_from_the_first_metre_until_the_rear_is_clear() -> None:
    ceilings = ceiling_map(TWO_LIMITS)

    assert ceilings.at(exact(1500.0), FAR_M).permitted_mps == pytest.approx(40 * KMH)
    assert ceilings.at(exact(1900.0 + LENGTH_M - 0.1), FAR_M).emergency_mps == pytest.approx(
        48 * KMH
    )
    assert ceilings.at(exact(1900.0 + LENGTH_M + 0.1), FAR_M).permitted_mps == pytest.approx(
        70 * KMH
    )


def test_the_worst_end_of_the_interval_counts_on_both_sides() -> None:
    ceilings = ceiling_map(TWO_LIMITS)
    unsure = Interval(1890.0 + LENGTH_M, 1910.0 + LENGTH_M, 1930.0 + LENGTH_M)

    assert ceilings.at(unsure, FAR_M).permitted_mps == pytest.approx(40 * KMH)
    assert ceilings.at(Interval(1380.0, 1400.0, 1420.0), FAR_M) == ceilings.at(exact(1420.0), FAR_M)
    assert ceilings.at(Interval(380.0, 400.0, 420.0), 450.0) == ceilings.at(exact(420.0), 450.0)


@given(front_m=st.floats(300.0, 1499.0), end_m=st.floats(310.0, 2500.0))
def test_the_four_speeds_are_always_in_order(front_m: float, end_m: float) -> None:
    ceiling = ceiling_map(TWO_LIMITS).at(exact(front_m), end_m)

    speeds = (
        0.0,
        ceiling.permitted_mps,
        ceiling.warning_mps,
        ceiling.service_mps,
        ceiling.emergency_mps,
    )
    assert list(speeds) == sorted(speeds)


@given(
    front_m=st.floats(100.0, 2400.0),
    gap_m=st.floats(0.0, 900.0),
    fall_permille=st.floats(0.0, 40.0),
    steep_start_m=st.floats(100.0, 2500.0),
)
def test_from_just_under_the_emergency_speed_no_train_passes_its_authority(
    front_m: float, gap_m: float, fall_permille: float, steep_start_m: float
) -> None:
    """The test simulates the worst case of IEEE 1474.1 over the gradients under the moving
    train."""
    steep = GradientSection(steep_start_m, steep_start_m + 300.0, -fall_permille)
    track = line((0.0, 6000.0, 25.0), gradients=(steep,))
    braking = SafeBraking(1.0, 1.0, 0.48, 1.05)
    ceiling = CeilingMap(CONFIG, braking, track, train_length_m=LENGTH_M).at(
        exact(front_m), front_m + gap_m
    )
    speed_mps = ceiling.emergency_mps

    at_m, time_s = front_m, 0.0
    while speed_mps > 0.0:
        covered_m = max(0.0, min(at_m, steep.end_m) - max(at_m - LENGTH_M, steep.start_m))
        fall_mps2 = 9.81 * fall_permille / 1000.0 * covered_m / LENGTH_M
        accel_mps2 = fall_mps2 + (1.0 if time_s < 0.48 else 0.0 if time_s < 1.53 else -1.0)
        at_m += speed_mps * 0.01
        speed_mps += accel_mps2 * 0.01
        time_s += 0.01

    assert at_m <= front_m + gap_m + 0.01 * ceiling.emergency_mps + 0.05


@given(front_m=st.floats(1000.0, 1500.0))
def test_from_just_under_the_emergency_speed_a_lower_limit_is_kept_but_for_the_overshoot(
    front_m: float,
) -> None:
    braking = SafeBraking(1.0, 1.0, 0.48, 1.05)
    ceiling = CeilingMap(CONFIG, braking, TWO_LIMITS, train_length_m=LENGTH_M).at(
        exact(front_m), FAR_M
    )
    target_mps = 48 * KMH

    end_m = front_m + worst_case_end_m(ceiling.emergency_mps, braking, 0.0, target_mps=target_mps)

    overshoot_mps = 1.0 * 0.48
    if ceiling.emergency_mps > target_mps + overshoot_mps:
        assert end_m <= 1500.0 + 0.05
    else:
        # The train is never faster here than it would be from the limit itself.
        assert end_m - front_m <= worst_case_end_m(
            target_mps + overshoot_mps, braking, 0.0, target_mps=target_mps
        )


def test_restrictions_beyond_the_horizon_change_nothing_and_within_it_something() -> None:
    ceilings = ceiling_map(TWO_LIMITS)
    limit_mps = ceilings.at(exact(300.0), FAR_M)

    assert limit_mps == Ceiling(
        70 * KMH, 70 * KMH + CONFIG.warning_margin_mps, 70 * KMH + CONFIG.service_margin_mps,
        70 * KMH + CONFIG.emergency_margin_mps, FAR_M - 300.0,
    )  # fmt: skip
    distances_m = [1500.0 - 5.0 * step for step in range(1, 250)]
    permitted = [ceilings.at(exact(at_m), FAR_M).permitted_mps for at_m in distances_m]
    assert permitted == sorted(permitted), "the curve must fall towards the limit without a step"
    steps = [later - earlier for earlier, later in itertools.pairwise(permitted)]
    assert max(steps) < 0.7


LEADS_S = (1.6, 1.0, 0.6, 0.0)
"""Leads of the shipped parameters: permitted, warning, service, emergency."""


def speeds_of(ceiling: Ceiling) -> tuple[float, ...]:
    return (
        ceiling.permitted_mps,
        ceiling.warning_mps,
        ceiling.service_mps,
        ceiling.emergency_mps,
    )


def test_towards_the_end_of_authority_each_curve_has_its_lead_and_none_a_margin() -> None:
    curve = SafeBraking(1.0, 1.0, 0.48, 1.05).on(0.0)

    ceiling = ceiling_map(TWO_LIMITS).at(exact(600.0), 660.0)

    assert speeds_of(ceiling) == pytest.approx(
        [curve.speed_mps(60.0, target_mps=0.0, lead_s=lead_s) for lead_s in LEADS_S]
    )


def test_towards_a_lower_limit_each_curve_has_its_lead_and_its_margin() -> None:
    curve = SafeBraking(1.0, 1.0, 0.48, 1.05).on(0.0)
    targets_mps = [(40.0 + margin) * KMH for margin in (0.0, 3.0, 5.5, 8.0)]

    ceiling = ceiling_map(TWO_LIMITS).at(exact(1440.0), FAR_M)

    assert speeds_of(ceiling) == pytest.approx(
        [
            curve.speed_mps(60.0, target_mps=target_mps, lead_s=lead_s)
            for target_mps, lead_s in zip(targets_mps, LEADS_S, strict=True)
        ]
    )


def test_beyond_the_authority_no_speed_is_permitted() -> None:
    ceiling = ceiling_map(TWO_LIMITS).at(exact(500.0), 480.0)

    assert ceiling.permitted_mps == ceiling.emergency_mps == 0.0
    assert ceiling.distance_to_authority_m == pytest.approx(-20.0)


def test_curves_are_monotone_in_distance() -> None:
    curve = SafeBraking(1.0, 1.0, 0.48, 1.05).on(-30.0)
    speeds = [curve.speed_mps(float(distance), target_mps=5.0) for distance in range(0, 600, 7)]

    assert speeds == sorted(speeds)
    assert math.isclose(speeds[0], 5.0)
