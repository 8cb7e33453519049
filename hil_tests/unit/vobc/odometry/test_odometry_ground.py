"""Speed over ground by hand calculation: the errors of radar and accelerometer in both
directions."""

import math
from dataclasses import replace

import pytest

from can_dbc.odometer import Doppler
from firmware_py.trackdb import GradientSection, LineMap, SpeedSection, Station
from hil_tests.unit.vobc.atp.heard_rig import SILENCE
from vobc.config import load_config
from vobc.odometry.ground import FIRST_CAR_M, Gradients, GroundSpeed, believable_mps
from vobc.vocabulary import NEVER_S

CONFIG = replace(
    load_config("florence4").odometry,
    max_accel_mps2=2.0,
    max_speed_mps=40.0,
    imu_error_mps2=0.25,
    doppler_error_mps=0.5,
    doppler_error_ratio=0.01,
    doppler_mean_mps=0.0625,
    doppler_mean_ratio=0.005,
    doppler_quality_percent=50.0,
    doppler_age_s=0.15,
)
STATION = Station("A", 0.0, -80.0, 5.0)


def line(*climbs: tuple[float, float, float]) -> LineMap:
    sections = tuple(GradientSection(*climb) for climb in climbs)
    return LineMap(
        "climbs", -500.0, 3000.0, (STATION,), (SpeedSection(-500.0, 3000.0, 20.0),),
        gradients=sections,
    )  # fmt: skip


FLAT = Gradients(line())


def ground(low_mps: float, high_mps: float, felt_mps2: float | None = None) -> GroundSpeed:
    made = GroundSpeed(CONFIG)
    made.begin(low_mps, high_mps)
    made.feel(felt_mps2, FLAT)
    return made


def speed_mps(made: GroundSpeed) -> tuple[float, float]:
    return made.low_mps, made.high_mps


def moved_m(made: GroundSpeed) -> tuple[float, float]:
    return made.moved_low_m, made.moved_high_m


def near(low: float, high: float) -> tuple[object, object]:
    return pytest.approx(low, abs=1e-9), pytest.approx(high, abs=1e-9)


# Radar.


@pytest.mark.parametrize(
    ("quality", "healthy", "age_s", "believed"),
    [
        (50.0, True, 0.15, True),
        (49.9, True, 0.15, False),
        (50.0, False, 0.15, False),
        (50.0, True, 0.151, False),
    ],
)
def test_a_radar_reading_counts_while_it_is_healthy_certain_and_fresh(
    quality: float, *, healthy: bool, age_s: float, believed: bool
) -> None:
    radar = Doppler(7.5, quality, healthy)
    seen = replace(SILENCE, doppler=radar, doppler_age_s=age_s)

    assert believable_mps(seen, CONFIG) == (7.5 if believed else None)
    assert believable_mps(SILENCE, CONFIG) is None


# Gradients.

CLIMBS = ((150.0, 300.0, 30.0), (300.0, 420.0, -25.0), (600.0, 610.0, 12.0))


def felt_mps2(low_m: float, high_m: float) -> tuple[float, float]:
    """Gravity that the accelerometer may feel.

    The range reaches from 25 m behind the rearmost front to the foremost front, including both
    sides of each gradient edge.
    """
    edges_m = [edge_m for start_m, end_m, _ in CLIMBS for edge_m in (start_m, end_m)]
    beside_m = [edge_m + aside_m for edge_m in edges_m for aside_m in (-1e-6, 1e-6)]
    places_m = [low_m - 25.0, high_m, *(m for m in beside_m if low_m - 25.0 < m < high_m)]
    permille = [
        value
        for at_m in places_m
        for value in [c for a, b, c in CLIMBS if a <= at_m < b] or [0.0]
    ]  # fmt: skip
    return 9.81 * min(permille) / 1000.0, 9.81 * max(permille) / 1000.0


