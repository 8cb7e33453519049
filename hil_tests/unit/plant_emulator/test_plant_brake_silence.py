"""The brake unit's reaction to the first commands after a silence, at rest and in motion."""

from dataclasses import replace

import pytest

from can_dbc.brake import BrakeCommand
from plant_emulator.actuators.brake import BrakeUnit
from plant_emulator.noise import Generators
from plant_emulator.train_config import load_train

MS = 1_000_000
TIMEOUT_MS = 150
RELEASED = BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True)
BRAKED = replace(RELEASED, emergency_released=False)


class Stand:
    """A brake unit that receives a command every 50 ms and runs in steps of 10 ms."""

    def __init__(self, speed_mps: float = 10.0) -> None:
        self.unit = BrakeUnit(
            load_train("florence4_ideal").brake,
            Generators(1),
            step_s=0.01,
            timeout_ns=TIMEOUT_MS * MS,
            inertia_kg=150_000.0,
            motor_ratio=0.5,
        )
        self.now_ms = 0
        self.speed_mps = speed_mps
        self.run(10.0, RELEASED)
        assert not self.unit.emergency_wanted

    def run(self, duration_s: float, command: BrakeCommand | None) -> None:
        for step in range(round(duration_s * 100.0)):
            if command is not None and step % 5 == 0:
                self.unit.hear(command, self.now_ms * MS)
            start_ns = self.now_ms * MS
            self.now_ms += 10
            self.unit.step(start_ns, self.now_ms * MS, self.speed_mps, electric_possible=True)


@pytest.mark.parametrize("speed_mps", [-10.0, 0.01, 10.0])
def test_a_brake_applied_by_silence_in_motion_ends_only_after_a_braking_command(
    speed_mps: float,
) -> None:
    """Otherwise old commands of a dead controller, replayed by another node, would release the
    train."""
    stand = Stand(speed_mps)
    stand.run(5.0, None)
    assert stand.unit.silent

    stand.run(10.0, RELEASED)
    assert not stand.unit.silent
    assert stand.unit.emergency_wanted

    for _ in range(2):
        stand.run(0.05, BRAKED)
        assert stand.unit.emergency_wanted
        stand.run(0.05, RELEASED)
        assert not stand.unit.emergency_wanted


def test_each_silence_needs_its_own_braking_command() -> None:
    stand = Stand()
    for _ in range(2):
        stand.run(0.5, None)
        stand.run(0.5, RELEASED)
        assert stand.unit.emergency_wanted
        stand.run(0.05, BRAKED)
        stand.run(0.05, RELEASED)
        assert not stand.unit.emergency_wanted


def test_a_train_stopped_by_silence_is_released_at_rest() -> None:
    """A brake that ended at rest does not come back when the train rolls."""
    stand = Stand()
    stand.run(5.0, None)
    stand.speed_mps = 0.0
    stand.run(0.01, None)
    stand.run(0.05, RELEASED)
    stand.speed_mps = 1.0
    stand.run(10.0, RELEASED)

    assert not stand.unit.emergency_wanted


@pytest.mark.parametrize(("late_ns", "losses"), [(0, 0), (1, 1)])
def test_a_command_just_after_the_timeout_ends_a_silence(late_ns: int, losses: int) -> None:
    """This holds although no step of the unit fell in between."""
    stand = Stand()
    stand.unit.hear(RELEASED, stand.now_ms * MS)
    stand.unit.hear(RELEASED, (stand.now_ms + TIMEOUT_MS) * MS + late_ns)

    assert stand.unit.losses == losses
    assert stand.unit.emergency_wanted is bool(losses)
