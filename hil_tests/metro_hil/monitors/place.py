"""Looks up what follows from the position on the line: limits, platforms, stopping distances."""

import itertools
import math
from bisect import bisect_right
from typing import Final

from firmware_py.trackdb import LineMap, PlatformSide

GRAVITY_MPS2: Final = 9.81
SIDES: Final = {
    PlatformSide.LEFT: 1.0,
    PlatformSide.RIGHT: -1.0,
    PlatformSide.BOTH: 0.0,
    PlatformSide.NONE: math.nan,
}
"""Platform sides as numbers. The one of a siding is on neither side of any other."""
HEIGHT_POINTS: Final = 5
"""Number of points along the train for the mean height of its mass."""
ROUNDS: Final = 8
"""Iterations for a distance on changing gradients; each reduces the error to a third or less."""
EXACT_M: Final = 1.0e-3
PASSED_M: Final = 10.0
"""Distance beyond the end of a platform within which a train still counts as standing at it."""


class LinePlaces:
    """One line for trains of one length; it keeps the latest look-ups."""

    __slots__ = (
        "_clear_m",
        "_edges_m",
        "_gravity_mps2",
        "_length_m",
        "_limit_mps",
        "_limits_mps",
        "_line",
        "_platforms_m",
        "_reached_m",
        "_sides",
        "_stations",
        "_stop_edges_m",
        "_stops_m",
        "worst_fall_mps2",
    )

    def __init__(self, line: LineMap, *, length_m: float, rotating_ratio: float) -> None:
        self._line = line
        self._length_m = length_m
        self._gravity_mps2 = GRAVITY_MPS2 / (1.0 + rotating_ratio)
        changes_m = [section.start_m for section in line.speed_sections[1:]]
        # The lowest limit under the train changes where its front or its rear passes a section
        # border.
        edges_m = sorted({*changes_m, *(change_m + length_m for change_m in changes_m)})
        ends_m = [line.start_m - length_m, *edges_m, line.end_m + 2.0 * length_m]
        self._edges_m = edges_m
        self._limits_mps = [
            line.least_limit_mps(0.5 * (low_m + high_m) - length_m, 0.5 * (low_m + high_m))
            for low_m, high_m in itertools.pairwise(ends_m)
        ]
        self._reached_m, self._clear_m = math.inf, -math.inf
        self._limit_mps = 0.0
        stations = line.stations
        self._stops_m = [station.stop_m for station in stations]
        self._stop_edges_m = [0.5 * (a + b) for a, b in itertools.pairwise(self._stops_m)]
        self._stations = stations
        self._sides = [SIDES[each.side] for each in stations]
        self._platforms_m = [
            (each.platform_start_m, each.platform_end_m + PASSED_M)
            for each in stations
            if each.platform_doors
        ]
        worst_permille = line.worst_gradient_permille(line.start_m, line.end_m)
        self.worst_fall_mps2 = self.fall_mps2(worst_permille)
        """Acceleration on the steepest fall of the whole line."""

    def fall_mps2(self, gradient_permille: float) -> float:
        """Return the acceleration of a coasting train on a falling gradient; 0 on a climb."""
        return max(0.0, -gradient_permille / 1000.0 * self._gravity_mps2)

    def limit_mps(self, front_m: float) -> float:
        """Return the lowest civil limit under the whole train."""
        if not self._reached_m <= front_m < self._clear_m:
            edges_m = self._edges_m
            index = bisect_right(edges_m, front_m)
            self._reached_m = edges_m[index - 1] if index > 0 else -math.inf
            self._clear_m = edges_m[index] if index < len(edges_m) else math.inf
            self._limit_mps = self._limits_mps[index]
        return self._limit_mps

    def stop_error_m(self, front_m: float) -> float:
        """Return the distance of the front beyond the nearest stopping point; negative before."""
        return front_m - self._stops_m[bisect_right(self._stop_edges_m, front_m)]

    def side(self, front_m: float) -> float:
        """Return the platform side of the nearest station: 1 is left, -1 is right, 0 is both,
        NaN is none."""
        return self._sides[bisect_right(self._stop_edges_m, front_m)]

    def room_m(self, front_m: float, at_m: float, until_m: float) -> float:
        """Return how far a stretch of the train lies within the platform of the nearest station;
        negative by its part beyond the nearer end.

        Args:
            front_m: front of the train, which is nearest to the station's stopping point.
            at_m: rear end of the stretch.
            until_m: its front end.
        """
        station = self._stations[bisect_right(self._stop_edges_m, front_m)]
        return min(at_m - station.platform_start_m, station.platform_end_m - until_m)

    def platform_doors(self, front_m: float) -> bool:
        """Tell whether the front is at a platform that has doors."""
        return any(low_m <= front_m <= high_m for low_m, high_m in self._platforms_m)

    def worst_fall_under_mps2(self, front_m: float) -> float:
        """Return the acceleration on the steepest fall anywhere under the train."""
        rear_m = front_m - self._length_m
        return self.fall_mps2(self._line.worst_gradient_permille(rear_m, front_m))

    def height_m(self, front_m: float) -> float:
        """Return the mean height of the train, with its mass spread evenly over its length."""
        step_m = self._length_m / HEIGHT_POINTS
        at_m = front_m - 0.5 * step_m
        total_m = 0.0
        for _ in range(HEIGHT_POINTS):
            total_m += self._line.height_m(at_m)
            at_m -= step_m
        return total_m / HEIGHT_POINTS

    def braking_m(self, front_m: float, speed_mps: float, decel_mps2: float) -> float:
        """Return the braking distance from a speed over the true heights, with a constant brake.

        Brake and climb together take the energy of the train, rotating parts included:
            decel * way + g / (1 + rotating) * (height(front + way) - height(front)) = speed**2 / 2
        """
        energy = 0.5 * speed_mps * speed_mps
        height_m = self.height_m(front_m)
        way_m = energy / decel_mps2
        for _ in range(ROUNDS):
            rise_m = self.height_m(front_m + way_m) - height_m
            before_m = way_m
            way_m = max(0.0, energy - self._gravity_mps2 * rise_m) / decel_mps2
            if abs(way_m - before_m) < EXACT_M:
                break
        return way_m
