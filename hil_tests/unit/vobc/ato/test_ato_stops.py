"""Stop accuracy and comfort in closed loop, with noise, loads and both kinds of brake delay."""

import dataclasses
import itertools
import statistics
from typing import Any

import pytest

from can_dbc.vobc import AtoPhase
from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from hil_tests.unit.vobc.ato.ato_rig import Rig, quick_stops, run_line
from vobc.ato import Ato, AtoConfig
from vobc.vocabulary import BrakeFinding

LINE = load_line("florence")
CYCLE_S = 0.05


def brake_findings(rig: Rig) -> list[BrakeFinding]:
    found = [demand.brake_finding for demand in rig.trace.demands]
    return [each for each in found if each is not None]


@pytest.mark.parametrize("delay_s", [1.0, None], ids=["fixed", "drawn"])
def test_every_stop_lies_within_ten_centimetres(delay_s: float | None) -> None:
    """The runs combine loads of 0, 50 and 100 % with odometer errors over the whole range, four
    stops each."""
    rigs = [
        run_line(seed=100 + index, brake_delay_s=delay_s, load_ratio=load, odometer_error=error)
        for index, (load, error) in enumerate(
            (load, error) for load in (0.0, 0.5, 1.0) for error in (-0.01, 0.02, 0.05)
        )
    ]
    errors_m = [abs(stop.error_m) for rig in rigs for stop in rig.stops]

    assert not any(map(brake_findings, rigs)), "the brake is neither late nor weak"
    assert len(errors_m) == 36
    assert max(errors_m) <= 0.08
    assert statistics.fmean(errors_m) <= 0.03


def test_a_weak_brake_is_reported_once_before_each_stop() -> None:
    rig = run_line(seed=3, brake_delay_s=None, brake_gain=0.78, load_ratio=0.0)

    assert [found.late for found in brake_findings(rig)] == [False] * len(rig.stops)


def test_without_noise_the_stops_are_a_centimetre_or_better() -> None:
    rig = run_line(
        brake_delay_s=1.0,
        brake_gain=1.0,
        tag_sigma_m=0.0,
        speed_sigma_mps=0.0,
        start_scale_known=True,
        load_ratio=0.0,
    )

    assert statistics.fmean(abs(stop.error_m) for stop in rig.stops) <= 0.01


@pytest.mark.parametrize(
    "settings",
    [
        {"brake_gain": 0.85},
        {"brake_gain": 1.15},
        {"brake_lag_s": 0.7},
        {"brake_delays_s": (0.5, 1.5)},
        {"brake_delays_s": (1.5, 1.5), "brake_lag_s": 0.7, "brake_gain": 0.89},
        {"cycle_s": 0.1},
        {"cycle_s": 0.02},
        {"missed_tags": frozenset({103, 203, 303, 403})},
        {"missed_tags": frozenset({101, 201, 301, 401, 102, 202, 302, 402})},
    ],
    ids=["weak", "strong", "slow", "late", "late and weak", "100ms", "20ms", "no T3", "only T3"],
)
def test_stops_tolerate_parameters_that_differ_from_the_assumed_ones(
    settings: dict[str, Any],
) -> None:
    """The controller does not know the gain (±15 %), twice the lag, a delay of 1.5 s or missed
    tags."""
    rig = run_line(**{"seed": 5, "brake_delay_s": None, "odometer_error": 0.02} | settings)

    assert max(abs(stop.error_m) for stop in rig.stops) <= 0.10


@pytest.mark.parametrize(
    "lowered",
    [
        [(480.0, 430.0, 18.3), (375.0, 330.0, 17.8)],
        [(430.0, 410.0, 18.0), (380.0, 330.0, 17.0)],
        [(500.0, 470.0, 18.3), (410.0, 380.0, 17.8), (345.0, 320.0, 17.4)],
    ],
)
@pytest.mark.parametrize("seed", [0, 4, 6, 7])
def test_a_train_that_was_braked_before_still_stops_at_the_mark(
    seed: int, lowered: list[tuple[float, float, float]]
) -> None:
    """The ceiling falls and rises as behind another train; each brake application has its own
    delay.

    Each entry of `lowered` is: from and to which distance before the mark, m, and the speed, m/s.
    """
    stop = quick_stops()[0]
    settings = ato_rig.RigSettings(seed=seed, brake_delay_s=None, brake_delays_s=(0.5, 1.5))
    rig = ato_rig.Rig(Ato(AtoConfig(), LINE, 0.0, [stop]), LINE, settings, 0.0)
    applications = 0

    def served(rig: ato_rig.Rig) -> bool:
        nonlocal applications
        asked = [-demand.accel_mps2 > 0.0 for demand in rig.trace.demands[-2:]]
        applications += asked == [False, True]
        left_m = stop.stop_m - rig.front_m
        rig.ceiling_mps = min(
            [100.0, *(low_mps for begin_m, end_m, low_mps in lowered if begin_m >= left_m > end_m)]
        )
        return bool(rig.stops)

    rig.run(served)

    assert applications >= len(lowered)
    assert abs(rig.stops[0].error_m) <= 0.10


