"""A bank of hypotheses, each with its own motion filter, weighted by their fit."""

import math
from collections.abc import Sequence
from typing import Final

from vobc.ato.model.motion_filter import MotionFilter

NEVER_MATTERS: Final = 40.0
"""Cost difference beyond which a hypothesis weighs less than rounding and is discarded."""


class ModelBank:
    """Filters of the same motion that assume different brake behaviour."""

    __slots__ = ("_cost", "_filters", "alive", "weights")

    def __init__(self, count: int, dt_s: float) -> None:
        self._filters = tuple(MotionFilter(dt_s) for _ in range(count))
        self._cost = [0.0] * count
        self.weights = [1.0 / count] * count
        """Weights of the hypotheses. They add up to 1."""
        self.alive = list(range(count))
        """Hypotheses that are not discarded."""

    def know(self, costs: Sequence[float]) -> None:
        """Restart all hypotheses with these prior costs."""
        self._cost = list(costs)
        self.alive = list(range(len(self._cost)))
        self.weigh()

    def begin(self, motion: MotionFilter) -> None:
        """Set all filters to the same motion."""
        for each in self._filters:
            each.copy(motion)

    def renew_disturbance(self) -> None:
        """Let every filter learn the disturbance quickly again."""
        for each in self._filters:
            each.renew_disturbance()

    def costs(self, most: float) -> list[float]:
        """Excess cost of each hypothesis over the best one, at most `most`.

        A discarded hypothesis has the cost `most`.
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
        """One cycle of one hypothesis, as in MotionFilter.step."""
        self._cost[index] += self._filters[index].step(
            measured_mps,
            push_mps2=push_mps2,
            braked_mps2=braked_mps2,
            friction_mps2=friction_mps2,
            blur_m2_per_s2=blur_m2_per_s2,
        )

    def weigh(self) -> None:
        """Update the weights after the step of all active hypotheses."""
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
        """Set `motion` to the weighted mean, with the uncertainty of the best hypothesis."""
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
