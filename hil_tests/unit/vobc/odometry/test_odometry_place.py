"""The two intervals of the position by hand calculation, and the best estimate against a matrix
filter."""

import math
from dataclasses import replace

import numpy as np
import pytest

from vobc.config import load_config
from vobc.odometry.localisation import REACH_PLAY_M, Localisation
from vobc.odometry.scale import Waypoint
from vobc.vocabulary import Interval, OdometryRecord

BASE = load_config("florence4")
CONFIG = replace(
    BASE.odometry,
    scale_error_low_ratio=-0.01,
    scale_error_high_ratio=0.05,
    scale_sigma_ratio=0.02,
    scale_margin_ratio=0.002,
    scale_base_m=20.0,
    creep_sigma_m_per_sqrt_m=0.05,
    tag_sigma_m=0.03,
    ground_slack_m=0.04,
)
TRAIN = replace(
    BASE.train, wheel_diameter_m=2.56 / math.pi, pulses_per_turn=256, antenna_offset_m=2.0
)
LEAST_M, MOST_M = 0.01 / 1.05, 0.01 / 0.99
START_M, BOUND_M = 100.0, 0.5


def place(bound_m: float = BOUND_M, m_per_pulse: float = 0.01) -> Localisation:
    return Localisation(CONFIG, TRAIN, OdometryRecord(START_M, bound_m, m_per_pulse))


def put(low_m: float, high_m: float, ground_low_m: float, ground_high_m: float) -> Localisation:
    made = place()
    made.low_m, made.high_m = low_m, high_m
    made.ground_low_m, made.ground_high_m = ground_low_m, ground_high_m
    return made


def wheels_m(where: Localisation) -> tuple[float, float]:
    return where.low_m, where.high_m


def ground_m(where: Localisation) -> tuple[float, float]:
    return where.ground_low_m, where.ground_high_m


def near(low_m: float, high_m: float) -> tuple[object, object]:
    return pytest.approx(low_m, abs=1e-9), pytest.approx(high_m, abs=1e-9)


def test_at_the_start_the_place_is_known_to_its_bound_and_one_pulse() -> None:
    where = place()

    assert (where.at_m, where.m_per_pulse, where.pulses) == (START_M, pytest.approx(0.01), 0)
    assert wheels_m(where) == near(99.5 - MOST_M, 100.5 + MOST_M)
    assert ground_m(where) == near(99.46 - MOST_M, 100.54 + MOST_M)
    assert place(m_per_pulse=1.0).m_per_pulse == pytest.approx(MOST_M)


def test_the_wheel_is_measured_from_the_start_on() -> None:
    """The antenna stood at 98 m, known within half a metre and a pulse."""
    where = place()
    where.measure(Waypoint(2098.0, 0.07, 200_000, 2000.0, 0.0))

    assert where.scale.low_m == pytest.approx((2000.0 - 0.57 - MOST_M) / 200_001 * 0.998, rel=1e-9)
    assert where.scale.high_m == pytest.approx((2000.0 + 0.57 + MOST_M) / 199_999 * 1.002, rel=1e-9)


@pytest.mark.parametrize("forgets", ["stretch", "follow_ground", "restart", "widen"])
def test_distance_run_with_slip_measures_no_wheel(forgets: str) -> None:
    where = place()
    if forgets == "widen":
        where.widen(0.1)
    else:
        getattr(where, forgets)(0.1, 0.1)
    where.measure(Waypoint(148.0, 0.07, 5000, 50.0, 0.0))

    assert (where.scale.low_m, where.scale.high_m) == near(LEAST_M, MOST_M)


def test_the_best_wheel_estimate_stays_within_the_measured_bounds() -> None:
    where = place(m_per_pulse=0.0097)
    where.measure(Waypoint(148.0, 0.07, 5000, 50.0, 0.0))

    assert where.m_per_pulse == where.scale.low_m > 0.0097


