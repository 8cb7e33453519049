"""Speed and distance over ground after one cycle of the odometer, by hand calculation."""

import math
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.brake import BrakeStatus
from can_dbc.nodes import Direction
from firmware_py.trackdb import GradientSection
from hil_tests.unit.vobc.odometry.odometry_desk import PULSE_M, Desk, near
from vobc.vocabulary import Interval

CYCLE_S = 0.04
CARRIED_M = near(0.5 * (3.9 + 3.84) * CYCLE_S, 0.5 * (4.1 + 4.16) * CYCLE_S)
"""Distance in a cycle from 4 m/s by radar, ±0.1 m/s, extrapolated by 1.5 m/s² either way."""


def going(step: int = 8, cycles: int = 60, **changes: Any) -> Any:
    """An odometer at 4 m/s, with 8 pulses in each 20 ms, seen by the radar."""
    made = Desk(**changes)
    made.cycles(cycles, step, step, radar_mps=step * 0.5)
    return made


def speeds(made: Any) -> tuple[float, float]:
    return made.ground.low_mps, made.ground.high_mps


# How it begins.


def test_the_first_radar_reading_begins_the_speed_over_ground() -> None:
    new = Desk()
    new.cycle(0, radar_mps=4.0)

    assert new.ground.begun
    assert speeds(new) == near(3.9, 4.1)


def test_without_radar_it_begins_with_the_first_full_window_of_the_wheels() -> None:
    """The window takes 0.2 s of samples. Until it is full, the ground interval is that of the
    wheels plus 3 cm."""
    new = Desk()
    for _ in range(5):
        told = new.cycle(8, 8)
        assert not new.ground.begun
        assert (told.speed_mps.low, told.speed_mps.high) == new.wheels()[::2]
        assert not told.slip
    told = new.cycle(8, 8)

    assert new.ground.begun
    assert speeds(new) == new.wheels()[::2]
    assert (told.speed_mps.low, told.speed_mps.high) == speeds(new)
    assert over_ground(new) == by_wheels(new)


def test_until_it_begins_the_place_over_ground_follows_the_wheels() -> None:
    new = Desk()
    for _ in range(4):
        new.cycle(8, 8)
        assert over_ground(new) == by_wheels(new)


def test_until_it_begins_the_ground_position_is_the_present_one() -> None:
    """8 pulses of 0.01 m in 20 ms are 4 m/s, so since a sample 16 ms ago the train ran 64 mm."""
    new = Desk()
    for _ in range(4):
        new.cycle(8, 8, age_s=0.016)
        low_m, high_m = over_ground(new)
        assert by_wheels(new, age_s=0.016) == (low_m, high_m)
    least, _, most = new.wheels()
    assert low_m == pytest.approx(new.where.low_m + 0.015 * least - 0.03)
    assert high_m == pytest.approx(new.where.high_m + 0.017 * most + 0.03)
    assert least < 4.0 < most


def over_ground(desk: Desk) -> tuple[float, float]:
    return desk.where.ground_low_m, desk.where.ground_high_m


def by_wheels(desk: Desk, age_s: float = 0.0) -> Any:
    """Position now by the wheels, without the accumulated radar error."""
    low_m, high_m = desk.where.by_wheels(Interval(*desk.wheels()), age_s)
    return pytest.approx((low_m - 0.03, high_m + 0.03))


def test_two_distant_samples_without_a_pulse_begin_at_rest() -> None:
    new = Desk()
    new.cycle(0)
    assert not new.ground.begun
    new.cycle(0, dt_s=0.625)

    assert new.ground.begun
    assert speeds(new) == (-0.02, 0.02)


def test_a_train_that_stands_for_exactly_long_enough_begins_at_rest() -> None:
    measured = Desk()
    measured.cycle(0)
    measured.cycle(0, dt_s=0.625)
    still_s = measured.track.still_s
    for standing_s, at_rest in ((still_s, True), (math.nextafter(still_s, 1.0), False)):
        new = Desk(standing_s=standing_s)
        new.cycle(0)
        told = new.cycle(0, dt_s=0.625)

        assert (speeds(new) == (-0.02, 0.02)) is at_rest
        assert told.standing is at_rest