@pytest.mark.parametrize("freed_m", [130.0, 140.0, 150.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_train_that_drew_up_to_an_authority_and_got_a_longer_one_stops_at_the_mark(
    seed: int, freed_m: float
) -> None:
    """The train brakes for an end of authority 30 m before the mark. The end moves on and the
    train applies traction. Then it brakes again with another delay, just after the earlier brake
    has decayed."""
    stop = quick_stops()[0]
    settings = ato_rig.RigSettings(seed=seed, brake_delay_s=None, brake_delays_s=(0.5, 1.5))
    rig = ato_rig.Rig(Ato(AtoConfig(), LINE, 0.0, [stop]), LINE, settings, 0.0)
    pulled_again = False

    def served(rig: ato_rig.Rig) -> bool:
        nonlocal pulled_again
        left_m = stop.stop_m - rig.front_m
        rig.authority_end_m = LINE.end_m if left_m < freed_m else stop.stop_m - 30.0
        pulled_again = pulled_again or (
            0.0 < left_m < freed_m and rig.trace.demands[-1].accel_mps2 > 0.0
        )
        return bool(rig.stops)

    rig.run(served)

    assert pulled_again
    assert abs(rig.stops[0].error_m) <= 0.10


def test_legs_and_the_last_fifty_metres_take_little_time() -> None:
    rig = run_line(seed=3, odometer_error=0.02)

    assert statistics.fmean(stop.leg_s for stop in rig.stops) <= 105.0
    assert max(stop.last_50_m_s for stop in rig.stops) <= 25.0
    hop = next(stop for stop in rig.stops if stop.station == "III")
    assert hop.leg_s <= 70.0


@pytest.mark.parametrize("delay_s", [1.0, None], ids=["fixed", "drawn"])
def test_demands_stay_within_acceleration_and_jerk(delay_s: float | None) -> None:
    """The test checks every cycle of the line, including position jumps at tags."""
    demands = run_line(seed=11, brake_delay_s=delay_s, odometer_error=0.05).trace.demands

    for before, after in itertools.pairwise(demands):
        assert abs(after.accel_mps2) <= 0.8 + 1e-9
        assert abs(after.accel_mps2 - before.accel_mps2) <= 0.6 * CYCLE_S + 1e-9


def test_the_brake_is_applied_once_for_each_stop() -> None:
    """From the first brake demand of an approach until the stop, the demand never returns to
    zero."""
    rig = run_line(seed=4, brake_delay_s=None, odometer_error=0.03)

    approaching = (AtoPhase.APPROACHING, AtoPhase.STOPPING)
    braking = False
    for demand in rig.trace.demands:
        if demand.phase not in approaching:
            braking = False
        elif braking:
            assert demand.accel_mps2 < 0.0
        else:
            braking = demand.accel_mps2 < 0.0


def test_the_last_step_at_the_stop_is_small() -> None:
    """The test takes the deceleration below 0.1 m/s on the level, before the holding brake acts."""
    rig = run_line(seed=2, brake_delay_s=None, odometer_error=0.02)

    trace = rig.trace
    last = [
        -accel
        for accel, speed, demand in zip(
            trace.accels_mps2, trace.speeds_mps, trace.demands, strict=True
        )
        if demand.phase is AtoPhase.STOPPING and 0.02 < speed < 0.1 and not demand.hold
    ]
    assert last
    assert max(last) <= 0.2


def test_the_ceiling_is_never_reached() -> None:
    """The limits are 70, 40 and again 70 km/h; the speed stays below the lowest one under the
    whole train."""
    rig = run_line(seed=6, brake_delay_s=None, odometer_error=0.0)

    trace = rig.trace
    for front_m, speed_mps in zip(trace.fronts_m, trace.speeds_mps, strict=True):
        limit_mps = LINE.least_limit_mps(front_m - ato_rig.TRAIN_LENGTH_M, front_m)
        assert speed_mps <= limit_mps + 0.05


def test_the_train_does_not_roll_back_where_it_stops_uphill() -> None:
    """The train stops entirely on +30 per mille and departs from there.

    Without traction gravity would end the stop with a step of 0.27 m/s².
    """
    stop = dataclasses.replace(LINE.station("I"), stop_m=745.0, platform_start_m=660.0)
    uphill = dataclasses.replace(LINE, stations=(stop, LINE.station("IV")), tags=())
    rig = ato_rig.Rig(
        Ato(
            AtoConfig(), uphill, 500.0, [dataclasses.replace(stop, dwell_s=1.0), uphill.stations[1]]
        ),
        uphill,
        ato_rig.RigSettings(seed=1, start_scale_known=True),
        500.0,
    )

    lowest_mps = 0.0

    def away(rig: ato_rig.Rig) -> bool:
        nonlocal lowest_mps
        lowest_mps = min(lowest_mps, rig.speed_mps)
        return rig.front_m > 760.0

    rig.run(away)

    trace = rig.trace
    still = next(index for index, mps in enumerate(trace.speeds_mps) if index > 200 and mps <= 0.0)
    assert -0.12 <= trace.accels_mps2[still - 2] < 0.0
    assert abs(rig.stops[0].error_m) <= 0.10
    assert lowest_mps >= -0.02


def test_the_printed_scheme_misses_under_a_delayed_brake() -> None:
    """The published scheme fails on the train on which the other law stops in time."""
    config = AtoConfig(strategy="pid_literal")
    for seed in (1, 2):
        stops = quick_stops()
        rig = ato_rig.Rig(
            Ato(config, LINE, 0.0, stops),
            LINE,
            ato_rig.RigSettings(seed=seed, odometer_error=None, brake_delay_s=1.0),
            0.0,
        )
        rig.run(lambda rig: rig.now_s > 30.0 and rig.still_s > 5.0 and rig.held)
        assert abs(rig.front_m - 1500.0) > 0.10


def test_the_shipped_tags_lie_where_the_scheme_expects_them() -> None:
    """T1, T2 and T3 of every station lie where the scheme expects the antenna."""
    expected = {"t1": 50.0, "t2": 10.0, "t3": 1.5}
    for tag in LINE.tags:
        if tag.kind.value in expected:
            assert tag.station is not None
            stop_m = LINE.station(tag.station).stop_m
            distance_m = stop_m - (tag.position_m + ato_rig.ANTENNA_M)
            assert distance_m == pytest.approx(expected[tag.kind.value])