def test_pulses_move_the_interval_by_the_least_and_the_most_that_they_stand_for() -> None:
    where = place()
    low_m, high_m = wheels_m(where)
    where.advance(1)
    assert wheels_m(where) == near(low_m + LEAST_M, high_m + MOST_M)
    where.advance(299)
    assert wheels_m(where) == near(low_m + 300 * LEAST_M, high_m + 300 * MOST_M)
    assert where.pulses == 300
    where.advance(-100)
    assert wheels_m(where) == near(
        low_m + 300 * LEAST_M - 100 * MOST_M, high_m + 300 * MOST_M - 100 * LEAST_M
    )
    assert where.pulses == 200
    assert ground_m(where) == near(99.46 - MOST_M, 100.54 + MOST_M)


def test_the_way_over_ground_moves_the_other_interval() -> None:
    where = put(10.0, 20.0, 11.0, 21.0)
    where.move_over_ground(1.5, 2.5, 0.1, steady=True)

    assert wheels_m(where) == (10.0, 20.0)
    assert ground_m(where) == (12.5, 23.5)


def test_the_distance_over_ground_is_known_for_a_while_unless_a_gap_breaks_it() -> None:
    where = put(10.0, 20.0, 11.0, 21.0)
    assert where.lately_m(0.0) is None
    where.move_over_ground(1.5, 2.5, 0.1, steady=True)
    where.move_over_ground(0.5, 1.0, 0.1, steady=True)
    way_m = where.lately_m(0.15)
    assert way_m is not None
    assert way_m == near(1.25 - 0.5 * 1.7 * 0.05 * 0.05, 2.25 + 0.5 * 1.7 * 0.05 * 0.05)
    where.stretch(1.0, 1.0)
    assert where.lately_m(0.15) == way_m
    where.widen(0.5)
    assert where.lately_m(0.0) is None
    where.move_over_ground(1.5, 2.5, 0.1, steady=True)
    where.move_over_ground(0.0, 2.5, 0.1, steady=False)
    assert where.lately_m(0.0) is None
    assert ground_m(where) == near(11.0 + 1.5 + 0.5 - 0.5 + 1.5, 21.0 + 2.5 + 1.0 + 0.5 + 2.5 + 2.5)


def test_doubtful_wheels_widen_their_own_interval_and_a_doubtful_motion_both() -> None:
    where = put(10.0, 20.0, 11.0, 21.0)
    where.stretch(1.0, 2.0)
    assert wheels_m(where) == (9.0, 22.0)
    assert ground_m(where) == (11.0, 21.0)
    where.widen(0.5)
    assert wheels_m(where) == (8.5, 22.5)
    assert ground_m(where) == (10.5, 21.5)


@pytest.mark.parametrize(
    ("low_mps", "high_mps", "window"),
    [(2.0, 4.0, (9.0, 21.0)), (-4.0, -2.0, (11.0, 23.0)), (-2.0, 4.0, (9.0, 22.0))],
)
def test_the_ground_position_at_the_last_sample_excludes_the_motion_since(
    low_mps: float, high_mps: float, window: tuple[float, float]
) -> None:
    """The front is at 11 to 21 m now, half a second after the sample; the train may have stood
    for part of it."""
    where = put(15.0, 16.0, 11.0, 21.0)
    assert where.windows(low_mps, high_mps, 0.5).ground_m == window
    assert wheels_m(where) == (15.0, 16.0)
    where.trust_ground(low_mps, high_mps, 0.5)
    assert wheels_m(where) == window
    assert ground_m(where) == (11.0, 21.0)


def test_the_window_of_a_tag_includes_the_position_by_the_wheels() -> None:
    assert put(1.0, 31.0, 11.0, 21.0).windows(-1.0, 1.0, 0.5).whole_m == (1.0, 31.0)


