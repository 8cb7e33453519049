"""Tables of motors: force over speed and efficiency over speed and load, alone and in the train."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from firmware_py.settings import SettingsError, override
from firmware_py.trackdb import load_line
from plant_emulator.actuators.traction import TractionUnit
from plant_emulator.train_config import (
    EfficiencyMap,
    EffortPoint,
    TrainConfig,
    effort_n,
    load_train,
)
from plant_emulator.world import World

TRAIN = load_train("florence4_ideal")
POINTS = (EffortPoint(0.0, 200e3), EffortPoint(10.0, 160e3), EffortPoint(20.0, 60e3))
MAP = EfficiencyMap((0.0, 20.0), (0.0, 1.0), ((0.5, 0.7), (0.8, 0.9)))


@pytest.mark.parametrize(
    ("speed_mps", "force_n"),
    [(0.0, 200e3), (5.0, 180e3), (10.0, 160e3), (15.0, 110e3), (20.0, 60e3), (30.0, 40e3)],
)
def test_force_is_linear_between_points_and_of_constant_power_beyond(
    speed_mps: float, force_n: float
) -> None:
    assert effort_n(POINTS, speed_mps) == pytest.approx(force_n)


@pytest.mark.parametrize(
    ("speed_mps", "load_ratio", "found"),
    [
        (0.0, 0.0, 0.5),
        (0.0, 1.0, 0.7),
        (20.0, 0.0, 0.8),
        (10.0, 0.5, 0.725),
        (90.0, 2.0, 0.9),
    ],
)
def test_efficiency_is_bilinear_and_holds_beyond_the_edges(
    speed_mps: float, load_ratio: float, found: float
) -> None:
    assert MAP.at(speed_mps, load_ratio) == pytest.approx(found)


@given(speed_mps=st.floats(0.0, 60.0), load_ratio=st.floats(0.0, 2.0))
def test_efficiency_stays_within_the_values_of_the_map(speed_mps: float, load_ratio: float) -> None:
    assert 0.5 <= MAP.at(speed_mps, load_ratio) <= 0.9 + 1e-12


def test_traction_gives_no_more_than_its_table() -> None:
    config = replace(TRAIN.traction, effort=POINTS, dead_time_s=0.0, lag_s=0.0, slew_n_per_s=1.0e12)
    unit = TractionUnit(config, step_s=0.01, timeout_ns=10**12)
    unit.hear(TractionCommand(190e3, Direction.FORWARD, True), 0)

    found = [unit._limited(190e3, speed_mps) for speed_mps in (0.0, 15.0, 20.0)]

    assert found == [190e3, pytest.approx(110e3), pytest.approx(60e3)]
    unit.feed(0.5)
    assert unit._limited(-190e3, 15.0) == pytest.approx(-55e3 * config.effort_ratio)


def energy_j(train: TrainConfig) -> tuple[float, float]:
    """Return traction work at the rail and energy into the inverters of one pulled step."""
    world = World(train, load_line("florence"), seed=1, front_m=1100.0)
    world.consist.place(1100.0, 10.0, 0.0)
    world.drive_n = 100e3
    world._book_energy(0.1)
    return 100e3 * 0.1, world.power.traction_j


def test_the_map_converts_the_work_of_the_motors() -> None:
    flat = EfficiencyMap((0.0,), (0.0,), ((0.5,),))

    work_j, taken_j = energy_j(replace(TRAIN, traction=replace(TRAIN.traction, efficiency=flat)))

    assert taken_j == pytest.approx(work_j / 0.5)
    assert energy_j(TRAIN)[1] == pytest.approx(work_j / TRAIN.traction.efficiency_ratio)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            {"traction.effort": [{"speed_mps": 1.0, "force_n": 9.0}]},
            r"begins at 1\.0 m/s",
        ),
        (
            {"traction.effort": [{"speed_mps": 0.0, "force_n": 9.0}] * 2},
            r"traction: effort: speed 0\.0 m/s does not rise",
        ),
        (
            {
                "traction.efficiency": {
                    "speed_mps": [0.0],
                    "load_ratio": [0.0, 1.0],
                    "efficiency_ratio": [[0.8]],
                }
            },
            r"traction\.efficiency: efficiency_ratio at 0\.0 m/s has 1 values for 2 loads",
        ),
        (
            {
                "traction.efficiency": {
                    "speed_mps": [0.0],
                    "load_ratio": [0.0],
                    "efficiency_ratio": [[1.2]],
                }
            },
            r"efficiency_ratio 1\.2 is not in",
        ),
    ],
)
def test_a_wrong_table_is_refused_with_its_key(change: dict[str, object], complaint: str) -> None:
    with pytest.raises(SettingsError, match=complaint):
        override(TRAIN, change, "train.toml")