@pytest.mark.parametrize("width_m", [0.05, 3.05, 60.05, 300.05])
def test_the_accelerometer_may_feel_any_gradient_under_the_first_car(width_m: float) -> None:
    """A fresh lookup gives the exact range; a cached one may be wider, never narrower."""
    kept = Gradients(line(*CLIMBS))
    places_m = [7.03 * n for n in range(100)] + [700.0 - 13.07 * n for n in range(55)]
    for low_m in places_m:
        kept.look(low_m, low_m + width_m)
        fresh = Gradients(line(*CLIMBS))
        fresh.look(low_m, low_m + width_m)

        lowest, highest = felt_mps2(low_m, low_m + width_m)
        assert (fresh.lowest_mps2, fresh.highest_mps2) == near(lowest, highest)
        assert kept.lowest_mps2 <= lowest + 1e-9
        assert kept.highest_mps2 >= highest - 1e-9


@pytest.mark.parametrize(
    ("low_m", "high_m", "highest_permille"),
    [
        (10.0, 99.9, 0.0),
        (10.0, 100.0, 20.0),
        (200.0 + FIRST_CAR_M, 300.0, 20.0),
        (200.1 + FIRST_CAR_M, 300.0, 0.0),
    ],
)
def test_a_gradient_counts_from_its_very_start_to_its_very_end(
    low_m: float, high_m: float, highest_permille: float
) -> None:
    climb = Gradients(line((100.0, 200.0, 20.0)))
    climb.look(low_m, high_m)

    assert climb.lowest_mps2 == 0.0
    assert climb.highest_mps2 == pytest.approx(9.81 * highest_permille / 1000.0)


def test_in_the_middle_of_a_climb_only_its_gradient_counts() -> None:
    """The range holds up to both ends of the climb; one step further it includes the level."""
    for low_m, high_m, flattest_permille in (
        (100.0 + FIRST_CAR_M, 199.9, 20.0),
        (100.0 + FIRST_CAR_M, 200.0, 0.0),
        (99.9 + FIRST_CAR_M, 199.9, 0.0),
    ):
        climb = Gradients(line((100.0, 200.0, 20.0)))
        climb.look(low_m, high_m)
        assert climb.lowest_mps2 == pytest.approx(9.81 * flattest_permille / 1000.0)
        assert climb.highest_mps2 == pytest.approx(9.81 * 20.0 / 1000.0)


def test_a_cached_gradient_counts_only_up_to_the_next_edge() -> None:
    """The line is level before and behind the climb; each side counts as soon as the train may
    be there."""
    climb = Gradients(line((100.0, 200.0, 20.0)))
    climb.look(90.0, 95.0)
    climb.look(90.0, 100.1)
    assert climb.highest_mps2 > 0.0
    back = Gradients(line((100.0, 200.0, 20.0)))
    back.look(230.0, 231.0)
    assert back.highest_mps2 == 0.0
    back.look(224.9, 231.0)
    assert back.highest_mps2 > 0.0


def test_a_gradient_cached_at_the_start_of_a_climb_does_not_count_behind_it() -> None:
    climb = Gradients(line((100.0, 200.0, 20.0)))
    climb.look(100.0 + FIRST_CAR_M, 190.0)
    assert climb.lowest_mps2 > 0.0
    climb.look(99.0 + FIRST_CAR_M, 190.0)
    assert climb.lowest_mps2 == 0.0


class Watched:
    """A line that counts how often its gradients are looked up."""

    def __init__(self, *climbs: tuple[float, float, float]) -> None:
        self._line = line(*climbs)
        self.asked = 0

    @property
    def gradients(self) -> tuple[GradientSection, ...]:
        self.asked += 1
        return self._line.gradients


@pytest.mark.parametrize(
    ("low_m", "high_m", "restarts"),
    [
        (100.0, 110.0, False),
        (50.0, 160.0, False),
        (49.9, 160.0, True),
        (50.0, 160.1, True),
        (51.0, 105.0, False),
        (120.0, 159.0, False),
    ],
)
def test_gradients_are_looked_up_again_after_fifty_metres_either_way(
    low_m: float, high_m: float, *, restarts: bool
) -> None:
    watched = Watched()
    level = Gradients(watched)  # type: ignore[arg-type]
    level.look(100.0, 110.0)
    once = watched.asked
    assert once > 0
    level.look(low_m, high_m)

    assert (watched.asked > once) is restarts


