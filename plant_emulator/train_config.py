"""What the train really is: the consist files as frozen, checked values."""

import math
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import Final, Protocol

from firmware_py import settings

PACKAGE: Final = "plant_emulator.consists"
MAX_CARS: Final = 24


class Draws(Protocol):
    """A generator of numbers in [0, 1), such as numpy's."""

    def random(self) -> float: ...


@dataclass(frozen=True, slots=True)
class Spread:
    """A quantity spread evenly over [low, high]; equal ends make it fixed."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ValueError(f"low {self.low} is not at or under high {self.high}")

    def draw(self, generator: Draws) -> float:
        return self.low + (self.high - self.low) * generator.random()


class ConsistModel(Enum):
    """How finely the train is resolved."""

    MULTI_MASS = "multi_mass"
    """Every car a mass, couplers between them."""
    POINT_MASS = "point_mass"
    """One rigid body of the whole train's length."""


class DeadTimeKind(Enum):
    """What the dead time of the service brake delays."""

    TRANSPORT = "transport"
    """Every change of the demand, within one application all by the same time."""
    APPLICATION = "application"
    """Only the first build-up; a brake that is on follows at once."""


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
        _check(self, "tare_kg", 1.0, 1.0e6)
        _check(self, "length_m", 1.0, 100.0)
        _check(self, "passengers_kg", 0.0, 1.0e6)


@dataclass(frozen=True, slots=True)
class CouplerConfig:
    """Between every two cars, alike in push and pull."""

    stiffness_n_per_m: float
    damping_ns_per_m: float

    def __post_init__(self) -> None:
        _check(self, "stiffness_n_per_m", 1.0, 1.0e9)
        _check(self, "damping_ns_per_m", 0.0, 1.0e8)


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
            _check(self, name, 0.0, 1000.0)
        _check_spread(self, "error_ratio", -0.9, 10.0)


@dataclass(frozen=True, slots=True)
class TractionConfig:
    rated_force_n: float
    """Of all motors together, at the rail."""
    max_power_w: float
    """At the rail; force is at most power / speed."""
    effort_ratio: float
    """Share of rated force and power that heat and failed motors leave."""
    dead_time_s: float
    lag_s: float
    slew_n_per_s: float
    cut_s: float
    """From losing the permission to the open contactor. At most 0.30 s."""
    efficiency_ratio: float

    def __post_init__(self) -> None:
        _check(self, "rated_force_n", 1.0, 1.0e7)
        _check(self, "max_power_w", 1.0, 1.0e8)
        _check(self, "effort_ratio", 0.0, 1.0)
        _check(self, "dead_time_s", 0.0, 5.0)
        _check(self, "lag_s", 0.0, 5.0)
        _check(self, "slew_n_per_s", 1.0, 1.0e12)
        _check(self, "cut_s", 0.0, 0.30)
        _check(self, "efficiency_ratio", 0.1, 1.0)


@dataclass(frozen=True, slots=True)
class ElectricBrakeConfig:
    """The motors as generators; they fade out towards the stop and friction takes over."""

    share_ratio: float
    """Largest share of the service brake's force that the motors take."""
    max_force_n: float
    max_power_w: float
    fade_begin_mps: float
    fade_end_mps: float
    """Nothing is left from here down."""
    efficiency_ratio: float
    """Of what the brake takes from the train, so much reaches the line."""

    def __post_init__(self) -> None:
        _check(self, "share_ratio", 0.0, 1.0)
        _check(self, "max_force_n", 0.0, 1.0e7)
        _check(self, "max_power_w", 0.0, 1.0e8)
        _check(self, "fade_end_mps", 0.01, 100.0)
        _check(self, "fade_begin_mps", 0.01, 100.0)
        _check(self, "efficiency_ratio", 0.0, 1.0)
        if self.fade_end_mps >= self.fade_begin_mps:
            raise ValueError(
                f"fade_end_mps {self.fade_end_mps} is not under "
                f"fade_begin_mps {self.fade_begin_mps}"
            )


