"""Edge cases of arbitration: unknown motion, no desk, coasting, minimal force, a weak train."""

import math
from dataclasses import replace

import pytest

from can_dbc.cab import CabMode, Desk
from can_dbc.nodes import Direction
from can_dbc.vobc import AtoPhase, Missing, Supervision
from hil_tests.unit.vobc.atp.heard_rig import DESK
from vobc.arbitration import (
    BRAKED_DEMAND,
    arbitrate,
    inertia_kg,
    manual_demand,
    most_accel_mps2,
)
from vobc.atp import ProtectionVerdict
from vobc.atp.doors import DoorEnable
from vobc.config import load_config
from vobc.vocabulary import AtoDemand, CycleOutput, Interval, Motion

TRAIN = load_config("florence4").train
WEAK = replace(TRAIN, rated_power_w=50_000.0)
FREE = ProtectionVerdict(
    supervision=Supervision.NOMINAL,
    cause="",
    missing=Missing.NOTHING,
    ceiling=None,
    doors_locked=True,
    emergency_released=True,
    service_brake=False,
    traction_permitted=True,
    hold=False,
    doors=DoorEnable(True, False),
)
DRIVE = AtoDemand(0.5, False, False, AtoPhase.RUNNING, 12.0, 300.0)


def decided(
    demand: AtoDemand, motion: Motion | None = None, desk: Desk | None = DESK
) -> CycleOutput:
    return arbitrate(FREE, demand, motion, desk, train=WEAK, load_kg=0.0)


@pytest.mark.parametrize("speed_mps", [0.5, 1.0, 2.0])
def test_the_power_limits_traction_at_any_speed(speed_mps: float) -> None:
    most_mps2 = most_accel_mps2(speed_mps, train=WEAK, load_kg=0.0)

    assert most_mps2 * inertia_kg(WEAK, 0.0) == pytest.approx(50_000.0 / speed_mps)


def at(speed_mps: float) -> Motion:
    speed = Interval(speed_mps, speed_mps, speed_mps)
    return Motion(Interval(0.0, 0.0, 0.0), speed, 0.0, 0.0, False, False, True, False, ())


def test_a_measured_speed_that_jumps_does_not_change_the_force() -> None:
    forces_n = [decided(DRIVE, at(speed_mps)).force_n for speed_mps in (2.0, 1.9, 2.1, -0.1)]

    assert forces_n == [pytest.approx(0.5 * inertia_kg(WEAK, 0.0))] * 4


def test_a_train_that_coasts_keeps_its_traction_ready() -> None:
    output = decided(replace(DRIVE, accel_mps2=0.0))

    assert (output.force_n, output.traction_permitted) == (0.0, True)
    assert output.direction is Direction.FORWARD


def test_the_least_traction_releases_a_held_train() -> None:
    output = decided(replace(DRIVE, accel_mps2=1e-6, hold=True))

    assert 0.0 < output.force_n < 1.0
    assert output.traction_permitted


def test_without_a_desk_operation_asks_for_doors() -> None:
    output = decided(replace(DRIVE, open_doors=True), desk=None)

    assert (output.open_left, output.open_right) == (True, False)


def test_without_a_driver_or_ato_the_reported_demand_is_full_service_brake() -> None:
    assert decided(BRAKED_DEMAND).accel_demand_mps2 == -TRAIN.service_decel_max_mps2
    assert decided(DRIVE).accel_demand_mps2 == 0.5


def test_the_lever_demands_effort_only() -> None:
    lever = replace(DESK, mode=CabMode.MANUAL, lever_percent=50.0)

    demand = manual_demand(lever, 0.0, False, train=TRAIN, jerk_mps=1.0)

    assert (demand.open_doors, demand.target_mps) == (False, 0.0)
    assert math.isinf(demand.distance_to_stop_m)


def test_a_nan_lever_gives_the_safe_output_without_a_lasting_effect() -> None:
    lever = replace(DESK, mode=CabMode.MANUAL, lever_percent=math.nan)

    demand = manual_demand(lever, 0.2, False, train=TRAIN, jerk_mps=0.03)
    output = decided(demand)
    after = manual_demand(
        replace(lever, lever_percent=0.0), demand.accel_mps2, False, train=TRAIN, jerk_mps=0.03
    )

    assert (output.force_n, output.emergency_released) == (0.0, False)
    assert output.supervision is Supervision.EMERGENCY
    assert after.accel_mps2 == 0.0