@pytest.mark.parametrize(
    ("low_m", "high_m", "restarts"),
    [
        (125.0, 200.0, False),
        (124.9, 199.9, True),
        (125.1, 200.1, True),
    ],
)
def test_gradients_are_looked_up_again_where_one_ends(
    low_m: float, high_m: float, *, restarts: bool
) -> None:
    """The test covers a first lookup near to the ends and one just up to them."""
    for first_low_m, first_high_m in ((130.0, 195.0), (125.0, 200.0)):
        watched = Watched((100.0, 200.0, 20.0))
        climb = Gradients(watched)  # type: ignore[arg-type]
        climb.look(first_low_m, first_high_m)
        once = watched.asked
        climb.look(low_m, high_m)

        assert (watched.asked > once) is restarts


# The accelerometer.


def test_a_silent_accelerometer_no_longer_counts() -> None:
    made = ground(10.0, 12.0, 1.0)
    made.feel(None, FLAT)
    made.step(0.5, None, NEVER_S, 0.0, 0.0)

    assert speed_mps(made) == near(9.0, 13.0)


def test_a_silent_radar_no_longer_counts() -> None:
    made = shown(11.0, wheels=ELSEWHERE)
    assert made.seen
    made.step(0.5, None, NEVER_S, *ELSEWHERE)
    assert not made.seen
    made.step(0.0, 11.0, 0.0, *ELSEWHERE)
    assert made.seen
    made.step(0.0, 30.0, 0.0, *ELSEWHERE)
    assert not made.seen


def test_without_accelerometer_the_speed_may_change_as_much_as_a_train_can() -> None:
    made = ground(10.0, 12.0)
    made.step(0.5, None, NEVER_S, 0.0, 0.0)

    assert speed_mps(made) == near(9.0, 13.0)
    assert moved_m(made) == near(0.5 * 9.5, 0.5 * 12.5)
    assert not made.seen
    assert made.best_mps == pytest.approx(11.0)


def test_before_the_first_evidence_any_train_speed_is_possible() -> None:
    new = GroundSpeed(CONFIG)
    assert not new.begun
    assert speed_mps(new) == (-40.0, 40.0)
    assert (moved_m(new), new.seen, new.refused) == ((0.0, 0.0), False, 0)
    new.step(0.5, None, NEVER_S, 0.0, 0.0)
    assert speed_mps(new) == (-40.0, 40.0)
    new.begin(3.0, 4.0)
    assert new.begun
    new.step(0.5, None, NEVER_S, 0.0, 0.0)
    assert speed_mps(new) == near(2.0, 5.0)


def test_the_bounds_include_the_accelerometers_error_and_its_change() -> None:
    made = ground(10.0, 12.0, 1.0)
    made.step(0.5, None, NEVER_S, 0.0, 0.0)
    assert speed_mps(made) == near(10.0 + 0.5 * 0.75, 12.0 + 0.5 * 1.25)
    for felt, low, high in ((0.5, -0.25, 1.25), (0.75, 0.25, 1.25)):
        made.begin(10.0, 12.0)
        made.feel(felt, FLAT)
        made.step(0.5, None, NEVER_S, 0.0, 0.0)
        assert speed_mps(made) == near(10.0 + 0.5 * low, 12.0 + 0.5 * high)
    made.begin(10.0, 12.0)
    made.feel(None, FLAT)
    made.feel(1.0, FLAT)
    made.step(0.5, None, NEVER_S, 0.0, 0.0)
    assert speed_mps(made) == near(10.0 + 0.5 * 0.75, 12.0 + 0.5 * 1.25)


