"""Trapezoids, braking curves and limits, replayed step by step as motion."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py.trackdb import LineMap, SpeedSection, Station, load_line
from vobc.ato.motion import profile, trapezoid
from vobc.ato.settings.ato import AtoConfig, Braking, Limits

FINE_S = 1e-3


def replay_ramp(
    from_mps: float, to_mps: float, accel_mps2: float, jerk_mps3: float
) -> tuple[float, float, float]:
    """Time, distance and largest acceleration of a speed change in three parts: build up, hold,
    ease."""
    size_mps, sign = abs(to_mps - from_mps), math.copysign(1.0, to_mps - from_mps)
    peak_mps2 = min(accel_mps2, math.sqrt(size_mps * jerk_mps3))
    build_s = peak_mps2 / jerk_mps3
    hold_s = max(0.0, (size_mps - peak_mps2 * build_s) / accel_mps2)
    total_s = 2.0 * build_s + hold_s
    count = 4000
    step_s = total_s / count
    speed_mps, distance_m, accel, most = from_mps, 0.0, 0.0, 0.0
    for index in range(count):
        at_s = (index + 0.5) * step_s
        accel = sign * min(peak_mps2, jerk_mps3 * at_s, jerk_mps3 * (total_s - at_s))
        distance_m += (speed_mps + accel * step_s / 2.0) * step_s
        speed_mps += accel * step_s
        most = max(most, abs(accel))
    assert speed_mps == pytest.approx(to_mps, abs=1e-3)
    return total_s, distance_m, most


@settings(max_examples=40, deadline=None)
@given(
    from_mps=st.floats(0.0, 20.0),
    to_mps=st.floats(0.0, 20.0),
    accel_mps2=st.floats(0.2, 1.2),
    jerk_mps3=st.floats(0.2, 1.5),
)
def test_a_speed_change_takes_the_time_and_distance_of_its_replayed_motion(
    from_mps: float, to_mps: float, accel_mps2: float, jerk_mps3: float
) -> None:
    if abs(to_mps - from_mps) < 0.01:
        return
    total_s, distance_m, most = replay_ramp(from_mps, to_mps, accel_mps2, jerk_mps3)

    assert most <= accel_mps2 + 1e-9
    change_s = trapezoid.ramp_s(to_mps - from_mps, accel_mps2=accel_mps2, jerk_mps3=jerk_mps3)
    change_m = trapezoid.ramp_m(from_mps, to_mps, accel_mps2=accel_mps2, jerk_mps3=jerk_mps3)
    assert change_s == pytest.approx(total_s)
    assert change_m == pytest.approx(distance_m, rel=1e-3, abs=1e-2)


@pytest.mark.parametrize(
    ("from_kmh", "to_kmh", "duration_s", "distance_m"),
    [(0.0, 70.0, 25.64, 249.3), (70.0, 15.0, 20.4, 241.2)],
)
def test_the_paper_s_speed_changes_take_their_known_time(
    from_kmh: float, to_kmh: float, duration_s: float, distance_m: float
) -> None:
    from_mps, to_mps = from_kmh / 3.6, to_kmh / 3.6

    change_s = trapezoid.ramp_s(to_mps - from_mps, accel_mps2=0.8, jerk_mps3=0.6)

    assert change_s == pytest.approx(duration_s, abs=0.05)
    change_m = trapezoid.ramp_m(from_mps, to_mps, accel_mps2=0.8, jerk_mps3=0.6)
    assert change_m == pytest.approx(distance_m, abs=0.2)


@settings(max_examples=50, deadline=None)
@given(
    speed_mps=st.floats(5.0, 20.0),
    from_mps2=st.floats(-0.8, 0.8),
    to_mps2=st.floats(-0.8, 0.8),
)
def test_a_swing_of_acceleration_takes_the_distance_of_its_replayed_motion(
    speed_mps: float, from_mps2: float, to_mps2: float
) -> None:
    after_mps, travel_m = trapezoid.swing(
        speed_mps, from_mps2=from_mps2, to_mps2=to_mps2, jerk_mps3=0.6
    )

    count = round(abs(to_mps2 - from_mps2) / 0.6 / FINE_S)
    v_mps, x_m = speed_mps, 0.0
    for index in range(count):
        accel = from_mps2 + math.copysign(0.6, to_mps2 - from_mps2) * (index + 0.5) * FINE_S
        x_m += (v_mps + accel * FINE_S / 2.0) * FINE_S
        v_mps += accel * FINE_S
    assert after_mps == pytest.approx(v_mps, abs=2e-3)
    assert travel_m == pytest.approx(x_m, abs=3e-2)


def stop_curve(
    steady_mps2: float = 0.67, final_mps2: float = 0.08
) -> profile.ReferenceBrakingCurve:
    return profile.stopping_curve(Braking(), steady_mps2=steady_mps2, final_mps2=final_mps2)


@settings(max_examples=40, deadline=None)
@given(
    speed_mps=st.floats(0.05, 20.0),
    steady_mps2=st.floats(0.15, 0.8),
    final_mps2=st.floats(0.05, 0.6),
)
def test_a_train_that_follows_the_curve_stops_at_its_end(
    speed_mps: float, steady_mps2: float, final_mps2: float
) -> None:
    """The replay reads only the deceleration at each step; distance and time must agree."""
    curve = stop_curve(steady_mps2, final_mps2)
    promised = curve.at_speed(speed_mps)

    v_mps, x_m, t_s, last_mps2 = speed_mps, 0.0, 0.0, promised.decel_mps2
    while v_mps > 0.0:
        decel_mps2 = curve.at_speed(v_mps).decel_mps2
        assert abs(decel_mps2 - last_mps2) <= 0.6 * FINE_S
        last_mps2 = decel_mps2
        step_s = min(FINE_S, v_mps / decel_mps2)
        x_m += (v_mps - decel_mps2 * step_s / 2.0) * step_s
        v_mps = max(0.0, v_mps - decel_mps2 * step_s) if step_s == FINE_S else 0.0
        t_s += step_s

    assert x_m == pytest.approx(promised.distance_m, rel=2e-3, abs=2e-3)
    assert t_s == pytest.approx(promised.time_to_go_s, rel=2e-3, abs=2e-3)


@settings(max_examples=60, deadline=None)
@given(distance_m=st.floats(20.0, 2000.0))
def test_the_peak_speed_uses_the_section_and_no_more(distance_m: float) -> None:
    limit_mps = 70.0 / 3.6
    curve = stop_curve()

    peak_mps = profile.peak_speed_mps(
        0.0,
        distance_m,
        curve,
        accel_mps2=0.8,
        jerk_mps3=0.6,
        change_over_s=1.0,
        limit_mps=limit_mps,
    )

    _, rise_m, _ = replay_ramp(0.0, peak_mps, 0.8, 0.6)
    v_mps, build_m, decel_mps2 = peak_mps, 0.0, 0.0
    while decel_mps2 < 0.67:
        decel_mps2 += 0.6 * FINE_S
        v_mps -= decel_mps2 * FINE_S
        build_m += v_mps * FINE_S
    used_m = rise_m + peak_mps * 1.0 + build_m + curve.at_speed(max(0.0, v_mps)).distance_m
    assert peak_mps <= limit_mps
    assert used_m <= distance_m + 0.15
    assert peak_mps == limit_mps or used_m >= distance_m - 0.15


def test_the_500_m_hop_cannot_reach_the_limit() -> None:
    peak_mps = profile.peak_speed_mps(
        0.0, 500.0, stop_curve(), accel_mps2=0.8, jerk_mps3=0.6, change_over_s=1.0, limit_mps=19.44
    )

    assert 15.0 < peak_mps < 70.0 / 3.6


def test_a_train_already_too_fast_does_not_accelerate() -> None:
    peak_mps = profile.peak_speed_mps(
        12.0, 20.0, stop_curve(), accel_mps2=0.8, jerk_mps3=0.6, change_over_s=1.0, limit_mps=19.44
    )

    assert peak_mps == pytest.approx(12.0)


def limits_of(line: LineMap) -> profile.SpeedLimits:
    return profile.SpeedLimits(AtoConfig(), line)


@pytest.mark.parametrize(
    ("front_m", "limit_kmh"),
    [(1499.9, 70.0), (1500.1, 40.0), (1900.1, 40.0), (1968.5, 40.0), (1968.7, 70.0)],
)
def test_a_limit_holds_until_the_rear_has_cleared_it(front_m: float, limit_kmh: float) -> None:
    limits = limits_of(load_line("florence"))

    assert limits.under_train_mps(front_m) == pytest.approx(limit_kmh / 3.6)


def test_lower_limits_ahead_are_found_in_their_order() -> None:
    limits_mps = (20.0, 10.0, 15.0, 5.0)
    edges_m = (0.0, 500.0, 800.0, 1200.0, 1500.0)
    sections = tuple(
        SpeedSection(start, end, limit)
        for (start, end), limit in zip(itertools.pairwise(edges_m), limits_mps, strict=True)
    )
    station = Station("End", 1400.0, 1300.0, 1410.0)
    limits = limits_of(LineMap("steps", 0.0, 1500.0, (station,), sections))

    first = limits.lowering(limits.next_lowering(100.0))
    second = limits.lowering(limits.next_lowering(600.0))

    assert first is not None
    assert (first.at_m, first.curve.end_mps) == (500.0, 9.5)
    assert second is not None
    assert (second.at_m, second.curve.end_mps) == (1200.0, 4.5)
    assert limits.lowering(limits.next_lowering(1300.0)) is None


def test_a_stop_on_a_falling_gradient_is_planned_within_the_demand() -> None:
    line = load_line("florence")

    def planned(at_m: float, gain_ratio: float | None = 0.0) -> float:
        return profile.steady_decel_mps2(AtoConfig(), line, at_m, gain_ratio)

    assert planned(1500.0) == Braking().decel_mps2
    # On -30 per mille gravity takes 0.27 m/s² of the greatest demand, which is 1 m/s² there.
    assert planned(1890.0) == pytest.approx(1.0 - 0.02 - 9.81 * 0.03 / 1.08, abs=1e-6)
    # A brake with a gain of 0.75 still gives what is planned before the gain is known.
    assert planned(1890.0, None) == pytest.approx(0.744 - 0.02 - 9.81 * 0.03 / 1.08, abs=1e-6)
    assert planned(1890.0, None) < 0.75 - 9.81 * 0.03 / 1.08
    # A brake with a gain of 0.76 still gives 0.76 m/s² with the greatest demand, so one that is
    # measured as 0.85 is planned with that.
    assert planned(1500.0, -0.15) == pytest.approx(0.76 - 0.02, abs=1e-6)
    # Without a greater demand it would give 0.68 of 0.8 m/s².
    level = replace(AtoConfig(), limits=Limits(brake_demand_max_mps2=0.8))
    assert profile.steady_decel_mps2(level, line, 1500.0, -0.15) == pytest.approx(0.68 - 0.02)
    assert planned(1500.0, 0.1) == Braking().decel_mps2
    assert planned(1500.0, None) == pytest.approx(0.8 * 0.84 - 0.02, abs=1e-6)
