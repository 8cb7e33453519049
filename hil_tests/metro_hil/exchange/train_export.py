"""Writes a consist as a train of TTOBench, or as rolling stock of railML 3.2."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from firmware_py.settings import build, find, parse
from metro_hil.exchange.railml_export import NAMESPACE, decimal_text, kmh
from metro_hil.exchange.railml_own import REGISTER
from metro_hil.exchange.survey import file_name
from metro_hil.exchange.ttobench_export import LIBRARY
from plant_emulator.consist.track import GRAVITY_MPS2
from plant_emulator.train_config import PACKAGE, TrainConfig, effort_n

KG_PER_T: Final = 1000.0
STEPS: Final = 20
"""Number of steps of a curve up to the greatest speed."""
KMH_IN_N: Final = ("kN", "kN/(km/h)", "kN/(km/h)^2")
KMH_PER_MPS: Final = 3.6
LOST_BY_TTOBENCH: Final = (
    "delays and blending of the brakes, couplers, sensors, doors, rail and supply",
    "single cars: the format has their number, and the mass with passengers at load_ratio",
    "a curve of effort or a map of efficiency: the greatest force and power stand for it",
)
"""What the format has no place for in a train."""


@dataclass(frozen=True, slots=True)
class ExportedTrain:
    """A consist with its file's table, and the speed that a consist does not have."""

    config: TrainConfig
    table: dict[str, Any]
    speed_mps_max: float

    @property
    def resistance_n(self) -> tuple[float, float, float]:
        """Running resistance of the whole train: N, N/(m/s), N/(m/s)²."""
        train, own = self.config, self.config.resistance
        weight_kn = train.mass_kg * GRAVITY_MPS2 / 1000.0
        factors = (own.a_n_per_kn, own.b_n_per_kn_per_mps, own.c_n_per_kn_per_mps2)
        a, b, c = (weight_kn * factor for factor in factors)
        return a, b, c

    @property
    def inertia_kg(self) -> float:
        """Mass with passengers and rotating masses."""
        return self.config.mass_kg * (1.0 + self.config.rotating_mass_percent / 100.0)

    def effort_n(self, speed_mps: float) -> float:
        """Greatest tractive effort at a speed."""
        traction = self.config.traction
        if traction.effort:
            return effort_n(traction.effort, speed_mps)
        if speed_mps * traction.rated_force_n <= traction.max_power_w:
            return traction.rated_force_n
        return traction.max_power_w / speed_mps


def load_exported(name: str, speed_mps_max: float) -> ExportedTrain:
    """The consist of a file or shipped name. Raises SettingsError."""
    table = parse(find(name, PACKAGE))
    return ExportedTrain(build(TrainConfig, table, name), table, speed_mps_max)


def ttobench_train_text(train: ExportedTrain) -> str:
    """The train as a JSON file of TTOBench."""
    config = train.config
    electric = config.brake.service.electric
    table: dict[str, Any] = {
        "metadata": {"id": file_name(config.name), "library version": LIBRARY},
        "mass": _value("kg", config.mass_kg),
        "rho": _value("-", config.rotating_mass_percent / 100.0),
        "length": _value("m", config.length_m),
        "num coaches": {"value": len(config.cars)},
        "max traction power": _value("W", config.traction.max_power_w),
        "max traction force": _value("N", config.traction.rated_force_n),
        "max reg braking power": _value("W", electric.max_power_w),
        "max reg braking force": _value("N", electric.max_force_n),
        "max pn braking force": _value("N", config.brake.service.max_decel_mps2 * train.inertia_kg),
        "max deceleration": _value("m/s^2", config.brake.service.max_decel_mps2),
        "max speed": _value("km/h", float(kmh(train.speed_mps_max))),
        "efficiency traction": _value("-", config.traction.efficiency_ratio),
        "efficiency reg brake": _value("-", electric.efficiency_ratio),
        "ETCS braking data": {
            "A_brake_emergency": {
                "units": {"velocity": "km/h", "deceleration": "m/s^2"},
                "values": [[0.0, config.brake.emergency.decel_mps2]],
            }
        },
    }
    for power, (unit, newtons) in enumerate(zip(KMH_IN_N, train.resistance_n, strict=True)):
        table[f"rolling resistance r{power}"] = _value(unit, newtons / 1000.0 / KMH_PER_MPS**power)
    return json.dumps(table, indent=1) + "\n"


