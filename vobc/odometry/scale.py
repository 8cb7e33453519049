"""Distance per wheel pulse: hard bounds from declared values, tags and ground."""

from dataclasses import dataclass

from vobc.odometry.config import OdometryConfig


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A known place on the way, with what wheels and ground show there."""

    antenna_m: float
    bound_m: float
    """Bound of `antenna_m`."""
    pulses: int
    ground_m: float
    """Best estimate of the distance over ground since the start, within `ground_bound_m`."""
    ground_bound_m: float


class WheelScale:
    """Bounds of the distance per pulse.

    Two tags measure it if no slip was detected in between, and the distance over ground between
    them measures it, too. A measurement by tags counts only together with another one that it
    agrees with: that over ground, or the one by tags before. The hull of both narrows the bounds.

    The hull holds the true value if one sensor is wrong or one tag lies off its place. Ground and
    tags are never both wrong then. Of two measurements by three tags, the middle tag falsifies
    both in opposite directions, and an outer tag only one. Tags that contradict the ground or the
    bounds restore the declared bounds.
    """

    __slots__ = ("_anchor", "_config", "_declared_m", "_measured_m", "high_m", "low_m")

    def __init__(self, config: OdometryConfig, nominal_m: float) -> None:
        self._config = config
        self._declared_m = (
            nominal_m / (1.0 + config.scale_error_high_ratio),
            nominal_m / (1.0 + config.scale_error_low_ratio),
        )
        self.low_m, self.high_m = self._declared_m
        """Least and greatest distance per pulse."""
        self._anchor: Waypoint | None = None
        """Start of the present measurement."""
        self._measured_m: tuple[float, float] | None = None
        """Least and greatest distance per pulse by the last measurement."""

    @property
    def declared_m(self) -> tuple[float, float]:
        """Declared bounds, independent of any measurement."""
        return self._declared_m

    def nearest(self, m_per_pulse: float) -> float:
        """The nearest value within the bounds."""
        return min(max(m_per_pulse, self.low_m), self.high_m)

    def anchor(self, here: Waypoint) -> None:
        self._anchor = here

    def forget_anchor(self) -> None:
        """Abandon the present measurement, because the wheels slipped."""
        self._anchor = None

    def forget(self) -> None:
        """Return to the declared bounds, because another wheel counts."""
        self.low_m, self.high_m = self._declared_m
        self._anchor = self._measured_m = None

    def measure(self, here: Waypoint) -> None:
        """Bound the distance per pulse by two known places and the pulses between them."""
        anchor = self._anchor
        if anchor is None:
            self._anchor = here
            return
        base_m, counted = here.antenna_m - anchor.antenna_m, here.pulses - anchor.pulses
        if base_m < self._config.scale_base_m or counted <= 1:
            return
        margin_ratio, slack_m = self._config.scale_margin_ratio, here.bound_m + anchor.bound_m
        over_m = here.ground_m - anchor.ground_m
        blur_m = here.ground_bound_m - anchor.ground_bound_m + self._config.ground_slack_m
        low_m, high_m = (1.0 - margin_ratio) / (counted + 1), (1.0 + margin_ratio) / (counted - 1)
        by_tags_m = ((base_m - slack_m) * low_m, (base_m + slack_m) * high_m)
        over_ground_m = ((over_m - blur_m) * low_m, (over_m + blur_m) * high_m)
        self._anchor = here
        before_m, self._measured_m = self._measured_m, None
        if not self._narrow(over_ground_m, by_tags_m):
            self.low_m, self.high_m = self._declared_m
            return
        self._measured_m = by_tags_m
        if before_m is not None:
            self._narrow(before_m, by_tags_m)

    def _narrow(self, other_m: tuple[float, float], by_tags_m: tuple[float, float]) -> bool:
        """Cut the bounds with the hull of two measurements. False: they contradict each other or
        the bounds.
        """
        low_m = max(min(other_m[0], by_tags_m[0]), self.low_m)
        high_m = min(max(other_m[1], by_tags_m[1]), self.high_m)
        agree = other_m[0] <= by_tags_m[1] and by_tags_m[0] <= other_m[1] and low_m <= high_m
        if agree:
            self.low_m, self.high_m = low_m, high_m
        return agree
