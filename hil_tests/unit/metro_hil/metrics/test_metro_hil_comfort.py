"""Comfort of a run, against motions with a known answer."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from can_dbc.nodes import Direction
from can_dbc.vobc import AtoPhase, Supervision
from metro_hil.metrics.comfort import Comfort, CommandLog, comfort_of, felt_worst
from metro_hil.model.log_columns import Columns
from vobc.vocabulary import SAFE_OUTPUT

STEP_S = 0.05
LONG_S = 60.0
OVERSHOOT = 1.0432
"""Step response overshoot of a second-order Butterworth filter: 1 + exp(-π)."""
DRIVING = replace(
    SAFE_OUTPUT,
    direction=Direction.FORWARD,
    service_decel_mps2=0.0,
    emergency_released=True,
    holding_released=True,
    supervision=Supervision.NOMINAL,
    ato_phase=AtoPhase.RUNNING,
)


def log_of(*accels_mps2: np.ndarray, emergency: np.ndarray | None = None) -> Columns:
    """A truth log of a train whose cars have these accelerations, one value each `STEP_S`."""
    speeds_mps = np.stack([np.concatenate(([0.0], np.cumsum(a) * STEP_S)) for a in accels_mps2])
    count = speeds_mps.shape[1]
    on = np.zeros(count, dtype=bool) if emergency is None else emergency
    return Columns(
        "test",
        {
            "t_s": [repr(STEP_S * row) for row in range(count)],
            "speed_mps": [repr(float(v)) for v in speeds_mps.mean(axis=0)],
            "car_speeds_mps": [" ".join(map(repr, row.tolist())) for row in speeds_mps.T],
            "emergency": ["1" if value else "0" for value in on],
        },
        0,
    )


def over_time(times_s: list[float], accels_mps2: list[float]) -> np.ndarray:
    """Straight lines between these points; a jump has two points at one time."""
    return np.asarray(np.interp(np.arange(0.0, LONG_S, STEP_S), times_s, accels_mps2))


def sine(amplitude_mps2: float, frequency_hz: float) -> np.ndarray:
    """A sine that fades in from 5 s on; a mean acceleration belongs to the middle of its step."""
    times_s = np.arange(0.0, LONG_S, STEP_S) + 0.5 * STEP_S
    swing = amplitude_mps2 * np.sin(2.0 * np.pi * frequency_hz * (times_s - 5.0))
    return swing * np.clip((times_s - 5.0) / 10.0, 0.0, 1.0)


@pytest.mark.parametrize("jerk_mps3", [0.2, 0.5, 0.8])
def test_a_long_ramp_is_felt_with_its_slope_and_its_height(jerk_mps3: float) -> None:
    ramp_s = 2.0 / jerk_mps3

    felt = felt_worst(log_of(over_time([10.0, 10.0 + ramp_s, 50.0], [0.0, 2.0, 2.0])))

    # The beginning and the end of a ramp are steps of jerk, which the filter overshoots.
    assert felt["felt_jerk_2hz_mps3"] == pytest.approx(jerk_mps3 * OVERSHOOT, rel=0.01)
    assert felt["felt_jerk_1s_mps3"] == pytest.approx(jerk_mps3, rel=0.03)
    assert felt["felt_accel_max_mps2"] == pytest.approx(2.0, rel=0.03)


def test_a_step_counts_with_its_height_over_a_second_and_with_much_more_at_once() -> None:
    """For a second-order Butterworth filter the slope of the step response is at most exp(-π/4)
    / √2 · √2 ω."""
    felt = felt_worst(log_of(over_time([10.0, 10.001, 60.0], [0.0, 0.3, 0.3])))

    steepest_per_s = 2.0 * np.pi * 2.0 * np.exp(-np.pi / 4.0)
    assert felt["felt_accel_max_mps2"] == pytest.approx(0.3 * OVERSHOOT, rel=0.01)
    assert felt["felt_jerk_1s_mps3"] == pytest.approx(0.3 * OVERSHOOT, rel=0.03)
    assert felt["felt_jerk_2hz_mps3"] == pytest.approx(0.3 * steepest_per_s, rel=0.05)


@pytest.mark.parametrize(
    ("frequency_hz", "share"), [(0.5, 1.0), (2.0, 1.0 / np.sqrt(2.0)), (8.0, 0.025)]
)
def test_shaking_is_felt_up_to_two_hertz(frequency_hz: float, share: float) -> None:
    felt = felt_worst(log_of(sine(0.4, frequency_hz)))

    assert felt["felt_accel_max_mps2"] == pytest.approx(0.4 * share, rel=0.06, abs=0.01)


def test_the_worst_car_counts_and_not_the_mean() -> None:
    """Two cars that oscillate against each other leave the mean of the train at rest."""
    swing = sine(0.5, 0.5)

    felt = felt_worst(log_of(swing, -swing, 0.1 * swing))

    assert felt["felt_accel_max_mps2"] == pytest.approx(0.5, rel=0.03)
    assert felt["felt_jerk_2hz_mps3"] == pytest.approx(0.5 * 2.0 * np.pi * 0.5, rel=0.03)
    assert felt_worst(log_of(0.0 * swing))["felt_accel_max_mps2"] == 0.0


def test_the_jolt_into_the_standstill_is_felt() -> None:
    soft = felt_worst(
        log_of(over_time([5, 15, 15.001, 30, 30.001, 60], [0.1, 0.1, -0.1, -0.1, 0, 0]))
    )
    slow = felt_worst(log_of(over_time([5, 15, 20.0, 30, 35.0, 60], [0.1, 0.1, -0.1, -0.1, 0, 0])))

    soft_mps3, slow_mps3 = soft["felt_jerk_2hz_mps3"], slow["felt_jerk_2hz_mps3"]
    assert soft_mps3 is not None
    assert slow_mps3 is not None
    assert soft_mps3 > 5.0 * slow_mps3


def test_an_emergency_brake_and_its_aftermath_are_left_out() -> None:
    """The emergency brake gives 1.2 m/s² from 30 to 36 s; before it there are 0.5 m/s²."""
    accels = over_time(
        [5.0, 10.0, 20.0, 20.4, 30.0, 30.1, 36.0, 36.1], [0, 0.5, 0.5, 0, 0, -1.2, -1.2, 0]
    )
    times_s = np.arange(0.0, LONG_S + STEP_S / 2.0, STEP_S)
    emergency = (times_s >= 30.0) & (times_s <= 36.0)

    felt = felt_worst(log_of(accels, emergency=emergency))
    all_of_it = felt_worst(log_of(accels))

    assert felt["felt_accel_max_mps2"] == pytest.approx(0.5, rel=0.05)
    assert felt["felt_jerk_1s_mps3"] == pytest.approx(0.5, rel=0.05)
    assert all_of_it["felt_accel_max_mps2"] == pytest.approx(1.2 * OVERSHOOT, rel=0.05)


def test_an_emergency_brake_that_only_holds_leaves_nothing_out() -> None:
    accels = over_time([10.0, 10.001, 20.0, 20.001], [0.0, 0.4, 0.4, 0.0])
    times_s = np.arange(0.0, LONG_S + STEP_S / 2.0, STEP_S)

    felt = felt_worst(log_of(accels, emergency=times_s < 9.5))

    assert felt["felt_accel_max_mps2"] == pytest.approx(0.4 * OVERSHOOT, rel=0.02)


def test_a_log_without_cars_or_too_short_gives_no_measure() -> None:
    old = Columns("test", {"t_s": ["0", "1"] * 9, "speed_mps": ["0"] * 18}, 0)

    assert set(felt_worst(old).values()) == {None}
    assert set(felt_worst(log_of(np.zeros(5))).values()) == {None}
    assert comfort_of(None, None, inertia_kg=None) == Comfort()


def test_the_demand_is_effort_over_inertia_minus_brake() -> None:
    log = CommandLog(inertia_kg=100_000.0)

    for cycle, force_n in enumerate([0.0, 2_000.0, 4_500.0, 50_000.0]):
        log.output(cycle * STEP_S, replace(DRIVING, force_n=force_n))
    log.output(0.20, replace(DRIVING, force_n=50_000.0, ato_phase=AtoPhase.STOPPED))
    log.output(0.25, replace(DRIVING, service_decel_mps2=0.7, ato_phase=AtoPhase.STOPPING))
    log.output(0.30, replace(DRIVING, service_decel_mps2=0.72, ato_phase=AtoPhase.STOPPING))

    accel_mps2, jerk_mps3 = log.worst()

    assert accel_mps2 == pytest.approx(0.72)
    assert jerk_mps3 == pytest.approx((50_000.0 - 4_500.0) / 100_000.0 / STEP_S)


@pytest.mark.parametrize(
    "change",
    [
        {"ato_phase": AtoPhase.HOLDING},
        {"supervision": Supervision.SERVICE},
        {"emergency_released": False},
        {"holding_released": False},
    ],
)
def test_demands_that_operation_does_not_control_do_not_count(change: dict[str, Any]) -> None:
    log = CommandLog(inertia_kg=100_000.0)

    for cycle in range(9):
        log.output(cycle * STEP_S, replace(DRIVING, service_decel_mps2=1.9, **change))

    assert log.worst() == (None, None)


def test_the_cycle_log_agrees_with_the_commands() -> None:
    cycles = Columns(
        "test",
        {
            "t_s": ["0", "0.05", "0.1", "0.15"],
            "force_n": ["0", "2000", "0", "0"],
            "decel_mps2": ["0", "0", "0.01", "1.9"],
            "phase": ["running", "running", "approaching", "stopped"],
            "supervision": ["nominal", "warning", "nominal", "nominal"],
            "emergency_released": ["1", "1", "1", "1"],
            "holding_released": ["1", "1", "1", "0"],
        },
        0,
    )

    comfort = comfort_of(None, cycles, inertia_kg=100_000.0)

    assert comfort.commanded_accel_max_mps2 == pytest.approx(0.02)
    assert comfort.commanded_jerk_max_mps3 == pytest.approx(0.03 / STEP_S)
    assert comfort.felt_accel_max_mps2 is None


@pytest.mark.parametrize(
    ("frequency_hz", "weight"), [(0.2, 0.24), (0.4, 0.72), (1.0, 1.01), (2.0, 0.89)]
)
def test_the_index_of_en_12299_weighs_each_frequency_as_the_standard_does(
    frequency_hz: float, weight: float
) -> None:
    """A sine of 0.3 m/s² with the weights Wd of ISO 2631-1, table 3."""
    felt = felt_worst(log_of(sine(0.3, frequency_hz)))

    assert felt["en12299_index_ratio"] == pytest.approx(6.0 * weight * 0.3 / np.sqrt(2.0), rel=0.06)


def test_no_index_counts_windows_at_rest_or_in_an_emergency() -> None:
    swing = sine(0.3, 1.0)
    still = np.where(np.arange(len(swing)) < len(swing) // 2, swing, 0.0)
    always = np.ones(len(swing) + 1, dtype=bool)

    assert felt_worst(log_of(0.0 * swing))["en12299_index_ratio"] is None
    assert felt_worst(log_of(swing, emergency=always))["en12299_index_ratio"] is None
    assert felt_worst(log_of(still))["en12299_index_ratio"] == pytest.approx(1.27, rel=0.1)
