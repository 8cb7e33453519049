"""The worst motion that the parameters declare, followed exactly. It shares no code with ATP.

The train runs on at its speed for a lead, then with the runaway acceleration, then without
traction and brake, then with the guaranteed brake. At each place the steepest fall under any part
of the train acts. Between the places where that changes, the acceleration is constant.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

GRAVITY_MPS2: Final = 9.81


@dataclass(frozen=True, slots=True)
class DeclaredMotion:
    """The worst train of the safe braking model."""

    runaway_mps2: float
    runaway_s: float
    build_up_s: float
    brake_mps2: float


@dataclass(frozen=True, slots=True)
class FollowedMotion:
    """Where the train stops, and how fast its front passes each place."""

    stop_m: float
    arrivals_mps: tuple[float | None, ...]
    """None for a place that the front does not reach."""


class FallsUnder:
    """The steepest fall under a train, by the place of its front."""

    def __init__(self, gradients: Sequence[tuple[float, float, float]], length_m: float) -> None:
        """Args:
        gradients: start, end and gradient in per mille; falls are negative.
        length_m: of the train.
        """
        starts_m, ends_m, values_permille = np.array(gradients, dtype=float).reshape(-1, 3).T
        clear_m = ends_m + length_m
        self.changes_m: list[float] = np.union1d(starts_m, clear_m).tolist()
        if not self.changes_m:
            self._falls_mps2 = [0.0]
            return
        # A front in the middle of a piece stands for all places of the piece.
        edges_m = [self.changes_m[0] - 2.0, *self.changes_m, self.changes_m[-1] + 2.0]
        fronts_m = 0.5 * (np.array(edges_m[:-1]) + np.array(edges_m[1:]))[:, None]
        under = (starts_m < fronts_m) & (fronts_m < clear_m)
        steepest_permille = np.max(np.where(under, -values_permille, 0.0), axis=1)
        self._falls_mps2 = (GRAVITY_MPS2 * np.maximum(0.0, steepest_permille) / 1000.0).tolist()

    def piece(self, front_m: float) -> int:
        """Number of the piece that a front running forwards enters here."""
        return bisect_right(self.changes_m, front_m)

    def fall_mps2(self, piece: int) -> float:
        return self._falls_mps2[piece]

    def end_m(self, piece: int) -> float:
        return self.changes_m[piece] if piece < len(self.changes_m) else math.inf


def follow(
    falls: FallsUnder,
    declared: DeclaredMotion,
    front_m: float,
    speed_mps: float,
    *,
    places_m: Sequence[float] = (),
    lead_s: float = 0.0,
) -> FollowedMotion:
    """Follow the worst motion to its end.

    Args:
        front_m: where the front is at the beginning.
        speed_mps: zero or more.
        places_m: ahead of the front, in rising order.
        lead_s: time at constant speed before the first phase.
    """
    arrivals: list[float | None] = [None] * len(places_m)
    at_m, piece, awaited = front_m, falls.piece(front_m), 0
    phases = (
        (None, lead_s),
        (declared.runaway_mps2, declared.runaway_s),
        (0.0, declared.build_up_s),
        (-declared.brake_mps2, math.inf),
    )
    for push_mps2, left_s in phases:
        while left_s > 0.0:
            accel_mps2 = 0.0 if push_mps2 is None else push_mps2 + falls.fall_mps2(piece)
            place_m = places_m[awaited] if awaited < len(places_m) else math.inf
            next_m = min(falls.end_m(piece), place_m)
            until_s = min(left_s, _time_to_s(next_m - at_m, speed_mps, accel_mps2))
            if until_s == math.inf:
                # The brake stops the train before the next place.
                stop_m = at_m + 0.5 * speed_mps * speed_mps / -accel_mps2
                return FollowedMotion(stop_m, tuple(arrivals))
            reached = until_s < left_s
            at_m = next_m if reached else at_m + (speed_mps + 0.5 * accel_mps2 * until_s) * until_s
            speed_mps = max(0.0, speed_mps + accel_mps2 * until_s)
            left_s -= until_s
            if reached and next_m == place_m:
                arrivals[awaited] = speed_mps
                awaited += 1
            if reached and next_m == falls.end_m(piece):
                piece += 1
    raise AssertionError("the guaranteed brake does not hold the train")


def _time_to_s(way_m: float, speed_mps: float, accel_mps2: float) -> float:
    """Time for a distance at constant acceleration; infinite if the train does not get there."""
    if way_m <= 0.0:
        return 0.0
    square = speed_mps * speed_mps + 2.0 * accel_mps2 * way_m
    if square < 0.0:
        return math.inf
    sum_mps = speed_mps + math.sqrt(square)
    return 2.0 * way_m / sum_mps if sum_mps > 0.0 else math.inf
