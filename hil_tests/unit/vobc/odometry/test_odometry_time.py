"""The clocks of odometry: its own, which never goes back, and the age of each sensor's frames."""

from dataclasses import replace

import pytest

from can_dbc.nodes import Direction
from can_dbc.odometer import Doppler, Imu, Tacho
from vobc.odometry.sampling import FrameClock, OdometerClocks, OwnTime, SampleClock

MS = 1_000_000
S = 1_000_000_000
YEARS_NS = 10**18 + 1
"""Uptime at which a float can no longer resolve single nanoseconds."""

TACHO = Tacho(0, 0, Direction.FORWARD, True, True, 0.0)
RADAR, IMU = Doppler(0.0, 0.0, True), Imu(0.0, True)


# Clock of the odometer.


def test_before_the_first_cycle_no_time_has_passed() -> None:
    new = OwnTime()
    assert (new.begun, new.now_s, new.dt_s, new.steady) == (False, 0.0, 0.0, True)

    assert new.tell(7 * S) == 7.0
    assert (new.begun, new.now_s, new.dt_s, new.steady) == (True, 7.0, 0.0, True)


def test_own_time_advances_by_the_longest_step_when_the_clock_is_set_back() -> None:
    time = OwnTime()
    steps = [
        (time.tell(now_ns), time.dt_s, time.steady)
        for now_ns in (7 * S, 7 * S + 50 * MS, 2 * S, 2 * S + 50 * MS, 2 * S + 50 * MS)
    ]

    told_s = [7.0, 7.05, 7.05 + 0.1, 7.1 + 0.1, 7.1 + 0.1]
    assert [step[0] for step in steps] == pytest.approx(told_s)
    assert [step[1] for step in steps] == pytest.approx([0.0, 0.05, 0.1, 0.05, 0.0])
    assert [step[2] for step in steps] == [True, True, False, True, True]


def test_a_step_of_own_time_is_steady_up_to_its_longest() -> None:
    for step_ns, steady in ((100 * MS, True), (100 * MS + 1, False), (-1, False)):
        time = OwnTime()
        time.tell(0)
        time.tell(step_ns)

        assert time.steady is steady
        assert time.dt_s == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("cycle_s", "longest_ms"), [(0.02, 100), (0.0625, 100), (0.07, 105), (0.2, 300), (1.0, 1500)]
)
def test_one_and_a_half_cycles_of_a_slow_controller_are_no_gap(
    cycle_s: float, longest_ms: int
) -> None:
    for step_ns, steady in ((longest_ms * MS - 1_000, True), (longest_ms * MS + 1_000, False)):
        time = OwnTime()
        time.expect(cycle_s)
        time.tell(0)
        time.tell(step_ns)
        assert time.steady is steady
        time.tell(0)
        assert time.dt_s == pytest.approx(0.001 * longest_ms)
        assert not time.steady


# Clocks of the sensors.


@pytest.mark.parametrize("back_ns", [1, 300 * MS, 3 * S, 3600 * S])
def test_sensor_clocks_restart_when_the_clock_is_set_back(back_ns: int) -> None:
    tacho, radar = SampleClock(), FrameClock(50)
    for number in range(5):
        tacho.sampled_ns(7200 * S + number * 20 * MS, number, 20 * number)
        radar.sampled_ns(7200 * S + number * 50 * MS, number)
    now_ns = 7200 * S - back_ns
    assert tacho.sampled_ns(now_ns, 5, 100) == now_ns
    assert radar.sampled_ns(now_ns, 5) == now_ns
    assert tacho.sampled_ns(now_ns + 20 * MS, 6, 120) == now_ns + 20 * MS
    assert radar.sampled_ns(now_ns + 50 * MS, 6) == now_ns + 50 * MS


