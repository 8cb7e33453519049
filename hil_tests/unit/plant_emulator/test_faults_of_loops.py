"""Current loops that are read, broken, off and shorted, and the reaction of the units."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from can_dbc.analogue import AnalogueCommand
from firmware_py.settings import SettingsError, override
from plant_emulator.actuators.loops import effort_ratio
from plant_emulator.faults.fitting import FaultTargets, check_fitting
from plant_emulator.faults.plan import read_faults
from plant_emulator.noise import Generators, NoiseSource
from plant_emulator.train_config import TrainConfig, load_train

ATrain = Callable[..., Any]


@pytest.mark.parametrize(
    ("read_ma", "traction_ratio", "brake_ratio"),
    [
        (0.0, 0.0, 0.0),
        (3.999, 0.0, 0.0),
        (4.0, 0.0, 0.0),
        (4.014, 0.001, 0.001),
        (11.0, 0.5, 0.5),
        (17.986, 0.999, 0.999),
        (18.0, 1.0, 1.0),
        (20.0, 1.0, 1.0),
        (20.001, 0.0, 1.0),
        (24.0, 0.0, 1.0),
    ],
)
def test_a_unit_reads_its_current_by_the_analogue_mapping(
    read_ma: float, traction_ratio: float, brake_ratio: float
) -> None:
    assert effort_ratio(read_ma, over_ratio=0.0) == pytest.approx(traction_ratio)
    assert effort_ratio(read_ma, over_ratio=1.0) == pytest.approx(brake_ratio)


def test_a_looped_train_brakes_and_pulls_by_its_currents(
    a_train: ATrain, looped: TrainConfig
) -> None:
    train = a_train(train=looped, speed_mps=15.0)
    assert train.world.brake.status().ready
    assert train.world.traction.status(0.0).ready

    train.run(3.0, train.braking(0.6))
    assert train.decel_mps2 == pytest.approx(0.6, abs=1e-3)
    train.run(3.0, train.RELEASED, train.driving(90_000.0))
    assert train.world.drive_n == pytest.approx(90_000.0, rel=2e-3)


@pytest.mark.parametrize(("bits", "steps"), [(6, 63), (12, 4095)])
def test_a_unit_reads_whole_counts_of_its_converter(
    a_train: ATrain, looped: TrainConfig, bits: int, steps: int
) -> None:
    train = a_train(
        train=override(looped, {"loop.adc_bits": bits, "loop.broken_ma": 3.0}, "looped"),
        speed_mps=15.0,
    )
    train.run(0.2, train.braking(0.6))
    counts = train.world.loops.brake.read_ma / 24.0 * steps

    assert counts == pytest.approx(round(counts))
    assert abs(train.world.loops.brake.read_ma - 12.4) <= 12.0 / steps + 1e-9


def test_each_loop_of_each_run_has_its_own_offset_and_scatter(
    a_train: ATrain, quiet: TrainConfig
) -> None:
    errors = {
        "loop.connected": True, "loop.offset_ma": {"low": -0.3, "high": 0.3}, "loop.adc_bits": 20,
    }  # fmt: skip
    train = a_train(train=override(quiet, errors, "looped"), speed_mps=15.0)
    readings_ma = [
        (world.loops.brake.read_ma, world.loops.traction.read_ma) for world in train.each_step(2.0)
    ]
    for of_one_ma in zip(*readings_ma, strict=True):
        mean_ma = sum(of_one_ma) / len(of_one_ma)
        assert abs(mean_ma - 3.8) <= 0.3 + 0.0076
        assert 0.0 < max(of_one_ma) - min(of_one_ma) < 10 * 0.004
    brake_ma, traction_ma = readings_ma[0]
    assert abs(brake_ma - traction_ma) > 0.01


@pytest.mark.parametrize(("wait_s", "reads_ma"), [(0.14, 12.4), (0.18, 0.0)])
def test_after_150_ms_of_silence_the_module_outputs_no_current(
    a_train: ATrain, looped: TrainConfig, wait_s: float, reads_ma: float
) -> None:
    train = a_train(train=looped, speed_mps=15.0)
    train.run(0.05, train.braking(0.6))
    silence_s = wait_s - 0.05
    train.run(silence_s, None, None)

    assert train.world.loops.brake.read_ma == pytest.approx(reads_ma, abs=0.003)


# A broken wire.


@pytest.mark.parametrize(("offset_ma", "ready"), [(-0.19, True), (-0.21, False)])
def test_a_loop_under_3_6_ma_counts_as_broken(
    a_train: ATrain, looped: TrainConfig, offset_ma: float, ready: bool
) -> None:
    train = a_train({"kind": "loop_offset", "offset_ma": offset_ma}, train=looped, speed_mps=15.0)
    train.run(0.5)

    assert train.world.brake.status().ready is ready
    assert train.world.traction.status(0.0).ready


@pytest.mark.parametrize(("after_s", "ready"), [(0.28, True), (0.33, False)])
def test_a_unit_tolerates_a_loop_fault_for_some_time(
    a_train: ATrain, looped: TrainConfig, after_s: float, ready: bool
) -> None:
    train = a_train({"kind": "loop_break"}, train=looped, speed_mps=15.0)
    train.run(after_s)

    assert train.world.brake.status().ready is ready


def test_a_brake_with_a_broken_loop_follows_the_protected_command(
    a_train: ATrain, looped: TrainConfig
) -> None:
    train = a_train({"kind": "loop_break"}, train=looped, speed_mps=15.0)
    eased = [world.brake.service.decel_mps2 for world in train.each_step(5.0, train.braking(0.6))]

    assert not train.world.brake.status().ready
    assert eased[40] == 0.0
    assert eased[-1] == pytest.approx(0.6, rel=1e-3)


def test_traction_with_a_broken_loop_gives_no_effort(a_train: ATrain, looped: TrainConfig) -> None:
    train = a_train(
        {"kind": "loop_break", "loop": "traction", "start_s": 3.0}, train=looped, speed_mps=15.0
    )
    train.run(2.9, train.RELEASED, train.driving(90_000.0))
    assert train.world.drive_n > 80_000.0
    train.run(3.0, train.RELEASED, train.driving(90_000.0))

    assert train.world.drive_n == pytest.approx(0.0, abs=100.0)
    assert not train.world.traction.status(0.0).ready
    assert train.world.brake.status().ready


def test_a_distrusted_loop_must_be_right_for_some_time(
    a_train: ATrain, looped: TrainConfig
) -> None:
    train = a_train({"kind": "loop_break", "end_s": 2.0}, train=looped, speed_mps=15.0)
    ready = [world.brake.status().ready for world in train.each_step(14.0)]

    assert ready.index(False) == pytest.approx(31, abs=1)
    assert ready.index(True, 50) == pytest.approx(1200, abs=2)


# A loop with a wrong current.


@pytest.mark.parametrize(("offset_ma", "ready"), [(-2.7, True), (-2.9, False), (2.9, False)])
def test_a_loop_more_than_0_2_mps2_off_the_protected_command_is_distrusted(
    a_train: ATrain, looped: TrainConfig, offset_ma: float, ready: bool
) -> None:
    train = a_train({"kind": "loop_offset", "offset_ma": offset_ma}, train=looped, speed_mps=15.0)
    train.run(4.0, train.braking(0.6))

    assert train.world.brake.status().ready is ready
    least_mps2 = 0.6 + offset_ma / 14.0 if ready else 0.6
    assert train.decel_mps2 >= least_mps2 - 1e-3


def test_the_brake_follows_a_wrong_loop_that_demands_more(
    a_train: ATrain, looped: TrainConfig
) -> None:
    train = a_train({"kind": "loop_offset", "offset_ma": 1.4}, train=looped, speed_mps=15.0)
    train.run(4.0, train.braking(0.6))

    assert train.decel_mps2 == pytest.approx(0.7, abs=2e-3)


# A loop shorted to a supply.


@pytest.mark.parametrize(
    ("current_ma", "traction_n", "decel_mps2"),
    [(19.9, 90_000.0, 1.0), (20.1, 0.0, 1.0)],
)
def test_over_20_ma_the_brake_is_full_and_traction_is_cut(
    a_train: ATrain, looped: TrainConfig, current_ma: float, traction_n: float, decel_mps2: float
) -> None:
    patient = override(looped, {"loop.tolerance_mps2": 9.0, "loop.patience_s": 9.0}, "looped")
    fault = {"kind": "loop_short", "current_ma": current_ma, "loop": "both"}
    pulled = a_train({**fault, "loop": "traction", "start_s": 1.0}, train=patient, speed_mps=5.0)
    pulled.world.traction.ready = pulled.world.loops.traction.trusted = True
    pulled.run(3.0, pulled.RELEASED, pulled.driving(90_000.0))
    full_n = pulled.world.consist.inertia_kg

    braked = a_train({**fault, "loop": "brake"}, train=patient, speed_mps=15.0)
    braked.run(4.0)

    assert braked.decel_mps2 == pytest.approx(decel_mps2, abs=1e-3)
    wanted_n = full_n if traction_n else 0.0
    assert pulled.world.drive_n == pytest.approx(wanted_n, rel=0.02, abs=500.0)


def test_permission_and_emergency_brake_need_no_loop(a_train: ATrain, looped: TrainConfig) -> None:
    train = a_train(
        {"kind": "loop_break", "loop": "both", "start_s": 2.0}, train=looped, speed_mps=15.0
    )
    train.run(1.8, train.RELEASED, train.driving(90_000.0))
    forbidden = replace(train.driving(90_000.0), traction_permitted=False)
    train.run(0.2, train.RELEASED, forbidden)
    assert train.world.drive_n == 0.0
    train.run(4.0, train.EMERGENCY, train.FORBIDDEN)
    assert train.decel_mps2 == pytest.approx(1.2, rel=1e-3)


# Trains without loops.


def test_a_train_without_loops_that_receives_currents_reports_not_ready(
    a_train: ATrain, quiet: TrainConfig
) -> None:
    train = a_train(train=quiet, speed_mps=15.0)
    train.world.hear_currents(AnalogueCommand(3.8, 12.4), train.world.now_ns)
    ready = [
        world.brake.status().ready and world.traction.status(0.0).ready
        for world in train.each_step(0.3, train.braking(0.3))
    ]

    assert ready.index(True) == 15
    assert all(ready[15:])
    train.run(2.0, train.braking(0.3))
    assert train.decel_mps2 == pytest.approx(0.3, abs=2e-3)


def test_a_fault_of_a_missing_loop_is_refused() -> None:
    faults = read_faults([{"kind": "wheel_slip"}, {"kind": "loop_break"}], "scenario")

    with pytest.raises(SettingsError, match=r"scenario: fault\[1\]\.kind: loop_break"):
        check_fitting(faults, FaultTargets(load_train("florence4")), "scenario")
    check_fitting(faults, FaultTargets(load_train("florence4_loop")), "scenario")
    check_fitting(faults[:1], FaultTargets(load_train("florence4")), "scenario")


def test_the_loops_have_their_own_noise_sources() -> None:
    """The two sources of the loops come after the fourteen earlier ones, whose numbers stay."""
    before = np.random.SeedSequence(7).spawn(14)

    for source, child in zip(NoiseSource, before, strict=False):
        expected = np.random.Generator(np.random.PCG64(child)).random()
        assert Generators(7).of(source).random() == expected
    assert [source.name for source in list(NoiseSource)[14:16]] == ["LOOP_ERROR", "LOOP_NOISE"]
