"""The end of a stop with notches: a small brake through blending, then the chase to the mark."""

from vobc.ato.config import AtoConfig
from vobc.ato.predictor import Ahead
from vobc.ato.step_curve import StepCurve


def last_notch_mps2(config: AtoConfig, gravity_mps2: float) -> float:
    """The least notch that still stops the train on this gradient; the strongest if none does.

    Args:
        gravity_mps2: deceleration by the gradient, negative where the track falls.
    """
    wanted_mps2 = config.chasing.last_decel_mps2 - min(0.0, gravity_mps2)
    for level_mps2 in config.output.brake_levels_mps2:
        if level_mps2 >= wanted_mps2 - 1e-9:
            return level_mps2
    return config.output.brake_levels_mps2[-1]


class StopEnding:
    """Asked in every cycle of a braking to a stop; it answers once its part has come."""

    __slots__ = (
        "_chasing",
        "_config",
        "_curve",
        "_last_m",
        "_last_mps2",
        "_resistance_mps2",
        "_small_mps2",
    )

    def __init__(self, config: AtoConfig) -> None:
        self._config = config
        self._curve = StepCurve((config.chasing.decel_mps2,), ())
        self._resistance_mps2 = 0.0
        self._last_mps2 = config.output.brake_levels_mps2[0]
        self._last_m = 0.0
        self.reset()

    def reset(self) -> None:
        self._small_mps2 = 0.0
        """The small brake while it is held."""
        self._chasing = False

    def plan(self, curve: StepCurve, gravity_mps2: float) -> None:
        """A new stop, on this gradient."""
        scheme = self._config.chasing
        self._curve = curve
        self._resistance_mps2 = gravity_mps2 + scheme.rolling_mps2
        self._last_mps2 = last_notch_mps2(self._config, gravity_mps2)
        self._last_m = curve.at_speed(scheme.last_speed_mps).distance_m
        self.reset()

    def notch_mps2(
        self,
        ahead: Ahead,
        distance_m: float,
        *,
        measured_mps: float,
        now_mps2: float,
        rested: bool,
    ) -> float | None:
        """The demand of the notch to take, negative; None while the curve is chased.

        Args:
            distance_m: from the predicted front to the stop.
            measured_mps: the speed now; blending goes by it, whatever is predicted.
            now_mps2: the notch at work.
            rested: it has been at work long enough.
        """
        scheme = self._config.chasing
        if scheme.small_brake and not self._chasing:
            if self._small_mps2 == 0.0:
                if not self._must_ease(ahead, now_mps2):
                    return None
                self._small_mps2 = self._small_notch_mps2(ahead, distance_m)
            if measured_mps > scheme.blending_end_mps:
                return -self._small_mps2
            self._chasing = True
        elif not self._chasing:
            if ahead.speed_mps > scheme.blending_end_mps:
                return None
            self._chasing = True
        return self._final_mps2(ahead, distance_m, -now_mps2, rested=rested)

    def _eased_mps(self, from_mps2: float, to_mps2: float) -> float:
        """Speed that is still lost while a brake notch gives way to a smaller one."""
        fall_mps2 = max(0.0, from_mps2 - to_mps2)
        mean_mps2 = (from_mps2 + to_mps2) / 2.0 + self._resistance_mps2
        return mean_mps2 * fall_mps2 / self._config.limits.jerk_mps3

    def _must_ease(self, ahead: Ahead, now_mps2: float) -> bool:
        scheme = self._config.chasing
        begin_mps = scheme.blending_begin_mps * (1.0 + scheme.blending_spread_ratio)
        lost_mps = self._eased_mps(-now_mps2, scheme.small_decel_mps2)
        return ahead.speed_mps - lost_mps <= begin_mps

    def _small_notch_mps2(self, ahead: Ahead, distance_m: float) -> float:
        """The notch that leads from here to the end of blending, within its bounds."""
        scheme = self._config.chasing
        end = self._curve.at_speed(scheme.blending_end_mps)
        room_m = max(0.1, distance_m - end.distance_m)
        squares = ahead.speed_mps**2 - scheme.blending_end_mps**2
        wanted_mps2 = squares / (2.0 * room_m) - self._resistance_mps2
        low_mps2 = scheme.small_decel_min_mps2 - min(0.0, self._resistance_mps2)
        high_mps2 = scheme.small_decel_max_mps2 - min(0.0, self._resistance_mps2)
        wanted_mps2 = min(high_mps2, max(low_mps2, wanted_mps2))
        levels_mps2 = self._config.output.brake_levels_mps2
        return min(levels_mps2, key=lambda level_mps2: abs(level_mps2 - wanted_mps2))

    def _final_mps2(
        self, ahead: Ahead, distance_m: float, now_mps2: float, *, rested: bool
    ) -> float:
        """b = v**2 / 2d towards where the last notch begins; the next notch above it.

        Taking the notch above lets what is needed fall until the next smaller one just fits, so the
        train arrives with the last one.
        """
        scheme = self._config.chasing
        if not rested:
            return -now_mps2
        last_mps, last_m = scheme.last_speed_mps, self._last_m
        speed_mps = ahead.speed_mps
        if speed_mps - self._eased_mps(now_mps2, self._last_mps2) <= last_mps:
            last_mps, last_m = 0.0, 0.0
        squares = max(0.0, speed_mps * speed_mps - last_mps * last_mps)
        room_m = distance_m - last_m
        held_mps2 = now_mps2 + self._resistance_mps2
        beyond_m = squares / (2.0 * held_mps2) - room_m if held_mps2 > 0.0 else 1.0
        if abs(beyond_m) <= scheme.stop_tolerance_m and now_mps2 >= self._last_mps2:
            return -now_mps2
        levels_mps2 = self._config.output.brake_levels_mps2
        if room_m <= 0.0:
            return -levels_mps2[-1] if squares > 0.01 else -max(now_mps2, self._last_mps2)
        needed_mps2 = squares / (2.0 * room_m) - self._resistance_mps2
        for level_mps2 in levels_mps2:
            if level_mps2 >= needed_mps2 and level_mps2 >= self._last_mps2:
                return -level_mps2
        return -levels_mps2[-1]
