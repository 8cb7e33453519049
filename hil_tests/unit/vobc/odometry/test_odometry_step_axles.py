"""One of two axles slips and no radar sees the ground: what the wheels still prove."""

import pytest

from hil_tests.unit.vobc.odometry.odometry_desk import CONFIG, Desk, near
from vobc.vocabulary import Interval


def braking() -> Desk:
    """An odometer below 4 m/s whose axle B slipped by 10 pulses while the radar saw the ground."""
    made = Desk()
    made.cycles(60, 8, 8, radar_mps=4.0)
    made.cycle(8, 8, steps_b=(8, 18), radar_mps=4.0)
    for radar_mps in (3.95, 3.9, 3.85):
        made.cycle(8, 7, radar_mps=radar_mps)
    assert made.ground.seen
    return made


def test_wheels_that_contradicted_the_ground_count_again_a_second_later() -> None:
    """The train stands, but its ground speed was wrong. It widens until it holds the wheels' 0."""
    made = Desk()
    made.cycles(30, 0, 0, radar_mps=0.0)
    made.over_ground(2.0, 2.1)
    while made.cycle(0, 0).slip:
        assert made.ground.high_mps > 2.1

    assert made.odometry._time.now_s - made.odometry._against_s == pytest.approx(1.0)
    assert (made.ground.low_mps, made.ground.high_mps) == (-0.02, 0.02)


@pytest.mark.parametrize(
    ("accel_mps2", "paired", "out", "against_s", "slips"),
    [
        (0.0, True, False, 1.0, True),
        (-2.0, True, False, 1.0, True),
        (CONFIG.gentle_mps2, True, False, 1.0, True),
        (CONFIG.gentle_mps2 + 1e-9, True, False, 1.0, False),
        (0.0, False, False, 1.0, False),
        (0.0, True, True, 1.0, False),
        (0.0, True, False, 0.999, False),
    ],
)
def test_one_axle_slips_if_both_count_and_agreed_with_the_ground_for_a_second(
    accel_mps2: float, paired: bool, out: bool, against_s: float, slips: bool
) -> None:
    odometry = Desk().odometry
    odometry._time.now_s, odometry._against_s = 5.0, 5.0 - against_s
    odometry._track.accel_pulses_per_s2 = accel_mps2 / odometry._where.m_per_pulse
    odometry._pulses.paired, odometry._wheels_out = paired, out

    assert odometry._one_axle_slips() is slips


def test_the_distance_over_ground_covers_the_axle_that_leads_since_the_radar_fell_silent() -> None:
    made = braking()
    low_m, high_m = made.moved(7, 7)
    best_mps = made.wheels()[1]

    assert made.odometry._slip
    assert (low_m, high_m) == near(0.6 * best_mps * 0.04, 1.4 * best_mps * 0.04)
    low_m, high_m = made.moved(7, 7, steps_b=(7, 9))
    best_mps = made.wheels()[1]
    # Each of the two further pulses is 1 cm long, and 40 % longer on a slipping wheel.
    assert (low_m, high_m) == near(0.6 * best_mps * 0.04, 1.4 * best_mps * 0.04 + 0.028)


def test_the_first_difference_of_the_axles_already_widens_the_distance_over_ground() -> None:
    made = Desk()
    made.cycles(60, 8, 8, radar_mps=4.0)
    made.cycles(3, 7, 7, radar_mps=3.5)
    low_m, high_m = made.moved(7, 7, steps_b=(7, 17))
    best_mps = made.wheels()[1]

    assert (low_m, high_m) == near(0.6 * best_mps * 0.04, 1.4 * best_mps * 0.04 + 0.14)


def test_above_the_speed_that_a_radar_must_see_slipping_wheels_narrow_nothing() -> None:
    made = Desk()
    made.cycles(60, 12, 12, radar_mps=6.0)
    made.cycles(3, 11, 11, radar_mps=5.5)
    moved_m = made.moved(11, 11, steps_b=(11, 21))

    assert made.odometry._one_axle_slips()
    assert moved_m == near(made.ground.moved_low_m, made.ground.moved_high_m)


@pytest.mark.parametrize(
    ("low_mps", "high_mps", "best_mps"), [(3.0, 4.0, 3.5), (3.75, 4.0, 3.75), (3.0, 3.25, 3.25)]
)
def test_the_likeliest_speed_is_that_of_the_wheels_inside_the_bounds_over_ground(
    low_mps: float, high_mps: float, best_mps: float
) -> None:
    made = braking()
    made.over_ground(low_mps, high_mps)

    assert made.odometry._slip
    assert made.odometry._one_axle_slips()
    assert made.odometry._speed(Interval(3.25, 3.5, 3.75)).best == best_mps


@pytest.mark.parametrize(("accel_pulses_per_s2", "best_mps"), [(0.0, 3.5), (1e-9, 3.55)])
def test_a_train_that_accelerates_is_likeliest_as_fast_as_the_ground_says(
    accel_pulses_per_s2: float, best_mps: float
) -> None:
    """At a departure the axles swing with the couplers."""
    made = braking()
    made.over_ground(3.3, 3.8)
    made.track.accel_pulses_per_s2 = accel_pulses_per_s2

    assert made.odometry._slip
    assert made.odometry._one_axle_slips()
    assert made.odometry._speed(Interval(3.25, 3.5, 3.75)).best == pytest.approx(best_mps)
