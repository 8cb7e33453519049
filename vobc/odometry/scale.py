"""How far a wheel runs for one pulse: hard bounds, from what is declared and from pairs of tags."""

from vobc.odometry.config import OdometryConfig


class WheelScale:
    """The bounds fall only from tag to tag, and only while nothing was seen of slip between them.

    Two tags that contradict what was measured before take all of that back.
    """

    __slots__ = ("_anchor", "_config", "_declared_m", "high_m", "low_m")

    def __init__(self, config: OdometryConfig, nominal_m: float) -> None:
        self._config = config
        self._declared_m = (
            nominal_m / (1.0 + config.scale_error_high_ratio),
            nominal_m / (1.0 + config.scale_error_low_ratio),
        )
        self.low_m, self.high_m = self._declared_m
        """Least and most distance behind one pulse."""
        self._anchor: tuple[float, int, float] | None = None
        """Where the antenna was, pulses then and bound, from where the scale is being measured."""

    @property
    def declared_m(self) -> tuple[float, float]:
        """What one pulse may stand for, whatever was measured."""
        return self._declared_m

    def nearest(self, m_per_pulse: float) -> float:
        """Within the bounds."""
        return min(max(m_per_pulse, self.low_m), self.high_m)

    def anchor(self, antenna_m: float, pulses: int, bound_m: float) -> None:
        self._anchor = (antenna_m, pulses, bound_m)

    def forget_anchor(self) -> None:
        """The wheels did not run as the train did."""
        self._anchor = None

    def forget(self) -> None:
        """Back to what is declared."""
        self.low_m, self.high_m = self._declared_m
        self._anchor = None

    def measure(self, tag_m: float, pulses: int, bound_m: float) -> None:
        """Two known places and the pulses between them bound the distance behind one pulse."""
        if self._anchor is None:
            self._anchor = (tag_m, pulses, bound_m)
            return
        base_m, counted = tag_m - self._anchor[0], pulses - self._anchor[1]
        if base_m < self._config.scale_base_m or counted <= 1:
            return
        slack_m = bound_m + self._anchor[2]
        margin_ratio = self._config.scale_margin_ratio
        low_m = (base_m - slack_m) / (counted + 1) * (1.0 - margin_ratio)
        high_m = (base_m + slack_m) / (counted - 1) * (1.0 + margin_ratio)
        low_m, high_m = max(low_m, self.low_m), min(high_m, self.high_m)
        if low_m > high_m:
            self.forget()
        else:
            self.low_m, self.high_m = low_m, high_m
        self._anchor = (tag_m, pulses, bound_m)
