"""Reads rolling stock of OSRD (RailJSON)."""

from typing import Final

from metro_hil.exchange.effort_curve import EffortCurve, effort_curve
from metro_hil.exchange.survey import Element, SurveyedTrain, file_name

PER_MASS_SINCE: Final = (3, 4)
"""First version in which the rolling resistance is that of each kilogram."""
CHECK_MPS: Final = 10.0
RESISTANCE_N_PER_KG: Final = (0.002, 0.5)
"""Plausible resistance of each kilogram at 10 m/s; outside, the unit is another one."""
IGNORED: Final = {
    "startup_time": "the delays are those of the shipped train",
    "startup_acceleration": "traction builds up as that of the shipped train",
    "energy_sources": "the emulated train has a collector only",
    "etcs_brake_params": "the emergency brake is that of the shipped train",
    "power_restrictions": "the curve without restriction is used",
}


def read_rolling_stock(file: Element) -> SurveyedTrain:
    """Read a train. Raises SettingsError that names file and element."""
    mass_kg = positive(file.part("mass"))
    speed_mps_max = positive(file.part("max_speed"))
    inertia = file.part("inertia_coefficient")
    rotating_ratio = inertia.number() - 1.0
    if not 0.0 <= rotating_ratio < 1.0:
        raise inertia.error(f"{inertia.value!r} is not in 1..2; it is the mass with rotating parts")
    mode, curve = _curve(file.part("effort_curves"), speed_mps_max)
    decel_mps2 = _deceleration_mps2(file)
    return SurveyedTrain(
        name=file_name(file.part("name").text()),
        source=file.source,
        mass_kg=mass_kg,
        rotating_ratio=rotating_ratio,
        force_n=curve.force_n,
        power_w=curve.power_w,
        brake_force_n=curve.force_n,
        brake_power_w=curve.power_w,
        friction_n=decel_mps2 * mass_kg * (1.0 + rotating_ratio),
        resistance_n=_resistance_n(file, mass_kg),
        speed_mps_max=speed_mps_max,
        length_m=positive(file.part("length")),
        accel_mps2=positive(file.part("comfort_acceleration")),
        decel_mps2=decel_mps2,
        filled=(
            f"{curve.note} (mode {mode})",
            "electric brake: force and power of traction; friction alone reaches the deceleration",
        ),
        ignored=tuple(f"{name}: {why}" for name, why in IGNORED.items() if _given(file, name)),
    )


def positive(element: Element) -> float:
    """A number above zero. Raises SettingsError."""
    number = element.number()
    if not number > 0.0:
        raise element.error(f"{element.value!r} is not positive")
    return number


def _given(file: Element, name: str) -> bool:
    return file.has(name) and bool(file.part(name).value)


def _curve(curves: Element, speed_mps_max: float) -> tuple[str, EffortCurve]:
    """The default mode and the default of its curves."""
    mode = curves.part("default_mode").text()
    curve = curves.part("modes").part(mode).part("default_curve")
    speeds, efforts = curve.part("speeds").entries(), curve.part("max_efforts").entries()
    if len(speeds) != len(efforts):
        raise curve.error(f"{len(speeds)} speeds and {len(efforts)} efforts; give one for each")
    points = [(v.number(), effort.number()) for v, effort in zip(speeds, efforts, strict=True)]
    try:
        return mode, effort_curve(points, speed_mps_max)
    except ValueError as error:
        raise curve.error(str(error)) from error


def _deceleration_mps2(file: Element) -> float:
    """`const_gamma`; until version 3.2 the value of `gamma`."""
    gamma = file.optional("gamma")
    if gamma is not None and not file.has("const_gamma"):
        return positive(gamma.part("value"))
    return positive(file.part("const_gamma"))


def _resistance_n(file: Element, mass_kg: float) -> tuple[float, float, float]:
    """Resistance of the whole train."""
    table = file.part("rolling_resistance")
    factor = mass_kg if _version(file) >= PER_MASS_SINCE else 1.0
    a, b, c = (table.part(name).number(factor) for name in "ABC")
    per_kg = (a + CHECK_MPS * (b + CHECK_MPS * c)) / mass_kg
    least, most = RESISTANCE_N_PER_KG
    if min(a, b, c) < 0.0 or not least <= per_kg <= most:
        raise table.error(
            f"{per_kg:.3g} N for each kg at 36 km/h is not in {least:g}..{most:g}; give A, B and C "
            "of the whole train (N, m/s) before version 3.4, and of each kg from then on"
        )
    return a, b, c


def _version(file: Element) -> tuple[int, ...]:
    version = file.optional("railjson_version")
    if version is None:
        version = file.part("version")
    try:
        return tuple(int(part) for part in version.text().split("."))
    except ValueError:
        raise version.error(f"{version.value!r} is not a version such as '3.3'") from None
