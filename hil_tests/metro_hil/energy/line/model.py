"""Inputs of the simulated line: train, line, power supply, timetable and law."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_py.settings import SettingsError
from plant_emulator.power.supplies import Supply as Supply
from plant_emulator.power.supplies import load_supply
from plant_emulator.power.supplies import shipped_supplies as shipped_supplies

Numbers = NDArray[np.float64]
TRAINS: Final = 7
HEADWAY_S: Final = 180.0
LEGS: Final = 6
"""Number of legs: three in each direction."""
STOPS_M: Final = (0.0, 3799.0, 5824.0, 7788.0)
RUNS_S: Final = (216.0, 130.0, 127.0, 127.0, 130.0, 216.0)
DWELL_S: Final = 30.0
DWELL_SPREAD_S: Final = 10.0
TURNBACK_S: Final = 97.0
TURNBACK_MIN_S: Final = 60.0
LAP_S: Final = TRAINS * HEADWAY_S


@dataclass(frozen=True, slots=True)
class LineTrain:
    """Type B train as a point of mass; forces and powers at the wheel."""

    mass_kg: float = 198000.0
    """Including rotating masses."""
    weight_kg: float = 190000.0
    traction_force_n: float = 180000.0
    traction_power_w: float = 2.0e6
    brake_force_n: float = 180000.0
    brake_power_w: float = 3.0e6
    traction_efficiency_ratio: float = 0.86
    regeneration_efficiency_ratio: float = 0.86
    auxiliary_w: float = 120000.0
    speed_max_mps: float = 80.0 / 3.6
    jerk_mps3: float = 0.75
    decel_mps2: float = 0.85
    """Deceleration of the stop; the motors' share of it falls above 17 m/s."""

    def resistance_coefficients_n(self) -> tuple[float, float, float]:
        """Return Table 2 of [Lin], which has N for each kN and km/h, as N over m/s."""
        weight_kn = self.weight_kg * 9.81e-3
        return (3.74 * weight_kn, 0.025 * 3.6 * weight_kn, 0.000792 * 3.6**2 * weight_kn)


@dataclass(frozen=True, slots=True)
class Timetable:
    """Trains leave one terminal every headway, the other `phase_s` later; `runs_s` is (6,)."""

    runs_s: tuple[float, ...] = RUNS_S
    phase_s: float = 630.0
    """Time from leaving Zhuxinzhuang to leaving the far terminal: trip, dwells, turnback."""
    hold_mps: tuple[float, ...] = (0.0,) * LEGS
    coast_m: tuple[float, ...] = (0.0,) * LEGS
    """Place where coasting begins, from the start of each leg; only for hold and coast."""


@dataclass(frozen=True, slots=True)
class Law:
    """Law by which trains choose their speed between stations."""

    name: str
    alpha_ratio: float = 1.0
    beta_ratio: float = 0.0
    horizon_s: float = 1.0
    constant_v: float = 0.0
    """If positive, the law uses this voltage instead of the true one (ablation)."""
    standard_v: float = 750.0
    reversed_sign: bool = False
    literal_time: bool = False
    hold_and_coast: bool = False

    def as_array(self) -> Numbers:
        """Return the values in the order of `kernel`'s indices."""
        return np.array(
            [
                *(self.alpha_ratio, self.beta_ratio, self.horizon_s, self.constant_v),
                *(self.standard_v, -1.0 if self.reversed_sign else 1.0),
                *(float(self.literal_time), float(self.hold_and_coast)),
            ]
        )


def line_supply(name: str) -> Supply:
    """Load a supply that the simulated line can use. Raises SettingsError.

    Its sections follow one another along the line, and nothing in it has a memory.
    """
    supply = load_supply(name)
    if supply.storages:
        raise SettingsError(f"{name}: storages: the simulated line has none; use vobc run --trains")
    at_m = supply.sections[0].begin_m
    for section in supply.sections:
        if section.begin_m != at_m or section.end_m <= at_m:
            raise SettingsError(
                f"{name}: sections: {section.begin}-{section.end} does not begin at {at_m:g} m, "
                "where the one before ends"
            )
        at_m = section.end_m
    if supply.sections[0].begin_m > STOPS_M[0] or at_m < STOPS_M[-1]:
        raise SettingsError(
            f"{name}: sections: do not reach from {STOPS_M[0]:g} to {STOPS_M[-1]:g} m"
        )
    return supply


def edges_m(supply: Supply) -> list[float]:
    """Return the ends of the sections of a supply that `line_supply` accepted."""
    return [supply.sections[0].begin_m, *(section.end_m for section in supply.sections)]


TRADITIONAL: Final = Law("traditional")
HOLD_AND_COAST: Final = Law("hold and coast", hold_and_coast=True)
