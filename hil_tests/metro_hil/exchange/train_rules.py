"""Completes a surveyed train by stated rules, from the shipped train florence4."""

import math
from typing import Any, Final

from can_dbc.doors import CARS_MAX
from firmware_py.settings import build, find, parse
from metro_hil.exchange.line_rules import Completed, FittedTrain
from metro_hil.exchange.survey import SurveyedTrain
from plant_emulator.consist.track import GRAVITY_MPS2
from plant_emulator.train_config import PACKAGE, TrainConfig
from vobc.config import SHIPPED, VobcConfig

BASE: Final = "florence4"
"""Shipped train that gives what the file does not say."""
CAR_M: Final = 19.5
"""Length of a car of a file without length; that of a type B car."""
CAR_KG: Final = 45_000.0
"""Mass of a car of a file that does not say how many there are; a type B car with passengers."""
KEPT_RATIO: Final = 1.0 / 1.2
"""Guaranteed share of the emergency brake of a file without one; that of the shipped train."""
SERVICE_MPS2_MAX: Final = 1.0
SPEED_SPARE_MPS: Final = 10.0
"""Odometry must measure up to this much above the train's greatest speed."""
BASE_POWER_W: Final = 2.4e6
"""Power of the shipped train, for what grows with the power."""
SLEW_PER_S: Final = 2.0
HEAT_S: Final = 25.0
"""Time at full power that the shipped train's resistor withstands from cold, s."""
PLAUSIBLE_TENTHS: Final = 10.0


def complete_train(train: SurveyedTrain) -> tuple[Completed, Completed]:
    """Consist and parameters as tables of their files. Raises SettingsError."""
    cars = train.cars or max(1, round(train.mass_kg / CAR_KG))
    lengths_m = [(train.length_m or cars * CAR_M) / cars] * cars
    if train.given:
        own = build(TrainConfig, train.given, train.source)
        lengths_m = [car.length_m for car in own.cars]
        params = _parameters(train, lengths_m)
        _know(params, own)
        build(VobcConfig, params, train.source)
        note = f"consist: that of the export; the rules made parameters, from those of {BASE}"
        left_out = tuple(f"left out: {text}" for text in train.ignored)
        return Completed(dict(train.given), (note, *left_out)), Completed(params, ())
    consist, params = _consist(train, lengths_m), _parameters(train, lengths_m)
    build(TrainConfig, consist, train.source)
    build(VobcConfig, params, train.source)
    return Completed(consist, tuple(_notes(train, lengths_m))), Completed(params, ())


def _know(params: dict[str, Any], own: TrainConfig) -> None:
    """Let the parameters have what a consist says beyond the elements of the file."""
    tacho, *_ = own.sensors.tachos
    tare_kg = sum(car.tare_kg for car in own.cars)
    params["train"] |= {
        "tare_kg": tare_kg,
        "full_load_kg": sum(car.passengers_kg for car in own.cars),
        "rotating_mass_ratio": own.rotating_mass_percent * own.mass_kg / tare_kg / 100.0,
        "antenna_offset_m": own.sensors.antenna_m,
        "wheel_diameter_m": tacho.wheel_diameter_m,
        "pulses_per_turn": own.sensors.pulses_per_turn,
    }


def fitted(train: SurveyedTrain, params: dict[str, Any]) -> FittedTrain:
    """What a line needs to know about the train."""
    own = params["train"]
    return FittedTrain(
        train.name, own["length_m"], own["antenna_offset_m"], speed_mps_max=train.speed_mps_max
    )


def _inertia_kg(train: SurveyedTrain) -> float:
    return train.mass_kg * (1.0 + train.rotating_ratio)


def _force_n(train: SurveyedTrain) -> float:
    """Tractive effort, at most what gives the greatest acceleration of the file."""
    if train.accel_mps2 is None:
        return train.force_n
    return min(train.force_n, train.accel_mps2 * _inertia_kg(train))


def _service_mps2(train: SurveyedTrain) -> float:
    if train.decel_mps2 is not None:
        return min(train.decel_mps2, SERVICE_MPS2_MAX)
    return min((train.brake_force_n + train.friction_n) / _inertia_kg(train), SERVICE_MPS2_MAX)


def _davis(train: SurveyedTrain) -> dict[str, float]:
    """Resistance for each kN of weight."""
    weight_kn = train.mass_kg * GRAVITY_MPS2 / 1000.0
    names = ("a_n_per_kn", "b_n_per_kn_per_mps", "c_n_per_kn_per_mps2")
    return {name: n / weight_kn for name, n in zip(names, train.resistance_n, strict=True)}


