"""Tractive effort over speed, as force and power of the emulated motors."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from firmware_py.settings import SettingsError
from metro_hil.exchange.motor_tables import MotorTable
from metro_hil.exchange.survey import SurveyedTrain

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


def with_effort(train: SurveyedTrain, table: MotorTable) -> SurveyedTrain:
    """The train with the effort of a CSV file. Raises SettingsError that names the file."""
    points = [(point["speed_mps"], point["force_n"]) for point in table.value]
    try:
        curve = effort_curve(points, train.speed_mps_max)
    except ValueError as error:
        raise SettingsError(f"{table.source}: {error}") from error
    return replace(
        train,
        force_n=curve.force_n,
        power_w=curve.power_w,
        effort_points=tuple(points),
        filled=(
            *(note for note in train.filled if not note.startswith(EFFORT)),
            f"{curve.note} ({table.source.name}); so the parameters, while the train follows the "
            "curve",
        ),
    )
