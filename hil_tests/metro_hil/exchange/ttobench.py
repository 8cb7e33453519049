"""Reads the JSON files of TTOBench, a benchmark of train trajectory optimisation."""

import itertools
import math
from typing import Final

from firmware_py.settings import SettingsError
from metro_hil.exchange.survey import UNITS, CurvedStretch, Element, SurveyedLine, SurveyedTrain

STRAIGHT: Final = "infinity"
"""Text of a radius on straight track."""
LENGTHS: Final = ("m", "km")
SPEEDS: Final = ("km/h", "m/s")
MASSES: Final = ("kg", "t")
FORCES: Final = ("kN", "N")
POWERS: Final = ("kW", "MW", "W")
RATIOS: Final = ("%", "-")
ACCELERATIONS: Final = ("m/s^2",)
IGNORED_OF_TRACK: Final = {
    "altitude": "the height above sea level has no effect on the train",
    "tunnels": "the format does not give their air drag; add tunnels with a drag_ratio by hand",
}
IGNORED_OF_TRAIN: Final = {
    "num seats": "the mass of the file is that of the loaded train",
}
TUNNEL_DRAG: Final = "tunnel resistance"
ETCS: Final = "ETCS braking data"


def is_track(file: Element) -> bool:
    """Whether the file describes a track."""
    return file.has("stops")


def is_train(file: Element) -> bool:
    """Whether the file describes a train."""
    return file.has("mass")


def identity(file: Element) -> str:
    """The identifier of track or train."""
    name = file.part("metadata").part("id")
    text = name.text()
    if not all(each.isalnum() or each in "_-" for each in text):
        raise name.error(f"{text!r}: use letters, digits, _ and - only; it names files")
    return text


def read_track(file: Element) -> SurveyedLine:
    """Read a track. Raises SettingsError that names file and element."""
    stops_m = _stops_m(file.part("stops"))
    limits = _changes(file.part("speed limits"), "velocity", SPEEDS)
    gradients = file.optional("gradients")
    bends = file.optional("curvatures")
    for at_m, limit_mps in limits:
        if not limit_mps > 0.0:
            raise file.part("speed limits").error(
                f"{limit_mps:g} m/s at {at_m:g} m: a limit must be positive"
            )
    return SurveyedLine(
        name=identity(file),
        source=file.source,
        stops=tuple((f"S{number}", at_m) for number, at_m in enumerate(stops_m)),
        limits=limits,
        gradients=_changes(gradients, "slope", ("permil",)) if gradients else (),
        bends=_bends(bends, stops_m[-1]) if bends else (),
        ignored=tuple(f"{name}: {why}" for name, why in IGNORED_OF_TRACK.items() if file.has(name)),
    )


def _stops_m(stops: Element) -> list[float]:
    factor = stops.part("unit").unit(LENGTHS)
    values = stops.part("values").entries()
    if len(values) < 2:
        raise stops.error(f"{len(values)} stops; a line needs two or more")
    stops_m = [each.number(factor) for each in values]
    for element, (before_m, at_m) in zip(values[1:], itertools.pairwise(stops_m), strict=True):
        if not before_m < at_m:
            raise element.error(f"{at_m:g} m is not beyond the stop before it, {before_m:g} m")
    return stops_m


def _rows(table: Element, columns: tuple[tuple[str, tuple[str, ...]], ...]) -> list[list[Element]]:
    """The rows of a table; each must be as long as its list of units."""
    rows = table.part("values").entries()
    if not rows:
        raise table.error("has no values; leave it out or fill it in")
    for row in rows:
        if len(row.entries()) != len(columns):
            names = ", ".join(name for name, _ in columns)
            raise row.error(f"{row.value!r} is not a row of {names}")
    return [row.entries() for row in rows]