def test_the_greatest_and_the_least_gravity_are_subtracted() -> None:
    climb = Gradients(line())
    climb.lowest_mps2, climb.highest_mps2 = -0.25, 0.5
    made = GroundSpeed(CONFIG)
    made.begin(10.0, 12.0)
    made.feel(0.5, climb)
    made.step(0.5, None, NEVER_S, 0.0, 0.0)

    assert speed_mps(made) == near(10.0 + 0.5 * -0.25, 12.0 + 0.5 * 1.0)


@pytest.mark.parametrize(
    ("felt", "low", "high"),
    [
        (2.0, 1.75, 2.0),
        (2.25, 2.0, 2.0),
        (2.26, -2.0, 2.0),
        (-2.0, -2.0, -1.75),
        (-2.25, -2.0, -2.0),
        (-2.26, -2.0, 2.0),
    ],
)
def test_an_acceleration_beyond_that_of_a_train_does_not_count(
    felt: float, low: float, high: float
) -> None:
    made = ground(10.0, 12.0, felt)
    made.step(0.5, None, NEVER_S, 0.0, 0.0)

    assert speed_mps(made) == near(10.0 + 0.5 * low, 12.0 + 0.5 * high)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_bounds_never_exceed_the_maximum_train_speed(sign: float) -> None:
    made = ground(*sorted((sign * 39.5, sign * 38.0)))
    made.step(0.5, None, NEVER_S, 0.0, 0.0)

    assert speed_mps(made) == near(*sorted((sign * 40.0, sign * 37.0)))


# Both.


def shown(
    radar_mps: float, *, age_s: float = 0.0, wheels: tuple[float, float], felt: float | None = None
) -> GroundSpeed:
    """Speed over ground half a second after 10 to 12 m/s; without accelerometer it lies in 9 to
    13 m/s."""
    made = ground(10.0, 12.0, felt)
    made.step(0.5, radar_mps, age_s, *wheels)
    return made


ELSEWHERE = (-5.0, -4.0)


@pytest.mark.parametrize(
    ("radar_mps", "low", "high"),
    [(11.0, 10.39, 11.61), (13.0, 12.37, 13.0), (9.0, 9.0, 9.59)],
)
def test_a_radar_narrows_the_bounds_to_its_own_error(
    radar_mps: float, low: float, high: float
) -> None:
    made = shown(radar_mps, wheels=ELSEWHERE)

    assert speed_mps(made) == near(low, high)
    assert (made.seen, made.refused) == (True, 0)


def test_the_radar_error_is_the_same_backwards() -> None:
    made = ground(-12.0, -10.0)
    made.step(0.5, -11.0, 0.0, *ELSEWHERE)

    assert speed_mps(made) == near(-11.61, -10.39)


def test_an_old_radar_reading_widens_by_the_possible_speed_change() -> None:
    """The reading changes by up to 2 m/s² for 0.1 s in either direction, or only in the
    direction that the accelerometer shows."""
    assert speed_mps(shown(11.0, age_s=0.1, wheels=ELSEWHERE)) == near(10.19, 11.81)
    assert speed_mps(shown(11.0, age_s=0.1, wheels=ELSEWHERE, felt=1.0)) == near(
        10.39, 11.61 + 0.1 * 1.25
    )
    assert speed_mps(shown(10.4, age_s=0.1, wheels=ELSEWHERE, felt=-1.0)) == near(
        9.796 - 0.1 * 1.25, 11.004
    )


def test_the_mean_of_the_readings_narrows_the_distance() -> None:
    """The radar shows 11 m/s with an error of 0.0625 m/s + 0.5 % = 0.1175 m/s, read at the end
    of half a second."""
    made = shown(11.0, wheels=ELSEWHERE, felt=1.0)
    mean_mps, off_mps = 11.0 - 0.25 * 1.0, 0.1175 + 0.25 * 0.25

    assert moved_m(made) == near(0.5 * (mean_mps - off_mps), 0.5 * (mean_mps + off_mps))
    late = shown(11.0, age_s=0.4, wheels=ELSEWHERE, felt=1.0)
    mean_mps, off_mps = 11.0 + 0.15 * 1.0, 0.1175 + 0.15 * 0.25
    assert moved_m(late) == near(0.5 * (mean_mps - off_mps), 0.5 * (mean_mps + off_mps))
    back = ground(-12.0, -10.0, -1.0)
    back.step(0.5, -11.0, 0.25, *ELSEWHERE)
    assert moved_m(back) == near(0.5 * (-11.0 - 0.1175), 0.5 * (-11.0 + 0.1175))