def test_an_old_sample_of_still_wheels_begins_with_the_possible_speed_change() -> None:
    """No pulse came in 0.625 s. The bound allows one pulse, 1 ms and 1.5 m/s² over half of it,
    then 0.625 s more."""
    new = Desk()
    new.cycle(0)
    new.cycle(0, dt_s=0.625, tacho_age_s=0.2)
    most_mps = PULSE_M / 0.624 + 1.5 * (0.3125 + 0.001)

    assert speeds(new) == near(-most_mps - 1.5 * 0.625, most_mps + 1.5 * 0.625)


# Radar and wheels.


@pytest.mark.parametrize("end", [0, 2])
def test_a_radar_that_either_bound_of_the_wheels_confirms_replaces_the_extrapolated_speed(
    end: int,
) -> None:
    made = going()
    radar_mps = made.wheels()[end]
    made.over_ground(30.0, 31.0)
    made.cycle(dt_s=0.0, radar_mps=radar_mps)

    assert made.ground.seen
    assert speeds(made) == near(radar_mps - 0.1, radar_mps + 0.1)


def test_the_distance_follows_the_mean_radar_speed() -> None:
    """The radar shows 4 m/s ± 0.02 m/s, extrapolated back by half a cycle at 1.5 m/s²."""
    made = going()
    assert made.moved(8, 8, radar_mps=4.0) == near(3.95 * CYCLE_S, 4.05 * CYCLE_S)


# Accelerometer.


def felt(made: Any, **heard: Any) -> tuple[float, float]:
    """Change of the bounds of 4 and 4.5 m/s in a cycle without evidence from the wheels, in
    m/s²."""
    made.over_ground(4.0, 4.5)
    made.cycle(tacho_age_s=1.0, **heard)
    low, high = speeds(made)
    return (low - 4.0) / CYCLE_S, (high - 4.5) / CYCLE_S


def test_a_healthy_and_fresh_accelerometer_extrapolates_the_bounds() -> None:
    assert felt(going(), felt_mps2=1.0) == near(0.75, 1.25)
    assert felt(going(), felt_mps2=1.0, imu_age_s=0.15) == near(0.75, 1.25)
    assert felt(going(), felt_mps2=1.0, imu_age_s=0.151) == near(-1.5, 1.5)
    assert felt(going(), felt_mps2=1.0, imu_healthy=False) == near(-1.5, 1.5)
    assert felt(going()) == near(-1.5, 1.5)


def test_the_accelerometer_covers_only_the_end_of_a_gap_between_cycles() -> None:
    made = going()
    made.over_ground(4.0, 4.5)
    made.cycle(dt_s=0.5, tacho_age_s=1.0, felt_mps2=1.0)

    assert speeds(made) == near(4.0 - 0.75, 4.5 + 0.75)


@pytest.mark.parametrize(
    ("low_m", "ground_low_m", "high_m", "ground_high_m", "climbs"),
    [
        (100.0, 100.0, 110.0, 110.0, False),
        (100.0, 100.0, 200.5, 110.0, True),
        (100.0, 100.0, 110.0, 200.5, True),
        (330.0, 330.0, 340.0, 340.0, False),
        (324.0, 330.0, 340.0, 340.0, True),
        (330.0, 324.0, 340.0, 340.0, True),
    ],
)
def test_gradients_are_taken_from_the_furthest_ends_of_both_intervals(
    low_m: float, ground_low_m: float, high_m: float, ground_high_m: float, *, climbs: bool
) -> None:
    """The gradient is 20 per mille from 200 m to 300 m; the accelerometer is up to 25 m behind
    the front."""
    made = going(climbs=(GradientSection(200.0, 300.0, 20.0),))
    made.where.low_m, made.where.high_m = low_m, high_m
    made.where.ground_low_m, made.where.ground_high_m = ground_low_m, ground_high_m

    least_mps2 = 0.75 - (0.02 * 9.81 if climbs else 0.0)
    assert felt(made, felt_mps2=1.0) == near(least_mps2, 1.25)


