"""One consist file: the whole train."""

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Final

from firmware_py import settings
from plant_emulator.train_config.brakes import BrakeConfig
from plant_emulator.train_config.equipment import (
    DoorConfig,
    RailConfig,
    SupplyConfig,
    TractionConfig,
)
from plant_emulator.train_config.loops import LoopConfig
from plant_emulator.train_config.ranges import Spread, check, check_spread
from plant_emulator.train_config.sensors import SensorConfig

PACKAGE: Final = "plant_emulator.consists"
MAX_CARS: Final = 24


class ConsistModel(Enum):
    """How finely the train is resolved."""

    MULTI_MASS = "multi_mass"
    """Every car a mass, couplers between them."""
    POINT_MASS = "point_mass"
    """One rigid body of the whole train's length."""


@dataclass(frozen=True, slots=True)
class CarConfig:
    tare_kg: float
    length_m: float
    """Over couplers."""
    passengers_kg: float
    """At load ratio 1."""
    motor: bool
    """All axles driven; a car without is not driven at all."""

    def __post_init__(self) -> None:
        check(self, "tare_kg", 1.0, 1.0e6)
        check(self, "length_m", 1.0, 100.0)
        check(self, "passengers_kg", 0.0, 1.0e6)


@dataclass(frozen=True, slots=True)
class CouplerConfig:
    """Between every two cars, alike in push and pull."""

    stiffness_n_per_m: float
    damping_ns_per_m: float

    def __post_init__(self) -> None:
        check(self, "stiffness_n_per_m", 1.0, 1.0e9)
        check(self, "damping_ns_per_m", 0.0, 1.0e8)


@dataclass(frozen=True, slots=True)
class ResistanceConfig:
    """Davis: weight * (a + b * v + c * v**2), v in m/s; `a` is friction at standstill too."""

    a_n_per_kn: float
    b_n_per_kn_per_mps: float
    c_n_per_kn_per_mps2: float
    error_ratio: Spread
    """Drawn once a run: the true resistance is (1 + error) times that."""

    def __post_init__(self) -> None:
        for name in ("a_n_per_kn", "b_n_per_kn_per_mps", "c_n_per_kn_per_mps2"):
            check(self, name, 0.0, 1000.0)
        check_spread(self, "error_ratio", -0.9, 10.0)


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """One consist file."""

    name: str
    model: ConsistModel
    rotating_mass_percent: float
    """Wheels and motors add this much of the train's mass to its inertia, nothing to its weight."""
    load_ratio: float
    cars: tuple[CarConfig, ...]
    """From the front."""
    coupler: CouplerConfig
    resistance: ResistanceConfig
    traction: TractionConfig
    brake: BrakeConfig
    rail: RailConfig
    sensors: SensorConfig
    doors: DoorConfig
    supply: SupplyConfig
    description: str = ""
    load_report_ratio: float = 1.0
    """Load that the air springs report over the true one."""
    loop: LoopConfig = field(default_factory=LoopConfig)

    def __post_init__(self) -> None:
        check(self, "rotating_mass_percent", 0.0, 50.0)
        check(self, "load_ratio", 0.0, 1.0)
        check(self, "load_report_ratio", 0.0, 3.0)
        if not 1 <= len(self.cars) <= MAX_CARS:
            raise ValueError(f"cars: {len(self.cars)}, 1 to {MAX_CARS} are possible")
        if not any(car.motor for car in self.cars):
            raise ValueError("cars: none has a motor")
        for tacho in self.sensors.tachos:
            if not 1 <= tacho.car <= len(self.cars):
                raise ValueError(f"sensors.tachos: car {tacho.car} is not in 1..{len(self.cars)}")

    @property
    def length_m(self) -> float:
        return sum(car.length_m for car in self.cars)

    @property
    def passengers_kg(self) -> float:
        return self.load_ratio * sum(car.passengers_kg for car in self.cars)

    @property
    def mass_kg(self) -> float:
        """With passengers, without rotating masses."""
        return sum(car.tare_kg for car in self.cars) + self.passengers_kg


def load_train(name: str) -> TrainConfig:
    """A consist by path or by the stem of a shipped file; raises SettingsError."""
    return settings.load(TrainConfig, name, PACKAGE)


def with_overrides(
    train: TrainConfig,
    *,
    load_ratio: float | None = None,
    odometer_error_ratio: float | None = None,
) -> TrainConfig:
    """The same train with what a scenario fixes; None leaves the file's. Raises ValueError."""
    if load_ratio is not None:
        train = replace(train, load_ratio=load_ratio)
    if odometer_error_ratio is not None:
        fixed = Spread(odometer_error_ratio, odometer_error_ratio)
        train = replace(train, sensors=replace(train.sensors, odometer_error_ratio=fixed))
    return train