def test_a_reading_that_the_wheels_confirm_replaces_the_extrapolated_speed() -> None:
    made = shown(20.0, wheels=(20.0, 20.1))

    assert speed_mps(made) == near(19.3, 20.7)
    assert (made.seen, made.refused) == (True, 0)
    assert moved_m(made) == near(0.5 * (20 - 0.1625 - 0.25 * 2), 0.5 * (20 + 0.1625 + 0.25 * 2))


@pytest.mark.parametrize(
    ("wheels", "low", "high", "seen", "refused"),
    [
        ((20.7 - 1e-9, 30.0), 19.3, 20.7, True, 0),
        ((20.7 + 1e-6, 30.0), 9.0, 20.7, False, 1),
        ((13.1, 19.3 + 1e-9), 19.3, 20.7, True, 0),
        ((13.1, 19.3 - 1e-6), 9.0, 20.7, False, 1),
        ((13.0, 19.0), 9.0, 13.0, False, 1),
        ((13.0 + 1e-6, 19.0), 9.0, 20.7, False, 1),
        ((-9.0, 9.0), 9.0, 13.0, False, 1),
        ((-9.0, 9.0 - 1e-6), 9.0, 20.7, False, 1),
    ],
)
def test_the_wheels_decide_between_contradicting_bounds_and_otherwise_both_count(
    wheels: tuple[float, float], low: float, high: float, *, seen: bool, refused: int
) -> None:
    """The extrapolated speed is 9 to 13 m/s, the radar shows 19.3 to 20.7 m/s."""
    made = shown(20.0, wheels=wheels)

    assert speed_mps(made) == near(low, high)
    assert (made.seen, made.refused) == (seen, refused)
    if not seen:
        assert moved_m(made) == near(0.5 * 9.5, 0.5 * 12.5)


@pytest.mark.parametrize("refusals", [1, 2])
def test_every_refused_reading_is_counted(refusals: int) -> None:
    for wheels in ((12.0, 12.0), ELSEWHERE):
        made = ground(10.0, 12.0)
        for _ in range(refusals):
            made.step(0.0, 20.0, 0.0, *wheels)
            made.begin(10.0, 12.0)

        assert made.refused == refusals


def test_a_radar_below_the_extrapolated_speed_contradicts_it_too() -> None:
    assert speed_mps(shown(2.0, wheels=ELSEWHERE)) == near(1.48, 13.0)
    assert speed_mps(shown(2.0, wheels=(2.0, 2.0))) == near(1.48, 2.52)


def test_bounds_that_touch_agree() -> None:
    """The radar shows 13.5 to 14.5 m/s without a relative error; the extrapolated bound ends at
    13.5 m/s."""
    config = replace(CONFIG, doppler_error_ratio=0.0)
    for radar_mps, touching in ((14.0, (13.5, 13.5)), (8.0, (8.5, 8.5))):
        made = GroundSpeed(config)
        made.begin(8.5, 13.5)
        made.step(0.0, radar_mps, 0.0, *ELSEWHERE)
        assert speed_mps(made) == touching
        assert made.seen
    for radar_mps, wheel_mps in ((20.0, 19.5), (20.0, 20.5)):
        made = GroundSpeed(config)
        made.begin(8.5, 13.5)
        made.step(0.0, radar_mps, 0.0, wheel_mps, wheel_mps)
        assert speed_mps(made) == (19.5, 20.5)
    for wheel_mps in (8.5, 13.5):
        made = GroundSpeed(config)
        made.begin(8.5, 13.5)
        made.step(0.0, 20.0, 0.0, wheel_mps, wheel_mps)
        assert speed_mps(made) == (8.5, 13.5)
    assert not math.isnan(made.best_mps)
