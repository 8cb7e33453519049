"""Tractive effort over speed, as force and power of the emulated motors."""

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from firmware_py.settings import SettingsError, text_of
from metro_hil.exchange.survey import SurveyedTrain

SPEED_COLUMNS: Final[Mapping[str, float]] = {"speed_kmh": 1.0 / 3.6, "speed_mps": 1.0}
EFFORT_COLUMNS: Final[Mapping[str, float]] = {"effort_kn": 1000.0, "effort_n": 1.0}
PERCENT: Final = 100.0
KMH_PER_MPS: Final = 3.6
EFFORT: Final = "tractive effort"
"""Begin of the note about the curve."""


@dataclass(frozen=True, slots=True)
class EffortCurve:
    """The least force and power that reach every point of the curve up to the greatest speed."""

    force_n: float
    power_w: float
    note: str
    """Sentence that says how far the emulated effort exceeds the curve."""


def effort_curve(points: Sequence[tuple[float, float]], speed_mps_max: float) -> EffortCurve:
    """Force and power of points (m/s, N).

    Raises:
        ValueError: the points are no curve.
    """
    if len(points) < 2:
        raise ValueError(f"{len(points)} points; a curve needs two or more")
    for (before_mps, _), (speed_mps, _) in itertools.pairwise(points):
        if not before_mps < speed_mps:
            raise ValueError(
                f"{speed_mps:g} m/s does not follow {before_mps:g} m/s; sort the points by speed"
            )
    if points[0][0] < 0.0 or min(effort_n for _, effort_n in points) < 0.0:
        raise ValueError("speeds and efforts must not be negative")
    used = [point for point in points if point[0] <= speed_mps_max]
    force_n = max((effort_n for _, effort_n in used), default=0.0)
    power_w = max((speed_mps * effort_n for speed_mps, effort_n in used), default=0.0)
    if not power_w > 0.0:
        raise ValueError(
            f"no effort above standstill and up to {speed_mps_max * KMH_PER_MPS:g} km/h, the "
            "train's greatest speed"
        )
    excess, at_mps = max(
        (min(force_n, power_w / speed_mps) / effort_n - 1.0, speed_mps)
        for speed_mps, effort_n in used
        if speed_mps > 0.0 and effort_n > 0.0
    )
    note = (
        f"{EFFORT}: the curve's greatest force, {force_n / 1000:.0f} kN, and power, "
        f"{power_w / 1000:.0f} kW; at most {excess * PERCENT:.0f} % above the curve, at "
        f"{at_mps * KMH_PER_MPS:.0f} km/h"
    )
    return EffortCurve(force_n, power_w, note)


def with_effort(train: SurveyedTrain, path: Path) -> SurveyedTrain:
    """The train with the effort of a CSV file. Raises SettingsError that names file and line."""
    points = _read_points(path)
    try:
        curve = effort_curve(points, train.speed_mps_max)
    except ValueError as error:
        raise SettingsError(f"{path}: {error}") from error
    return replace(
        train,
        force_n=curve.force_n,
        power_w=curve.power_w,
        effort_points=tuple(points),
        filled=(
            *(note for note in train.filled if not note.startswith(EFFORT)),
            f"{curve.note} ({path.name}); so the parameters, while the train follows the curve",
        ),
    )


def _read_points(path: Path) -> list[tuple[float, float]]:
    rows = list(csv.reader(io.StringIO(text_of(path))))
    head = [name.strip() for name in rows[0]] if rows else []
    speed = [name for name in head if name in SPEED_COLUMNS]
    effort = [name for name in head if name in EFFORT_COLUMNS]
    if len(speed) != 1 or len(effort) != 1:
        raise SettingsError(
            f"{path}: line 1: {','.join(head)!r} is not the head of an effort curve; write "
            "speed_kmh or speed_mps, and effort_kn or effort_n"
        )
    at, of = head.index(speed[0]), head.index(effort[0])
    points = []
    for number, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            speed_mps = float(row[at]) * SPEED_COLUMNS[speed[0]]
            effort_n = float(row[of]) * EFFORT_COLUMNS[effort[0]]
        except (ValueError, IndexError):
            raise SettingsError(
                f"{path}: line {number}: {','.join(row)!r} has no two numbers; write them with a "
                "decimal point and a comma between them"
            ) from None
        if not abs(speed_mps) + abs(effort_n) < float("inf"):
            raise SettingsError(f"{path}: line {number}: {','.join(row)!r} is not finite")
        points.append((speed_mps, effort_n))
    return points
