"""The PID law and its published original: delay margins, references over the position, stops."""

import itertools
import statistics
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.trackdb import load_line
from hil_tests.unit.vobc.ato import ato_rig
from hil_tests.unit.vobc.ato.ato_rig import quick_stops, run_line
from vobc.ato import Ato, AtoConfig
from vobc.ato.laws.pid import PidPredicted
from vobc.ato.laws.pid_reference import SpeedCurve, rise, slow_down, stop_at_platform
from vobc.ato.settings.pid import PidGains, PidScheme, PrintedScheme, falling_decel

LINE = load_line("florence")
LAG_S = 0.3
"""Lag of the brake for which the published delay margins hold."""


def delay_margin_s(gains: PidGains, integrators: int) -> float:
    """The largest dead time at which the loop with these gains, a lag and `integrators` is stable.

    The function computes it from the frequency response: phase margin over crossover frequency.
    """
    w = np.geomspace(1e-3, 1e3, 400_001)
    s = 1j * w
    loop = (gains.kp_per_s + gains.ki_per_s2 / s + gains.kd_ratio * s) / s**integrators
    loop = loop / (1.0 + LAG_S * s)
    last = int(np.flatnonzero(np.abs(loop) >= 1.0)[-1])
    phase_to_spare = np.mod(np.angle(loop[last]) + np.pi, 2.0 * np.pi)
    return float(phase_to_spare / w[last])


@pytest.mark.parametrize(
    ("name", "integrators", "margin_s"),
    [("rising", 1, 0.20), ("falling", 1, 3.3), ("constant", 1, 1.65), ("position", 2, 0.23)],
)
def test_the_published_gains_have_these_delay_margins(
    name: str, integrators: int, margin_s: float
) -> None:
    gains = getattr(PrintedScheme(), name)

    assert delay_margin_s(gains, integrators) == pytest.approx(margin_s, rel=0.02)


def swings(gains: PidGains, delay_s: float) -> tuple[float, float]:
    """Greatest errors in the first and in the second half minute of a point mass that the
    position loop moves from 0.1 m off the target."""
    dt_s = 0.005
    late = [0.0] * (round(delay_s / dt_s) + 1)
    x_m, v_mps, integral, accel_mps2 = 0.1, 0.0, 0.0, 0.0
    errors_m = []
    for _ in range(round(60.0 / dt_s)):
        integral += -x_m * dt_s
        asked = -gains.kp_per_s * x_m - gains.kd_ratio * v_mps + gains.ki_per_s2 * integral
        late.append(asked)
        accel_mps2 += (late.pop(0) - accel_mps2) * dt_s / LAG_S
        v_mps += accel_mps2 * dt_s
        x_m += v_mps * dt_s
        errors_m.append(abs(x_m))
    half = len(errors_m) // 2
    return max(errors_m[:half]), max(errors_m[half:])


def test_the_published_position_loop_is_unstable_with_one_second_of_delay() -> None:
    printed = PrintedScheme().position

    first_m, later_m = swings(printed, 1.0)
    assert later_m > 100.0 * first_m
    first_m, later_m = swings(printed, 0.1)
    assert later_m < 0.5 * first_m


def integrated(curve: SpeedCurve, from_m: float, step_m: float) -> tuple[float, float]:
    """Greatest deviation between the slope of v²/2 and the curve's acceleration, and greatest
    jerk."""
    places = np.arange(from_m, curve.length_m, step_m)
    points = [curve.at(float(place)) for place in places]
    worst = jump = 0.0
    for before, after in itertools.pairwise(points):
        slope = (after.speed_mps**2 - before.speed_mps**2) / (2.0 * step_m)
        worst = max(worst, abs(slope - (before.accel_mps2 + after.accel_mps2) / 2.0))
        spent_s = 2.0 * step_m / (before.speed_mps + after.speed_mps)
        jump = max(jump, abs(after.accel_mps2 - before.accel_mps2) / spent_s)
    return worst, jump


