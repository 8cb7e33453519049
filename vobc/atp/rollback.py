"""Rollback: how far a train that rolls back on a climb gets before its emergency brake holds it."""

import math
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.atp.config import AtpConfig
from vobc.kinematics import GRAVITY_MPS2
from vobc.vocabulary import Motion

LEAST_M: Final = 0.1
"""Counted rollback below which protection does not brake, m. It exceeds the give of a held train
and the pulse error of a standing one."""


class RollbackWatch:
    """Bounds of one train on one line. The brake has the declared worst properties."""

    def __init__(
        self,
        config: AtpConfig,
        line: LineMap,
        *,
        train_length_m: float,
        cycle_s: float,
        true_per_counted: float = 1.0,
    ) -> None:
        """`true_per_counted`: greatest true distance of one counted metre."""
        self._line = line
        self._length_m = train_length_m
        self._decel_mps2 = config.guaranteed_decel_mps2
        self._reaction_s = config.runaway_s(cycle_s) + config.brake_build_up_s
        self._true_per_counted = true_per_counted

    def room_m(self, counted_m: float, motion: Motion) -> float:
        """Distance that remains to the line's limit if the emergency brake is applied now.

        Args:
            counted_m: distance back from the foremost place.
        """
        if counted_m < LEAST_M:
            return math.inf
        climb_mps2 = self._climb_mps2(motion)
        back_mps = -motion.speed_mps.low
        # A NaN stays, and the guard then decides for the brake.
        run_m = self.run_m(0.0 if back_mps < 0.0 else back_mps, climb_mps2=climb_mps2)
        return self._line.rollback_m - counted_m * self._true_per_counted - run_m

    def run_m(self, speed_mps: float, *, climb_mps2: float) -> float:
        """Distance from the decision to brake to standstill, for a train that rolls back.

        The climb accelerates the train until the brake has built up. Then the brake acts against
        the climb:

            d = v * t + a * t**2 / 2 + (v + a * t)**2 / (2 * (b - a))
        """
        left_mps2 = self._decel_mps2 - climb_mps2
        if not left_mps2 > 0.0:
            return math.inf
        reaction_s = self._reaction_s
        reached_mps = speed_mps + climb_mps2 * reaction_s
        way_m = (speed_mps + 0.5 * climb_mps2 * reaction_s) * reaction_s
        return way_m + reached_mps * reached_mps / (2.0 * left_mps2)

    def least_m(self) -> float:
        """Rollback on the line's steepest climb if protection brakes as soon as it has counted
        `LEAST_M`. No limit below that can be kept.

        The train rolls from rest, by the climb alone.
        """
        line = self._line
        climb_mps2 = _accel_mps2(line.steepest_climb_permille(line.start_m, line.end_m))
        rolled_m = LEAST_M * self._true_per_counted
        speed_mps = math.sqrt(2.0 * climb_mps2 * rolled_m)
        return rolled_m + self.run_m(speed_mps, climb_mps2=climb_mps2)

    def _climb_mps2(self, motion: Motion) -> float:
        """Acceleration by the steepest climb under any part of the train; anywhere, while its place
        is unknown.
        """
        line, front_m = self._line, motion.front_m
        rear_m = front_m.low - self._length_m
        if motion.localised and rear_m <= front_m.high:
            return _accel_mps2(line.steepest_climb_permille(rear_m, front_m.high))
        return _accel_mps2(line.steepest_climb_permille(line.start_m, line.end_m))


def _accel_mps2(climb_permille: float) -> float:
    return GRAVITY_MPS2 * max(0.0, climb_permille) / 1000.0
