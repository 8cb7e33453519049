"""A train without noise on a level line, with the faults that a scenario gives it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest

from can_dbc.analogue import AnalogueCommand
from can_dbc.brake import BrakeCommand
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Direction
from can_dbc.traction import TractionCommand
from firmware_py.settings import override
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.circuit import load_network
from firmware_py.trackdb.network import Running
from firmware_py.trackdb.paths import make_path
from plant_emulator.faults.plan import read_faults
from plant_emulator.faults.schedule import Schedule
from plant_emulator.faults.stage import FaultStage
from plant_emulator.train_config import TrainConfig, load_train
from plant_emulator.wayside.interlocking import Interlocking
from plant_emulator.wayside.railway import Railway
from plant_emulator.world import STEP_S, World

QUIET: Final = override(
    load_train("florence4"),
    {
        "resistance": {
            "a_n_per_kn": 0.0,
            "b_n_per_kn_per_mps": 0.0,
            "c_n_per_kn_per_mps2": 0.0,
            "error_ratio": 0.0,
        },
        "brake.service": {"dead_time_s": 0.5, "lag_s": 0.3, "gain_ratio": 1.0},
        "sensors": {
            "odometer_error_ratio": 0.0,
            "doppler_error_ratio": 0.0,
            "doppler_sigma_mps": 0.0,
            "imu_bias_mps2": 0.0,
            "imu_sigma_mps2": 0.0,
            "tag_sigma_m": 0.0,
            "tag_stamp_s": 0.0,
            "tag_latency_s": 0.02,
        },
        "sensors.tachos.1.wheel_diameter_m": 0.86,
    },
    "quiet",
)
LOOPED: Final = override(
    QUIET,
    {"loop": {"connected": True, "offset_ma": 0.0, "gain_ratio": 1.0, "sigma_ma": 0.0}},
    "looped",
)
LEVEL: Final[LineMap] = replace(load_line("florence"), gradients=(), curves=())
START_M: Final = 2000.0
JUNCTION: Final = Path(__file__).resolve().parents[3] / "docs/examples/line/junction.toml"


def interlocking() -> Interlocking:
    """Switches and routes for faults, none of them on the train's path."""
    network = load_network(str(JUNCTION))
    path = make_path(network, "alone", [("east", Running.UP)])
    return Interlocking(network, path, to_m=0.0, front_m=0.0, rear_m=-70.0)


class Train:
    """A train that gets commands every 50 ms and updates its faults before each step, as in the
    plant."""

    RELEASED = BrakeCommand(service_decel_mps2=0.0, emergency_released=True, holding_released=True)
    EMERGENCY = replace(RELEASED, emergency_released=False)
    HOLDING = replace(RELEASED, holding_released=False)
    COASTING = TractionCommand(force_n=0.0, direction=Direction.FORWARD, traction_permitted=True)
    FORBIDDEN = replace(COASTING, traction_permitted=False)

    def __init__(
        self,
        *faults: dict[str, Any],
        speed_mps: float = 0.0,
        train: TrainConfig = QUIET,
        front_m: float = START_M,
        seed: int = 1,
        released: bool = True,
    ) -> None:
        self.world = World(train, LEVEL, seed=seed, front_m=front_m)
        if released:
            self._warm_up(speed_mps)
        self.railway = Railway(LEVEL, LEVEL.stations[-1], interlocking())
        self.schedule = Schedule(read_faults(faults, "scenario"))
        self.stage = FaultStage(
            self.world,
            self.schedule,
            start_ns=self.world.now_ns,
            observer=self._observe,
            railway=self.railway,
        )
        self.truth = self.stage.truth
        self.samples: list[bytes] = []
        """The truth signals of every step."""

    def _observe(self, truth: object, now_ns: int) -> None:
        self.samples.append(self.truth.pack())

    def _warm_up(self, speed_mps: float) -> None:
        for step in range(800):
            if step % 5 == 0:
                self._hear(self.RELEASED, self.COASTING, None)
            self.world.step()
        consist = self.world.consist
        consist.car_speeds_mps[:] = [speed_mps] * len(consist.cars)
        consist.speed_mps = speed_mps

    def _hear(
        self,
        brake: BrakeCommand | None,
        traction: TractionCommand | None,
        doors: DoorCommand | None,
    ) -> None:
        now_ns = self.world.now_ns
        if self.world.loops is not None and brake is not None and traction is not None:
            self.world.hear_currents(self._currents(brake, traction), now_ns)
        if brake is not None:
            self.world.brake.hear(brake, now_ns)
        if traction is not None:
            self.world.traction.hear(traction, now_ns)
        if doors is not None:
            self.world.doors.hear(doors, now_ns)

    def _currents(self, brake: BrakeCommand, traction: TractionCommand) -> AnalogueCommand:
        """The frame that a controller for current loops sends beside these commands."""
        pull_mps2 = traction.force_n / self.world.consist.inertia_kg
        traction_ma, brake_ma = (
            4.0 + 14.0 * min(1.0, amount_mps2) if amount_mps2 > 0.0 else 3.8
            for amount_mps2 in (pull_mps2, brake.service_decel_mps2)
        )
        return AnalogueCommand(traction_ma=traction_ma, brake_ma=brake_ma)

    def each_step(
        self,
        duration_s: float,
        brake: BrakeCommand | None = RELEASED,
        traction: TractionCommand | None = COASTING,
        doors: DoorCommand | None = None,
    ) -> Iterator[World]:
        """Yield the world after every step; a command of None means silence."""
        for step in range(round(duration_s / STEP_S)):
            if step % 5 == 0:
                self._hear(brake, traction, doors)
            self.stage.look(0.0)
            self.world.step()
            yield self.world

    def run(self, duration_s: float, *commands: Any, **named: Any) -> World:
        """Run and return the world afterwards."""
        for _ in self.each_step(duration_s, *commands, **named):
            pass
        return self.world

    def braking(self, decel_mps2: float) -> BrakeCommand:
        return replace(self.RELEASED, service_decel_mps2=decel_mps2)

    def driving(self, force_n: float) -> TractionCommand:
        return replace(self.COASTING, force_n=force_n)

    @property
    def decel_mps2(self) -> float:
        """Deceleration that all brakes together gave in the last step."""
        return self.world.brake_n / self.world.consist.inertia_kg


@pytest.fixture
def a_train() -> Callable[..., Train]:
    """Factory `a_train(fault, ..., speed_mps=10.0)`: a released train with faults as in a
    scenario."""
    return Train


@pytest.fixture
def looped() -> TrainConfig:
    """The same train controlled by current loops without error or scatter."""
    return LOOPED


@pytest.fixture
def quiet() -> TrainConfig:
    """The train of `a_train`: without running resistance, noise, errors or random delays."""
    return QUIET