def _consist(train: SurveyedTrain, lengths_m: list[float]) -> dict[str, Any]:
    table: dict[str, Any] = parse(find(BASE, PACKAGE))
    cars, force_n = len(lengths_m), _force_n(train)
    table["name"] = train.name
    table["description"] = f"Imported from {train.source.rsplit('/', maxsplit=1)[-1]}"
    table["model"] = "point_mass"
    table["rotating_mass_percent"] = 100.0 * train.rotating_ratio
    table["load_ratio"] = 0.0
    table["cars"] = [
        {
            "tare_kg": train.mass_kg / cars,
            "length_m": length_m,
            "passengers_kg": 0.0,
            "motor": True,
        }
        for length_m in lengths_m
    ]
    table["resistance"] |= _davis(train)
    traction, service = table["traction"], table["brake"]["service"]
    traction["rated_force_n"] = force_n
    traction["max_power_w"] = train.power_w
    traction["slew_n_per_s"] = SLEW_PER_S * force_n
    if train.effort_points:
        (first_mps, first_n), *_ = train.effort_points
        standing = [] if first_mps == 0.0 else [(0.0, first_n)]
        traction["effort"] = [
            {"speed_mps": speed_mps, "force_n": effort_n}
            for speed_mps, effort_n in (*standing, *train.effort_points)
        ]
    if train.traction_efficiency_ratio is not None:
        traction["efficiency_ratio"] = train.traction_efficiency_ratio
    service["max_decel_mps2"] = _service_mps2(train)
    electric = service["electric"]
    electric["share_ratio"] = 1.0
    electric["max_force_n"] = train.brake_force_n
    electric["max_power_w"] = train.brake_power_w
    if train.brake_efficiency_ratio is not None:
        electric["efficiency_ratio"] = train.brake_efficiency_ratio
    if train.emergency_mps2 is not None:
        table["brake"]["emergency"]["decel_mps2"] = train.emergency_mps2
    for tacho in table["sensors"]["tachos"]:
        tacho["car"] = min(tacho["car"], cars)
    _scale_supply(table["supply"], train)
    return table


def _scale_supply(supply: dict[str, Any], train: SurveyedTrain) -> None:
    """A stronger train gets a line that carries its power with the same loss of voltage."""
    supply["source_ohm"] *= min(1.0, BASE_POWER_W / train.power_w)
    supply["resistor"]["max_power_w"] = train.brake_power_w
    supply["resistor"]["heat_max_j"] = HEAT_S * train.brake_power_w


def _parameters(train: SurveyedTrain, lengths_m: list[float]) -> dict[str, Any]:
    table: dict[str, Any] = parse(find(BASE, SHIPPED))
    force_n, service_mps2 = _force_n(train), _service_mps2(train)
    accel_mps2 = force_n / _inertia_kg(train)
    table["name"] = train.name
    table["train"] |= {
        "length_m": sum(lengths_m),
        "tare_kg": train.mass_kg,
        "full_load_kg": 0.0,
        "rotating_mass_ratio": train.rotating_ratio,
        "rated_force_n": force_n,
        "rated_power_w": train.power_w,
        "service_decel_max_mps2": service_mps2,
    }
    if len(lengths_m) <= CARS_MAX:
        table["train"]["car_lengths_m"] = lengths_m
    odometry, atp = table["odometry"], table["atp"]
    odometry["max_speed_mps"] = max(
        odometry["max_speed_mps"], train.speed_mps_max + SPEED_SPARE_MPS
    )
    atp["runaway_mps2"] = max(
        atp["runaway_mps2"], math.ceil(PLAUSIBLE_TENTHS * accel_mps2) / PLAUSIBLE_TENTHS
    )
    if train.emergency_mps2 is not None:
        kept_ratio = train.emergency_kept_ratio
        atp["guaranteed_decel_mps2"] = train.emergency_mps2 * (
            KEPT_RATIO if kept_ratio is None else kept_ratio
        )
    ato = table.setdefault("ato", {})
    ato["traction"] = {"rated_accel_mps2": accel_mps2}
    ato["resistance"] = _davis(train)
    ato["green"] = {"tare_kg": train.mass_kg}
    ato["power_limited"] = {
        "tare_kg": train.mass_kg,
        "brake_power_w": train.brake_power_w,
        "traction_power_w": train.power_w,
    }
    return table


def _notes(train: SurveyedTrain, lengths_m: list[float]) -> list[str]:
    cars = len(lengths_m)
    notes = [
        f"brakes' delays, sensors, doors, rail and supply: those of the shipped train {BASE}",
        "mass: the whole mass of the file is tare; there are no further passengers",
        "cars: a rigid train in which every car has motors, since the file has one force",
        f"service brake: at most {_service_mps2(train):.3g} m/s²",
    ]
    if train.cars is None:
        notes.append(f"cars: {cars}, one for each {CAR_KG / 1000:g} t of the train's mass")
    if train.length_m is None:
        notes.append(f"length: {sum(lengths_m):g} m, {CAR_M:g} m for each car")
    if _force_n(train) < train.force_n:
        notes.append(
            f"tractive effort: {_force_n(train) / 1000:.1f} kN, which gives the greatest "
            "acceleration of the file"
        )
    if train.emergency_mps2 is None:
        notes.append(f"emergency brake: that of {BASE}, guaranteed 1 m/s²")
    else:
        notes.append("emergency brake: the least deceleration of the file; the delays are shipped")
    notes.append("odometry and protection: declared bounds are the shipped ones")
    notes += [*train.filled, *(f"left out: {text}" for text in train.ignored)]
    return notes