def _changes(
    table: Element, quantity: str, allowed: tuple[str, ...]
) -> tuple[tuple[float, float], ...]:
    """Chainages and the values that hold from there on."""
    units = table.part("units")
    length = units.part("position").unit(LENGTHS)
    factor = units.part(quantity).unit(allowed)
    rows = _rows(table, (("position", LENGTHS), (quantity, allowed)))
    changes = [(at.number(length), value.number(factor)) for at, value in rows]
    for (at, _), (before, after) in zip(rows[1:], itertools.pairwise(changes), strict=True):
        if not before[0] < after[0]:
            raise at.error(f"{after[0]:g} m is not beyond the row before it, {before[0]:g} m")
    if quantity == "velocity" and changes[0][0] > 0.0:
        raise rows[0][0].error(f"the first limit begins at {changes[0][0]:g} m; it must be at 0")
    return tuple(changes)


def _bends(table: Element, end_m: float) -> tuple[CurvedStretch, ...]:
    units = table.part("units")
    names = ("position", "radius at start", "radius at end")
    factors = [units.part(name).unit(LENGTHS) for name in names]
    rows = _rows(table, tuple((name, LENGTHS) for name in names))
    starts_m = [row[0].number(factors[0]) for row in rows]
    bends = []
    for row, (start_m, next_m) in zip(rows, itertools.pairwise([*starts_m, end_m]), strict=True):
        if not start_m < next_m:
            raise row[0].error(f"{start_m:g} m is not before the next position, {next_m:g} m")
        mean_per_m = mean_curvature_per_m(
            _curvature_per_m(row[1], factors[1]), _curvature_per_m(row[2], factors[2])
        )
        if mean_per_m > 0.0:
            bends.append(CurvedStretch(start_m, next_m, 1.0 / mean_per_m))
    return tuple(bends)


def _curvature_per_m(radius: Element, factor: float) -> float:
    if radius.value == STRAIGHT:
        return 0.0
    radius_m = radius.number(factor)
    if radius_m == 0.0:
        raise radius.error(f"a radius of 0; write {STRAIGHT!r} for straight track")
    return 1.0 / radius_m


def mean_curvature_per_m(start_per_m: float, end_per_m: float) -> float:
    """Mean magnitude of a curvature that changes linearly; the sign is that of the direction."""
    sides = abs(start_per_m) + abs(end_per_m)
    if start_per_m * end_per_m >= 0.0:
        return sides / 2.0
    return (start_per_m**2 + end_per_m**2) / (2.0 * sides)


def read_train(file: Element) -> SurveyedTrain:
    """Read a train. Raises SettingsError that names file and element."""
    mass_kg = _positive(file, "mass", MASSES)
    etcs = file.optional(ETCS)
    cars = file.optional("num coaches")
    speed_mps_max = _positive(file, "max speed", SPEEDS)
    emergency_mps2, kept_ratio = _emergency(etcs, speed_mps_max) if etcs else (None, None)
    resistance = [
        _quantity(file.part(f"rolling resistance r{power}"), (unit,))
        for power, unit in enumerate(("kN", "kN/(km/h)", "kN/(km/h)^2"))
    ]
    return SurveyedTrain(
        name=identity(file),
        source=file.source,
        mass_kg=mass_kg,
        rotating_ratio=_quantity(file.part("rho"), RATIOS),
        force_n=_positive(file, "max traction force", FORCES),
        power_w=_positive(file, "max traction power", POWERS),
        brake_force_n=_quantity(file.part("max reg braking force"), FORCES),
        brake_power_w=_quantity(file.part("max reg braking power"), POWERS),
        friction_n=_quantity(file.part("max pn braking force"), FORCES),
        resistance_n=(resistance[0], resistance[1], resistance[2]),
        speed_mps_max=speed_mps_max,
        traction_efficiency_ratio=_efficiency(file.optional("efficiency traction")),
        brake_efficiency_ratio=_efficiency(file.optional("efficiency reg brake")),
        length_m=_optional(file, "length", LENGTHS),
        cars=None if cars is None else _whole(cars.part("value")),
        accel_mps2=_optional(file, "max acceleration", ACCELERATIONS),
        decel_mps2=_optional(file, "max deceleration", ACCELERATIONS),
        emergency_mps2=emergency_mps2,
        emergency_kept_ratio=kept_ratio,
        ignored=(
            *(f"{name}: {why}" for name, why in IGNORED_OF_TRAIN.items() if file.has(name)),
            *_tunnel_drag(file.optional(TUNNEL_DRAG), resistance[2]),
        ),
    )


