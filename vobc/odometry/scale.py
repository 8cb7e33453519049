"""Distance per wheel pulse: hard bounds from declared values and from pairs of tags."""

from vobc.odometry.config import OdometryConfig


class WheelScale:
    """Bounds of the distance per pulse.

    They narrow only from tag to tag, and only if no slip was detected in between. Two tags that
    contradict the earlier measurement reset the bounds.
    """

    __slots__ = ("_anchor", "_config", "_declared_m", "high_m", "low_m")

    def __init__(self, config: OdometryConfig, nominal_m: float) -> None:
        self._config = config
        self._declared_m = (
            nominal_m / (1.0 + config.scale_error_high_ratio),
            nominal_m / (1.0 + config.scale_error_low_ratio),
        )
        self.low_m, self.high_m = self._declared_m
        """Least and greatest distance per pulse."""
        self._anchor: tuple[float, int, float] | None = None
        """Start of the present measurement: place of the antenna, pulse count, and bound."""

    @property
    def declared_m(self) -> tuple[float, float]:
        """Declared bounds, independent of any measurement."""
        return self._declared_m

    def nearest(self, m_per_pulse: float) -> float:
        """The nearest value within the bounds."""
        return min(max(m_per_pulse, self.low_m), self.high_m)

    def anchor(self, antenna_m: float, pulses: int, bound_m: float) -> None:
        self._anchor = (antenna_m, pulses, bound_m)

    def forget_anchor(self) -> None:
        """Abandon the present measurement, because the wheels slipped."""
        self._anchor = None

    def forget(self) -> None:
        """Return to the declared bounds."""
        self.low_m, self.high_m = self._declared_m
        self._anchor = None

    def measure(self, tag_m: float, pulses: int, bound_m: float) -> None:
        """Bound the distance per pulse by two known places and the pulses between them."""
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
