"""Tables of motors from CSV files: force over speed, efficiency over speed and load."""

import copy
import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError, text_of
from plant_emulator.train_config import TrainConfig

SPEEDS: Final[Mapping[str, float]] = {"speed_kmh": 1.0 / 3.6, "speed_mps": 1.0}
FORCES: Final[Mapping[str, tuple[str, float]]] = {
    "effort_kn": ("traction", 1000.0),
    "effort_n": ("traction", 1.0),
    "brake_kn": ("brake", 1000.0),
    "brake_n": ("brake", 1.0),
}
PLACES: Final[Mapping[str, tuple[str, ...]]] = {
    "traction": ("traction",),
    "brake": ("brake", "service", "electric"),
}
HEAD_HINT: Final = (
    "write speed_kmh or speed_mps, then effort_kn, effort_n, brake_kn or brake_n for a curve, or "
    "traction_0.1,traction_0.5,… or brake_0.1,… for efficiencies at these loads"
)


@dataclass(frozen=True, slots=True)
class MotorTable:
    """One table for a consist file."""

    source: Path
    motor: str
    """`traction` or `brake`."""
    key: str
    """`effort` or `efficiency`."""
    value: Any

    @property
    def place(self) -> str:
        return ".".join((*PLACES[self.motor], self.key))


def read_table(path: Path) -> MotorTable:
    """Read a CSV file. Raises SettingsError that names file and line."""
    rows = list(csv.reader(io.StringIO(text_of(path))))
    head = [name.strip() for name in rows[0]] if rows else []
    speeds = [at for at, name in enumerate(head) if name in SPEEDS]
    others = [name for name in head if name not in SPEEDS]
    if len(speeds) != 1 or not others:
        raise _no_head(path, head)
    numbers = [
        _numbers(path, number, row, len(head))
        for number, row in enumerate(rows[1:], start=2)
        if any(cell.strip() for cell in row)
    ]
    if not numbers:
        raise SettingsError(f"{path}: has no row of numbers below its head")
    speeds_mps = [row.pop(speeds[0]) * SPEEDS[head[speeds[0]]] for row in numbers]
    if len(others) == 1 and others[0] in FORCES:
        motor, unit_n = FORCES[others[0]]
        points = [
            {"speed_mps": at_mps, "force_n": row[0] * unit_n}
            for at_mps, row in zip(speeds_mps, numbers, strict=True)
        ]
        return MotorTable(path, motor, "effort", points)
    motor, loads = _loads(path, head, others)
    efficiency = {
        "speed_mps": speeds_mps,
        "load_ratio": loads,
        "efficiency_ratio": numbers,
    }
    return MotorTable(path, motor, "efficiency", efficiency)


def with_tables(
    consist: Mapping[str, Any], tables: Sequence[MotorTable], source: str
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The consist with the tables, and a sentence for each. Raises SettingsError."""
    found: dict[str, Any] = copy.deepcopy(dict(consist))
    for table in tables:
        inner = found
        for name in PLACES[table.motor]:
            inner = inner.setdefault(name, {})
        inner[table.key] = table.value
        # The consist was right before, so an error is one of this table.
        settings.build(TrainConfig, found, f"{table.source}: {source}")
    return found, tuple(f"{each.place}: the table of {each.source.name}" for each in tables)


def read_consist(path: Path) -> dict[str, Any]:
    """Table of a consist file. Raises SettingsError if it is none."""
    text = text_of(path)
    table = settings.tables_of(text, str(path))
    with settings.located(str(path), text):
        settings.build(TrainConfig, table, str(path))
    return table


def _loads(path: Path, head: Sequence[str], names: Sequence[str]) -> tuple[str, list[float]]:
    """Motor and loads of a table of efficiencies."""
    motors, loads = set(), []
    for name in names:
        motor, _, load = name.partition("_")
        try:
            loads.append(float(load))
        except ValueError:
            raise _no_head(path, head) from None
        motors.add(motor)
    if len(motors) != 1 or not motors <= set(PLACES):
        raise _no_head(path, head)
    return motors.pop(), loads


def _numbers(path: Path, number: int, row: Sequence[str], width: int) -> list[float]:
    try:
        found = [float(cell) for cell in row]
    except ValueError:
        found = []
    if len(found) != width or not all(abs(each) < float("inf") for each in found):
        raise SettingsError(
            f"{path}: line {number}: {','.join(row)!r} is not {width} numbers; write them with a "
            "decimal point and commas between them"
        )
    return found


def _no_head(path: Path, head: Sequence[str]) -> SettingsError:
    return SettingsError(f"{path}: line 1: {','.join(head)!r} is no head of a table; {HEAD_HINT}")