# Wheels while the radar sees nothing.


def test_slow_gentle_wheels_measure_the_distance_within_a_small_slip() -> None:
    for step in (8, -8):
        made = going(step)
        way_m = made.moved(step, step)
        best_mps = made.wheels()[1]

        assert best_mps == pytest.approx(step * 0.5, abs=0.3)
        slack_mps = 0.08 * abs(best_mps)
        assert way_m == near((best_mps - slack_mps) * CYCLE_S, (best_mps + slack_mps) * CYCLE_S)


@pytest.mark.parametrize(
    ("share", "slip_ratio"),
    [(1.0, 0.08), (-1.0, 0.08), (1.001, 0.4), (-1.001, 0.4), (0.5, 0.08)],
)
def test_wheels_that_need_more_adhesion_may_slip_more(share: float, slip_ratio: float) -> None:
    """The last samples show 0.45 m/s² and more."""
    accel_pulses_per_s2 = 45.0
    made = going(gentle_mps2=accel_pulses_per_s2 * going().where.m_per_pulse)
    made.track.accel_pulses_per_s2 = share * accel_pulses_per_s2
    way_m = made.moved(tacho_age_s=0.04)
    best_mps = made.wheels()[1]

    slack_mps = slip_ratio * best_mps
    assert way_m == near((best_mps - slack_mps) * CYCLE_S, (best_mps + slack_mps) * CYCLE_S)


@pytest.mark.parametrize("step", [8, -8])
def test_wheels_above_the_radars_blind_speed_do_not_measure_the_distance(step: int) -> None:
    measured = going(step)
    measured.cycle(step, step)
    speed_mps = abs(measured.wheels()[1])
    slow = going(step, doppler_blind_mps=speed_mps)
    assert slow.moved(step, step)[0] == pytest.approx(
        (measured.wheels()[1] - 0.08 * speed_mps) * CYCLE_S
    )
    fast = going(step, doppler_blind_mps=math.nextafter(speed_mps, 0.0))
    low_m, high_m = fast.moved(step, step)
    assert sorted((abs(low_m), abs(high_m))) == CARRIED_M


@pytest.mark.parametrize(
    ("tacho_age_s", "witness"), [(0.0, True), (0.15, True), (0.151, False), (9.0, False)]
)
def test_an_old_tacho_sample_is_no_evidence(tacho_age_s: float, *, witness: bool) -> None:
    made = going()
    way_m = made.moved(tacho_age_s=tacho_age_s)

    assert (way_m != CARRIED_M) is witness


def test_wheels_that_turn_against_their_direction_are_no_evidence() -> None:
    assert going().moved(8, 8, way=Direction.REVERSE) == CARRIED_M


@pytest.mark.parametrize(("lead", "back_m", "ahead_m"), [(10, 0.0, 0.10), (-6, 0.06, 0.0)])
def test_axles_that_disagree_bound_the_ground_together_where_the_radar_is_blind(
    lead: int, back_m: float, ahead_m: float
) -> None:
    """Tacho B leads by so many pulses of 1 cm, and either axle may slip by 8 %."""
    made = going()
    longest = 1.08 * made.where.scale.declared_m[1] / 0.01
    low_m, high_m = made.moved(8, 8, steps_b=(8, 8 + lead))
    assert made.odometry._slip
    way_m = made.wheels()[1] * CYCLE_S
    assert (low_m, high_m) == near(
        0.92 * way_m - back_m * longest, 1.08 * way_m + ahead_m * longest
    )
    later = made.moved(tacho_age_s=0.04)
    way_m = made.wheels()[1] * CYCLE_S
    assert later == near(0.92 * way_m, 1.08 * way_m)