@dataclass(frozen=True, slots=True)
class PneumaticConfig:
    """Friction's own build-up, on top of the service brake's, when it takes its share over."""

    dead_time_s: Spread
    """Drawn once a run."""
    lag_s: float
    gain_ratio: Spread
    """Drawn once a run; friction gives this much of what it was asked."""

    def __post_init__(self) -> None:
        _check_spread(self, "dead_time_s", 0.0, 5.0)
        _check(self, "lag_s", 0.0, 5.0)
        _check_spread(self, "gain_ratio", 0.1, 2.0)


@dataclass(frozen=True, slots=True)
class ServiceBrakeConfig:
    """Decelerations are those of the loaded train on the level: the brake weighs its load."""

    max_decel_mps2: float
    dead_time_kind: DeadTimeKind
    dead_time_s: Spread
    """Drawn for each application: an application starts when the demand rises from zero."""
    lag_s: Spread
    """First-order build-up after the dead time; drawn once a run."""
    gain_ratio: Spread
    """Drawn once a run; the train gets this much of the deceleration it was asked."""
    electric: ElectricBrakeConfig
    pneumatic: PneumaticConfig

    def __post_init__(self) -> None:
        _check(self, "max_decel_mps2", 0.1, 3.0)
        _check_spread(self, "dead_time_s", 0.0, 5.0)
        _check_spread(self, "lag_s", 0.0, 5.0)
        _check_spread(self, "gain_ratio", 0.1, 2.0)


@dataclass(frozen=True, slots=True)
class EmergencyBrakeConfig:
    """Friction only, on a line of its own; applies when the command goes missing."""

    decel_mps2: float
    dead_time_s: float
    lag_s: float
    """The two give 10 % after dead + 0.105 * lag, at most 0.5 s, and 90 % after
    dead + 2.303 * lag, at most 1.6 s."""
    release_s: float
    """Dead time of the release."""

    def __post_init__(self) -> None:
        _check(self, "decel_mps2", 0.1, 3.0)
        _check(self, "dead_time_s", 0.0, 0.5)
        _check(self, "lag_s", 0.0, 1.0)
        _check(self, "release_s", 0.0, 5.0)
        tenth_s = self.dead_time_s - self.lag_s * math.log(0.9)
        most_s = self.dead_time_s - self.lag_s * math.log(0.1)
        if tenth_s > 0.5 or most_s > 1.6:
            raise ValueError(
                f"dead_time_s {self.dead_time_s} and lag_s {self.lag_s} give 10 % after "
                f"{tenth_s:.2f} s and 90 % after {most_s:.2f} s; allowed are 0.5 s and 1.6 s"
            )


@dataclass(frozen=True, slots=True)
class HoldingBrakeConfig:
    decel_mps2: float
    """What it could give; at least 0.3, so that a full train holds on 30 permille."""
    dead_time_s: float
    lag_s: float
    engage_under_mps: float
    """A moving train ignores the holding brake above this speed."""

    def __post_init__(self) -> None:
        _check(self, "decel_mps2", 0.3, 3.0)
        _check(self, "dead_time_s", 0.0, 5.0)
        _check(self, "lag_s", 0.0, 5.0)
        _check(self, "engage_under_mps", 0.0, 5.0)


@dataclass(frozen=True, slots=True)
class BrakeConfig:
    service: ServiceBrakeConfig
    emergency: EmergencyBrakeConfig
    holding: HoldingBrakeConfig
    full_pressure_kpa: float
    """Cylinder pressure at the emergency brake's deceleration."""

    def __post_init__(self) -> None:
        _check(self, "full_pressure_kpa", 1.0, 1000.0)


@dataclass(frozen=True, slots=True)
class RailConfig:
    """Wheel and rail. A wheel that is asked for more than adhesion slips or slides."""

    adhesion_ratio: float
    """Largest force along the rail over weight on the wheels."""
    slip_limit_ratio: float
    """Slip or slide over train speed at which the protection of the wheels catches it."""
    slip_limit_mps: float
    """The same at low speed; the larger one counts."""
    slip_recovery_mps2: float
    """How fast wheels find back to the train's speed."""

    def __post_init__(self) -> None:
        _check(self, "adhesion_ratio", 0.005, 1.0)
        _check(self, "slip_limit_ratio", 0.0, 1.0)
        _check(self, "slip_limit_mps", 0.0, 10.0)
        _check(self, "slip_recovery_mps2", 0.1, 100.0)


