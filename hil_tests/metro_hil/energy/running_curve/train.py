"""The train for running curves: mass, force and power at the wheel, efficiencies."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py import settings

SHIPPED: Final = "metro_hil.energy.running_curve.trains"
GRAVITY_MPS2: Final = 9.81

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RunningTrain:
    """All forces and powers are those of the whole train at the wheel."""

    name: str
    description: str
    mass_kg: float
    """Including rotating masses."""
    motors: int
    traction_force_n: float
    traction_power_w: float
    traction_efficiency_ratio: float
    """Share of the power drawn from the line that acts at the wheels."""
    brake_force_n: float
    """Maximum of the electric brake."""
    brake_power_w: float
    regeneration_efficiency_ratio: float
    """Share of the power of electric braking at the wheels that returns to the line."""
    service_force_n: float
    """Maximum of both brakes together. Running curves use no friction brake; only the optimum
    may."""
    speed_max_mps: float
    resistance_n: float
    resistance_n_per_mps: float
    resistance_n_per_mps2: float
    length_m: float = 66.0

    def __post_init__(self) -> None:
        for name in (
            *("mass_kg", "motors", "traction_force_n", "traction_power_w", "brake_force_n"),
            *("brake_power_w", "service_force_n", "speed_max_mps", "length_m"),
        ):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} {value} is not positive")
        for name in ("traction_efficiency_ratio", "regeneration_efficiency_ratio"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} {getattr(self, name)} is not within 0..1")
        for name in (*("resistance_n", "resistance_n_per_mps", "resistance_n_per_mps2"),):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} {value} is negative")

    def resistance_at_n(self, speed_mps: Numbers) -> Numbers:
        return self.resistance_n + speed_mps * (
            self.resistance_n_per_mps + speed_mps * self.resistance_n_per_mps2
        )

    def traction_at_n(self, speed_mps: Numbers) -> Numbers:
        """Return the maximum effort."""
        return np.minimum(self.traction_force_n, self.traction_power_w / np.maximum(speed_mps, 0.1))

    def braking_at_n(self, speed_mps: Numbers, power_w: Numbers | float) -> Numbers:
        """Return the electric brake force: full force at low speed, P / v above."""
        limit_w = np.minimum(power_w, self.brake_power_w)
        return np.minimum(self.brake_force_n, limit_w / np.maximum(speed_mps, 0.1))


def load_train(name: str) -> RunningTrain:
    """Load a train by path or by the name of a shipped file. Raises SettingsError."""
    return settings.load(RunningTrain, name, SHIPPED)
