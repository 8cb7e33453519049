"""The train for running curves: mass, force and power at the wheel, efficiencies."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_py import settings
from plant_emulator.train_config import EfficiencyMap, EffortPoint, TrainConfig
from plant_emulator.train_config import load_train as load_consist

SHIPPED: Final = "metro_hil.energy.running_curve.trains"
CONSISTS: Final = "plant_emulator.consists"
GRAVITY_MPS2: Final = 9.81
MOTORS_A_CAR: Final = 4
"""Motors of each car of a consist that has motors; consist files do not give their number."""
POWER_SAMPLES: Final = 1000
SPEED_MAX_MPS: Final = 100.0
"""Greatest speed of a consist, beyond all limits of lines."""

Numbers = NDArray[np.float64]


class CellDrag(NamedTuple):
    """What the track adds to the train's running resistance in cells, or in a single one."""

    grade_n: Numbers
    """Force of the gradient against the train, positive uphill."""
    air_ratio: Numbers
    """Air drag of the whole train, divided by that in the open."""

    def at_n(self, train: "RunningTrain", speed_mps: Numbers) -> Numbers:
        """Return the whole force against the train."""
        return train.resistance_at_n(speed_mps, self.air_ratio) + self.grade_n

    def of(self, index: Any) -> "CellDrag":
        """Return one cell, or all cells along another axis."""
        return CellDrag(self.grade_n[index], self.air_ratio[index])


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
    rotating_ratio: float = 0.0
    """Rotating masses as a share of the weight, on which gradients do not act. 0: the whole of
    `mass_kg` counts as weight."""
    auxiliary_w: float = 0.0
    """Power of the auxiliaries on a line with a supply. Single running curves leave it out."""
    traction_map: EfficiencyMap | None = None
    """Efficiency of traction by speed and share of `traction_force_n`. It replaces the single
    value."""
    regeneration_map: EfficiencyMap | None = None
    """Efficiency of regeneration by speed and share of `brake_force_n`, likewise."""
    traction_effort: tuple[EffortPoint, ...] = ()
    """Greatest traction over speed. It replaces force and power, which are then its greatest."""
    brake_effort: tuple[EffortPoint, ...] = ()
    """Greatest force of the electric brake over speed, likewise."""

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
        for name in (
            *("resistance_n", "resistance_n_per_mps", "resistance_n_per_mps2", "rotating_ratio"),
            "auxiliary_w",
        ):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} {value} is negative")

    @property
    def weight_kg(self) -> float:
        return self.mass_kg / (1.0 + self.rotating_ratio)

    def resistance_at_n(self, speed_mps: Numbers, air_ratio: Numbers | float = 1.0) -> Numbers:
        """Return the running resistance where air drag has this ratio to that in the open."""
        return self.resistance_n + speed_mps * (
            self.resistance_n_per_mps + speed_mps * (self.resistance_n_per_mps2 * air_ratio)
        )

    def traction_at_n(self, speed_mps: Numbers) -> Numbers:
        """Return the maximum effort."""
        if self.traction_effort:
            return along(self.traction_effort, speed_mps)
        return np.minimum(self.traction_force_n, self.traction_power_w / np.maximum(speed_mps, 0.1))

    def traction_efficiency(self, speed_mps: Numbers, force_n: Numbers) -> Numbers | float:
        """Share of the drawn power that acts at the wheels, at this speed and force."""
        if self.traction_map is None:
            return self.traction_efficiency_ratio
        return interpolated(self.traction_map, speed_mps, force_n / self.traction_force_n)

    def regeneration_efficiency(self, speed_mps: Numbers, force_n: Numbers) -> Numbers | float:
        """Share of the electric brake's power at the wheels that returns to the line."""
        if self.regeneration_map is None:
            return self.regeneration_efficiency_ratio
        return interpolated(self.regeneration_map, speed_mps, force_n / self.brake_force_n)

    def braking_at_n(self, speed_mps: Numbers, power_w: Numbers | float) -> Numbers:
        """Return the electric brake force: full force at low speed, P / v above."""
        limit_w = np.minimum(power_w, self.brake_power_w)
        most_n: Numbers | float = self.brake_force_n
        if self.brake_effort:
            most_n = np.minimum(most_n, along(self.brake_effort, speed_mps))
        return np.minimum(most_n, limit_w / np.maximum(speed_mps, 0.1))


def along(points: tuple[EffortPoint, ...], speed_mps: Numbers) -> Numbers:
    """Force of a curve at many speeds: linear between points, constant power beyond the last."""
    last = points[-1]
    inside_n = np.interp(
        speed_mps, [each.speed_mps for each in points], [each.force_n for each in points]
    )
    beyond_n = last.force_n * last.speed_mps / np.maximum(speed_mps, 0.1)
    return np.where(speed_mps > last.speed_mps, beyond_n, inside_n)


