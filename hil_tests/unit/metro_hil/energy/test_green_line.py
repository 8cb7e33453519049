"""The simulated line: energy balances, steps, laws, and the properties of the timetable."""

import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metro_hil.energy.line.model import (
    HOLD_AND_COAST,
    RUNS_S,
    TRADITIONAL,
    Law,
    LineTrain,
    Timetable,
)
from metro_hil.energy.line.regimes import LegRuns, least_traction
from metro_hil.energy.line.simulate import LapResults, dwells_of, first_minutes, simulate
from metro_hil.energy.line.synchronise import TimetableSearch
from metro_hil.energy.line.table_four import PRINTED, paired, share_at_least
from plant_emulator.power.supplies import load_supply
from vobc.ato.laws import green_speeds

TRAIN = LineTrain()
STRONG, WEAK = load_supply("strong"), load_supply("weak")


def lap(law: Law = TRADITIONAL, seed: int = 1, step_s: float = 0.2, supply=STRONG) -> LapResults:  # type: ignore[no-untyped-def]
    return simulate(TRAIN, supply, Timetable(), law, dwells_of(seed, 3), step_s=step_s)


@pytest.mark.parametrize("supply", [STRONG, WEAK], ids=["strong", "weak"])
def test_energy_is_conserved_from_grid_to_wheel_and_every_step_has_a_solution(supply) -> None:  # type: ignore[no-untyped-def]
    outcome = lap(supply=supply)

    assert outcome.unconverged == 0
    assert abs(outcome.closure_ratio) < 5e-3
    assert 0.0 < outcome.use_ratio < 1.0
    assert outcome.burnt_kwh > 0.0


def test_a_quarter_of_the_step_gives_the_same_energy() -> None:
    coarse, fine = lap(step_s=0.2), lap(step_s=0.05)

    assert coarse.actual_kwh == pytest.approx(fine.actual_kwh, rel=2e-3)


def test_the_same_seed_gives_the_same_energy_balance_and_another_one_another() -> None:
    one, again, other = lap(seed=3), lap(seed=3), lap(seed=4)

    assert np.array_equal(one.books, again.books)
    assert one.actual_kwh != other.actual_kwh


def test_one_run_takes_its_kinetic_energy_and_resistance() -> None:
    """The oracle integrates full traction, hold and coast again; braking feeds no traction."""
    runs = LegRuns(TRAIN)
    regime = runs.run(1, 18.0, 1200.0)
    a_n, b_n, c_n = TRAIN.resistance_coefficients_n()
    speed_mps = way_m = work_j = effort_n = 0.0
    while way_m < 1200.0:
        drag_n = a_n + speed_mps * (b_n + speed_mps * c_n)
        most_n = min(TRAIN.traction_force_n, TRAIN.traction_power_w / max(speed_mps, 0.1))
        wanted_n = TRAIN.mass_kg * min(1.0, 0.6 * (18.0 - speed_mps)) + drag_n
        effort_n = min(most_n, wanted_n, effort_n + 0.75 * 0.01 * TRAIN.mass_kg)
        after_mps = speed_mps + 0.01 * (effort_n - drag_n) / TRAIN.mass_kg
        work_j += effort_n * (speed_mps + after_mps) / 2.0 * 0.01
        way_m += (speed_mps + after_mps) / 2.0 * 0.01
        speed_mps = after_mps
    fading_j = (effort_n**2) / (2.0 * 0.75 * TRAIN.mass_kg) * speed_mps

    traction_j = (work_j + fading_j) / TRAIN.traction_efficiency_ratio
    assert regime.traction_j == pytest.approx(traction_j, rel=0.01)


def test_runs_of_hold_and_coast_take_their_times_and_less_energy() -> None:
    calm = least_traction(LegRuns(TRAIN), Timetable())
    before = lap()
    after = simulate(TRAIN, STRONG, calm, HOLD_AND_COAST, dwells_of(1, 3))

    assert np.all(np.abs(after.late_s) <= 1.0)
    assert after.on_time_ratio == 1.0
    assert after.actual_kwh < before.actual_kwh
    # The published law with an energy weight of 0 is the traditional one.
    assert lap(Law("1/0", 1.0, 0.0)).actual_kwh == before.actual_kwh


def test_an_impossible_running_time_is_refused() -> None:
    with pytest.raises(ValueError, match="leg 1: no run takes 120 s"):
        least_traction(LegRuns(TRAIN), Timetable(runs_s=(120.0, *RUNS_S[1:])))


def test_the_search_only_improves_and_keeps_trip_time_and_punctuality() -> None:
    found = TimetableSearch(TRAIN, STRONG, Timetable(), seed=1, budget=12).run()

    assert found.tried <= 12
    assert found.best_kwh < found.start_kwh
    assert sum(found.timetable.runs_s[:3]) == pytest.approx(sum(RUNS_S[:3]))
    assert sum(found.timetable.runs_s[3:]) == pytest.approx(sum(RUNS_S[3:]))
    judged = simulate(TRAIN, STRONG, found.timetable, HOLD_AND_COAST, dwells_of(55, 3))
    assert judged.on_time_ratio == 1.0


