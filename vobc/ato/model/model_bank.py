"""A bank of hypotheses, each with its own filter of the motion, weighed by how well it fits."""

import math
from collections.abc import Sequence
from typing import Final

from vobc.ato.model.motion_filter import MotionFilter

NEVER_MATTERS: Final = 40.0
"""A hypothesis that is worse by this cost weighs less than rounding; it is given up."""


class ModelBank:
    """Filters of the same motion that differ in what they take the brake to have done."""

    __slots__ = ("_cost", "_filters", "alive", "weights")

    def __init__(self, count: int, dt_s: float) -> None:
        self._filters = tuple(MotionFilter(dt_s) for _ in range(count))
        self._cost = [0.0] * count
        self.weights = [1.0 / count] * count
        """They add up to 1."""
        self.alive = list(range(count))
        """Hypotheses that were not given up."""

    def know(self, costs: Sequence[float]) -> None:
        """All come to life again; `costs` are what is known of them beforehand."""
        self._cost = list(costs)
        self.alive = list(range(len(self._cost)))
        self.weigh()

    def begin(self, motion: MotionFilter) -> None:
        """All go on from the same motion."""
        for each in self._filters:
            each.copy(motion)

    def costs(self, most: float) -> list[float]:
        """By how much each hypothesis is worse than the best, up to a bound; one that was given up,
        by that much.
        """
        least = min([self._cost[index] for index in self.alive])
        worse = [most] * len(self._cost)
        for index in self.alive:
            worse[index] = min(most, self._cost[index] - least)
        return worse

    def step(
        self,
        index: int,
        measured_mps: float,
        *,
        push_mps2: float,
        braked_mps2: float,
        friction_mps2: float,
        blur_m2_per_s2: float,
    ) -> None:
        """One cycle of one hypothesis; see MotionFilter.step."""
        self._cost[index] += self._filters[index].step(
            measured_mps,
            push_mps2=push_mps2,
            braked_mps2=braked_mps2,
            friction_mps2=friction_mps2,
            blur_m2_per_s2=blur_m2_per_s2,
        )

    def weigh(self) -> None:
        """After all that are alive took their step."""
        cost = self._cost
        least = min([cost[index] for index in self.alive])
        self.alive = [index for index in self.alive if cost[index] - least < 2.0 * NEVER_MATTERS]
        self.weights = [0.0] * len(cost)
        total = 0.0
        for index in self.alive:
            weight = math.exp((least - cost[index]) / 2.0)
            self.weights[index] = weight
            total += weight
        for index in self.alive:
            self.weights[index] /= total

    def mean(self, values: Sequence[float]) -> float:
        total = 0.0
        for index in self.alive:
            total += self.weights[index] * values[index]
        return total

    def agree(self, motion: MotionFilter) -> None:
        """Fill in what they agree on, as uncertain as the best one is."""
        weights, filters = self.weights, self._filters
        best = max(self.alive, key=weights.__getitem__)
        motion.copy(filters[best])
        speed_mps = disturbance_mps2 = gain_ratio = friction_ratio = 0.0
        for index in self.alive:
            weight, each = weights[index], filters[index]
            speed_mps += weight * each.speed_mps
            disturbance_mps2 += weight * each.disturbance_mps2
            gain_ratio += weight * each.gain_ratio
            friction_ratio += weight * each.friction_ratio
        motion.speed_mps, motion.disturbance_mps2 = speed_mps, disturbance_mps2
        motion.gain_ratio, motion.friction_ratio = gain_ratio, friction_ratio
