"""Values that every importer produces, and the elements of a JSON file it reads them from."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from firmware_py.settings import SettingsError, nearest, text_of

UNITS: Final[Mapping[str, float]] = {
    "-": 1.0,
    "m": 1.0,
    "km": 1000.0,
    "s": 1.0,
    "m/s": 1.0,
    "km/h": 1.0 / 3.6,
    "m/s^2": 1.0,
    "permil": 1.0,
    "%": 0.01,
    "m^2": 1.0,
    "kg": 1.0,
    "t": 1000.0,
    "N": 1.0,
    "kN": 1000.0,
    "W": 1.0,
    "kW": 1000.0,
    "MW": 1.0e6,
    "kN/(km/h)": 3.6e3,
    "kN/(km/h)^2": 12.96e3,
}
"""Factor from each unit of a file to that of this project: metres, seconds, newtons, watts."""


@dataclass(frozen=True, slots=True)
class CurvedStretch:
    """A stretch of curved track; its mean curvature, so that its resistance keeps its energy."""

    start_m: float
    end_m: float
    radius_m: float


@dataclass(frozen=True, slots=True)
class SurveyedLine:
    """What a foreign file says about a line. Each list of changes holds from its chainage on."""

    name: str
    source: str
    stops: tuple[tuple[str, float], ...]
    """Name and chainage of each stopping point, in running order."""
    limits: tuple[tuple[float, float], ...]
    """Chainage, m, and civil limit from there on, m/s."""
    gradients: tuple[tuple[float, float], ...] = ()
    """Chainage, m, and gradient from there on, ‰; positive climbs."""
    bends: tuple[CurvedStretch, ...] = ()
    given: Mapping[str, Any] = field(default_factory=dict)
    """What the file says in keys of line files; `stations` has those of each station by name."""
    ignored: tuple[str, ...] = ()
    """Sentences about parts of the file that the importer does not use."""
    filled: tuple[str, ...] = ()
    """Sentences about what the importer itself filled or converted."""


@dataclass(frozen=True, slots=True)
class SurveyedTrain:
    """What a foreign file says about a train; None where it says nothing."""

    name: str
    source: str
    mass_kg: float
    rotating_ratio: float
    force_n: float
    power_w: float
    brake_force_n: float
    brake_power_w: float
    friction_n: float
    resistance_n: tuple[float, float, float]
    """Running resistance of the whole train: N, N/(m/s), N/(m/s)²."""
    speed_mps_max: float
    traction_efficiency_ratio: float | None = None
    brake_efficiency_ratio: float | None = None
    length_m: float | None = None
    cars: int | None = None
    accel_mps2: float | None = None
    decel_mps2: float | None = None
    emergency_mps2: float | None = None
    """Least deceleration of the emergency brake in the table of the file."""
    emergency_kept_ratio: float | None = None
    """Share of it that the train's builder guarantees on dry rail."""
    given: Mapping[str, Any] = field(default_factory=dict)
    """The consist of an export of this project. Empty: the rules make one."""
    effort_points: tuple[tuple[float, float], ...] = ()
    """Tractive effort (m/s, N) over speed. Empty: force and power determine it."""
    ignored: tuple[str, ...] = ()
    filled: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Element:
    """One part of a JSON file, with the place that messages name."""

    source: str
    path: str
    value: Any

    def error(self, text: str) -> SettingsError:
        """An error that names file and element."""
        return SettingsError(f"{self.source}: {self.path or 'the file'}: {text}")

    def keys(self) -> list[str]:
        """Names of the parts. Raises SettingsError if this is no object."""
        if not isinstance(self.value, dict):
            raise self.error("is not an object; write { … } with named parts")
        return list(self.value)

    def has(self, name: str) -> bool:
        """Whether there is a part of this name. Raises SettingsError if this is no object."""
        return name in self.keys()

    def part(self, name: str) -> "Element":
        """A part by name. Raises SettingsError if it is missing."""
        found = self.optional(name)
        if found is None:
            hint = nearest(name, self.keys(), "part") if self.keys() else "it is empty"
            raise self.error(f"has no {name!r}, which the import needs; {hint}")
        return found

    def optional(self, name: str) -> "Element | None":
        """A part by name, or None."""
        if not self.has(name):
            return None
        return Element(self.source, f"{self.path}.{name}".lstrip("."), self.value[name])

    def entries(self) -> list["Element"]:
        """The entries of a list. Raises SettingsError if this is none."""
        if not isinstance(self.value, list):
            raise self.error("is not a list; write [ … ]")
        return [
            Element(self.source, f"{self.path}[{index}]", each)
            for index, each in enumerate(self.value)
        ]

    def text(self) -> str:
        """The value as text. Raises SettingsError if it is none or empty."""
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"{self.value!r} is not a text")
        return self.value

    def number(self, factor: float = 1.0) -> float:
        """The value as a finite number times `factor`. Raises SettingsError."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(f"{value!r} is not a number")
        try:
            number = float(value) * factor
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.error(f"{value!r} is not a finite number")
        return number

    def unit(self, allowed: Sequence[str]) -> float:
        """The factor of the unit that this element names. Raises SettingsError."""
        if self.value not in allowed:
            names = ", ".join(allowed)
            raise self.error(f"unit {self.value!r} is unknown here; convert the values to {names}")
        return UNITS[str(self.value)]


def file_name(text: str) -> str:
    """The text with an underscore for each character that a file's name should not have."""
    return "".join(
        each if (each.isascii() and each.isalnum()) or each in "_-" else "_" for each in text
    )


def read_json(path: Path) -> Element:
    """Read a JSON file. Raises SettingsError."""
    try:
        return Element(str(path), "", json.loads(text_of(path)))
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"{path}: not JSON: {error}") from error