PLAIN = """
import sys
sys.modules['numba'] = None
from metro_hil.energy.line import simulate
from plant_emulator.power import supplies
from metro_hil.energy.compiled import COMPILED
assert not COMPILED
print(' '.join(repr(float(book)) for book in simulate.first_minutes(supplies.load_supply('weak'))))
"""


def test_without_the_compiler_the_energy_balance_is_the_same() -> None:
    told = subprocess.run(
        [sys.executable, "-c", PLAIN], capture_output=True, text=True, check=True
    ).stdout.split()

    compiled = first_minutes(WEAK)
    assert [float(number) for number in told] == pytest.approx(list(compiled), rel=1e-6, abs=1.0)


# Functions of the law.


@given(
    left_m=st.floats(200.0, 4000.0), left_s=st.floats(20.0, 300.0), speed_mps=st.floats(0.0, 22.0)
)
def test_the_timing_speed_uses_the_remaining_time(
    left_m: float, left_s: float, speed_mps: float
) -> None:
    wanted_mps = green_speeds.timing_speed_mps(
        left_m, left_s, speed_mps, accel_mps2=0.8, decel_mps2=0.9
    )

    if math.isinf(wanted_mps):
        return
    gain_s = max(0.0, wanted_mps - speed_mps) / 0.8
    gain_m = (speed_mps + wanted_mps) / 2.0 * gain_s
    lose_s, lose_m = wanted_mps / 0.9, wanted_mps**2 / 1.8
    steady_m = left_m - gain_m - lose_m
    assert gain_s + lose_s + steady_m / wanted_mps == pytest.approx(left_s, rel=1e-6)


@given(voltage_v=st.floats(500.0, 950.0))
def test_a_high_voltage_speeds_a_train_up_and_a_low_one_slows_it_down(voltage_v: float) -> None:
    current_a = green_speeds.arm_current_a(
        voltage_v, 750.0, feed_factor=4.0, arm_ohm=0.04, train_count=2.0, exponent=1.0
    )
    speed_mps = green_speeds.energy_speed_mps(
        15.0, 198e3, voltage_v, current_a, standard_w=0.0, horizon_s=1.0
    )

    assert (speed_mps - 15.0) * (voltage_v - 750.0) >= 0.0


def test_a_ladder_of_resistors_confirms_the_exponent_of_one() -> None:
    """The test compares the mean drop of m trains on a doubly fed ladder with equation (8)."""
    ohm, trains, current_a = 0.04, 3, 500.0
    n = trains
    matrix = np.zeros((n, n))
    part = ohm / (n + 1)
    for i in range(n):
        matrix[i, i] = 2.0 / part
        if i + 1 < n:
            matrix[i, i + 1] = matrix[i + 1, i] = -1.0 / part
    middle_v = float(np.max(np.linalg.solve(matrix, np.full(n, current_a))))
    asked_a = green_speeds.arm_current_a(
        750.0 - middle_v, 750.0, feed_factor=4.0, arm_ohm=ohm, train_count=n, exponent=1.0
    )

    # Equation (8) gives the current of half the section: m / 2 trains.
    assert asked_a == pytest.approx(n * current_a / 2.0, rel=0.02)


def test_no_weight_on_energy_leaves_the_timing_speed() -> None:
    assert green_speeds.target_speed_mps(20.0, 15.0, 99.0, alpha_ratio=1.0, beta_ratio=0.0) == 15.0
    assert green_speeds.target_speed_mps(20.0, 15.0, 99.0, alpha_ratio=0.5, beta_ratio=0.5) == 17.5
    assert green_speeds.target_speed_mps(20.0, 25.0, 10.0, alpha_ratio=0.5, beta_ratio=0.5) == 20.0


# Statistics and arithmetic.


def test_the_published_saving_is_nine_per_cent_and_not_ten() -> None:
    saved = PRINTED[0].actual_kwh - PRINTED[2].actual_kwh

    assert round(100.0 * saved / PRINTED[0].actual_kwh, 2) == 9.04
    assert round(100.0 * saved / PRINTED[2].actual_kwh, 2) == 9.94
    # With 180 s and 7 trains there are such laps for 15 h a day.
    assert saved * 15 * 3600 / 1260 * 365 == pytest.approx(2273532, rel=1e-4)


def test_one_seed_has_no_interval() -> None:
    single = paired([lap(seed=1)], [lap(seed=1)])

    assert single.half_ratio is None
    assert single.text == "+0.00 %, one seed"


def test_pairs_with_one_difference_have_no_spread() -> None:
    one, other = lap(seed=1), lap(seed=2)

    same = paired([one, other], [one, other])

    assert (same.mean_ratio, same.half_ratio) == (0.0, 0.0)
    assert same.text == "+0.00 % ± 0.00"
    assert share_at_least(3000, 3000) == pytest.approx(1.0 - 3.0 / 3000.0, abs=2e-4)