@pytest.mark.parametrize("first_ns", [0, 7_200 * S, YEARS_NS])
def test_a_frame_that_is_late_is_timed_to_the_nanosecond_however_long_the_board_is_up(
    first_ns: int,
) -> None:
    """A frame is 7 ms late after 50 or 20 ms. In these times two crystals of 100 ppm may deviate
    by 11 400 or 5 400 ns."""
    radar, tacho = FrameClock(50), SampleClock()
    assert radar.sampled_ns(first_ns, 255) == first_ns
    assert tacho.sampled_ns(first_ns, 255, 250.0) == first_ns

    assert radar.sampled_ns(first_ns + 57 * MS, 0) == first_ns + 50 * MS + 11_400
    assert tacho.sampled_ns(first_ns + 27 * MS, 0, 14.0) == first_ns + 20 * MS + 5_400


def test_radar_and_accelerometer_send_every_fifty_milliseconds() -> None:
    clocks = OdometerClocks()
    for frame in (RADAR, IMU):
        clocks.sampled_ns(frame, 0, 0)

        assert clocks.sampled_ns(frame, 57 * MS, 1) == 50 * MS + 11_400


def test_a_second_frame_that_comes_faster_than_the_first_does_not_count_as_a_queue() -> None:
    """The first frame was 30 ms late and there was no silence."""
    clock = FrameClock(50)
    clock.sampled_ns(30 * MS, 0)

    assert clock.sampled_ns(51 * MS, 1) == 51 * MS
    assert clock.sampled_ns(121 * MS, 2) == 101 * MS + 14_000
    assert clock.refused == 0


@pytest.mark.parametrize(("over_ns", "taken"), [(0, True), (1, False)])
def test_a_tenth_of_a_second_late_is_the_most(over_ns: int, *, taken: bool) -> None:
    """The clocks may have parted by 30 006 ns meanwhile."""
    clock = FrameClock(50)
    clock.sampled_ns(0, 0)

    assert (clock.sampled_ns(150 * MS + 30_006 + over_ns, 1) is not None) is taken


@pytest.mark.parametrize(("over_ns", "paced"), [(0, True), (1, False)])
def test_in_step_is_ten_milliseconds_early_at_the_most(over_ns: int, *, paced: bool) -> None:
    """After 20 s of silence, five frames in step are needed; one out of step restarts the count."""
    clock = FrameClock(50)
    clock.sampled_ns(0, 0)
    clock.sampled_ns(20_050 * MS, 401 % 256)
    clock.sampled_ns(20_090 * MS - over_ns, 402 % 256)
    later = [clock.sampled_ns((20_150 + 50 * n) * MS, (403 + n) % 256) for n in range(6)]

    assert [found_ns is not None for found_ns in later].index(True) == (3 if paced else 4)


def test_a_tacho_frame_without_a_stamp_counts_as_stamped_at_zero() -> None:
    """The stamp is 6 ms out of step with the counter; 5 ms would be tolerated."""
    clock = SampleClock()
    clock.sampled_ns(0, 0, 242.0)

    assert clock.sampled_ns(30 * MS, 1) == 30 * MS
    assert clock.restarts == 1


@pytest.mark.parametrize("first_ns", [0, YEARS_NS])
def test_a_restarted_sensor_is_timed_from_its_restart_to_the_nanosecond(first_ns: int) -> None:
    clock = SampleClock()
    clock.sampled_ns(first_ns, 0, 0.0)
    clock.sampled_ns(first_ns + 20 * MS, 1, 20.0)
    assert clock.sampled_ns(first_ns + 30 * MS, 70, 100.0) == first_ns + 30 * MS
    assert clock.restarts == 1

    assert clock.sampled_ns(first_ns + 57 * MS, 71, 120.0) == first_ns + 50 * MS + 5_400
    assert clock.restarts == 1


def test_all_three_sensors_of_one_odometer_count_late_frames() -> None:
    clocks = OdometerClocks()
    for frame in (TACHO, RADAR, IMU):
        clocks.sampled_ns(frame, 0, 0)
    assert clocks.sampled_ns(replace(TACHO, stamp_ms=20.0), 500 * MS, 1) is None
    assert clocks.refused == 1
    assert clocks.sampled_ns(RADAR, 500 * MS, 1) is None
    assert clocks.refused == 2
    assert clocks.sampled_ns(IMU, 500 * MS, 1) is None
    assert clocks.refused == 3
