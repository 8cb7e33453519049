"""Running curves of trains whose efficiency depends on speed and load."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metro_hil.energy.running_curve.design import Hop, curve_of, design
from metro_hil.energy.running_curve.net import with_thrift
from metro_hil.energy.running_curve.optimum import optimise
from metro_hil.energy.running_curve.trace import trace
from metro_hil.energy.running_curve.track import level_track
from metro_hil.energy.running_curve.train import interpolated, load_train, of_consist
from plant_emulator.train_config import EfficiencyMap
from plant_emulator.train_config import load_train as load_consist

TRAIN = load_train("seed002")
TRACTION = EfficiencyMap(
    (0.0, 10.0, 20.0), (0.1, 0.5, 1.0), ((0.5, 0.6, 0.62), (0.7, 0.84, 0.86), (0.78, 0.88, 0.89))
)
BRAKE = EfficiencyMap((0.0, 5.0, 20.0), (0.2, 1.0), ((0.3, 0.4), (0.7, 0.75), (0.8, 0.86)))
MAPPED = dataclasses.replace(TRAIN, traction_map=TRACTION, regeneration_map=BRAKE)
TRACK = level_track(TRAIN, 1000.0, cell_m=8.0)
TIME_S = 80.0


@settings(deadline=None)
@given(speed_mps=st.floats(0.0, 30.0), load_ratio=st.floats(0.0, 1.5))
def test_many_values_at_once_are_those_of_the_plant_one_by_one(
    speed_mps: float, load_ratio: float
) -> None:
    found = interpolated(TRACTION, np.array([speed_mps]), np.array([load_ratio]))

    assert found[0] == pytest.approx(TRACTION.at(speed_mps, load_ratio))


def test_a_map_of_one_value_changes_nothing() -> None:
    single = TRAIN.traction_efficiency_ratio, TRAIN.regeneration_efficiency_ratio
    flat = [EfficiencyMap((0.0, 9.0), (0.0, 1.0), ((value,) * 2,) * 2) for value in single]
    train = dataclasses.replace(TRAIN, traction_map=flat[0], regeneration_map=flat[1])

    with_map, without = Hop(train, TRACK).net, Hop(TRAIN, TRACK).net

    assert with_map.acceleration_j == pytest.approx(without.acceleration_j)
    assert with_map.regenerated_j == pytest.approx(without.regenerated_j)


FINE = level_track(TRAIN, 600.0, cell_m=2.0)


def limited_hop() -> Hop:
    ceiling_mps = np.where(FINE.at_m > 350.0, 11.0, FINE.ceiling_mps)
    limited = dataclasses.replace(FINE, ceiling_mps=ceiling_mps)
    return Hop(MAPPED, with_thrift(MAPPED, limited, 1.0))


@pytest.mark.parametrize(
    "hop", [Hop(MAPPED, FINE), limited_hop()], ids=["level", "with a lower limit"]
)
def test_a_designed_run_has_the_mean_efficiencies_of_its_cells(hop: Hop) -> None:
    """The oracle asks the plant's map for each cell of the finished run."""
    curve = design(hop, 65.0, 0.0).curve
    run = trace(MAPPED, hop.track, curve)

    pulled_j = drawn_j = braked_j = given_j = 0.0
    speeds_mps = (run.speed_mps[1:] + run.speed_mps[:-1]) / 2.0
    for speed_mps, work_j in zip(speeds_mps, run.power_w[1:] * np.diff(run.time_s), strict=True):
        force_n = abs(work_j) / FINE.cell_m
        if work_j > 0.0:
            pulled_j += work_j
            drawn_j += work_j / TRACTION.at(speed_mps, force_n / TRAIN.traction_force_n)
        else:
            braked_j -= work_j
            given_j -= work_j * BRAKE.at(speed_mps, force_n / TRAIN.brake_force_n)
    plain = curve_of(TRAIN, hop.track, curve.notch_off_mps, curve.hold_m, curve.power_w)
    wheel_j = plain.acceleration_j * TRAIN.traction_efficiency_ratio
    assert wheel_j / curve.acceleration_j == pytest.approx(pulled_j / drawn_j, rel=0.01)
    wheel_j = plain.regenerated_j / TRAIN.regeneration_efficiency_ratio
    assert curve.regenerated_j / wheel_j == pytest.approx(given_j / braked_j, rel=0.01)


def test_the_optimum_knows_the_map_and_passes_its_checks() -> None:
    hop = Hop(MAPPED, TRACK)
    curve = design(hop, TIME_S, 0.0).curve
    begin = trace(MAPPED, TRACK, curve).square_m2_per_s2
    plain = optimise(TRAIN, TRACK, TIME_S, 0.5, begin)

    best = optimise(MAPPED, TRACK, TIME_S, 0.5, begin)

    assert best.cost_j <= curve.total_j(0.5) + 0.01 * curve.acceleration_j
    middle_mps = np.sqrt((plain.speed_mps[1:] ** 2 + plain.speed_mps[:-1] ** 2) / 2.0)
    drawn_n = plain.traction_n / MAPPED.traction_efficiency(middle_mps, plain.traction_n)
    given_n = plain.electric_n * MAPPED.regeneration_efficiency(middle_mps, plain.electric_n)
    other_j = float(np.sum(drawn_n - 0.5 * given_n)) * TRACK.cell_m
    assert best.cost_j <= other_j + 1e-6 * abs(other_j)


def test_a_consist_brings_its_maps_with_loads_of_the_force_that_it_has() -> None:
    consist = load_consist("nanakuma4")
    worn = dataclasses.replace(consist.traction, efficiency=TRACTION, effort_ratio=0.5)

    train = of_consist(dataclasses.replace(consist, traction=worn))

    assert train.traction_map is not None
    assert train.traction_map.load_ratio == pytest.approx((0.2, 1.0, 2.0))
    assert train.regeneration_map is None
