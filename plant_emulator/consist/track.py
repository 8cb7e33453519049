"""Gravity, curve resistance and air drag of one car as functions of its place.

Gravity and curve resistance are piecewise linear: they are averaged over the car's length, so that
a gradient acts on the share of the car that stands on it. Air drag is that of the place of the
car's middle.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Final

from firmware_py.trackdb import CurveSection, LineMap

GRAVITY_MPS2: Final = 9.81
SHARP_CURVE_M: Final = 300.0


def curve_resistance_n_per_kn(radius_m: float) -> float:
    """Return the curve resistance by Röckl: 650 / (R - 55) from R = 300 m on, 500 / (R - 30)
    below.
    """
    assert radius_m > 30.0
    if radius_m < SHARP_CURVE_M:
        return 500.0 / (radius_m - 30.0)
    return 650.0 / (radius_m - 55.0)


@dataclass(frozen=True, slots=True)
class Piece:
    """Forces on a car in low_m <= x < high_m: gravity_n + gravity_n_per_m * x; curve resistance
    likewise.
    """

    low_m: float
    high_m: float
    gravity_n: float
    """Force against the running direction, so positive uphill."""
    gravity_n_per_m: float
    curve_n: float
    """Force against the motion in either direction."""
    curve_n_per_m: float
    drag_ratio: float
    """Air drag, divided by that in the open."""


class CarTrack:
    """The track under one car. Its place x is that of the train's front in a rigid train."""

    def __init__(
        self, line: LineMap, *, behind_front_m: float, length_m: float, weight_n: float
    ) -> None:
        self._line = line
        self._front_offset_m = behind_front_m
        self._rear_offset_m = behind_front_m + length_m
        self._middle_m = behind_front_m + length_m / 2.0
        self._length_m = length_m
        self._weight_n = weight_n
        self._edges_m = self._edges()

    def _edges(self) -> list[float]:
        """Return the places at which an end of the car meets a change of the track; all forces are
        linear in x between them.
        """
        gradients = [(section.start_m, section.end_m) for section in self._line.gradients]
        curves = [(section.start_m, section.end_m) for section in self._line.curves]
        changes_m = {end_m for section in gradients + curves for end_m in section}
        offsets_m = (self._front_offset_m, self._rear_offset_m)
        edges_m = {change_m + offset_m for change_m in changes_m for offset_m in offsets_m}
        for tunnel in self._line.tunnels:
            edges_m |= {tunnel.start_m + self._middle_m, tunnel.end_m + self._middle_m}
        return sorted(edges_m)

    def piece(self, x_m: float) -> Piece:
        """Return the linear piece that contains x."""
        index = bisect_right(self._edges_m, x_m)
        low_m = self._edges_m[index - 1] if index > 0 else -inf
        high_m = self._edges_m[index] if index < len(self._edges_m) else inf
        if low_m == -inf or high_m == inf:
            # The track does not change beyond its first and its last change.
            gravity_n, curve_n = self.gravity_n(x_m), self.curve_n(x_m)
            return Piece(low_m, high_m, gravity_n, 0.0, curve_n, 0.0, self._drag_ratio(x_m))
        span_m = high_m - low_m
        gravity_n = self.gravity_n(low_m)
        curve_n = self.curve_n(low_m)
        gravity_n_per_m = (self.gravity_n(high_m) - gravity_n) / span_m
        curve_n_per_m = (self.curve_n(high_m) - curve_n) / span_m
        return Piece(
            low_m,
            high_m,
            gravity_n - gravity_n_per_m * low_m,
            gravity_n_per_m,
            curve_n - curve_n_per_m * low_m,
            curve_n_per_m,
            self._drag_ratio((low_m + high_m) / 2.0),
        )

    def _drag_ratio(self, x_m: float) -> float:
        return self._line.drag_ratio(x_m - self._middle_m)

    def gravity_n(self, x_m: float) -> float:
        climb_m = self._line.height_m(x_m - self._front_offset_m) - self._line.height_m(
            x_m - self._rear_offset_m
        )
        return self._weight_n * climb_m / self._length_m

    def curve_n(self, x_m: float) -> float:
        rear_m, front_m = x_m - self._rear_offset_m, x_m - self._front_offset_m
        return self._weight_n / 1000.0 * _curve_n_per_kn(self._line.curves, rear_m, front_m)


def _curve_n_per_kn(curves: Sequence[CurveSection], rear_m: float, front_m: float) -> float:
    """Mean curve resistance over a stretch of the line."""
    total = 0.0
    for curve in curves:
        under_m = min(front_m, curve.end_m) - max(rear_m, curve.start_m)
        if under_m > 0.0:
            total += under_m * curve_resistance_n_per_kn(curve.radius_m)
    return total / (front_m - rear_m)
