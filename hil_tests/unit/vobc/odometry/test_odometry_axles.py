"""One axle slips while the radar is silent, and clocks are set back: the bounds hold the truth."""

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_tests.unit.vobc.odometry import odometry_rig as rig
from hil_tests.unit.vobc.odometry.odometry_rig import Errors, Rig


def no_radar(time_s: float, speed_mps: float) -> None:
    return None


def cruise(time_s: float, speed_mps: float) -> float:
    return 1.0 if time_s < 12.0 else 0.0


def up_and_down(time_s: float, speed_mps: float) -> float:
    if time_s < 15.0:
        return 0.8
    return -0.5 if time_s > 22.0 and speed_mps > 0.0 else 0.0


def assert_true(history: list[rig.Moment]) -> None:
    for moment in history:
        front, speed = moment.motion.front_m, moment.motion.speed_mps
        assert front.low <= moment.front_m <= front.high, moment
        assert speed.low <= moment.speed_mps <= speed.high, moment


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("share", [-0.9, -0.29, -0.12, -0.05, 0.05, 0.13, 0.3, 0.9])
@pytest.mark.parametrize("from_s", [2.0, 18.0])
@pytest.mark.parametrize("accel", [cruise, up_and_down])
def test_without_radar_the_hull_holds_the_truth_though_one_axle_slips(
    axle: int, share: float, from_s: float, accel: Callable[[float, float], float]
) -> None:
    """Wheels that disagree are no evidence of the speed over ground; the accelerometer is."""
    errors = Errors(seed=11, slips=((from_s, from_s + 15.0, share, axle),), radar=no_radar)
    history = Rig(errors).run(36.0, accel)

    assert_true(history)
    slipping = {moment.motion.slip for moment in history if from_s + 2 < moment.time_s < from_s + 8}
    assert slipping == {True}
    assert not any(moment.motion.slip for moment in history if moment.time_s < from_s)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 1 << 20), st.floats(2.0, 25.0), st.floats(1.0, 20.0), st.floats(-1.0, 1.0),
    st.sampled_from([1, 2]), st.floats(0.0, 25.0), st.floats(-0.05, 0.05),
)  # fmt: skip
def test_one_slipping_axle_never_breaks_the_bounds_when_the_radar_falls_silent(
    seed: int, from_s: float, for_s: float, share: float, axle: int, out_s: float, bias: float
) -> None:
    errors = Errors(seed=seed, imu_bias_mps2=bias, slips=((from_s, from_s + for_s, share, axle),))
    errors.radar = lambda time_s, mps: None if time_s >= out_s else mps

    assert_true(Rig(errors).run(40.0, up_and_down))


def test_a_silence_of_the_tacho_is_no_slip() -> None:
    errors = Errors(silent=(20.0, 20.45))
    history = Rig(errors).run(24.0, cruise)

    assert_true(history)
    assert not any(moment.motion.slip for moment in history if moment.time_s > 20.5)


# Clocks.


@pytest.mark.parametrize("back_s", [0.03, 0.3, 3.0, 3600.0])
def test_a_clock_that_is_set_back_neither_freezes_nor_falsifies_the_position(back_s: float) -> None:
    ride = Rig(Errors(seed=5))
    history = ride.run(15.0, cruise)
    ride.set_back(back_s)
    history += ride.run(6.0, cruise)

    assert_true(history)
    assert ride.odometry.usable
    last = history[-1].motion
    assert not last.slip
    assert last.speed_mps.best == pytest.approx(ride.speed_mps, abs=0.2)
    assert last.front_m.best == pytest.approx(ride.front_m, abs=0.6)


def test_a_clock_set_back_at_standstill_does_not_hide_the_start() -> None:
    ride = Rig(Errors(seed=5))
    ride.run(5.0, lambda time_s, mps: 0.0)
    ride.set_back(100.0)
    standing = ride.run(5.0, lambda time_s, mps: 0.0)
    going = ride.run(5.0, lambda time_s, mps: 1.0)

    assert standing[-1].motion.standstill
    assert_true(standing + going)
    assert not going[-1].motion.standstill


# A stop with one sliding axle.

TAG_M = rig.TAGS[0].position_m + rig.ANTENNA_M


def stops_past_a_tag(errors: Errors) -> list[rig.Moment]:
    """Run at 4 m/s and brake to a stop about a metre past the first tag."""
    made = Rig(errors, front_m=TAG_M - 25.0, believed_m=TAG_M - 25.0)

    def accel(time_s: float, mps: float) -> float:
        way_m = TAG_M - 1.4 - made.front_m
        if mps > 0.0 and way_m < mps * mps / (2.0 * 0.4):
            return -0.4
        return 1.0 if mps < 4.0 and made.front_m < TAG_M - 15.0 else 0.0

    return made.run(24.0, accel)


@settings(max_examples=4, deadline=None)
@given(
    st.integers(0, 1 << 20), st.floats(-0.29, 0.29), st.floats(-0.05, 0.05),
    st.floats(-0.0099, 0.0499), st.floats(3.0, 9.0), st.sampled_from([1, 2]),
)  # fmt: skip
def test_axles_that_slip_differently_down_to_the_stop_never_break_the_bounds(
    seed: int, share: float, other: float, scale: float, from_s: float, axle: int
) -> None:
    """The oracle is the motion of the train; the second axle may slip a little, too."""
    slips = ((from_s, 99.0, share, axle), (from_s + 1.0, 99.0, other, 3 - axle))

    assert_true(stops_past_a_tag(Errors(seed=seed, scale_ratio=scale, slips=slips)))


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("share", [-0.02, -0.05])
def test_one_sliding_axle_leaves_the_place_narrow_enough_for_doors(axle: int, share: float) -> None:
    slips = ((3.0, 99.0, share, axle),)
    history = stops_past_a_tag(Errors(seed=3, scale_ratio=0.02, slips=slips))

    assert_true(history)
    assert any(moment.motion.slip for moment in history)
    last = history[-1]
    assert last.speed_mps == 0.0
    assert last.motion.standstill
    assert last.motion.front_m.high - last.motion.front_m.low < 0.5


def test_a_locked_wheel_does_not_prove_that_the_train_stands() -> None:
    """Axle A locks at 0.6 m/s; axle B shows that the train runs on."""
    made = Rig(Errors(seed=4, slips=((8.0, 99.0, -1.0, 1),)))

    def accel(time_s: float, mps: float) -> float:
        return 0.3 if mps < 0.6 else 0.0

    history = made.run(9.0, accel)

    assert_true(history)
    assert not any(moment.motion.standstill for moment in history if moment.time_s > 7.0)
