"""Faults of the line supply, of the doors and of the driver's desk."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from can_dbc.cab import CabMode
from can_dbc.doors import DoorCommand, DoorState
from firmware_py.settings import SettingsError, override
from firmware_py.trackdb import LineZone
from plant_emulator.faults.fitting import FaultTargets, check_fitting
from plant_emulator.faults.plan import read_faults
from plant_emulator.train_config import TrainConfig, load_train

ATrain = Callable[..., Any]
CLOSE = DoorCommand(enable_left=False, enable_right=False, open_left=False, open_right=False)
OPEN_RIGHT = DoorCommand(enable_left=False, enable_right=True, open_left=False, open_right=True)
LOCKED = DoorState.LOCKED


@pytest.mark.parametrize(
    "fault", [{"kind": "line_voltage", "voltage_v": 0.0}, {"kind": "breaker_open"}]
)
def test_without_line_voltage_there_is_no_effort_and_friction_brakes(
    a_train: ATrain, fault: dict[str, Any]
) -> None:
    train = a_train({**fault, "start_s": 3.0, "end_s": 8.0}, speed_mps=15.0)
    train.run(3.0, train.RELEASED, train.driving(100_000.0))
    power = train.world.power
    assert train.world.drive_n > 90_000.0
    train.run(0.02, train.RELEASED, train.driving(100_000.0))
    assert train.world.drive_n == 0.0
    drawn_j, returned_j = power.drawn_j, power.returned_j

    train.run(3.0, train.braking(0.6), train.FORBIDDEN)

    assert train.world.brake.electric_n == 0.0
    assert train.decel_mps2 == pytest.approx(0.6, rel=1e-3)
    assert (power.drawn_j, power.returned_j) == (drawn_j, returned_j)
    supply = power.supply()
    assert supply.line_current_a == 0.0
    assert supply.breaker_closed is (fault["kind"] == "line_voltage")
    assert supply.line_voltage_v == (0.0 if supply.breaker_closed else 750.0)
    assert train.world.traction.status(0.0).effort_available_ratio == 0.0

    train.run(3.0, train.braking(0.6), train.FORBIDDEN)
    assert train.world.brake.electric_n > 0.0
    assert power.returned_j > returned_j
    train.run(4.0, train.RELEASED, train.driving(100_000.0))
    assert train.world.drive_n > 90_000.0


def test_a_train_is_without_power_while_any_part_of_it_is_in_a_section_that_is_off(
    a_train: ATrain,
) -> None:
    """The front enters the dead section at once; the rear leaves it 266 m further on."""
    fault = {"kind": "power_section_off", "section": "S2", "start_s": 1.0}
    train = a_train(fault, speed_mps=20.0, front_m=190.0)
    world = train.world
    ends_m = (-120.0, 200.0, 400.0, 4700.0)
    world.line = replace(
        world.line,
        power_sections=tuple(
            LineZone(*ends, f"S{n}") for n, ends in enumerate(itertools.pairwise(ends_m), start=1)
        ),
    )
    train.run(0.9, train.RELEASED, train.driving(100_000.0))
    assert world.drive_n > 0.0
    assert world.is_in("S2")

    train.run(0.2, train.RELEASED, train.driving(100_000.0))
    dead_m: list[float] = []
    for _ in train.each_step(18.0, train.RELEASED, train.driving(100_000.0)):
        if world.power.supply().line_voltage_v == 0.0:
            dead_m.append(world.front_m)
            assert world.drive_n == 0.0
    assert dead_m[0] < 230.0
    assert dead_m[-1] == pytest.approx(400.0 + world.length_m, abs=0.5)
    assert world.drive_n > 0.0
    assert not world.is_in("S2")


def test_a_section_feeds_again_when_its_fault_ends(a_train: ATrain) -> None:
    fault = {"kind": "power_section_off", "section": "S1", "start_s": 1.0, "end_s": 3.0}
    train = a_train(fault, speed_mps=15.0)
    sections = (LineZone(-120.0, 4700.0, "S1"),)
    train.world.line = replace(train.world.line, power_sections=sections)
    train.run(1.1, train.braking(0.6))
    drawn_j = train.world.power.drawn_j

    train.run(1.8, train.braking(0.6))
    assert train.world.power.drawn_j == drawn_j
    assert train.world.brake.electric_n == 0.0
    assert train.decel_mps2 == pytest.approx(0.6, rel=1e-3)

    train.run(3.0, train.braking(0.6))
    assert train.world.brake.electric_n > 0.0


def test_a_section_that_the_line_has_not_is_refused() -> None:
    faults = read_faults([{"kind": "power_section_off", "section": "S3"}], "scenario")
    train = load_train("florence4")

    with pytest.raises(SettingsError, match="section: 'S3': the line has no power sections"):
        check_fitting(faults, FaultTargets(train), "scenario")
    with pytest.raises(SettingsError, match="section: 'S3': no such section; valid names: S1, S2"):
        check_fitting(faults, FaultTargets(train, sections=frozenset({"S1", "S2"})), "scenario")
    check_fitting(faults, FaultTargets(train, sections=frozenset({"S3"})), "scenario")


def test_energy_is_conserved_at_an_outage(a_train: ATrain) -> None:
    train = a_train({"kind": "line_voltage", "voltage_v": 0.0, "start_s": 4.0, "end_s": 6.0})
    train.run(5.0, train.RELEASED, train.driving(100_000.0))
    train.run(5.0, train.braking(0.5))
    power = train.world.power
    balance_j = power.traction_j - power.braking_j + power.auxiliary_j
    assert power.drawn_j - power.returned_j == pytest.approx(balance_j)


HIGH: dict[str, Any] = {"kind": "line_voltage", "voltage_v": 920.0, "start_s": 4.0}
LATE_FRICTION = {
    "brake.service.electric.share_ratio": 1.0,
    "brake.service.electric.max_force_n": 200_000.0,
    "brake.service.pneumatic.dead_time_s": 1.0,
    "brake.service.pneumatic.lag_s": 0.2,
}


def dips(train: Any, decel_mps2: float, until_mps: float) -> float:
    """Least share of the demanded force from 4 s on, until the train has slowed to `until_mps`."""
    least = 1.0
    for world in train.each_step(60.0, train.braking(decel_mps2), train.FORBIDDEN):
        if world.speed_mps < until_mps:
            return least
        if train.truth.t_s >= 4.0:
            least = min(least, train.decel_mps2 / decel_mps2)
    raise AssertionError("it does not stop")


def test_a_line_that_takes_no_power_leaves_the_electric_brake_to_the_resistor(
    a_train: ATrain, quiet: TrainConfig
) -> None:
    train = a_train(HIGH, speed_mps=17.0, train=override(quiet, LATE_FRICTION, "late"))
    assert dips(train, 0.8, until_mps=3.0) > 0.999
    power = train.world.power
    assert power.resistor_j > 10.0e6
    assert power.heat_j <= power.resistor_j
    assert train.truth.voltage_v == 920.0


def test_a_resistor_that_overheats_at_its_own_power_is_refused(quiet: TrainConfig) -> None:
    with pytest.raises(SettingsError, match=r"heat_max_j 3e\+07 within fade_s 15"):
        override(quiet, {"supply.resistor.heat_max_j": 30.0e6}, "small")


@pytest.mark.parametrize("dead_time_s", [0.6, 1.0])
def test_a_hot_resistor_hands_over_to_late_friction_with_a_dip_of_at_most_a_tenth(
    a_train: ATrain, quiet: TrainConfig, dead_time_s: float
) -> None:
    """The resistor is half hot from the start and cannot take the rest of the train's 24 MJ."""
    changes = {
        **LATE_FRICTION,
        "supply.resistor.heat_max_j": 36.0e6,
        "brake.service.pneumatic.dead_time_s": dead_time_s,
    }
    train = a_train(HIGH, speed_mps=17.0, train=override(quiet, changes, "hot"))
    train.world.power.heat_j = 20.0e6
    assert 0.9 <= dips(train, 0.5, until_mps=3.0) < 0.999
    assert train.world.power.heat_j < 36.0e6