@dataclass(frozen=True, slots=True)
class TachoConfig:
    car: int
    """Car that carries the axle, from the front, 1 for the first."""
    wheel_diameter_m: float
    """As worn; the nominal wheel has NOMINAL_WHEEL_M."""

    def __post_init__(self) -> None:
        _check(self, "wheel_diameter_m", 0.5, 1.2)


NOMINAL_WHEEL_M: Final = 0.860
PULSES_PER_TURN: Final = 256


@dataclass(frozen=True, slots=True)
class SensorConfig:
    odometer_error_ratio: Spread
    """Counted distance = true distance * (1 + error), on both axles; drawn once a run."""
    tachos: tuple[TachoConfig, TachoConfig]
    """Tacho A and tacho B."""
    doppler_error_ratio: Spread
    doppler_sigma_mps: float
    doppler_blind_mps: float
    imu_bias_mps2: Spread
    imu_sigma_mps2: float
    antenna_m: float
    """Tag antenna's centre behind the front coupler."""
    tag_sigma_m: float
    tag_clip_m: float
    tag_stamp_s: Spread
    """Error of the time stamp at the antenna's centre."""
    tag_latency_s: Spread
    """From the antenna's centre to the first byte on the line."""

    def __post_init__(self) -> None:
        _check_spread(self, "odometer_error_ratio", -0.2, 0.2)
        _check_spread(self, "doppler_error_ratio", -0.2, 0.2)
        _check(self, "doppler_sigma_mps", 0.0, 10.0)
        _check(self, "doppler_blind_mps", 0.0, 10.0)
        _check_spread(self, "imu_bias_mps2", -2.0, 2.0)
        _check(self, "imu_sigma_mps2", 0.0, 10.0)
        _check(self, "antenna_m", 0.0, 100.0)
        _check(self, "tag_sigma_m", 0.0, 1.0)
        _check(self, "tag_clip_m", 0.0, 1.0)
        _check_spread(self, "tag_stamp_s", -0.1, 0.1)
        _check_spread(self, "tag_latency_s", 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class DoorConfig:
    unlock_s: float
    """From the demand to the first movement."""
    open_s: float
    close_s: float
    """From the end of the demand to closed and locked."""
    obstructed_closings: int
    """How many of the first closings meet an obstacle and open again."""
    reopen_s: float
    """How long they stay open then, before they try again."""

    def __post_init__(self) -> None:
        for name in ("unlock_s", "open_s", "close_s", "reopen_s"):
            _check(self, name, 0.0, 60.0)
        if not 0 <= self.obstructed_closings <= 1000:
            raise ValueError(f"obstructed_closings {self.obstructed_closings} is not in 0..1000")


@dataclass(frozen=True, slots=True)
class SupplyConfig:
    """The line as one source behind a resistance, and what the train draws besides traction."""

    no_load_v: float
    source_ohm: float
    full_effort_v: float
    """Traction gives its full effort from here up."""
    no_effort_v: float
    """And nothing from here down."""
    auxiliary_w: float

    def __post_init__(self) -> None:
        _check(self, "no_load_v", 1.0, 5000.0)
        _check(self, "source_ohm", 0.0, 10.0)
        _check(self, "full_effort_v", 1.0, 5000.0)
        _check(self, "no_effort_v", 0.0, 5000.0)
        _check(self, "auxiliary_w", 0.0, 1.0e7)
        if self.no_effort_v >= self.full_effort_v:
            raise ValueError(
                f"no_effort_v {self.no_effort_v} is not under full_effort_v {self.full_effort_v}"
            )


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

    def __post_init__(self) -> None:
        _check(self, "rotating_mass_percent", 0.0, 50.0)
        _check(self, "load_ratio", 0.0, 1.0)
        _check(self, "load_report_ratio", 0.0, 3.0)
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


def _check(owner: object, name: str, least: float, most: float) -> None:
    """NaN is in no range, so it is refused too."""
    value = getattr(owner, name)
    if not least <= value <= most:
        raise ValueError(f"{name} {value} is not in {least:g}..{most:g}")


def _check_spread(owner: object, name: str, least: float, most: float) -> None:
    spread = getattr(owner, name)
    for end in fields(spread):
        value = getattr(spread, end.name)
        if not least <= value <= most:
            raise ValueError(f"{name}.{end.name} {value} is not in {least:g}..{most:g}")