def _value(unit: str, value: float) -> dict[str, Any]:
    return {"unit": unit, "value": value}


def railml_train_text(train: ExportedTrain) -> str:
    """The train as a railML file."""
    root = Element("railML", {"xmlns": NAMESPACE, "version": "3.2"})
    add_rolling_stock(root, train)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def add_rolling_stock(root: Element, train: ExportedTrain) -> None:
    """Add one formation and its vehicles, one for each car."""
    config = train.config
    stock = SubElement(root, "rollingstock", {"id": "rs_train"})
    vehicles = SubElement(stock, "vehicles")
    motors = sum(car.motor for car in config.cars)
    for number, car in enumerate(config.cars, start=1):
        brutto_kg = car.tare_kg + config.load_ratio * car.passengers_kg
        vehicle = SubElement(
            vehicles,
            "vehicle",
            {
                "id": f"veh{number}",
                "bruttoWeight": decimal_text(brutto_kg / KG_PER_T),
                "tareWeight": decimal_text(car.tare_kg / KG_PER_T),
                "length": decimal_text(car.length_m),
                "speed": decimal_text(kmh(train.speed_mps_max)),
            },
        )
        if car.motor:
            effort = SubElement(
                SubElement(vehicle, "engine", {"id": f"eng{number}"}), "tractiveEffort"
            )
            points = [(at_mps, train.effort_n(at_mps) / motors) for at_mps in _speeds(train)]
            _curve(effort, "F", points)
    formations = SubElement(stock, "formations")
    keys = {"id": "for1", "speed": decimal_text(kmh(train.speed_mps_max))}
    formation = SubElement(formations, "formation", keys)
    SubElement(formation, "name", {"name": config.name, "language": "en"})
    entry = json.dumps(train.table, ensure_ascii=False, sort_keys=True)
    SubElement(formation, "designator", {"register": REGISTER, "entry": entry})
    for number in range(1, len(config.cars) + 1):
        order = {"orderNumber": str(number), "vehicleRef": f"veh{number}"}
        SubElement(formation, "trainOrder", order)
    decel = {"meanDeceleration": decimal_text(config.brake.service.max_decel_mps2)}
    SubElement(formation, "trainBrakes", {"brakeType": "none"} | decel)
    a, b, c = train.resistance_n
    points = [(v, a + v * (b + v * c)) for v in _speeds(train)]
    _curve(SubElement(formation, "trainResistance"), "R", points)


def _speeds(train: ExportedTrain) -> Sequence[float]:
    """Speeds of a curve: steps, corners of the effort, and the end of the greatest force."""
    traction, most_mps = train.config.traction, train.speed_mps_max
    corners = [each.speed_mps for each in traction.effort]
    corners.append(traction.max_power_w / traction.rated_force_n)
    steps = [most_mps * step / STEPS for step in range(STEPS + 1)]
    return sorted({*steps, *(at_mps for at_mps in corners if at_mps < most_mps)})


def _curve(parent: Element, name: str, points: Sequence[tuple[float, float]]) -> None:
    table = SubElement(
        parent,
        "valueTable",
        {"xValueName": "v", "xValueUnit": "m/s", "yValueName": name, "yValueUnit": "N"},
    )
    for at_mps, newtons in points:
        line = SubElement(table, "valueLine", {"xValue": decimal_text(Decimal(repr(at_mps)))})
        SubElement(line, "value", {"yValue": decimal_text(newtons)})