@pytest.mark.parametrize(
    ("bounds_m", "restarts", "wheels", "ground"),
    [
        # Reference: the wheels give 102.4 to 104.6 m, the ground 102.26 to 105.74 m.
        ((90.0, 120.0, 90.0, 120.0), False, (102.4, 104.6), (102.26, 105.74)),
        ((103.0, 120.0, 103.0, 120.0), False, (102.4, 104.6), (102.26, 105.74)),
        ((102.5, 104.6, 102.3, 105.7), False, (102.5, 104.6), (102.3, 105.7)),
        ((102.5, 104.8, 102.3, 105.9), False, (102.4, 104.6), (102.26, 105.74)),
        ((103.0, 104.0, 103.0, 104.0), True, (102.4, 104.6), (102.26, 105.74)),
        ((90.0, 102.3, 90.0, 102.2), False, (102.4, 104.6), (102.26, 105.74)),
        ((104.7, 110.0, 105.8, 110.0), False, (102.4, 104.6), (102.26, 105.74)),
    ],
)
def test_a_reference_narrows_or_replaces_each_interval(
    bounds_m: tuple[float, float, float, float],
    *,
    restarts: bool,
    wheels: tuple[float, float],
    ground: tuple[float, float],
) -> None:
    where = put(*bounds_m)
    where.refer(100.0, (2.5, 3.0, 4.5), (2.4, 5.6), 0.1, restarts=restarts)

    assert wheels_m(where) == near(*wheels)
    assert ground_m(where) == near(*ground)


def test_an_interval_as_wide_as_the_reference_stays() -> None:
    """The bounds are exact in binary: the reference is 2.25 m wide, and 2.5 m over ground."""
    record = OdometryRecord(START_M, BOUND_M, 0.01)
    where = Localisation(replace(CONFIG, ground_slack_m=0.125), TRAIN, record)
    where.low_m, where.high_m = 102.0, 104.25
    where.ground_low_m, where.ground_high_m = 102.0, 104.5
    where.refer(100.0, (2.5, 3.0, 4.5), (2.5, 4.5), 0.125, restarts=False)

    assert wheels_m(where) == (102.0, 104.25)
    assert ground_m(where) == (102.0, 104.5)


def test_a_tag_that_contradicts_the_intervals_widens_both() -> None:
    """The tag places the front at 102.4 to 104.6 m by the wheels, and 102.26 to 105.74 m by the
    ground."""
    ahead, behind = put(90.0, 101.0, 91.0, 101.5), put(106.0, 120.0, 107.0, 121.0)
    for where in (ahead, behind):
        where.embrace(100.0, (2.5, 3.0, 4.5), (2.4, 5.6), 0.1)

    assert (wheels_m(ahead), ground_m(ahead)) == (near(90.0, 104.6), near(91.0, 105.74))
    assert (wheels_m(behind), ground_m(behind)) == (near(102.4, 120.0), near(102.26, 121.0))


@pytest.mark.parametrize(
    ("bounds_m", "wheels", "ground"),
    [
        # Half a second after the sample the wheels give 1 m more at either end, the ground 0.5 m.
        ((10.0, 20.0, 12.0, 18.0), (10.0, 20.0), (9.0, 21.0)),
        ((14.0, 16.0, 10.0, 20.0), (9.5, 20.5), (10.0, 20.0)),
    ],
)
def test_after_slip_both_intervals_hold_what_either_held(
    bounds_m: tuple[float, float, float, float],
    wheels: tuple[float, float],
    ground: tuple[float, float],
) -> None:
    where = put(*bounds_m)
    where.reconcile(Interval(-2.0, 0.0, 2.0), Interval(-1.0, 0.0, 1.0), 0.5)

    assert wheels_m(where) == pytest.approx(wheels, abs=0.01)
    assert ground_m(where) == pytest.approx(ground, abs=0.01)


def reported(
    where: Localisation, low: float, best: float, high: float
) -> tuple[float, float, float]:
    front = where.never_narrower(low, best, high)
    return front.low, front.best, front.high