def test_without_a_resistor_there_is_no_brake_until_friction_acts(
    a_train: ATrain, quiet: TrainConfig
) -> None:
    bare = replace(quiet, supply=replace(quiet.supply, resistor=None))
    train = a_train(HIGH, speed_mps=17.0, train=override(bare, LATE_FRICTION, "bare"))
    assert dips(train, 0.8, until_mps=3.0) < 0.1
    assert train.world.power.resistor_j == 0.0


def test_energy_is_conserved_in_the_resistor(a_train: ATrain) -> None:
    train = a_train(HIGH, speed_mps=17.0)
    train.run(12.0, train.braking(0.8), train.FORBIDDEN)
    power = train.world.power
    balance_j = power.traction_j - power.braking_j + power.auxiliary_j + power.resistor_j
    assert power.drawn_j - power.returned_j == pytest.approx(balance_j)
    assert power.resistor_j > 1.0e6
    train.run(3.0, train.HOLDING, train.FORBIDDEN)
    hot_j = power.heat_j
    train.run(400.0, train.HOLDING, train.FORBIDDEN)
    assert power.heat_j == pytest.approx(hot_j / math.e, rel=0.01)


def test_low_voltage_leaves_a_share_of_the_effort(a_train: ATrain) -> None:
    """Full effort needs 600 V, and there is none at 450 V; the resistance of the line takes a
    little more."""
    train = a_train({"kind": "line_voltage", "voltage_v": 540.0, "end_s": 5.0})
    train.run(4.0, train.RELEASED, train.driving(200_000.0))
    weak_n, voltage_v = train.world.drive_n, train.truth.voltage_v
    train.run(6.0, train.RELEASED, train.driving(200_000.0))

    assert voltage_v < 540.0
    assert weak_n == pytest.approx(200_000.0 * (voltage_v - 450.0) / 150.0, rel=0.02)
    assert train.world.drive_n == pytest.approx(200_000.0, rel=0.01)