@pytest.mark.parametrize(
    "why", ["fast", "pulls", "against the ground", "direction", "one axle", "jump"]
)
def test_axles_that_disagree_are_no_evidence_where_more_is_wrong(why: str) -> None:
    made = going(doppler_blind_mps=1.0 if why == "fast" else 5.0)
    heard: dict[str, Any] = {}
    made.cycle(8, 8, steps_b=(8, 18))
    if why == "against the ground":
        made.over_ground(5.9, 6.1)
        made.cycle(8, 8)
        made.over_ground(3.9, 4.1)
        made.cycles(23, 8, 8, radar_mps=4.0)
    elif why == "direction":
        made.cycle(8, 8, way=Direction.REVERSE)
    elif why == "one axle":
        heard["healthy"] = (True, False)
    elif why == "pulls":
        made.track.accel_pulses_per_s2 = 46.0
        heard["tacho_age_s"] = 0.04
    elif why == "jump":
        made.odometry._wheels_out = True
    made.over_ground(3.9, 4.1)

    assert made.moved(8, 8, **heard) == CARRIED_M


def test_while_axles_differ_the_train_stands_only_if_both_do() -> None:
    made = going(step=0)
    made.cycles(8, 0, 0, steps_b=(1, 1))
    assert made.odometry._slip
    assert made.moved(0, 0, steps_b=(0, 1))[1] > 0.0
    for _ in range(12):
        made.over_ground(-0.2, 0.2)
        made.cycle(0, 0)
        assert speeds(made) == near(-0.26, 0.26)
    assert made.odometry._slip
    made.cycle(0, 0)
    assert speeds(made) == (-0.02, 0.02)


def test_wheels_that_disagree_with_the_ground_are_no_evidence_of_it() -> None:
    made = going()
    made.over_ground(20.0, 21.0)

    assert made.moved(8, 8) == near(0.5 * (20.0 + 19.94) * CYCLE_S, 0.5 * (21.0 + 21.06) * CYCLE_S)


def test_a_train_that_stands_does_not_move_and_is_no_faster_than_two_centimetres_a_second() -> None:
    made = Desk()
    made.cycles(14, 0, 0)
    made.over_ground(-0.2, 0.2)

    assert made.moved(0, 0) == (0.0, 0.0)
    assert speeds(made) == (-0.02, 0.02)
    made.over_ground(-0.01, 0.01)
    assert made.moved(tacho_age_s=0.151) == near(-0.04 * 0.04, 0.04 * 0.04)
    assert speeds(made) == near(-0.07, 0.07)


# Wheels that stand while the train sets off.

EASING = BrakeStatus(
    applied_decel_mps2=0.6,
    cylinder_pressure_kpa=150.0,
    emergency_applied=True,
    holding_applied=False,
    released=False,
    ready=True,
)
HOLDING = replace(EASING, holding_applied=True)
PULLED = near(-0.02 + 0.75 * CYCLE_S, 0.02 + 1.25 * CYCLE_S)
"""Bounds after a cycle at 1 ± 0.25 m/s² from rest, with 2 cm/s to either side."""
PULLED_M = near(CYCLE_S * (-0.02 + 0.375 * CYCLE_S), CYCLE_S * (0.02 + 0.625 * CYCLE_S))


def stood(**changes: Any) -> Any:
    """An odometer of a train that stood for 0.56 s; its last cycle already measured 1 m/s², so
    this no longer changes."""
    made = Desk(**changes)
    made.cycles(14, 0, 0)
    made.cycle(0, 0, felt_mps2=1.0, brake=HOLDING)
    return made


@pytest.mark.parametrize("brake", [None, EASING, replace(EASING, released=True)])
def test_still_wheels_do_not_prove_rest_while_the_accelerometer_shows_motion(brake: Any) -> None:
    """No brake holds the train; a brake that eases off proves nothing."""
    made = stood()

    assert made.moved(0, 0, felt_mps2=1.0, brake=brake) == PULLED_M
    assert speeds(made) == PULLED


def test_just_stopped_wheels_do_not_prove_rest_while_the_accelerometer_shows_motion() -> None:
    measured = stood()
    measured.cycle(0, 0, felt_mps2=1.0, brake=HOLDING)
    made = stood(standing_s=measured.track.still_s)
    made.over_ground(-0.02, 0.02)
    made.cycle(0, 0, felt_mps2=1.0, brake=EASING)

    assert made.track.still_s == measured.track.still_s
    assert speeds(made) == PULLED