def test_accelerating_to_seventy_takes_the_distance_of_the_trapezoid() -> None:
    """The hand calculation from time and mean speed gives 249.3 m for 0.8 m/s² and 0.6 m/s³."""
    curve = rise(0.0, 0.0, 70.0 / 3.6, accel_mps2=0.8, jerk_mps3=0.6)

    assert curve.length_m == pytest.approx(249.3, abs=0.1)
    assert curve.top_mps == pytest.approx(70.0 / 3.6)


@given(from_mps=st.floats(0.5, 10.0), gain_mps=st.floats(0.3, 12.0), first_mps2=st.floats(0.0, 0.3))
def test_a_rise_respects_acceleration_and_jerk_and_ends_with_neither(
    from_mps: float, gain_mps: float, first_mps2: float
) -> None:
    curve = rise(from_mps, first_mps2, from_mps + gain_mps, accel_mps2=0.8, jerk_mps3=0.4)

    worst, jerk = integrated(curve, 0.01, curve.length_m / 500.0)
    assert max(curve.at(curve.length_m * share).accel_mps2 for share in (0.2, 0.5, 0.8)) <= 0.8
    assert jerk <= 0.4 * 1.05
    assert worst <= 0.02
    assert curve.at(curve.length_m + 1.0).accel_mps2 == 0.0


def test_the_fall_to_a_platform_passes_the_tags_at_their_speeds() -> None:
    config = AtoConfig(strategy="pid")
    scheme = config.pid
    curve = stop_at_platform(config, LINE, 1500.0, 19.0)

    assert curve.at(0.0).speed_mps == pytest.approx(0.0, abs=1e-4)
    assert curve.at(0.0).accel_mps2 == pytest.approx(scheme.last_decel_mps2, abs=1e-4)
    assert curve.at(scheme.t3_m).speed_mps == pytest.approx(scheme.t3_speed_mps, abs=0.02)
    assert curve.at(scheme.t2_m).speed_mps == pytest.approx(scheme.t2_speed_mps, abs=0.05)
    assert curve.at(scheme.t1_m).speed_mps == pytest.approx(15.0 / 3.6, abs=0.1)
    assert curve.top_mps == pytest.approx(19.0)
    assert max(curve.at(d).accel_mps2 for d in range(1, 400)) <= scheme.decel_mps2 + 1e-9


@given(speed_mps=st.floats(0.3, 19.0))
def test_place_and_speed_of_a_curve_are_inverse_functions(speed_mps: float) -> None:
    curve = stop_at_platform(AtoConfig(strategy="pid"), LINE, 1500.0, 19.4)

    assert curve.at(curve.place_of_m(speed_mps)).speed_mps == pytest.approx(speed_mps, abs=1e-4)


def test_slowing_down_ends_at_the_limit_without_deceleration() -> None:
    """From 70 to 15 km/h with 0.6 m/s² and 0.3 m/s³, the distance is mean speed times duration."""
    config = AtoConfig(strategy="pid")
    top_mps, low_mps = 70.0 / 3.6, 15.0 / 3.6
    curve = slow_down(config, to_mps=low_mps, decel_mps2=0.67, top_mps=top_mps)

    duration_s = (top_mps - low_mps) / 0.6 + 0.6 / 0.3
    assert curve.length_m == pytest.approx((top_mps + low_mps) / 2.0 * duration_s)
    end = curve.at(0.0)
    found = end.speed_mps, end.accel_mps2, end.jerk_mps3
    assert found == pytest.approx((low_mps, 0.0, 0.3), abs=1e-6)