def greatest_power_w(points: tuple[EffortPoint, ...]) -> float:
    """Greatest power on a curve. Between two points it is a parabola over speed."""
    speeds_mps = np.linspace(0.0, points[-1].speed_mps, POWER_SAMPLES)
    speeds_mps = np.append(speeds_mps, [each.speed_mps for each in points])
    return float(np.max(along(points, speeds_mps) * speeds_mps))


def interpolated(table: EfficiencyMap, speed_mps: Numbers, load_ratio: Numbers) -> Numbers:
    """Interpolate between the four nearest values; beyond an edge the edge holds."""
    values = np.array(table.efficiency_ratio)
    rows, columns = values.shape
    row = np.interp(speed_mps, table.speed_mps, np.arange(rows))
    column = np.interp(load_ratio, table.load_ratio, np.arange(columns))
    up, left = row.astype(np.intp), column.astype(np.intp)
    down, right = np.minimum(up + 1, rows - 1), np.minimum(left + 1, columns - 1)
    above = values[up, left] + (column - left) * (values[up, right] - values[up, left])
    below = values[down, left] + (column - left) * (values[down, right] - values[down, left])
    found: Numbers = above + (row - up) * (below - above)
    return found


def _with_loads(table: EfficiencyMap | None, of_n: float, now_of_n: float) -> EfficiencyMap | None:
    """The table with its loads as shares of another force. Without such a force it stays."""
    if table is None or now_of_n <= 0.0:
        return table
    loads = tuple(load_ratio * of_n / now_of_n for load_ratio in table.load_ratio)
    return replace(table, load_ratio=loads)


def scaled(points: tuple[EffortPoint, ...], ratio: float) -> tuple[EffortPoint, ...]:
    return tuple(EffortPoint(each.speed_mps, ratio * each.force_n) for each in points)


def load_train(name: str) -> RunningTrain:
    """Load a train by path or by the name of a shipped file. Raises SettingsError.

    It may also be a consist, such as `vobc import` writes.
    """
    if settings.is_path(name):
        consist = "cars" in settings.parse(Path(name))
    else:
        shipped, consists = settings.shipped_names(SHIPPED), settings.shipped_names(CONSISTS)
        if name not in (*shipped, *consists):
            hint = settings.nearest(name, sorted({*shipped, *consists}), "train")
            raise settings.SettingsError(f"{name}: {hint}")
        consist = name not in shipped
    return of_consist(load_consist(name)) if consist else settings.load(RunningTrain, name, SHIPPED)


def of_consist(consist: TrainConfig) -> RunningTrain:
    """Return the train of a consist, with its load.

    The line sets its greatest speed. The electric brake works down to the standstill.
    """
    traction, service = consist.traction, consist.brake.service
    electric, resistance = service.electric, consist.resistance
    rotating_ratio = consist.rotating_mass_percent / 100.0
    mass_kg = consist.mass_kg * (1.0 + rotating_ratio)
    weight_kn = consist.mass_kg * GRAVITY_MPS2 / 1000.0
    service_n = mass_kg * service.max_decel_mps2
    rated_n, power_w = traction.rated_force_n, traction.max_power_w
    pull = scaled(traction.effort, traction.effort_ratio)
    if pull:
        rated_n = max(each.force_n for each in traction.effort)
        power_w = greatest_power_w(traction.effort)
    electric_n, electric_w = electric.max_force_n, electric.max_power_w
    if electric.effort:
        electric_n = max(each.force_n for each in electric.effort)
        electric_w = greatest_power_w(electric.effort)
    electric_n = min(service_n, electric_n)
    try:
        return RunningTrain(
            name=consist.name,
            description=consist.description or consist.name,
            mass_kg=mass_kg,
            motors=MOTORS_A_CAR * sum(car.motor for car in consist.cars),
            traction_force_n=rated_n * traction.effort_ratio,
            traction_power_w=power_w * traction.effort_ratio,
            traction_efficiency_ratio=traction.efficiency_ratio,
            brake_force_n=electric_n,
            brake_power_w=electric_w,
            regeneration_efficiency_ratio=electric.efficiency_ratio,
            service_force_n=service_n,
            speed_max_mps=SPEED_MAX_MPS,
            resistance_n=resistance.a_n_per_kn * weight_kn,
            resistance_n_per_mps=resistance.b_n_per_kn_per_mps * weight_kn,
            resistance_n_per_mps2=resistance.c_n_per_kn_per_mps2 * weight_kn,
            length_m=consist.length_m,
            rotating_ratio=rotating_ratio,
            auxiliary_w=consist.supply.auxiliary_w,
            traction_map=_with_loads(
                traction.efficiency, traction.rated_force_n, rated_n * traction.effort_ratio
            ),
            regeneration_map=_with_loads(electric.efficiency, electric.max_force_n, electric_n),
            traction_effort=pull,
            brake_effort=electric.effort,
        )
    except ValueError as error:
        raise settings.SettingsError(f"consist {consist.name}: {error}") from error