def test_still_wheels_do_not_narrow_wide_bounds_while_the_accelerometer_shows_motion() -> None:
    made = stood()
    made.over_ground(-0.4, 0.4)

    assert made.moved(0, 0, felt_mps2=1.0, brake=EASING) == near(
        CYCLE_S * (-0.4 + 0.375 * CYCLE_S), CYCLE_S * (0.4 + 0.625 * CYCLE_S)
    )
    assert speeds(made) == near(-0.4 + 0.75 * CYCLE_S, 0.4 + 1.25 * CYCLE_S)


def test_a_held_train_stands_whatever_the_accelerometer_shows() -> None:
    made = stood()

    assert made.moved(0, 0, felt_mps2=1.0, brake=HOLDING) == (0.0, 0.0)
    assert speeds(made) == (-0.02, 0.02)


@pytest.mark.parametrize(("age_s", "holds"), [(0.15, True), (0.151, False)])
def test_an_old_brake_report_does_not_prove_holding(age_s: float, holds: bool) -> None:
    made = stood()
    made.cycle(0, 0, felt_mps2=1.0, brake=HOLDING, brake_age_s=age_s)

    assert speeds(made) == ((-0.02, 0.02) if holds else PULLED)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("felt_mps2", "stands"), [(0.25, True), (0.26, False), (0.0, True)])
def test_still_wheels_prove_rest_while_the_accelerometer_does_not_exclude_it(
    felt_mps2: float, sign: float, stands: bool
) -> None:
    """The accelerometer may err by 0.25 m/s²."""
    made = Desk()
    made.cycles(14, 0, 0)
    made.cycles(2, 0, 0, felt_mps2=sign * felt_mps2, brake=HOLDING)
    made.cycle(0, 0, felt_mps2=sign * felt_mps2, brake=EASING)

    assert (speeds(made) == (-0.02, 0.02)) is stands


def test_a_train_with_a_wrong_accelerometer_stands_again_once_it_is_held() -> None:
    made = stood()
    made.cycles(5, 0, 0, felt_mps2=1.0, brake=EASING)
    assert speeds(made) != (-0.02, 0.02)

    made.cycle(0, 0, felt_mps2=1.0, brake=HOLDING)

    assert speeds(made) == (-0.02, 0.02)


def test_wheels_that_stopped_a_moment_ago_count_as_slow_wheels() -> None:
    """Such wheels do not count as standing yet and measure the distance like slow wheels: none."""
    made = Desk()
    made.cycles(11, 0, 0, felt_mps2=1.0, brake=EASING)
    made.over_ground(-0.1, 0.1)

    assert made.moved(0, 0, felt_mps2=1.0, brake=EASING) == near(0.0, 0.0)
    assert 0.4 < made.track.still_s < 0.5


@pytest.mark.parametrize(
    ("low_mps", "high_mps", "told"),
    [
        (-5.0, 12.0, (True, True)),
        (3.0, 9.0, (True, True)),
        (3.96, 9.0, (False, True)),
        (-1.0, 4.04, (True, False)),
    ],
)
def test_bounds_that_are_too_wide_are_narrowed_to_the_wheels_and_their_slip(
    low_mps: float, high_mps: float, told: tuple[bool, bool]
) -> None:
    made = going()
    made.over_ground(low_mps, high_mps)
    made.cycle(dt_s=0.0)
    low, best, high = made.wheels()
    assert low > 3.6
    assert high < 4.4
    wheels_mps = (low - 0.08 * best, high + 0.08 * best)

    assert speeds(made) == near(
        wheels_mps[0] if told[0] else low_mps, wheels_mps[1] if told[1] else high_mps
    )