def test_the_reported_interval_never_narrows_between_two_references() -> None:
    """The interval was 10 m wide, reaching 5 m to either end. It keeps both, around the same
    best estimate."""
    where = place()
    assert reported(where, 14.9, 15.0, 15.1) == (14.9, 15.0, 15.1)
    assert reported(where, 10.0, 15.0, 20.0) == (10.0, 15.0, 20.0)
    assert reported(where, 13.0, 16.0, 19.0) == pytest.approx((10.025, 16.0, 20.025))
    assert reported(where, 9.0, 15.0, 21.0) == (9.0, 15.0, 21.0)
    assert reported(where, 10.0, 15.0, 20.0) == pytest.approx((8.525, 15.0, 20.525))
    where.refer(100.0, (0.0, 0.0, 0.0), (0.0, 0.0), 1.0, restarts=True)
    assert reported(where, 14.9, 15.0, 15.1) == (14.9, 15.0, 15.1)


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_the_further_end_keeps_its_distance_from_the_best_estimate_within_the_play(
    ahead: float,
) -> None:
    """The estimate moved by 3 m within 10 m. The further end is now 8 m away, and then 7 m
    again."""
    where = place()
    reported(where, -5.0, ahead * 3.0, 5.0)
    low, best, high = reported(where, -5.0, ahead * 2.0, 5.0)
    reach_m = 8.0 - REACH_PLAY_M

    assert best == ahead * 2.0
    assert max(best - low, high - best) == pytest.approx(reach_m)
    assert (high if ahead > 0 else low) == ahead * 5.0
    assert reported(where, -5.0, ahead * 2.96, 5.0)[1] == ahead * 2.96


def test_a_central_best_estimate_moves_backwards() -> None:
    where = place()
    reported(where, 0.0, 8.0, 10.0)
    low, best, high = reported(where, 3.0, 8.0, 13.0)

    assert (best, high) == (8.0, 13.0)
    assert low == pytest.approx(8.0 - (8.0 - REACH_PLAY_M))


def test_within_the_play_the_reported_interval_is_the_known_one() -> None:
    where = place()
    reported(where, 0.0, 6.0, 10.0)

    assert reported(where, 0.0, 5.96, 10.0) == (0.0, 5.96, 10.0)
    low, _, high = reported(where, 0.0, 5.94, 10.0)
    assert (low, high) == pytest.approx((-0.01, 10.0))


def test_both_ends_keep_the_reported_width() -> None:
    where = place()
    reported(where, 0.0, 5.0, 10.0)
    reported(where, 0.0, 9.0, 9.98)
    low, best, high = reported(where, 1.0, 9.0, 9.99)

    assert best == 9.0
    assert high - low >= 10.0 - 1e-12
    assert best - low >= 9.0 - REACH_PLAY_M - 0.02


class Oracle:
    """A textbook Kalman filter over position and metres per pulse, with matrices."""

    def __init__(self, bound_m: float) -> None:
        self.state = np.array([START_M, 0.01])
        self.spread = np.diag([(bound_m / 2.0) ** 2, (0.01 * 0.02) ** 2])

    def wheels(self, pulses: int) -> None:
        step = np.array([[1.0, pulses], [0.0, 1.0]])
        moved_m = abs(pulses * self.state[1])
        self.state = step @ self.state
        self.spread = step @ self.spread @ step.T + np.diag([0.05**2 * moved_m, 0.0])

    def ground(self, likely_m: float, spread_m: float) -> None:
        self.state[0] += likely_m
        self.spread[0, 0] += 0.05**2 * abs(likely_m) + spread_m**2

    def tag(self, front_m: float, pulses_since: float, latch_m: float) -> None:
        seen = np.array([1.0, -pulses_since])
        noise = 0.03**2 + MOST_M**2 / 12.0 + latch_m**2 / 3.0
        gain = self.spread @ seen / (seen @ self.spread @ seen + noise)
        self.state = self.state + gain * (front_m - seen @ self.state)
        self.spread = self.spread - np.outer(gain, seen @ self.spread)


def assert_alike(where: Localisation, oracle: Oracle) -> None:
    assert (where.at_m, where.m_per_pulse) == pytest.approx(tuple(oracle.state), rel=1e-12)