@given(speed_mps=st.floats(0.2, 1.2), way_m=st.floats(0.8, 2.0))
def test_a_falling_deceleration_ends_at_rest_after_the_given_distance(
    speed_mps: float, way_m: float
) -> None:
    """The test integrates in small steps of time by the trapezoid rule."""
    first_mps2, stop_s = falling_decel(speed_mps, way_m, 0.08)
    last_mps2 = min(first_mps2, 0.08)
    time_s = np.linspace(0.0, stop_s, 20_001)
    speeds = speed_mps - np.concatenate(
        ([0.0], np.cumsum(np.full(20_000, stop_s / 20_000)
         * np.interp((time_s[1:] + time_s[:-1]) / 2.0, (0.0, stop_s), (first_mps2, last_mps2))))
    )  # fmt: skip

    assert speeds[-1] == pytest.approx(0.0, abs=1e-6)
    assert np.trapezoid(speeds, time_s) == pytest.approx(way_m, rel=1e-6)
    assert first_mps2 >= last_mps2


@pytest.mark.parametrize("delay_s", [1.0, None], ids=["fixed", "drawn"])
def test_the_repaired_law_stops_within_ten_centimetres(delay_s: float | None) -> None:
    errors_m = []
    for seed, load in enumerate((0.0, 0.5, 1.0)):
        rig = run_line(
            AtoConfig(strategy="pid"),
            seed=40 + seed,
            brake_delay_s=delay_s,
            load_ratio=load,
            odometer_error=0.02,
        )
        errors_m += [abs(stop.error_m) for stop in rig.stops]
        for before, after in itertools.pairwise(rig.trace.demands):
            assert abs(after.accel_mps2) <= 0.8 + 1e-9
            assert abs(after.accel_mps2 - before.accel_mps2) <= 0.6 * 0.05 + 1e-9

    assert max(errors_m) <= 0.10
    assert statistics.fmean(errors_m) <= 0.033


def test_without_t3_the_stop_is_made_under_speed_control() -> None:
    """Without any T3 the stop relies on the odometer, which T1 and T2 have scaled."""
    rig = run_line(
        AtoConfig(strategy="pid"),
        seed=3,
        odometer_error=0.02,
        missed_tags=frozenset(tag.tag_id for tag in LINE.tags if tag.kind.value == "t3"),
    )

    assert max(abs(stop.error_m) for stop in rig.stops) <= 0.15


def test_an_assumed_delay_misses_the_stop_where_the_identified_one_does_not() -> None:
    """The brake answers after 0.4 s, while the law without identification assumes 1 s."""
    errors_m = {}
    for identify in (True, False):
        config = AtoConfig(strategy="pid", pid=PidScheme(identify_delay=identify))
        rig = ato_rig.Rig(
            Ato(config, LINE, 0.0, quick_stops()),
            LINE,
            ato_rig.RigSettings(seed=2, brake_delay_s=0.4, brake_lag_s=0.35),
            0.0,
        )
        rig.run(lambda rig: rig.now_s > 30.0 and rig.still_s > 5.0 and rig.held)
        errors_m[identify] = abs(rig.front_m - 1500.0)

    assert errors_m[True] <= 0.10
    assert errors_m[False] > errors_m[True]


def test_the_dead_time_is_found_while_braking() -> None:
    ato = Ato(AtoConfig(strategy="pid"), LINE, 0.0, quick_stops())
    settings = ato_rig.RigSettings(seed=1, brake_delay_s=0.6, brake_lag_s=0.35)
    rig = ato_rig.Rig(ato, LINE, settings, 0.0)
    rig.run(lambda rig: rig.front_m > 1480.0)

    assert isinstance(ato.strategy, PidPredicted)
    assert ato.strategy.brake_dead_time_s == pytest.approx(0.6 + settings.link_s, abs=0.12)


@pytest.mark.parametrize(
    "settings",
    [
        {"t2_m": 60.0},
        {"t3_speed_mps": 1.4},
        {"last_decel_mps2": 0.5},
        {"t1_speed_mps": 9.0},
        {"decel_mps2": 0.0},
    ],
)
def test_impossible_sections_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"t2_m|t3_speed_mps|last_decel_mps2|tags|decel_mps2"):
        PidScheme(**settings)