def test_a_line_with_too_high_voltage_takes_no_power_back(a_train: ATrain) -> None:
    train = a_train({"kind": "line_voltage", "voltage_v": 950.0, "end_s": 6.0}, speed_mps=20.0)
    train.run(5.0, train.braking(0.6), train.FORBIDDEN)
    refused_j, friction_mps2 = train.world.power.returned_j, train.decel_mps2
    train.run(3.0, train.braking(0.6), train.FORBIDDEN)

    assert refused_j == 0.0
    assert friction_mps2 == pytest.approx(0.6, rel=1e-3)
    assert train.world.power.returned_j > 0.0
    assert train.world.brake.electric_n > 0.0


def test_a_line_with_too_high_voltage_still_supplies_traction(a_train: ATrain) -> None:
    train = a_train({"kind": "line_voltage", "voltage_v": 950.0})
    train.run(4.0, train.RELEASED, train.driving(100_000.0))
    assert train.world.drive_n == pytest.approx(100_000.0, rel=1e-3)


def test_an_interrupted_lock_line_cuts_traction_although_the_doors_are_closed(
    a_train: ATrain,
) -> None:
    train = a_train({"kind": "door_lock_lost", "start_s": 3.0, "end_s": 6.0})
    train.run(3.0, train.RELEASED, train.driving(100_000.0), CLOSE)
    train.run(1.0, train.RELEASED, train.driving(100_000.0), CLOSE)
    status = train.world.doors.status()
    assert train.world.drive_n == 0.0
    assert not status.closed_and_locked
    assert (status.left, status.right) == (LOCKED, LOCKED)
    assert train.truth.doors_locked == 0.0
    assert train.truth.right_open == 0.0
    train.run(5.0, train.RELEASED, train.driving(100_000.0), CLOSE)
    assert train.world.drive_n > 90_000.0
    assert train.world.doors.status().closed_and_locked


@pytest.mark.parametrize(
    ("side", "opened"), [("left", (1, 0)), ("right", (0, 1)), ("both", (1, 1))]
)
def test_doors_open_without_command_and_enable_and_close_again(
    a_train: ATrain, side: str, opened: tuple[int, int]
) -> None:
    train = a_train(
        {"kind": "door_opens", "side": side, "start_s": 1.0, "end_s": 6.0}, speed_mps=5.0
    )
    train.run(5.0, doors=CLOSE)
    assert (train.world.doors.left.open_ratio, train.world.doors.right.open_ratio) == opened
    assert not train.world.doors.locked
    train.run(5.0, doors=CLOSE)
    assert train.world.doors.locked


