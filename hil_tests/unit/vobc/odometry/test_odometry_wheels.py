"""Pulses, wheel scale and speed filter by hand calculation at each threshold."""

import math
from dataclasses import replace

import pytest

from can_dbc.nodes import Direction
from can_dbc.odometer import Tacho
from vobc.config import load_config
from vobc.odometry.pulses import PulseCounter, signed_difference
from vobc.odometry.scale import Waypoint, WheelScale
from vobc.odometry.tracking import SpeedTrack

CONFIG = replace(
    load_config("florence4").odometry,
    scale_error_low_ratio=-0.01,
    scale_error_high_ratio=0.05,
    scale_margin_ratio=0.002,
    scale_base_m=20.0,
)
NOMINAL_M = 0.01
DECLARED_M = (pytest.approx(0.01 / 1.05), pytest.approx(0.01 / 0.99))


def bounds_m(scale: WheelScale) -> tuple[float, float]:
    return scale.low_m, scale.high_m


def between(base_m: float, counted: int, slack_m: float) -> tuple[object, object]:
    """Bounds of the distance of one pulse when either count may be off by one."""
    return (
        pytest.approx((base_m - slack_m) / (counted + 1) * 0.998, rel=1e-12),
        pytest.approx((base_m + slack_m) / (counted - 1) * 1.002, rel=1e-12),
    )


def test_before_any_tag_a_pulse_has_the_declared_distance() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)

    assert bounds_m(scale) == scale.declared_m == DECLARED_M
    assert scale.nearest(0.0098) == 0.0098
    assert scale.nearest(0.005) == scale.low_m
    assert scale.nearest(0.02) == scale.high_m


def test_each_pair_of_tags_measures_the_wheel_from_where_the_pair_before_ended() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.anchor(Waypoint(10.0, 0.05, 100, 10.0, 0.0))
    scale.measure(Waypoint(60.0, 0.07, 5100, 60.0, 0.0))
    assert bounds_m(scale) == between(50.0, 5000, 0.12)

    scale.measure(Waypoint(160.0, 0.06, 15100, 160.0, 0.0))
    assert bounds_m(scale) == between(100.0, 10000, 0.13)


def test_the_ground_measures_with_its_slack_and_the_bound_that_it_gained() -> None:
    """The bound over ground grew by 0.75 m between the tags."""
    scale = WheelScale(replace(CONFIG, ground_slack_m=0.25), NOMINAL_M)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.5))
    scale.measure(Waypoint(200.0, 0.05, 20000, 200.0, 1.25))

    assert bounds_m(scale) == between(200.0, 20000, 1.0)


@pytest.mark.parametrize("over_m", [98.0, 102.0])
def test_tags_that_contradict_the_ground_restore_the_declared_bounds(over_m: float) -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.0))
    scale.measure(Waypoint(100.0, 0.05, 10000, over_m, 0.0))

    assert bounds_m(scale) == DECLARED_M


def test_two_measurements_that_just_touch_agree() -> None:
    for lower, upper in (((0.0099, 0.01), (0.01, 0.0101)), ((0.01, 0.0101), (0.0099, 0.01))):
        assert WheelScale(CONFIG, NOMINAL_M)._narrow(lower, upper) is True


def test_a_worse_measurement_never_widens_the_bounds_of_the_wheel() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.0))
    scale.measure(Waypoint(200.0, 0.05, 20000, 200.0, 0.0))
    best = bounds_m(scale)
    scale.measure(Waypoint(225.0, 0.06, 22500, 225.0, 0.0))

    assert bounds_m(scale) == best == between(200.0, 20000, 0.1)


def test_the_first_tag_without_an_anchor_only_begins() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.measure(Waypoint(10.0, 0.05, 100, 10.0, 0.0))
    assert bounds_m(scale) == DECLARED_M
    scale.measure(Waypoint(60.0, 0.07, 5100, 60.0, 0.0))
    assert bounds_m(scale) == between(50.0, 5000, 0.12)

    scale.forget_anchor()
    scale.measure(Waypoint(160.0, 0.06, 15100, 160.0, 0.0))
    assert bounds_m(scale) == between(50.0, 5000, 0.12)


def test_tags_closer_than_the_base_measure_nothing_and_the_anchor_stays() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.0))
    scale.measure(Waypoint(19.99, 0.05, 1999, 19.99, 0.0))
    assert bounds_m(scale) == DECLARED_M
    scale.measure(Waypoint(20.0, 0.05, 2000, 20.0, 0.0))
    assert bounds_m(scale) == between(20.0, 2000, 0.1)