def test_the_best_estimate_equals_a_filter_over_position_and_wheel() -> None:
    where, oracle = place(bound_m=60.0), Oracle(60.0)

    for pulses, tag_m, since, latch_m in (
        (3000, 131.0, 40.0, 0.05), (2000, 150.4, 25.0, 0.2), (-500, 145.3, -10.0, 0.1)
    ):  # fmt: skip
        where.follow_wheels(pulses)
        oracle.wheels(pulses)
        assert_alike(where, oracle)
        where.correct(tag_m, since, latch_m)
        oracle.tag(tag_m, since, latch_m)
        assert_alike(where, oracle)
    assert where.m_per_pulse != 0.01


def test_the_best_estimate_over_ground_after_widening_and_for_another_wheel() -> None:
    """Each of these makes the filter less certain, as the next tag shows."""
    where, oracle = place(bound_m=60.0), Oracle(60.0)
    for each in (where.follow_wheels, oracle.wheels):
        each(3000)
    where.correct(130.5, 0.0, 0.0)
    oracle.tag(130.5, 0.0, 0.0)

    where.follow_ground(-4.0, 0.5)
    oracle.ground(-4.0, 0.5)
    where.follow_wheels(200)
    oracle.wheels(200)
    where.correct(128.2, 20.0, 0.1)
    oracle.tag(128.2, 20.0, 0.1)
    assert_alike(where, oracle)

    where.stretch(0.1, 0.3)
    oracle.spread[0, 0] += 0.4**2
    where.forget_scale()
    oracle.spread[1, 1] += (MOST_M * 0.02) ** 2
    where.follow_wheels(900)
    oracle.wheels(900)
    where.correct(137.0, 5.0, 0.3)
    oracle.tag(137.0, 5.0, 0.3)
    assert_alike(where, oracle)


def test_a_recovered_position_keeps_only_the_wheel_estimate() -> None:
    where, oracle = place(bound_m=5000.0), Oracle(5000.0)
    for each in (where.follow_wheels, oracle.wheels):
        each(3000)
    where.restart(1000.0, 0.7)
    oracle.state[0] = 1000.0
    oracle.spread[0, 0] = 0.7**2
    oracle.spread[0, 1] = oracle.spread[1, 0] = 0.0
    where.correct(1000.4, 15.0, 0.1)
    oracle.tag(1000.4, 15.0, 0.1)

    assert_alike(where, oracle)


def test_the_measurement_of_one_wheel_does_not_apply_to_another() -> None:
    where = place()
    where.measure(Waypoint(148.0, 0.07, 5000, 50.0, 0.0))
    where.forget_scale()

    assert (where.scale.low_m, where.scale.high_m) == near(LEAST_M, MOST_M)


@pytest.mark.parametrize(
    ("tag_m", "bounds_m", "at_m"),
    [
        (140.0, (90.0, 101.0, 90.0, 102.0), 102.0),
        (140.0, (90.0, 102.0, 90.0, 101.0), 102.0),
        (60.0, (98.0, 110.0, 99.0, 110.0), 98.0),
        (60.0, (99.0, 110.0, 98.0, 110.0), 98.0),
    ],
)
def test_the_best_estimate_never_leaves_the_intervals(
    tag_m: float, bounds_m: tuple[float, float, float, float], at_m: float
) -> None:
    where = put(*bounds_m)
    where.correct(tag_m, 0.0, 0.0)

    assert where.at_m == at_m


def test_the_best_wheel_estimate_stays_within_the_declared_bounds() -> None:
    where = place(bound_m=60.0)
    where.follow_wheels(3000)
    where.correct(120.0, 0.0, 0.0)
    where.follow_wheels(3000)
    where.correct(190.0, 0.0, 0.0)

    assert LEAST_M <= where.m_per_pulse <= where.scale.high_m
    assert where.m_per_pulse == pytest.approx(MOST_M)
