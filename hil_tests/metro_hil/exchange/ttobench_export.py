"""Writes a line as a track of TTOBench."""

import itertools
import json
from collections.abc import Sequence
from decimal import Decimal
from typing import Any, Final

from firmware_py.trackdb import LineMap
from metro_hil.exchange.railml_export import kmh
from metro_hil.exchange.survey import file_name
from metro_hil.exchange.ttobench import STRAIGHT

LIBRARY: Final = "TTOBench v1.5"
LOST: Final = (
    "names of stations: they become S0, S1, …",
    "platforms, sides, dwell times, planned run times and doors",
    "tags, tunnels, neutral and power sections, no-stop zones and evacuation stops",
    "track before the first and beyond the last stopping point",
)
"""What the format has no place for."""


def ttobench_text(line: LineMap) -> str:
    """The line as a JSON file whose positions begin at the first stopping point."""
    zero = Decimal(repr(line.stations[0].stop_m))
    end_m = line.stations[-1].stop_m
    limits = [(each.start_m, each.end_m, each.limit_mps) for each in line.speed_sections]
    grades = [(each.start_m, each.end_m, each.gradient_permille) for each in line.gradients]
    curves = [(each.start_m, each.end_m, each.radius_m) for each in line.curves]
    table: dict[str, Any] = {
        "metadata": {"id": file_name(line.name), "library version": LIBRARY},
        "stops": {
            "unit": "m",
            "values": [_place(station.stop_m, zero) for station in line.stations],
        },
        "speed limits": {
            "units": {"position": "m", "velocity": "km/h"},
            "values": [[at, float(kmh(value))] for at, value in _changes(limits, zero, end_m, 0.0)],
        },
        "gradients": {
            "units": {"position": "m", "slope": "permil"},
            "values": [[at, value] for at, value in _changes(grades, zero, end_m, 0.0)],
        },
        "curvatures": {
            "units": {"position": "m", "radius at start": "m", "radius at end": "m"},
            "values": [
                [at, *[STRAIGHT if value == 0.0 else value] * 2]
                for at, value in _changes(curves, zero, end_m, 0.0)
            ],
        },
    }
    return json.dumps(table, indent=1) + "\n"


def _place(at_m: float, zero: Decimal) -> float:
    return float(Decimal(repr(at_m)) - zero)


def _changes(
    sections: Sequence[tuple[float, float, float]], zero: Decimal, end_m: float, between: float
) -> list[tuple[float, float]]:
    """Positions and the values that hold from there on, from the first to the last stop."""
    begin_m = float(zero)
    edges_m = sorted({begin_m, *(m for each in sections for m in each[:2] if begin_m < m < end_m)})
    found: list[tuple[float, float]] = []
    for start_m, finish_m in itertools.pairwise([*edges_m, end_m]):
        middle_m = (start_m + finish_m) / 2.0
        value = next((v for a, b, v in sections if a <= middle_m < b), between)
        if not found or found[-1][1] != value:
            found.append((_place(start_m, zero), value))
    return found