def test_a_single_pulse_measures_nothing_and_two_contradict() -> None:
    """After a contradiction the measurement restarts from the contradicting tag."""
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.0))
    scale.measure(Waypoint(50.0, 0.05, 5000, 50.0, 0.0))
    known = bounds_m(scale)
    scale.measure(Waypoint(100.0, 0.05, 5001, 100.0, 0.0))
    assert bounds_m(scale) == known
    scale.measure(Waypoint(100.0, 0.05, 5002, 100.0, 0.0))
    assert bounds_m(scale) == DECLARED_M
    scale.measure(Waypoint(150.0, 0.07, 10002, 150.0, 0.0))
    assert bounds_m(scale) == between(50.0, 5000, 0.12)


def test_bounds_that_meet_in_one_point_do_not_contradict() -> None:
    config = replace(CONFIG, scale_error_low_ratio=0.0, scale_margin_ratio=0.0, ground_slack_m=0.0)
    scale = WheelScale(config, 2.0**-7)
    scale.anchor(Waypoint(0.0, 0.0, 0, 0.0, 0.0))
    scale.measure(Waypoint(32.0, 0.0, 4095, 32.0, 0.0))

    assert bounds_m(scale) == (2.0**-7, 2.0**-7)


def test_a_measured_scale_is_discarded_for_another_wheel() -> None:
    scale = WheelScale(CONFIG, NOMINAL_M)
    scale.anchor(Waypoint(0.0, 0.05, 0, 0.0, 0.0))
    scale.measure(Waypoint(50.0, 0.05, 5000, 50.0, 0.0))
    scale.forget()
    assert bounds_m(scale) == DECLARED_M
    scale.measure(Waypoint(100.0, 0.05, 10000, 100.0, 0.0))
    assert bounds_m(scale) == DECLARED_M


# Pulses.


def tacho(
    a: int,
    b: int,
    way: Direction = Direction.FORWARD,
    *,
    healthy_a: bool = True,
    healthy_b: bool = True,
) -> Tacho:
    return Tacho(a % 65536, b % 1024, way, healthy_a, healthy_b, 0.0)


def counter(a: int = 0, b: int = 0) -> PulseCounter:
    pulses = PulseCounter(4000.0)
    assert pulses.step(tacho(a, b), 0.02) == 0
    return pulses


def test_half_a_turn_of_a_counter_counts_as_backwards() -> None:
    assert signed_difference(32767, 0) == 32767
    assert signed_difference(32768, 0) == -32768
    assert signed_difference(0, 65535) == 1
    assert signed_difference(511, 0, 1024) == 511
    assert signed_difference(512, 0, 1024) == -512


@pytest.mark.parametrize("healthy_a", [True, False])
@pytest.mark.parametrize("healthy_b", [True, False])
def test_the_first_sample_counts_nothing_if_an_axle_is_well(
    *, healthy_a: bool, healthy_b: bool
) -> None:
    pulses = PulseCounter(4000.0)
    assert pulses.since_latched(0) is None

    first = pulses.step(tacho(7, 9, healthy_a=healthy_a, healthy_b=healthy_b), 0.02)

    assert first == (0 if healthy_a or healthy_b else None)
    assert (pulses.count, pulses.jumps, pulses.on_b) == (0, 0, False)
    assert (pulses.axles_differ, pulses.contradicted) == (False, False)
    assert pulses.since_latched(2) == 5


@pytest.mark.parametrize("sign", [1, -1])
def test_a_counter_steps_no_further_than_the_fastest_train_and_one_late_sample(sign: int) -> None:
    """The limit is 4000 pulses/s over 20 ms plus 20 ms for a late sample: 160 pulses."""
    way = Direction.FORWARD if sign > 0 else Direction.REVERSE
    both, only_b, neither = counter(), counter(), counter()

    assert both.step(tacho(sign * 160, sign * 160, way), 0.02) == sign * 160
    assert (both.on_b, both.jumps) == (False, 0)
    assert only_b.step(tacho(sign * 161, sign * 160, way), 0.02) == sign * 160
    assert (only_b.on_b, only_b.jumps) == (True, 1)
    assert only_b.since_latched(0) is None
    assert not only_b.axles_differ
    assert neither.step(tacho(sign * 161, sign * 161, way), 0.02) is None
    assert (neither.count, neither.jumps) == (0, 2)


