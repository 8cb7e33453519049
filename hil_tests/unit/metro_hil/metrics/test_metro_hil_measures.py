"""Measures of a run, against motions with a known answer."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from firmware_py.trackdb import Station
from metro_hil.metrics.case import motion_measures
from metro_hil.metrics.run import measure_cycles, measure_ride, supervision_events
from metro_hil.metrics.stops import measure_stops
from metro_hil.model.log_columns import Columns, RunLogError, read_columns

STEP_S = 0.05
STATION = Station("A", stop_m=100.0, platform_start_m=20.0, platform_end_m=105.0)
TRUTH_MOTION = ("t_s", "front_m", "speed_mps")
BEYOND = Station("B", stop_m=900.0, platform_start_m=820.0, platform_end_m=905.0)


def columns_of(**values: list[float]) -> Columns:
    return Columns("test", {name: [repr(v) for v in column] for name, column in values.items()}, 0)


def motion(speeds_mps: list[float], start_m: float = 0.0) -> Columns:
    """A truth log of a train that has these speeds, one row each `STEP_S`."""
    front_m, fronts_m = start_m, []
    for index, speed_mps in enumerate(speeds_mps):
        if index:
            front_m += (speed_mps + speeds_mps[index - 1]) / 2.0 * STEP_S
        fronts_m.append(front_m)
    times_s = [index * STEP_S for index in range(len(speeds_mps))]
    return columns_of(t_s=times_s, front_m=fronts_m, speed_mps=speeds_mps)


def trapezoid(accel_mps2: float, top_mps: float, cruise_rows: int) -> list[float]:
    steps = round(top_mps / accel_mps2 / STEP_S)
    up = [accel_mps2 * STEP_S * index for index in range(steps + 1)]
    return [0.0] * 20 + up + [top_mps] * cruise_rows + up[::-1] + [0.0] * 40


def test_a_stop_is_measured_where_the_train_stands() -> None:
    speeds_mps = trapezoid(0.5, 5.0, 100)
    way_m = float(motion(speeds_mps).numbers("front_m")[-1])

    (stop,) = measure_stops(motion(speeds_mps, start_m=100.07 - way_m), [STATION])

    assert stop.error_m == pytest.approx(0.07, abs=1e-9)
    assert stop.run_time_s == pytest.approx(10.0 + 10.0 + 5.0, abs=2 * STEP_S)


def test_the_standstill_before_the_start_is_no_stop() -> None:
    """A train that never leaves a place far from the station has not stopped at it."""
    (stop,) = measure_stops(motion([0.0] * 50, start_m=30.0), [STATION])

    assert stop.error_m is None


def test_a_station_that_was_not_reached_has_no_error() -> None:
    stops = measure_stops(motion(trapezoid(0.5, 5.0, 50), start_m=0.0), [STATION, BEYOND])

    assert stops[1].error_m is None
    assert stops[1].run_time_s is None


def jogged(first_m: float) -> Columns:
    """A train that stops at `first_m`, then jogs and opens its doors one second later."""
    first, second = trapezoid(0.5, 5.0, 100), trapezoid(0.25, 0.5, 60)
    way_m = float(motion(first).numbers("front_m")[-1])
    log = motion(first + second, start_m=first_m - way_m)
    doors = ["locked"] * (len(log) - 20) + ["open"] * 20
    return Columns.of_rows(
        "truth",
        ("t_s", "front_m", "speed_mps", "door_left", "door_right"),
        [
            (*row, "locked", door)
            for *row, door in zip(
                *(log.numbers(name).tolist() for name in ("t_s", "front_m", "speed_mps")),
                doors,
                strict=True,
            )
        ],
    )


def test_a_corrected_stop_counts_where_the_train_stood_first() -> None:
    """The train stops 2.5 m short and tries again. The doors open where it stands then."""
    (stop,) = measure_stops(jogged(97.5), [STATION])

    assert stop.error_m == pytest.approx(-2.5, abs=1e-9)
    assert stop.run_time_s == pytest.approx(25.0, abs=2 * STEP_S)
    assert stop.jogs == 1
    assert stop.doors_error_m == pytest.approx(0.0, abs=0.03)
    assert stop.doors_delay_s == pytest.approx(2.0 + 1.0 + 2.0 + 3.0 + 2.0 + 1.0, abs=0.3)


def test_a_standstill_far_before_the_stop_is_no_stop_if_the_train_goes_on() -> None:
    """It waits 20 m before the stop for its authority."""
    first = trapezoid(0.5, 5.0, 100)
    second = trapezoid(0.5, 2.0, 160)
    way_m = float(motion(first).numbers("front_m")[-1])
    beyond_m = float(motion(second).numbers("front_m")[-1])

    (stop,) = measure_stops(motion(first + second, start_m=100.0 - beyond_m - way_m), [STATION])

    assert stop.error_m == pytest.approx(0.0, abs=1e-9)
    assert stop.jogs == 0
    assert stop.run_time_s is not None
    assert stop.run_time_s > 40.0


def test_a_settling_of_the_couplers_is_neither_a_jog_nor_a_departure() -> None:
    first = trapezoid(0.5, 5.0, 100)
    speeds_mps = first + [1e-3, -1e-3] * 5 + [0.0] * 40 + trapezoid(0.5, 5.0, 400)
    way_m = float(motion(first).numbers("front_m")[-1])
    log = motion(speeds_mps, start_m=100.0 - way_m)
    after = Station(
        "B", stop_m=float(log.numbers("front_m")[-1]), platform_start_m=0.0, platform_end_m=300.0
    )

    stop, later = measure_stops(log, [STATION, after])

    assert stop.jogs == 0
    assert later.run_time_s == pytest.approx(10.0 + 10.0 + 20.0, abs=4 * STEP_S)


def test_doors_that_stay_shut_have_neither_place_nor_delay() -> None:
    speeds_mps = trapezoid(0.5, 5.0, 100)
    way_m = float(motion(speeds_mps).numbers("front_m")[-1])

    (stop,) = measure_stops(motion(speeds_mps, start_m=100.0 - way_m), [STATION])

    assert stop.doors_error_m is None
    assert stop.doors_delay_s is None


def test_acceleration_of_a_steady_ramp_is_its_slope() -> None:
    ride = measure_ride(motion(trapezoid(0.7, 14.0, 100)))

    # The step at the start of the ramp overshoots a second-order Butterworth filter by 4.3 %.
    assert ride.max_accel_mps2 == pytest.approx(0.7 * 1.0432, rel=0.01)
    assert ride.top_speed_mps == pytest.approx(14.0)


@pytest.mark.parametrize("jerk_mps3", [0.2, 0.6, 1.0])
def test_jerk_of_a_slow_ramp_of_acceleration_is_its_slope(jerk_mps3: float) -> None:
    times_s = np.arange(0.0, 20.0, STEP_S)
    ramp_s = 0.8 / jerk_mps3
    accel = np.interp(
        times_s, [5.0, 5.0 + ramp_s, 9.0 + ramp_s, 9.0 + 2 * ramp_s], [0, 0.8, 0.8, 0]
    )
    speeds_mps = np.concatenate(([0.0], np.cumsum(accel) * STEP_S))

    ride = measure_ride(motion(speeds_mps.tolist()))

    assert ride.max_jerk_mps3 == pytest.approx(jerk_mps3, rel=0.08)


def test_a_sudden_halt_is_felt_as_jerk() -> None:
    """A deceleration that ends in an instant is felt in proportion to its size."""
    soft = measure_ride(motion(trapezoid(0.1, 5.0, 50))).max_jerk_mps3
    hard = measure_ride(motion(trapezoid(0.5, 5.0, 50))).max_jerk_mps3

    assert hard == pytest.approx(5.0 * soft, rel=0.01)


def test_a_log_too_short_to_measure_gives_zero() -> None:
    assert measure_ride(motion([0.0, 0.1])).max_jerk_mps3 == 0.0


def test_cycles_count_slips_and_find_the_least_margin() -> None:
    cycles = measure_cycles(
        columns_of(
            t_s=[0.0, 0.05, 0.1],
            work_us=[100.0, 300.0, 200.0],
            lateness_us=[1.0, 2.0, 99.0],
            speed_mps=[0.0, 10.0, 12.0],
            emergency_mps=[0.0, 12.5, 13.0],
            slips=[0.0, 0.0, 2.0],
        )
    )

    assert (cycles.cycles, cycles.slips) == (3, 2)
    assert cycles.work_us_p50 == 200.0
    assert cycles.lateness_us_max == 99.0
    assert cycles.least_margin_mps == pytest.approx(1.0), "a standing train has no margin to lose"


def test_cycles_of_a_train_that_never_moved_have_no_margin() -> None:
    cycles = measure_cycles(
        columns_of(
            t_s=[0.0],
            work_us=[1.0],
            lateness_us=[1.0],
            speed_mps=[0.0],
            emergency_mps=[5.0],
            slips=[0.0],
        )
    )

    assert math.isnan(cycles.least_margin_mps)


def test_supervision_events_are_the_changes() -> None:
    log = Columns(
        "test",
        {
            "t_s": ["0", "1", "2", "3"],
            "supervision": ["no_authority", "nominal", "nominal", "emergency"],
            "cause": ["waits", "", "", "overspeed"],
        },
        0,
    )

    events = supervision_events(log)

    assert [(e.at_s, e.state, e.cause) for e in events] == [
        (0.0, "no_authority", "waits"),
        (1.0, "nominal", ""),
        (3.0, "emergency", "overspeed"),
    ]


def test_a_torn_last_row_is_counted_and_not_used(tmp_path: Path) -> None:
    log = tmp_path / "cycles.csv"
    log.write_text("t_s,speed_mps\n0.0,1.0\n0.05,1.1\n0.1")

    read = read_columns(log)

    assert len(read) == 2
    assert read.torn_rows == 1


def test_an_empty_field_is_not_a_number(tmp_path: Path) -> None:
    log = tmp_path / "cycles.csv"
    log.write_text("t_s,speed_mps\n0.0,\n")

    assert np.isnan(read_columns(log).numbers("speed_mps")[0])


@pytest.mark.parametrize(
    ("text", "word"), [("", "empty"), ("t_s,speed_mps\n1,fast\n", "speed_mps")]
)
def test_a_useless_log_names_file_and_column(tmp_path: Path, text: str, word: str) -> None:
    log = tmp_path / "cycles.csv"
    log.write_text(text)

    with pytest.raises(RunLogError, match=word) as caught:
        read_columns(log).numbers("speed_mps")

    assert "cycles.csv" in str(caught.value)


def test_a_missing_column_is_reported_with_the_existing_ones(tmp_path: Path) -> None:
    log = tmp_path / "cycles.csv"
    log.write_text("t_s,speed_mps\n0,1\n")

    with pytest.raises(RunLogError, match="no column front_m; it has t_s, speed_mps"):
        read_columns(log).numbers("front_m")


# Doors that stay shut, and trains that stay.


def stood(*, off_m: float, seconds: float, opens: bool) -> dict[str, float | None]:
    """Measures of a train that runs to the station and stands there that long."""
    speeds_mps = trapezoid(0.5, 5.0, 100) + [0.0] * round(seconds / STEP_S - 40)
    way_m = float(motion(speeds_mps).numbers("front_m")[-1])
    moved = motion(speeds_mps, start_m=100.0 + off_m - way_m)
    doors = ["LOCKED"] * len(speeds_mps)
    if opens:
        doors[-20:] = ["OPEN"] * 20
    columns = {name: [repr(float(x)) for x in moved.numbers(name)] for name in TRUTH_MOTION}
    rest = {"emergency": ["0"] * len(speeds_mps), "door_left": [d.lower() for d in doors]}
    truth = Columns("test", {**columns, **rest}, 0)
    return motion_measures(truth, [replace(STATION, dwell_s=30.0)])


@pytest.mark.parametrize(
    ("off_m", "seconds", "opens", "shut", "stranded"),
    [
        (0.1, 90.0, True, 0.0, 0.0),
        (0.1, 90.0, False, 1.0, 1.0),
        (0.1, 50.0, False, 1.0, 0.0),
        (-80.0, 90.0, False, 0.0, 1.0),
    ],
)
def test_doors_that_stay_shut_and_trains_that_stay_are_counted(
    off_m: float, seconds: float, opens: bool, shut: float, stranded: float
) -> None:
    measures = stood(off_m=off_m, seconds=seconds, opens=opens)

    assert (measures["doors_shut_count"], measures["stranded_count"]) == (shut, stranded)


def test_a_stop_without_dwell_time_needs_no_doors() -> None:
    speeds_mps = trapezoid(0.5, 5.0, 100) + [0.0] * 1400
    way_m = float(motion(speeds_mps).numbers("front_m")[-1])
    moved = motion(speeds_mps, start_m=100.0 - way_m)
    columns = {name: [repr(float(x)) for x in moved.numbers(name)] for name in TRUTH_MOTION}
    truth = Columns("test", {**columns, "emergency": ["0"] * len(speeds_mps)}, 0)
    measures = motion_measures(truth, [replace(STATION, dwell_s=0.0)])

    assert (measures["doors_shut_count"], measures["stranded_count"]) == (0.0, 0.0)
