"""Running curves of trains whose force over speed is a table."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metro_hil.energy.running_curve.design import Hop, design
from metro_hil.energy.running_curve.optimum import optimise
from metro_hil.energy.running_curve.trace import trace
from metro_hil.energy.running_curve.track import level_track
from metro_hil.energy.running_curve.train import (
    RunningTrain,
    along,
    greatest_power_w,
    of_consist,
)
from plant_emulator.train_config import EffortPoint, TrainConfig
from plant_emulator.train_config import load_train as load_consist
from plant_emulator.train_config.tables import effort_n

CONSIST = load_consist("nanakuma4")
PULL = (EffortPoint(0.0, 103e3), EffortPoint(9.0, 100e3), EffortPoint(20.0, 40e3))
BRAKE = (EffortPoint(0.0, 120e3), EffortPoint(12.0, 115e3), EffortPoint(20.0, 70e3))


def consist(pull: tuple[EffortPoint, ...], brake: tuple[EffortPoint, ...]) -> TrainConfig:
    service = CONSIST.brake.service
    electric = dataclasses.replace(service.electric, effort=brake)
    return dataclasses.replace(
        CONSIST,
        traction=dataclasses.replace(CONSIST.traction, effort=pull),
        brake=dataclasses.replace(
            CONSIST.brake, service=dataclasses.replace(service, electric=electric)
        ),
    )


def sampled(force_n: float, power_w: float) -> tuple[EffortPoint, ...]:
    """Force and power as a table of closely spaced points."""
    speeds_mps = np.concatenate([[0.0], np.arange(5.0, 30.0, 0.05)])
    return tuple(
        EffortPoint(float(v), force_n if v == 0.0 else min(force_n, power_w / float(v)))
        for v in speeds_mps
    )


CURVED = of_consist(consist(PULL, BRAKE))


@settings(deadline=None)
@given(speed_mps=st.floats(0.0, 40.0))
def test_many_forces_at_once_are_those_of_the_plant_one_by_one(speed_mps: float) -> None:
    assert along(PULL, np.array([speed_mps]))[0] == pytest.approx(effort_n(PULL, speed_mps))


def test_the_greatest_power_of_a_curve_is_that_of_its_parabola() -> None:
    """With 100 kN at 9 m/s and 40 kN at 20 m/s, force times speed is greatest at 13.7 m/s."""
    slope = 60e3 / 11.0
    assert greatest_power_w(PULL) == pytest.approx((100e3 + 9.0 * slope) ** 2 / (4 * slope), 1e-4)


def test_a_table_of_force_and_power_gives_the_designs_and_optima_of_force_and_power() -> None:
    plain = of_consist(CONSIST)
    pull = sampled(plain.traction_force_n, plain.traction_power_w)
    tables = of_consist(consist(pull, sampled(plain.brake_force_n, plain.brake_power_w)))
    found = []
    for train in (plain, tables):
        hop = Hop(train, level_track(train, 600.0, cell_m=20.0))
        curve = design(hop, 58.0, 5.0).curve
        begin = trace(train, hop.track, curve).square_m2_per_s2
        best = optimise(train, hop.track, 58.0, 0.5, begin)
        found.append((curve.acceleration_j, curve.regenerated_j, best.cost_j))

    assert found[1] == pytest.approx(found[0], rel=2e-3)


def forces_n(train: RunningTrain, squares: np.ndarray, cell_m: float) -> tuple[np.ndarray, ...]:
    """Force at the wheel and speed in the middle of each cell."""
    middle_mps = np.sqrt((squares[1:] + squares[:-1]) / 2.0)
    need_n = train.mass_kg * np.diff(squares) / (2.0 * cell_m)
    return need_n + train.resistance_at_n(middle_mps), middle_mps


def test_designed_and_best_run_stay_within_the_curves() -> None:
    hop = Hop(CURVED, level_track(CURVED, 800.0, cell_m=8.0))
    curve = design(hop, 70.0, 0.0).curve
    begin = trace(CURVED, hop.track, curve).square_m2_per_s2
    best = optimise(CURVED, hop.track, 70.0, 0.5, begin)

    assert best.cost_j <= curve.total_j(0.5) + 0.01 * curve.acceleration_j
    for squares in (begin, best.speed_mps**2):
        force_n, middle_mps = forces_n(CURVED, squares, hop.track.cell_m)
        most_n = np.array([effort_n(PULL, float(v)) for v in middle_mps])
        assert np.all(force_n[2:] <= 1.02 * most_n[2:])
        assert np.max(force_n[2:] / most_n[2:]) > 0.97
    braking_n, middle_mps = forces_n(CURVED, begin, hop.track.cell_m)
    most_n = np.array([effort_n(BRAKE, float(v)) for v in middle_mps])
    assert np.all(-braking_n[:-2] <= 1.02 * most_n[:-2])


def test_a_worn_train_has_its_share_of_the_curve() -> None:
    whole = consist(PULL, BRAKE)
    worn = dataclasses.replace(
        whole, traction=dataclasses.replace(whole.traction, effort_ratio=0.5)
    )

    train = of_consist(worn)

    speeds_mps = np.array([0.0, 5.0, 15.0, 30.0])
    assert train.traction_at_n(speeds_mps) == pytest.approx(0.5 * CURVED.traction_at_n(speeds_mps))
    assert train.traction_force_n == pytest.approx(0.5 * 103e3)