def test_a_jump_of_b_is_counted_and_a_goes_on() -> None:
    pulses = counter()

    assert pulses.step(tacho(20, 400), 0.02) == 20
    assert (pulses.on_b, pulses.jumps, pulses.axles_differ) == (False, 1, False)


@pytest.mark.parametrize("sign", [1, -1])
def test_axle_a_no_longer_counts_after_standing_for_25_pulses_of_b(sign: int) -> None:
    way = Direction.FORWARD if sign > 0 else Direction.REVERSE
    pulses = counter()
    assert pulses.step(tacho(0, sign * 12, way), 0.02) == 0
    assert pulses.step(tacho(0, sign * 24, way), 0.02) == 0
    assert not pulses.on_b
    assert pulses.step(tacho(0, sign * 25, way), 0.02) == sign
    assert pulses.on_b
    assert pulses.count == sign
    assert pulses.step(tacho(sign * 3, sign * 28, way), 0.02) == sign * 3
    assert not pulses.on_b
    assert pulses.step(tacho(sign * 3, sign * 52, way), 0.02) == 0
    assert not pulses.on_b, "the count restarts when it moves"


@pytest.mark.parametrize("sign", [1, -1])
def test_axle_b_is_no_evidence_after_standing_for_25_pulses_of_a(sign: int) -> None:
    """If A is unhealthy too, no axle counts."""
    way = Direction.FORWARD if sign > 0 else Direction.REVERSE
    for stood, known in ((24, True), (25, False)):
        pulses = counter()
        pulses.step(tacho(sign * (stood - 1), 0, way), 0.02)
        pulses.step(tacho(sign * stood, 0, way, healthy_a=False), 0.02)

        assert (pulses.step(tacho(sign * stood, 0, way, healthy_a=False), 0.02) == 0) is known
    apart = counter()
    apart.step(tacho(sign * 24, 0, way), 0.02)
    assert apart.axles_differ
    apart.step(tacho(sign * 25, 0, way), 0.02)
    assert not apart.axles_differ, "an axle that is out says nothing"


@pytest.mark.parametrize(
    ("step", "way", "against"),
    [
        (3, Direction.FORWARD, False),
        (2, Direction.REVERSE, False),
        (3, Direction.REVERSE, True),
        (-3, Direction.REVERSE, False),
        (-2, Direction.FORWARD, False),
        (-3, Direction.FORWARD, True),
        (-3, Direction.NEUTRAL, True),
        (0, Direction.NEUTRAL, False),
    ],
)
def test_more_than_two_pulses_against_the_direction_contradict_it(
    step: int, way: Direction, *, against: bool
) -> None:
    pulses, on_b = counter(), counter()
    pulses.step(tacho(step, step, way), 0.02)
    on_b.step(tacho(step, step, way, healthy_a=False), 0.02)

    assert pulses.contradicted is against
    assert not on_b.contradicted, "the direction is that of A"


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("ahead", ["a", "b"])
def test_axles_differ_beyond_four_pulses_plus_a_hundredth_of_the_distance(
    sign: int, ahead: str
) -> None:
    """The axles count 100 and 98 or 102 pulses in each sample; the fifth sample exceeds the
    tolerance."""
    pulses = counter()
    behind = 102 if ahead == "b" else 98
    differ = []
    for sample in range(1, 7):
        pulses.step(tacho(sign * 100 * sample, sign * behind * sample), 0.02)
        differ.append(pulses.axles_differ)

    assert differ == [False, False, False, False, True, True]
    pulses.step(tacho(sign * 600, sign * behind * 6), 0.02)
    assert not pulses.axles_differ, "the counts themselves decide"


@pytest.mark.parametrize("sign", [1, -1])
def test_unused_tolerance_is_not_saved_for_later(sign: int) -> None:
    pulses = counter()
    pulses.step(tacho(sign * 150, sign * 149), 0.03)
    pulses.step(tacho(sign * 150, sign * 153), 0.03)
    assert not pulses.axles_differ
    pulses.step(tacho(sign * 150, sign * 154), 0.03)
    assert pulses.axles_differ


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("step_a", "differ"), [(200, False), (195, True)])
def test_a_hundredth_of_the_distance_and_four_pulses_are_tolerated(
    sign: int, step_a: int, *, differ: bool
) -> None:
    """The axles differ by six pulses, of which 2 or 1.95 are allowed for the wheel diameters."""
    pulses = counter()
    pulses.step(tacho(sign * step_a, sign * (step_a - 6)), 0.03)

    assert pulses.axles_differ is differ


