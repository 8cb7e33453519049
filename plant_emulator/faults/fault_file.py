"""Reads the faults of a scenario file, for programs that need no other part of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from firmware_py.settings import SettingsError, parse, unknown_key
from plant_emulator.faults.plan import FaultPlan, read_faults

FAULT_KEY: Final = "fault"
OTHER_KEYS: Final = (
    *("name", "title", "requirements", "bench", "seeds", "seed_base", "expected"),
    *("stop_at_violation", "invariants", "layout", "train", "timetable", "controller", "branch"),
    *("monitor", "sweep", "scenario"),
)
"""Other valid keys of a scenario file. They are ignored here; unknown keys are errors."""


def load_faults(path: str) -> tuple[FaultPlan, ...]:
    """Read the faults of a file. Raises SettingsError with file, key and value."""
    return faults_of(parse(Path(path)), path)


def faults_of(scenario: Mapping[str, Any], source: str) -> tuple[FaultPlan, ...]:
    """Read the `[[fault]]` tables of a scenario; raises SettingsError."""
    known = [FAULT_KEY, *OTHER_KEYS]
    for key in scenario:
        if key not in known:
            raise SettingsError(f"{source}: {key}: {unknown_key(key, known, scenario)}")
    tables = scenario.get(FAULT_KEY, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise SettingsError(f"{source}: {FAULT_KEY}: {tables!r} is not a list of [[fault]] tables")
    return read_faults(tables, source)
