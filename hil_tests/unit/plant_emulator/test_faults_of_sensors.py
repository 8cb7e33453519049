"""Wrong wheels, tachos, radar and accelerometer on a running train."""

import itertools
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.nodes import Direction
from plant_emulator.sensors.tacho import Wheelset

ATrain = Callable[..., Any]
SPEED_MPS = 10.0


def rolled_m(train: Any) -> list[float]:
    return [axle.rolled_m for axle in train.world.tachos.axles]


def counts(train: Any) -> list[int]:
    return [axle.count(axle.rolled_m) for axle in train.world.tachos.axles]


def counted_m(train: Any) -> list[float]:
    return [count * 3.141592653589793 * 0.860 / 256 for count in counts(train)]


@pytest.mark.parametrize(
    ("axle", "shares"), [("a", (1.2, 1.0)), ("b", (1.0, 1.2)), ("both", 2 * (1.2,))]
)
def test_a_slipping_wheel_runs_ahead_of_the_train_while_the_fault_lasts(
    a_train: ATrain, axle: str, shares: tuple[float, float]
) -> None:
    fault = {"kind": "wheel_slip", "slip_ratio": 0.2, "axle": axle, "start_s": 1.0, "end_s": 3.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    train.run(1.0)
    start = rolled_m(train)

    train.run(2.0)
    during = [end - begin for begin, end in zip(start, rolled_m(train), strict=True)]
    train.run(1.0)
    after = [end - begin for begin, end in zip(start, rolled_m(train), strict=True)]

    assert during == pytest.approx([20.0 * share for share in shares])
    assert after == pytest.approx([20.0 * share + 10.0 for share in shares])


def test_a_locked_wheel_counts_nothing_until_the_fault_ends(a_train: ATrain) -> None:
    fault = {"kind": "wheel_slide", "slide_ratio": 1.0, "start_s": 1.0, "duration_s": 2.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    train.run(1.0)
    begin = counted_m(train)

    train.run(2.0)
    locked = counted_m(train)
    train.run(1.0)

    assert locked[0] == pytest.approx(begin[0], abs=0.011)
    assert locked[1] == pytest.approx(begin[1] + 20.0, abs=0.011)
    assert counted_m(train)[0] == pytest.approx(begin[0] + 10.0, abs=0.022)


def test_a_ramp_builds_up_and_ends_slip_slowly(a_train: ATrain) -> None:
    """The area under a trapezium of 2 s up, 2 s full and 2 s down equals that of 4 s full."""
    fault = {"kind": "wheel_slip", "slip_ratio": 0.4, "ramp_s": 2.0, "start_s": 1.0, "end_s": 5.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    ahead = [rolled_m(train)[0] - rolled_m(train)[1]]
    for _ in range(8):
        train.run(1.0)
        ahead.append(rolled_m(train)[0] - rolled_m(train)[1])

    gained = [later - earlier for earlier, later in itertools.pairwise(ahead)]
    assert gained == pytest.approx([0.0, 1.0, 3.0, 4.0, 4.0, 3.0, 1.0, 0.0], abs=0.03)
    assert sum(gained) == pytest.approx(16.0, abs=0.05)


@given(
    own_mps=st.floats(-5.0, 5.0),
    ratio=st.floats(-1.0, 2.0),
    speed_mps=st.floats(-20.0, 20.0),
)
def test_combined_slip_of_rail_and_fault_is_at_least_each_and_never_turns_a_wheel_back(
    own_mps: float, ratio: float, speed_mps: float
) -> None:
    if own_mps * speed_mps < 0.0:
        own_mps = max(-abs(speed_mps), min(abs(speed_mps), own_mps))
    axle = Wheelset(100.0, 0.0)
    axle.forced_slip_ratio = ratio

    axle.step(speed_mps * 0.01, own_mps, 0.01)

    slip_mps = axle.rolled_m / 0.01 - speed_mps
    forced_mps = ratio * speed_mps
    low, high = sorted((own_mps, forced_mps))
    if own_mps * forced_mps > 0.0:
        assert slip_mps == pytest.approx(low if high < 0.0 else high, abs=1e-6)
    else:
        assert slip_mps == pytest.approx(own_mps + forced_mps, abs=1e-6)
    tread_mps = speed_mps + slip_mps
    assert tread_mps * speed_mps >= -1e-6, "slides at most to a standstill"


def test_low_adhesion_weakens_the_brake_and_makes_the_wheels_slide(a_train: ATrain) -> None:
    fault = {"kind": "low_adhesion", "adhesion_ratio": 0.04, "end_s": 5.0}
    train = a_train(fault, speed_mps=15.0)

    train.run(5.0, train.EMERGENCY)
    decel_mps2, behind_m = train.decel_mps2, train.world.front_m - 2000.0 - rolled_m(train)[0]
    train.run(0.5, train.EMERGENCY)

    assert decel_mps2 == pytest.approx(0.04 * 9.81 / 1.08, rel=1e-3)
    assert behind_m > 3.0
    assert train.decel_mps2 == pytest.approx(1.2, rel=1e-3)


def test_of_two_slippery_rails_the_worse_counts(a_train: ATrain) -> None:
    train = a_train(
        {"kind": "low_adhesion", "adhesion_ratio": 0.05},
        {"kind": "low_adhesion", "adhesion_ratio": 0.10, "end_s": 1.0},
        {"kind": "low_adhesion", "adhesion_ratio": 0.90},
        speed_mps=5.0,
    )
    train.run(0.5)
    assert train.truth.adhesion_ratio == 0.05
    train.run(1.0)
    assert train.truth.adhesion_ratio == 0.05


def test_a_stuck_tacho_reports_itself_healthy(a_train: ATrain) -> None:
    fault = {"kind": "tacho_stuck", "axle": "b", "start_s": 1.0, "duration_s": 3.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    train.run(1.0)
    begin = counts(train)

    train.run(3.0)
    stuck, frame = counts(train), train.world.tachos.frame(train.world.now_ns)
    train.run(1.0)

    assert stuck[1] == begin[1]
    assert stuck[0] > begin[0] + 2500
    assert (frame.healthy_a, frame.healthy_b) == (True, True)
    assert counts(train)[1] - stuck[1] == pytest.approx(10.0 / (3.1415926 * 0.86) * 256, abs=2)


def test_a_failed_tacho_reports_it_and_counts_no_more(a_train: ATrain) -> None:
    fault = {"kind": "tacho_unhealthy", "axle": "both", "start_s": 1.0, "duration_s": 1.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    train.run(1.0)
    begin = counts(train)

    train.run(1.0)
    frame = train.world.tachos.frame(train.world.now_ns)
    later = train.world.tachos.frame(train.world.now_ns + 300_000_000)
    failed = counts(train)
    train.run(0.1)

    assert failed == begin
    assert (frame.healthy_a, frame.healthy_b) == (False, False)
    assert later.direction is Direction.NEUTRAL
    well = train.world.tachos.frame(train.world.now_ns)
    assert (well.healthy_a, well.healthy_b) == (True, True)


def test_drift_ends_with_the_fault_but_its_extra_pulses_stay(
    a_train: ATrain,
) -> None:
    """The integral of rate * t over ten seconds is half of its last value times the duration."""
    fault = {"kind": "tacho_drift", "ratio_per_s": 0.01, "start_s": 1.0, "end_s": 11.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    train.run(11.0)
    ahead_m = counted_m(train)[0] - counted_m(train)[1]
    train.run(5.0)

    assert ahead_m == pytest.approx(SPEED_MPS * 0.01 * 10.0**2 / 2.0, abs=0.02)
    assert counted_m(train)[0] - counted_m(train)[1] == pytest.approx(ahead_m, abs=0.022)


@pytest.mark.parametrize("ratio", [0.97, 1.03, 0.5])
def test_worn_wheels_count_more_without_a_jump(a_train: ATrain, ratio: float) -> None:
    fault = {"kind": "wheel_wear", "diameter_ratio": ratio, "axle": "a", "start_s": 1.0}
    train = a_train({**fault, "end_s": 3.0}, speed_mps=SPEED_MPS)
    before = counts(train)[0]
    greatest = 0
    for _ in train.each_step(4.0):
        now = counts(train)[0]
        greatest, before = max(greatest, now - before), now

    assert counted_m(train)[0] == pytest.approx(20.0 + 20.0 / ratio, abs=0.03)
    assert greatest <= 0.1 / ratio / (3.1415926 * 0.86) * 256 + 1


def test_faults_of_one_scale_multiply(a_train: ATrain) -> None:
    train = a_train(
        {"kind": "wheel_wear", "diameter_ratio": 0.8},
        {"kind": "wheel_wear", "diameter_ratio": 0.5},
        {"kind": "tacho_stuck", "axle": "b"},
        speed_mps=SPEED_MPS,
    )
    train.run(1.0)
    assert counted_m(train) == pytest.approx([25.0, 0.0], abs=0.02)


def test_a_blind_radar_reports_it(a_train: ATrain) -> None:
    train = a_train({"kind": "doppler_outage", "start_s": 1.0, "end_s": 2.0}, speed_mps=SPEED_MPS)
    seen = []
    for _ in range(3):
        train.run(1.0)
        seen.append(train.world.doppler.frame(SPEED_MPS))

    assert [frame.quality_percent for frame in seen] == [95.0, 0.0, 95.0]
    assert [frame.speed_mps for frame in seen] == pytest.approx([10.0, 0.0, 10.0])
    assert all(frame.healthy for frame in seen)


def test_a_wrong_radar_does_not_report_it(a_train: ATrain) -> None:
    fault = {"kind": "doppler_wrong", "error_ratio": -0.3, "end_s": 1.0}
    train = a_train(fault, speed_mps=SPEED_MPS)
    train.run(1.0)
    wrong = train.world.doppler.frame(SPEED_MPS)
    train.run(0.5)

    assert wrong.speed_mps == pytest.approx(7.0)
    assert wrong.quality_percent == 95.0
    assert train.world.doppler.frame(SPEED_MPS).speed_mps == pytest.approx(10.0)


def test_biases_of_the_accelerometer_add(a_train: ATrain) -> None:
    train = a_train(
        {"kind": "imu_bias", "bias_mps2": 0.5},
        {"kind": "imu_bias", "bias_mps2": -0.2, "end_s": 1.0},
        speed_mps=0.0,
    )
    shown = []
    for _ in range(2):
        train.run(1.0)
        shown.append(train.world.imu.frame(train.world.now_ns, 0.0, 0.0).accel_mps2)

    assert shown == pytest.approx([0.3, 0.5])