def test_half_a_pulse_each_time_adds_up() -> None:
    pulses = counter()
    differ = []
    for sample in range(1, 11):
        pulses.step(tacho(50 * sample, 49 * sample), 0.02)
        differ.append(pulses.axles_differ)

    assert differ == [False] * 8 + [True] * 2


def test_an_unhealthy_or_standing_axle_neither_counts_nor_disagrees() -> None:
    pulses = counter()
    assert pulses.step(tacho(20, 60, healthy_a=False), 0.02) == 60
    assert not pulses.axles_differ
    assert pulses.step(tacho(20, 60, healthy_a=False, healthy_b=False), 0.02) is None
    moved = counter()
    moved.step(tacho(1, 1), 0.02)
    moved.step(tacho(25, 1), 0.02)
    assert moved.step(tacho(25, 1, healthy_a=False), 0.02) == 0


# Speed.

HALVING_RAD_S = math.log(2.0) / 0.02


def track(*samples: tuple[float, int], bandwidth_rad_s: float = 8.0) -> SpeedTrack:
    made = SpeedTrack(bandwidth_rad_s=bandwidth_rad_s, window_s=0.25)
    for stamp_s, count in samples:
        made.add(stamp_s, count)
    return made


def test_the_filter_matches_a_hand_calculation() -> None:
    """With theta = 1/2 the gains are 7/8, 9/16 and 1/8."""
    first = track((0.0, 0), bandwidth_rad_s=HALVING_RAD_S)
    assert (first.at_pulses, first.rate_pulses_per_s, first.accel_pulses_per_s2) == (0.5, 0.0, 0.0)
    first.add(0.02, 10)
    told = (first.at_pulses, first.rate_pulses_per_s, first.accel_pulses_per_s2)
    assert told == pytest.approx((9.25, 281.25, 3125.0))
    first.add(0.04, 20)
    told = (first.at_pulses, first.rate_pulses_per_s, first.accel_pulses_per_s2)
    assert told == pytest.approx((19.875, 484.375, 4687.5))
    first.settle()
    assert (first.rate_pulses_per_s, first.accel_pulses_per_s2) == (0.0, 0.0)


def test_samples_closer_than_a_millisecond_count_as_one_millisecond_apart() -> None:
    close = track((0.0, 0), (1e-5, 1), bandwidth_rad_s=math.log(2.0) / 1e-3)

    assert close.rate_pulses_per_s == pytest.approx(0.5625 * 1.0 / 1e-3)


def test_nothing_is_known_before_the_first_sample() -> None:
    new = SpeedTrack(bandwidth_rad_s=8.0, window_s=0.25)
    assert not new.begun
    assert (new.stamp_s, new.at_pulses) == (-math.inf, 0.5)
    assert (new.rate_pulses_per_s, new.accel_pulses_per_s2) == (0.0, 0.0)
    new.add(3.0, 5)
    assert new.begun
    assert (new.stamp_s, new.at_pulses, new.still_s) == (3.0, 5.5, 0.0)


def test_a_wheel_is_still_since_its_last_pulse_and_silence_adds_no_time() -> None:
    still = track((1.0, 5), (1.5, 6), (2.0, 6), (2.75, 6))

    assert still.still_s == 1.25


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_wheel_without_pulses_turns_slower_than_one_pulse_in_that_time(sign: float) -> None:
    still = track((0.0, 0), (0.5, 0))
    still.rate_pulses_per_s, still.accel_pulses_per_s2 = sign * 1.0, sign * 2.0

    assert still.limited_rate_pulses_per_s(0.5) == sign * 1.0
    assert still.limited_rate_pulses_per_s(0.75) == sign * 1.5
    assert still.limited_rate_pulses_per_s(1.5) == sign * 2.0


def test_the_acceleration_extrapolates_the_rate_while_pulses_come() -> None:
    moving = track((0.0, 0), (0.5, 7))
    moving.rate_pulses_per_s, moving.accel_pulses_per_s2 = 10.0, 4.0

    assert moving.limited_rate_pulses_per_s(0.75) == 11.0


