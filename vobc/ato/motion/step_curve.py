"""Braking curve of constant decelerations, as a train with notches follows it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from vobc.ato.motion.profile import CurvePoint


class _Step(NamedTuple):
    """Step of the curve, counted backwards from the stop: start and deceleration."""

    time_s: float
    speed_mps: float
    distance_m: float
    decel_mps2: float


class StepCurve:
    """Curve to a stop. `tops_mps` are the speeds at which the deceleration changes.

    Both sequences count from the stop, and the last deceleration has no top. `reserve_m` is a
    distance left before the first top, which the train covers at about that speed.
    """

    __slots__ = ("_steps", "end_mps", "steady_decel_mps2")

    def __init__(
        self, decels_mps2: Sequence[float], tops_mps: Sequence[float], reserve_m: float = 0.0
    ) -> None:
        assert len(tops_mps) == len(decels_mps2) - 1
        assert min(decels_mps2) > 0.0
        self.end_mps = 0.0
        self.steady_decel_mps2 = decels_mps2[-1]
        time_s = speed_mps = distance_m = 0.0
        steps: list[_Step] = []
        for index, decel_mps2 in enumerate(decels_mps2):
            steps.append(_Step(time_s, speed_mps, distance_m, decel_mps2))
            if index == len(tops_mps):
                break
            top_mps = tops_mps[index]
            assert top_mps > speed_mps
            time_s += (top_mps - speed_mps) / decel_mps2
            distance_m += (top_mps * top_mps - speed_mps * speed_mps) / (2.0 * decel_mps2)
            distance_m += reserve_m if index == 0 else 0.0
            speed_mps = top_mps
        self._steps = tuple(reversed(steps))

    def at_speed(self, speed_mps: float) -> CurvePoint:
        """The point with this speed. Below the lowest: the stop."""
        step = self._steps[-1]
        for candidate in self._steps:
            if speed_mps > candidate.speed_mps:
                step = candidate
                break
        start_s, start_mps, start_m, decel_mps2 = step
        top_mps = max(start_mps, speed_mps)
        squares = top_mps * top_mps - start_mps * start_mps
        return CurvePoint(
            start_s + (top_mps - start_mps) / decel_mps2,
            start_m + squares / (2.0 * decel_mps2),
            decel_mps2,
            0.0,
        )

    def speed_at_mps(self, distance_m: float) -> float:
        """Speed of the curve at this distance before the stop. 0 beyond the stop."""
        for step in self._steps:
            if distance_m > step.distance_m:
                rise = 2.0 * step.decel_mps2 * (distance_m - step.distance_m)
                return math.sqrt(step.speed_mps * step.speed_mps + rise)
        return 0.0
