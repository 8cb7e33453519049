"""Tables of motors: greatest force over speed, and efficiency over speed and load."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EffortPoint:
    """One point of a force curve."""

    speed_mps: float
    force_n: float


def check_effort(points: Sequence[EffortPoint]) -> None:
    """Raise ValueError unless speeds rise from 0 on and no force is negative."""
    for point in points:
        if not (0.0 <= point.speed_mps < math.inf and 0.0 <= point.force_n < math.inf):
            raise ValueError(f"effort: {point.speed_mps} m/s, {point.force_n} N: is negative")
    if points and points[0].speed_mps != 0.0:
        raise ValueError(f"effort: begins at {points[0].speed_mps} m/s, not at 0")
    for slow, fast in itertools.pairwise(points):
        if not slow.speed_mps < fast.speed_mps:
            raise ValueError(f"effort: speed {fast.speed_mps} m/s does not rise")


def effort_n(points: Sequence[EffortPoint], speed_mps: float) -> float:
    """Interpolate linearly. Beyond the last point the power stays that of the last point."""
    before = points[0]
    for point in points:
        if speed_mps < point.speed_mps:
            share = (speed_mps - before.speed_mps) / (point.speed_mps - before.speed_mps)
            return before.force_n + share * (point.force_n - before.force_n)
        before = point
    return before.force_n if speed_mps <= 0.0 else before.force_n * before.speed_mps / speed_mps


@dataclass(frozen=True, slots=True)
class EfficiencyMap:
    """Efficiency from line to rail by speed and load; rows by speed, columns by load."""

    speed_mps: tuple[float, ...]
    load_ratio: tuple[float, ...]
    """Force as a share of the greatest force."""
    efficiency_ratio: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        for name in ("speed_mps", "load_ratio"):
            axis = getattr(self, name)
            if not axis or axis[0] < 0.0 or any(not a < b for a, b in itertools.pairwise(axis)):
                raise ValueError(f"{name} {list(axis)} does not rise from 0 or more")
        if len(self.efficiency_ratio) != len(self.speed_mps):
            raise ValueError(
                f"efficiency_ratio has {len(self.efficiency_ratio)} rows for "
                f"{len(self.speed_mps)} speeds"
            )
        for speed_mps, row in zip(self.speed_mps, self.efficiency_ratio, strict=True):
            if len(row) != len(self.load_ratio):
                raise ValueError(
                    f"efficiency_ratio at {speed_mps} m/s has {len(row)} values for "
                    f"{len(self.load_ratio)} loads"
                )
            for value in row:
                if not 0.05 <= value <= 1.0:
                    raise ValueError(f"efficiency_ratio {value} is not in 0.05..1")

    def at(self, speed_mps: float, load_ratio: float) -> float:
        """Interpolate between the four nearest values; beyond an edge the edge holds."""
        row, down = _place(self.speed_mps, speed_mps)
        column, right = _place(self.load_ratio, load_ratio)
        near, far = self.efficiency_ratio[row], self.efficiency_ratio[min(row + 1, self._rows)]
        beside = min(column + 1, len(self.load_ratio) - 1)
        upper = near[column] + right * (near[beside] - near[column])
        lower = far[column] + right * (far[beside] - far[column])
        return upper + down * (lower - upper)

    @property
    def _rows(self) -> int:
        return len(self.speed_mps) - 1


def _place(axis: Sequence[float], value: float) -> tuple[int, float]:
    """Return the index of the value's interval, and its place in it as a share."""
    if value <= axis[0]:
        return 0, 0.0
    for index in range(len(axis) - 1):
        if value < axis[index + 1]:
            return index, (value - axis[index]) / (axis[index + 1] - axis[index])
    return len(axis) - 1, 0.0
