"""Reads rolling stock of railML 3: one formation with its vehicles."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final
from xml.etree import ElementTree

from firmware_py.settings import SettingsError, build, nearest
from metro_hil.exchange.effort_curve import EFFORT, effort_curve
from metro_hil.exchange.railml_own import own_keys
from metro_hil.exchange.survey import SurveyedTrain, file_name
from metro_hil.exchange.train_export import ExportedTrain, railml_train_text
from metro_hil.exchange.xml_node import XmlNode
from plant_emulator.train_config import TrainConfig

KG_PER_T: Final = 1000.0
MPS_PER_KMH: Final = 1.0 / 3.6
UNITS: Final[Mapping[str, float]] = {"km/h": MPS_PER_KMH, "m/s": 1.0, "N": 1.0, "other:kN": 1000.0}
SPEEDS: Final = ("km/h", "m/s")
FORCES: Final = ("N", "other:kN")
ROTATING_RATIO: Final = 0.1
"""Share of rotating masses; railML has none."""
DECEL_MPS2: Final = 1.0
"""Service deceleration of a formation without brake data."""
SAME_RATIO: Final = 1e-6
"""Difference of two numbers that rounding explains."""
RESISTANCE_PER_KG: Final = (0.02, 0.0, 1.3e-4)
"""Resistance of each kilogram of a formation without trainResistance: N, N/(m/s), N/(m/s)²."""


def read_rolling_stock(root: XmlNode, formation: str | None) -> SurveyedTrain:
    """Read the formation of a name or id, or the only one. Raises SettingsError."""
    node = _formation(root, formation)
    vehicles = _vehicles(root, node)
    mass_kg = _total(node, vehicles, "totalWeight", ("bruttoWeight", "tareWeight"), KG_PER_T)
    speed_mps_max = _speed_mps(node, vehicles)
    force_n, power_w, note = _effort(node, vehicles, speed_mps_max)
    decel_mps2, brake_note = _deceleration(node)
    resistance_n, resistance_note = _resistance(node, mass_kg, speed_mps_max)
    accel = node.first("trainEngine")
    train = SurveyedTrain(
        name=file_name(node.name()),
        source=root.source,
        mass_kg=mass_kg,
        rotating_ratio=ROTATING_RATIO,
        force_n=force_n,
        power_w=power_w,
        brake_force_n=force_n,
        brake_power_w=power_w,
        friction_n=decel_mps2 * mass_kg * (1.0 + ROTATING_RATIO),
        resistance_n=resistance_n,
        speed_mps_max=speed_mps_max,
        length_m=_total(node, vehicles, "length", ("length",), 1.0),
        cars=sum(len(list(each.all("vehiclePart"))) or 1 for each in vehicles),
        accel_mps2=_positive(accel, "maxAcceleration") if accel is not None else None,
        decel_mps2=decel_mps2,
        filled=(
            note,
            "electric brake: force and power of traction; friction alone reaches the deceleration",
            f"rotating masses: {ROTATING_RATIO:.0%} of the mass",
            *brake_note,
            *resistance_note,
        ),
    )
    return _with_own_keys(node, train)


def _with_own_keys(node: XmlNode, train: SurveyedTrain) -> SurveyedTrain:
    """The train with the consist of an export of this project.

    It is left out if another program has changed elements of the train since then.
    """
    table = own_keys(node)
    if not table:
        return train
    config = build(TrainConfig, table, f"{node.source}: {node.place}: designator")
    again = ExportedTrain(config, {}, train.speed_mps_max)
    root = XmlNode(node.source, ElementTree.fromstring(railml_train_text(again)))  # noqa: S314
    pairs = zip(_numbers(read_rolling_stock(root, None)), _numbers(train), strict=True)
    if all(math.isclose(one, other, rel_tol=SAME_RATIO) for one, other in pairs):
        return replace(train, given=table)
    why = "its elements were changed since the export, so the rules fill what they do not say"
    return replace(train, ignored=(*train.ignored, f"designator of {node.place}: {why}"))


def _numbers(train: SurveyedTrain) -> tuple[float, ...]:
    """All that railML says about a train."""
    return (
        *(train.mass_kg, train.force_n, train.power_w, train.speed_mps_max),
        *(train.friction_n, *train.resistance_n),
        *(train.length_m or 0.0, float(train.cars or 0)),
        *(train.accel_mps2 or 0.0, train.decel_mps2 or 0.0),
    )


def _formation(root: XmlNode, wanted: str | None) -> XmlNode:
    found = {node.name(): node for node in root.all("rollingstock", "formations", "formation")}
    if not found:
        raise root.error("rollingstock has no formation; the import needs one with its vehicles")
    if wanted is None and len(found) > 1:
        raise root.error(
            f"has {len(found)} formations; choose one with --formation: {', '.join(found)}"
        )
    name = wanted if wanted is not None else next(iter(found))
    if name not in found:
        raise root.error(f"has no formation {name!r}; {nearest(name, list(found), 'formation')}")
    return found[name]


def _vehicles(root: XmlNode, formation: XmlNode) -> list[XmlNode]:
    """The vehicles of the formation in order; one that occurs twice is there twice."""
    known = {
        node.need("id", "give it an id"): node
        for node in root.all("rollingstock", "vehicles", "vehicle")
    }
    found = []
    for order in formation.all("trainOrder"):
        ref = order.need("vehicleRef", "name a vehicle")
        if ref not in known:
            raise order.error(
                f"there is no vehicle {ref!r}; {nearest(ref, list(known), 'vehicle')}"
            )
        found.append(known[ref])
    if not found:
        raise formation.error("has no trainOrder; name its vehicles")
    return found


def _positive(node: XmlNode, name: str, factor: float = 1.0) -> float | None:
    number = node.number(name, factor)
    if number is not None and not number > 0.0:
        raise node.error(f"{name}: {node.text(name)!r} is not positive")
    return number


def _total(
    formation: XmlNode,
    vehicles: Sequence[XmlNode],
    own: str,
    names: Sequence[str],
    factor: float,
) -> float:
    """The value of the formation, or else the sum over its vehicles."""
    total = _positive(formation, own, factor)
    if total is not None:
        return total
    parts = []
    for vehicle in vehicles:
        values = [_positive(vehicle, name, factor) for name in names]
        part = next((value for value in values if value is not None), None)
        if part is None:
            raise vehicle.error(f"has no {names[0]!r}; give it, or {own!r} of the formation")
        parts.append(part)
    return math.fsum(parts)


def _speed_mps(formation: XmlNode, vehicles: Sequence[XmlNode]) -> float:
    speeds = [_positive(node, "speed", MPS_PER_KMH) for node in (formation, *vehicles)]
    known = [speed for speed in speeds if speed is not None]
    if not known:
        raise formation.error("has no 'speed'; write its greatest speed in km/h")
    return min(known)


def _effort(
    formation: XmlNode, vehicles: Sequence[XmlNode], speed_mps_max: float
) -> tuple[float, float, str]:
    """Force and power of all engines, and a sentence about them."""
    force_n = power_w = 0.0
    notes = []
    for vehicle in vehicles:
        for engine in list(vehicle.all("engine"))[:1]:
            table = engine.first("tractiveEffort", "valueTable")
            if table is None:
                raise engine.error("has no tractiveEffort with a valueTable; give its curve")
            try:
                curve = effort_curve(_points(table), speed_mps_max)
            except ValueError as error:
                raise table.error(str(error)) from error
            force_n += curve.force_n
            power_w += curve.power_w
            notes.append(curve.note)
    if not notes:
        raise formation.error("no vehicle of it has an engine; the emulated train needs traction")
    note = notes[0]
    if len(notes) > 1:
        note += f" (the first of {len(notes)} engines; {force_n / 1000:.0f} kN in all)"
    assert note.startswith(EFFORT)
    return force_n, power_w, note


def _points(table: XmlNode) -> list[tuple[float, float]]:
    """The first column of a table: m/s and N."""
    speed, force = _unit(table, "xValueUnit", SPEEDS), _unit(table, "yValueUnit", FORCES)
    points = []
    for line in table.all("valueLine"):
        at, value = line.number("xValue", speed), line.first("value")
        y = value.number("yValue", force) if value is not None else None
        if at is None or y is None:
            raise line.error("has no 'xValue' or no value with 'yValue'; write both")
        points.append((at, y))
    return points


def _unit(table: XmlNode, name: str, allowed: Sequence[str]) -> float:
    unit = table.need(name, f"write one of {', '.join(allowed)}")
    if unit not in allowed:
        raise table.error(f"{name}: {unit!r} is unknown here; convert to {', '.join(allowed)}")
    return UNITS[unit]


def _deceleration(formation: XmlNode) -> tuple[float, tuple[str, ...]]:
    """The greatest deceleration of the brakes for normal use."""
    found = [
        value
        for brake in formation.all("trainBrakes")
        if brake.text("brakeUse") != "emergency"
        for name in ("meanDeceleration", "maxDeceleration")
        for value in (_positive(brake, name),)
        if value is not None
    ]
    if found:
        return max(found), ()
    return DECEL_MPS2, (f"service deceleration: {DECEL_MPS2:g} m/s²; trainBrakes gives none",)


def _resistance(
    formation: XmlNode, mass_kg: float, speed_mps_max: float
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Resistance of the whole train, fitted to the curve of the file."""
    table = formation.first("trainResistance", "valueTable")
    if table is None:
        a, b, c = (value * mass_kg for value in RESISTANCE_PER_KG)
        return (a, b, c), (
            "resistance: that of a common metro train; trainResistance has no table",
        )
    points = _points(table)
    if len(points) < 3:
        raise table.error(f"{len(points)} values; the resistance needs three or more")
    # Loaded here, so that an import of other files does not wait for these libraries.
    import numpy as np
    from scipy.optimize import nnls

    speeds = np.array([at for at, _ in points])
    forces = np.array([force for _, force in points])
    matrix = np.stack([np.ones_like(speeds), speeds, speeds**2], axis=1)
    fitted, _ = nnls(matrix, forces)
    worst_n = float(np.max(np.abs(matrix @ fitted - forces)))
    if not float(np.sum(fitted)) > 0.0:
        raise table.error("the resistance is zero; give it in N")
    a, b, c = (float(value) for value in fitted)
    return (a, b, c), (f"resistance: quadratic in speed, within {worst_n:.0f} N of the curve",)


def no_infrastructure_nor_stock(root: XmlNode) -> SettingsError:
    """The error for a railML file that has neither."""
    return root.error("has neither infrastructure nor rollingstock; the import reads only these")
