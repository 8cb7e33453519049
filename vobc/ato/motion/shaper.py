"""Comfort limiter: no demand exceeds the limits of acceleration and jerk."""

from vobc.ato.settings.ato import Limits


class Shaper:
    __slots__ = ("_accel_mps2", "_jerk_mps3", "_limits", "demand_mps2")

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._accel_mps2 = limits.accel_mps2
        self._jerk_mps3 = limits.jerk_mps3
        self.demand_mps2 = 0.0

    def step(self, wanted_mps2: float, dt_s: float, *, lost_mps2: float = 0.0) -> float:
        """The demand nearest to the wanted one that the limits permit after `dt_s`.

        Args:
            lost_mps2: part of the brake demand that a falling gradient and a weak brake take away.
                The demand may exceed the comfort limit by as much.
        """
        reach_mps2 = self._jerk_mps3 * dt_s
        most_mps2 = self._limits.brake_most_mps2(lost_mps2)
        low_mps2 = max(-most_mps2, self.demand_mps2 - reach_mps2)
        high_mps2 = min(self._accel_mps2, self.demand_mps2 + reach_mps2)
        self.demand_mps2 = min(high_mps2, max(low_mps2, wanted_mps2))
        return self.demand_mps2

    def drop_traction(self) -> float:
        """Cut traction at once where safety requires it. A brake demand stays unchanged."""
        self.demand_mps2 = min(0.0, self.demand_mps2)
        return self.demand_mps2
