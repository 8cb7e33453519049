"""One consist file, which describes the whole train."""

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
    """Number of masses that represent the train."""

    MULTI_MASS = "multi_mass"
    """Every car is a mass, with couplers between them."""
    POINT_MASS = "point_mass"
    """The whole train is one rigid body."""


@dataclass(frozen=True, slots=True)
class CarConfig:
    tare_kg: float
    length_m: float
    """Length over couplers."""
    passengers_kg: float
    """Mass of the passengers at load ratio 1."""
    motor: bool
    """True: all axles are driven. False: none is."""

    def __post_init__(self) -> None:
        check(self, "tare_kg", 1.0, 1.0e6)
        check(self, "length_m", 1.0, 100.0)
        check(self, "passengers_kg", 0.0, 1.0e6)


@dataclass(frozen=True, slots=True)
class CouplerConfig:
    """The coupler between any two cars, with the same properties in push and pull."""

    stiffness_n_per_m: float
    damping_ns_per_m: float

    def __post_init__(self) -> None:
        check(self, "stiffness_n_per_m", 1.0, 1.0e9)
        check(self, "damping_ns_per_m", 0.0, 1.0e8)


@dataclass(frozen=True, slots=True)
class ResistanceConfig:
    """Davis resistance: weight * (a + b * v + c * v**2), v in m/s.

    `c` is that of the air, which a tunnel multiplies by its `drag_ratio`. `a` also holds the train
    at standstill.
    """

    a_n_per_kn: float
    b_n_per_kn_per_mps: float
    c_n_per_kn_per_mps2: float
    error_ratio: Spread
    """Error sampled once a run: the true resistance is (1 + error) times the Davis resistance."""

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
    """Share of the mass that wheels and motors add to the inertia, but not to the weight."""
    load_ratio: float
    cars: tuple[CarConfig, ...]
    """Cars from the front."""
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
    """Load reported by the air springs divided by the true load."""
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
        """Mass with passengers, without rotating masses."""
        return sum(car.tare_kg for car in self.cars) + self.passengers_kg


def load_train(name: str) -> TrainConfig:
    """Load a consist by path or by the name of a shipped file; raises SettingsError."""
    return settings.load(TrainConfig, name, PACKAGE)


def seen_from_other_cab(train: TrainConfig) -> TrainConfig:
    """The same train seen from its other cab: the last car is the first one.

    Each cab has an antenna of its own, at the same distance from its front. Tachos stay at their
    wheels.
    """
    cars = len(train.cars)
    one, other = (replace(each, car=cars + 1 - each.car) for each in train.sensors.tachos)
    return replace(
        train, cars=train.cars[::-1], sensors=replace(train.sensors, tachos=(one, other))
    )


def with_overrides(
    train: TrainConfig,
    *,
    load_ratio: float | None = None,
    odometer_error_ratio: float | None = None,
) -> TrainConfig:
    """Return the train with the values that a scenario fixes; None keeps the file's value.

    Raises ValueError.
    """
    if load_ratio is not None:
        train = replace(train, load_ratio=load_ratio)
    if odometer_error_ratio is not None:
        fixed = Spread(odometer_error_ratio, odometer_error_ratio)
        train = replace(train, sensors=replace(train.sensors, odometer_error_ratio=fixed))
    return train