def test_bounds_are_too_wide_beyond_three_tenths_and_the_slip_on_either_side() -> None:
    """At half a metre per second, the test takes exactly this width and the next larger float."""
    measured = going(1)
    measured.cycle(dt_s=0.0)
    low, best, _ = measured.wheels()
    assert best == pytest.approx(0.5, abs=0.01)
    width_mps = 2.0 * (0.3 + 0.08 * best)
    for high_mps, narrowed in ((width_mps, False), (math.nextafter(width_mps, 9.0), True)):
        made = going(1)
        made.over_ground(0.0, high_mps)
        made.cycle(dt_s=0.0)

        expected = (low - 0.08 * best) if narrowed else 0.0
        assert made.ground.low_mps == pytest.approx(max(0.0, expected), abs=1e-9)
        assert (speeds(made) == (0.0, high_mps)) is not narrowed


def test_bounds_beyond_those_of_the_wheels_stay_while_not_too_wide() -> None:
    made = going()
    made.over_ground(3.0, 3.9)
    made.cycle(dt_s=0.0)
    assert speeds(made) == (3.0, 3.9)
    made.over_ground(4.1, 5.0)
    made.cycle(dt_s=0.0)
    assert speeds(made) == (4.1, 5.0)


def test_an_old_tacho_sample_narrows_nothing() -> None:
    made = going()
    made.over_ground(-5.0, 12.0)
    made.cycle(dt_s=0.0, tacho_age_s=0.151)

    assert speeds(made) == (-5.0, 12.0)


# Gaps, and the way in sum.


@pytest.mark.parametrize("step", [8, -8])
def test_during_a_gap_between_cycles_the_train_may_have_stood(step: int) -> None:
    """The speed is 4 m/s ± 0.02 m/s, extrapolated back by a quarter of a second at 1.5 m/s²."""
    made = going(step)
    low_m, high_m = made.moved(step, dt_s=0.5, radar_mps=step * 0.5)

    most_m = (4.02 + 1.5 * 0.25) * 0.5
    assert (low_m, high_m) == (near(0.0, most_m) if step > 0 else near(-most_m, 0.0))


def test_during_a_gap_a_train_of_unknown_direction_may_be_anywhere_between() -> None:
    made = going()
    made.over_ground(-3.0, 3.5)

    assert made.moved(dt_s=0.5, tacho_age_s=9.0) == near(
        0.5 * (-3.0 - 3.75) * 0.5, 0.5 * (3.5 + 4.25) * 0.5
    )


def test_a_slow_controller_has_no_gaps_between_its_cycles() -> None:
    made = Desk()
    made.cycles(6, 40, 40, cycle_s=0.2, dt_s=0.2, apart_s=0.1, radar_mps=4.0)

    assert made.moved(40, 40, cycle_s=0.2, dt_s=0.2, apart_s=0.1, radar_mps=4.0)[0] > 0.7


def test_the_first_cycle_time_counts() -> None:
    """0.25 s is no gap for a controller that began with cycles of 0.2 s."""
    made = Desk()
    made.cycle(0, cycle_s=0.2, radar_mps=4.0)

    assert made.moved(50, dt_s=0.25, cycle_s=0.05, radar_mps=4.0)[0] > 0.9


def test_the_distance_over_ground_accumulates_with_half_its_width() -> None:
    made = going()
    way_m, blur_m = made.odometry._over_m, made.odometry._over_blur_m
    for cycle in range(1, 4):
        made.cycle(8, 8, radar_mps=4.0)

        assert made.odometry._over_m - way_m == pytest.approx(cycle * 0.16)
        assert made.odometry._over_blur_m - blur_m == pytest.approx(cycle * 0.05 * CYCLE_S)


# Both agree.


def test_wheels_agree_with_the_ground_while_their_bounds_touch() -> None:
    for beyond, slip in ((False, False), (True, True)):
        fast, slow = going(), going()
        low, _, high = fast.wheels()
        over = math.nextafter(high, 99.0) if beyond else high
        under = math.nextafter(low, -99.0) if beyond else low
        fast.over_ground(over, over + 0.1)
        slow.over_ground(under - 0.1, under)

        assert fast.cycle(dt_s=0.0).slip is slip
        assert slow.cycle(dt_s=0.0).slip is slip
