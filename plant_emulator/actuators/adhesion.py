"""Adhesion between wheel and rail.

Force beyond adhesion accelerates the wheels instead of the train.
"""

from math import copysign
from typing import Final

from plant_emulator.train_config import RailConfig

LEAST_ROTATING_RATIO: Final = 0.01
"""Minimum rotating mass as a share of the weight. It bounds wheel acceleration if the consist file
gives no rotating mass."""


class WheelGroup:
    """The wheels of a group of cars that are driven and braked alike."""

    __slots__ = ("_config", "_rotating_kg", "_step_s", "_weight_n", "slip_mps")

    def __init__(
        self, config: RailConfig, *, step_s: float, weight_n: float, rotating_kg: float
    ) -> None:
        self._config = config
        self._step_s = step_s
        self._weight_n = weight_n
        self._rotating_kg = max(rotating_kg, LEAST_ROTATING_RATIO * weight_n / 9.81)
        self.slip_mps = 0.0
        """Slip: speed of the tread minus speed of the train, signed in running direction."""

    def most_n(self, adhesion_ratio: float) -> float:
        return adhesion_ratio * self._weight_n

    def driven(self, drive_n: float, adhesion_ratio: float, speed_mps: float) -> float:
        """Return the part of a signed tractive effort that reaches the rail; the rest spins the
        wheels.
        """
        most_n = adhesion_ratio * self._weight_n
        if -most_n <= drive_n <= most_n:
            self._recover()
            return drive_n
        passed_n = copysign(most_n, drive_n)
        self._slip((drive_n - passed_n) / self._rotating_kg, speed_mps)
        return passed_n

    def braked(self, brake_n: float, adhesion_ratio: float, speed_mps: float) -> float:
        """Return the part of a non-negative brake force that the rail transmits; the rest slows the
        wheels.
        """
        most_n = adhesion_ratio * self._weight_n
        if brake_n <= most_n or speed_mps == 0.0:
            self._recover()
            return min(brake_n, most_n)
        self._slip(-copysign((brake_n - most_n) / self._rotating_kg, speed_mps), speed_mps)
        return most_n

    def _slip(self, accel_mps2: float, speed_mps: float) -> None:
        config = self._config
        caught_mps = max(config.slip_limit_mps, config.slip_limit_ratio * abs(speed_mps))
        slip_mps = self.slip_mps + accel_mps2 * self._step_s
        slip_mps = max(-caught_mps, min(caught_mps, slip_mps))
        if accel_mps2 * speed_mps < 0.0 and abs(slip_mps) > abs(speed_mps):
            # A brake can stop a wheel but cannot turn it backwards.
            slip_mps = copysign(speed_mps, slip_mps)
        self.slip_mps = slip_mps

    def _recover(self) -> None:
        if self.slip_mps != 0.0:
            change_mps = self._config.slip_recovery_mps2 * self._step_s
            if abs(self.slip_mps) <= change_mps:
                self.slip_mps = 0.0
            else:
                self.slip_mps -= copysign(change_mps, self.slip_mps)