def test_doors_open_by_themselves_even_without_commands(a_train: ATrain) -> None:
    train = a_train({"kind": "door_opens", "side": "left"})
    train.run(5.0, doors=None)
    assert train.world.doors.left.state is DoorState.OPEN


def test_an_obstacle_blocks_every_closing_until_it_is_gone(a_train: ATrain) -> None:
    train = a_train({"kind": "door_obstacle", "end_s": 30.0})
    train.run(4.0, train.HOLDING, doors=OPEN_RIGHT)
    met, before = 0, DoorState.OPEN
    for world in train.each_step(25.0, train.HOLDING, doors=CLOSE):
        state = world.doors.right.state
        met += state is DoorState.OBSTRUCTED and before is not DoorState.OBSTRUCTED
        before = state
        assert not world.doors.locked
    train.run(10.0, train.HOLDING, doors=CLOSE)

    # Half of 2.5 s to meet the obstacle and 3 s of waiting, then from open again.
    assert met == 6
    assert train.world.doors.locked


def test_an_obstacle_on_the_other_side_does_not_matter(a_train: ATrain) -> None:
    train = a_train({"kind": "door_obstacle", "side": "left"})
    train.run(4.0, train.HOLDING, doors=OPEN_RIGHT)
    train.run(3.0, train.HOLDING, doors=CLOSE)
    assert train.world.doors.locked


def test_deaf_doors_stay_closed_and_obey_again_after_the_fault(a_train: ATrain) -> None:
    train = a_train({"kind": "door_deaf", "side": "right", "end_s": 5.0})
    train.run(5.0, train.HOLDING, doors=OPEN_RIGHT)
    assert train.world.doors.right.state is LOCKED
    assert train.world.doors.locked
    train.run(4.0, train.HOLDING, doors=OPEN_RIGHT)
    assert train.world.doors.right.state is DoorState.OPEN


def test_doors_that_become_deaf_while_open_can_still_be_closed(a_train: ATrain) -> None:
    train = a_train({"kind": "door_deaf", "start_s": 4.0})
    train.run(6.0, train.HOLDING, doors=OPEN_RIGHT)
    assert train.world.doors.right.state is DoorState.OPEN
    train.run(3.0, train.HOLDING, doors=CLOSE)
    assert train.world.doors.locked


@pytest.mark.parametrize(
    ("fault", "field", "value"),
    [
        ({"kind": "passenger_alarm"}, "no_passenger_alarm", False),
        ({"kind": "emergency_button"}, "emergency_released", False),
        ({"kind": "desk_mode", "mode": "manual"}, "mode", CabMode.MANUAL),
        ({"kind": "desk_mode"}, "mode", CabMode.OFF),
        ({"kind": "desk_lever", "lever_percent": -40.0}, "lever_percent", -40.0),
        ({"kind": "desk_reset"}, "reset_requested", True),
    ],
)
def test_a_desk_fault_shows_while_it_lasts(
    a_train: ATrain, fault: dict[str, Any], field: str, value: object
) -> None:
    train = a_train({**fault, "start_s": 1.0, "end_s": 2.0})
    untouched, seen = train.world.desk, []
    for _ in range(3):
        train.run(1.0)
        seen.append(train.world.desk)

    assert seen[0] == seen[2] == untouched
    assert getattr(seen[1], field) == value
    assert getattr(untouched, field) != value


def test_desk_faults_do_not_cancel_each_other(a_train: ATrain) -> None:
    train = a_train(
        {"kind": "passenger_alarm", "end_s": 3.0},
        {"kind": "desk_mode", "mode": "manual", "start_s": 1.0},
        {"kind": "desk_mode", "mode": "off", "start_s": 1.0, "end_s": 2.0},
    )
    train.run(1.5)
    assert (train.world.desk.mode, train.world.desk.no_passenger_alarm) == (CabMode.OFF, False)
    train.run(1.0)
    assert (train.world.desk.mode, train.world.desk.no_passenger_alarm) == (CabMode.MANUAL, False)
    train.run(1.0)
    assert (train.world.desk.mode, train.world.desk.no_passenger_alarm) == (CabMode.MANUAL, True)