def test_the_window_covers_its_length_and_at_least_two_samples() -> None:
    steady = track(*((number / 16.0, number) for number in range(20)))
    assert steady.mean_rate(0.0)[2] == 0.25
    sparse = track((0.0, 0), (1.0, 1), (2.0, 2), (3.0, 3))
    assert sparse.mean_rate(0.0)[2] == 1.0


def test_the_received_time_counts_from_the_first_sample_to_the_last() -> None:
    assert track((5.0, 7)).heard_s == 0.0
    assert track((5.0, 7), (5.125, 8), (7.0, 9)).heard_s == 2.0


@pytest.mark.parametrize(("end_s", "full"), [(0.25, True), (0.2499, False)])
def test_a_window_is_full_exactly_at_its_length(end_s: float, *, full: bool) -> None:
    assert track((5.0, 7), (5.125, 8), (5.0 + end_s, 9)).window_full is full


@pytest.mark.parametrize(
    ("step", "low", "high"),
    [
        (9, 8 / 0.3125, 10 / 0.1875),
        (-9, -10 / 0.1875, -8 / 0.3125),
        (0, -1 / 0.1875, 1 / 0.1875),
        (1, 0.0, 2 / 0.1875),
        (2, 1 / 0.3125, 3 / 0.1875),
        (-2, -3 / 0.1875, -1 / 0.3125),
        (-1, -2 / 0.1875, 0.0),
    ],
)
def test_the_mean_rate_allows_for_a_pulse_and_the_jitter_either_way(
    step: int, low: float, high: float
) -> None:
    mean = track((0.0, 100), (0.25, 100 + step)).mean_rate(0.0625)

    assert mean == (pytest.approx(low), pytest.approx(high), 0.25)


def test_samples_within_the_jitter_give_no_rate() -> None:
    samples = track((0.0, 0), (0.125, 9))

    assert samples.mean_rate(0.0625) == (-math.inf, math.inf, 0.125)
    assert math.isfinite(samples.mean_rate(0.0624)[0])
    assert track((0.0, 0)).mean_rate(0.0)[0] == -math.inf


SIXTEENTHS_S = (0.0, 1 / 16, 1 / 8, 3 / 16)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_speed_change_beyond_any_train_is_a_jump(sign: int) -> None:
    """The pulses allow 1/8 s and 1/16 s of whole pulses, and 768 pulses/s² over half of 3/16 s:
    8 + 16 + 72 = 96."""
    stamps_s = [3.0 + stamp_s for stamp_s in SIXTEENTHS_S]
    for last, most, jumped in (
        (6, 768.0, False),
        (7, 768.0, True),
        (7, 932.0, True),
        (7, 940.0, False),
    ):
        made = track(*zip(stamps_s, (100, 100, 100, 100 + sign * last), strict=True))

        assert made.jumped(most, 0.0) is jumped
    steady = track(*zip(SIXTEENTHS_S, (0, sign * 50, sign * 100, sign * 150), strict=True))
    assert not steady.jumped(0.0, 0.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_tolerance_for_time_errors_grows_with_the_wheel_speed(sign: int) -> None:
    """From 512 to 800 pulses/s with 1/64 s of jitter: (1 + 8) * 8 + (1 + 12.5) * 16 = 288."""
    for after, jumped in ((50, False), (51, True)):
        counts = (0, sign * 32, sign * 64, sign * (64 + after))
        made = track(*zip(SIXTEENTHS_S, counts, strict=True))

        assert made.jumped(0.0, 1 / 64) is jumped


@pytest.mark.parametrize(
    ("stamps_s", "jumped"),
    [
        ((0.0, 0.1, 0.2), False),
        ((-0.1, -0.05, 0.0, 0.1), True),
        ((-0.1, -0.05, 0.0, 0.035), False),
        ((-0.035, -0.03, 0.0, 0.1), False),
        ((-0.036, -0.03, 0.0, 0.1), True),
        ((-0.1, -0.05, 0.0, 0.036), True),
    ],
)
def test_a_jump_needs_four_samples_and_two_halves_that_are_long_enough(
    stamps_s: tuple[float, ...], *, jumped: bool
) -> None:
    counts = [0] * (len(stamps_s) - 1) + [10_000]

    assert track(*zip(stamps_s, counts, strict=True)).jumped(0.0, 0.0) is jumped
