"""What the brake unit does with the first commands after a silence, at rest and in motion."""

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
    """A brake unit that hears a command every 50 ms, and takes steps of 10 ms."""

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
def test_what_silence_applied_in_motion_only_a_command_that_had_the_brake_on_ends(
    speed_mps: float,
) -> None:
    """So a dead controller's old commands, sent by somebody else, do not let the train go."""
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


def test_each_silence_waits_for_the_brake_anew() -> None:
    stand = Stand()
    for _ in range(2):
        stand.run(0.5, None)
        stand.run(0.5, RELEASED)
        assert stand.unit.emergency_wanted
        stand.run(0.05, BRAKED)
        stand.run(0.05, RELEASED)
        assert not stand.unit.emergency_wanted


def test_a_train_that_came_to_rest_braked_by_silence_is_let_go() -> None:
    """What rest has ended does not come back when the train rolls."""
    stand = Stand()
    stand.run(5.0, None)
    stand.speed_mps = 0.0
    stand.run(0.01, None)
    stand.run(0.05, RELEASED)
    stand.speed_mps = 1.0
    stand.run(10.0, RELEASED)

    assert not stand.unit.emergency_wanted


@pytest.mark.parametrize(("late_ns", "losses"), [(0, 0), (1, 1)])
def test_a_command_just_after_the_timeout_comes_after_a_silence_all_the_same(
    late_ns: int, losses: int
) -> None:
    """Though no step of the unit fell between."""
    stand = Stand()
    stand.unit.hear(RELEASED, stand.now_ms * MS)
    stand.unit.hear(RELEASED, (stand.now_ms + TIMEOUT_MS) * MS + late_ns)

    assert stand.unit.losses == losses
    assert stand.unit.emergency_wanted is bool(losses)