def _tunnel_drag(table: Element | None, open_n_per_mps2: float) -> tuple[str, ...]:
    """The ratios of air drag that a table of additional resistance gives for tunnels."""
    if table is None or not open_n_per_mps2 > 0.0:
        return ()
    units = table.part("units")
    area = units.part("cross section").unit(("m^2",))
    factor = units.part("coefficient").unit(("kN/(km/h)^2",))
    rows = _rows(table, (("cross section", ("m^2",)), ("coefficient", ("kN/(km/h)^2",))))
    ratios = ", ".join(
        f"{1.0 + more.number(factor) / open_n_per_mps2:.2f} in {square.number(area):g} m²"
        for square, more in rows
    )
    return (f"{TUNNEL_DRAG}: as drag_ratio of the line's tunnels it is {ratios}",)


def _quantity(table: Element, allowed: tuple[str, ...]) -> float:
    """A number with a unit, zero or more."""
    factor = table.part("unit").unit(allowed)
    value = table.part("value")
    number = value.number(factor)
    if number < 0.0:
        raise value.error(f"{value.value!r} is negative")
    return number


def _positive(file: Element, name: str, allowed: tuple[str, ...]) -> float:
    number = _quantity(file.part(name), allowed)
    if not number > 0.0:
        raise file.part(name).error("is zero; the emulated train needs a positive value")
    return number


def _optional(file: Element, name: str, allowed: tuple[str, ...]) -> float | None:
    return None if file.optional(name) is None else _positive(file, name, allowed)


def _whole(value: Element) -> int:
    number = value.number()
    if number < 1.0 or number != math.floor(number):
        raise value.error(f"{value.value!r} is not a whole number of coaches")
    return int(number)


def _efficiency(table: Element | None) -> float | None:
    """The efficiency if it is one number; a map of losses gives None."""
    if table is None or table.has("units"):
        return None
    ratio = _quantity(table, RATIOS)
    if not 0.0 < ratio <= 1.0:
        raise table.error(f"{ratio:g} is not an efficiency in 0..1")
    return ratio


def _emergency(etcs: Element, most_mps: float) -> tuple[float | None, float | None]:
    """The least deceleration at the train's speeds, and the share that holds on dry rail."""
    table, kept = etcs.optional("A_brake_emergency"), etcs.optional("K_dry_rst")
    if table is None:
        return None, None
    units = table.part("units")
    speed = units.part("velocity").unit(SPEEDS)
    factor = units.part("deceleration").unit(ACCELERATIONS)
    rows = _rows(table, (("velocity", SPEEDS), ("deceleration", ACCELERATIONS)))
    reached = [row[1].number(factor) for row in rows if row[0].number(speed) <= most_mps]
    if not reached:
        raise table.error("no row begins at or below the train's greatest speed; begin at 0")
    return min(reached), None if kept is None else _quantity(kept, RATIOS)


def read_file(file: Element) -> SurveyedLine | SurveyedTrain:
    """Read a track or a train, whichever the file holds. Raises SettingsError."""
    if is_track(file):
        return read_track(file)
    if is_train(file):
        return read_train(file)
    if file.has("timing points"):
        raise SettingsError(
            f"{file.source}: is a journey; give its track or train, and its times by hand as "
            "run_s of the stations"
        )
    raise SettingsError(
        f"{file.source}: has neither 'stops' (a track of TTOBench) nor 'mass' (a train) nor "
        "'track_sections' (RailJSON); give a file of one of these formats"
    )


assert set(LENGTHS + SPEEDS + MASSES + FORCES + POWERS + RATIOS + ACCELERATIONS) <= set(UNITS)
