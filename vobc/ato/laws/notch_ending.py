"""The end of a stop with notches: a small brake through blending, then the last notches to the
stop.
"""

from bisect import bisect_left
from typing import Final

from vobc.ato.model.predictor import PredictedState
from vobc.ato.motion.step_curve import StepCurve
from vobc.ato.settings.ato import AtoConfig
from vobc.ato.settings.chasing import ChasingScheme

LAST_SOONER_RATIO: Final = 2.0
LAST_LATER_RATIO: Final = 0.5
"""Bounds of the speed at which the last notch is taken, relative to its planned speed."""
SAME_MPS2: Final = 1e-9
"""Difference up to which two decelerations belong to the same notch."""
LEAST_ROOM_M: Final = 0.02
ROLL_RATIO: Final = 0.6
"""Share of the last notch below which the train rolls without brake."""
KEPT_RATIO: Final = 0.75
KEPT_LEAST_MPS2: Final = 0.03
"""Difference between the needed and the present notch up to which the present one is kept."""
SMALL_STEP_MPS2: Final = 0.04
"""Correction step of the small notch. Three quarters of it are its hysteresis."""
SMALL_SPARE_MPS2: Final = 0.035
HOLD_LOOKS_MPS: Final = 0.2
"""Speed difference to the end of blending within which the small notch stays unchanged."""
STEP_UP_MPS2: Final = 0.1
"""Greatest increase of the brake from one notch to the next."""


def last_notch_mps2(config: AtoConfig, gravity_mps2: float) -> float:
    """The smallest notch that still stops the train on this gradient. If none does, the strongest.

    Args:
        gravity_mps2: deceleration by the gradient, negative where the track falls.
    """
    wanted_mps2 = config.chasing.last_decel_mps2 - min(0.0, gravity_mps2)
    for level_mps2 in config.output.brake_levels_mps2:
        if level_mps2 >= wanted_mps2 - 1e-9:
            return level_mps2
    return config.output.brake_levels_mps2[-1]


def chase_from_mps(scheme: ChasingScheme) -> float:
    """Speed at which the first notch after blending begins to act. Until then the small one
    acts.
    """
    late_s = scheme.dead_time_s + scheme.lag_s + scheme.air_delay_s
    late_mps = scheme.small_decel_mps2 * late_s
    return max(2.0 * scheme.last_speed_mps, scheme.blending_end_mps - late_mps)


class StopEnding:
    """End of a stop. It is called in every cycle of the braking and takes over near the end."""

    __slots__ = (
        "_chasing",
        "_config",
        "_curve",
        "_holding",
        "_last_m",
        "_last_mps2",
        "_last_notch_mps2",
        "_lasting",
        "_levels_mps2",
        "_plan_mps2",
        "_resistance_mps2",
    )

    def __init__(self, config: AtoConfig) -> None:
        self._config = config
        self._curve = StepCurve((config.chasing.decel_mps2,), ())
        self._plan_mps2 = self._resistance_mps2 = 0.0
        """Deceleration without brake: by gradient and rolling, and with what was identified."""
        self._levels_mps2 = config.output.brake_levels_mps2
        """Deceleration by each notch."""
        self._last_notch_mps2 = self._last_mps2 = config.output.brake_levels_mps2[0]
        """The last notch, and the deceleration by it."""
        self._last_m = 0.0
        self.reset()

    def reset(self) -> None:
        self._holding = False
        self._chasing = False
        self._lasting = False

    def plan(self, curve: StepCurve, gravity_mps2: float) -> None:
        """Prepare a new stop on this gradient."""
        scheme = self._config.chasing
        self._curve = curve
        self._plan_mps2 = self._resistance_mps2 = gravity_mps2 + scheme.rolling_mps2
        self._last_notch_mps2 = last_notch_mps2(self._config, gravity_mps2)
        self._last_m = curve.at_speed(scheme.last_speed_mps).distance_m
        self.reset()

    def notch_mps2(
        self,
        ahead: PredictedState,
        distance_m: float,
        *,
        measured_mps: float,
        now_mps2: float,
        rested: bool,
        brake_ratio: float,
        drift_mps2: float,
    ) -> float | None:
        """Demand of the notch to take, negative. None: the curve is still followed.

        Args:
            distance_m: from the predicted front to the stop.
            measured_mps: present speed.
            now_mps2: demand of the present notch.
            rested: the dwell time of the notch is over.
            brake_ratio: deceleration by the brake, relative to the demand.
            drift_mps2: acceleration that neither brake nor gradient explain.
        """
        notches_mps2 = self._config.output.brake_levels_mps2
        self._levels_mps2 = tuple(notch_mps2 * brake_ratio for notch_mps2 in notches_mps2)
        self._last_mps2 = self._last_notch_mps2 * brake_ratio
        self._resistance_mps2 = self._plan_mps2 - drift_mps2
        wanted_mps2 = self._wanted_mps2(
            ahead, distance_m, measured_mps, now_mps2 * brake_ratio, rested=rested
        )
        if wanted_mps2 is not None and wanted_mps2 < 0.0:
            index = bisect_left(self._levels_mps2, -wanted_mps2 - SAME_MPS2)
            wanted_mps2 = -notches_mps2[min(index, len(notches_mps2) - 1)]
        scheme = self._config.chasing
        if wanted_mps2 is None or not scheme.small_brake:
            return wanted_mps2
        begin_mps = scheme.blending_begin_mps * (1.0 + scheme.blending_spread_ratio)
        if not scheme.blending_end_mps < measured_mps <= begin_mps:
            return wanted_mps2
        # During blending the notch may only grow, where distance is lacking.
        return min(now_mps2, wanted_mps2)

    def _wanted_mps2(
        self,
        ahead: PredictedState,
        distance_m: float,
        measured_mps: float,
        now_mps2: float,
        *,
        rested: bool,
    ) -> float | None:
        scheme = self._config.chasing
        if not self._chasing:
            if not scheme.small_brake:
                if ahead.speed_mps > scheme.blending_end_mps:
                    return None
            elif not self._holding:
                if not self._must_ease(ahead, now_mps2):
                    return None
                self._holding = True
                return -self._small_notch_mps2(ahead, distance_m, -now_mps2)
            elif measured_mps > scheme.blending_end_mps:
                near = ahead.speed_mps <= chase_from_mps(scheme) + HOLD_LOOKS_MPS
                if not rested or near:
                    return now_mps2
                return -self._small_notch_mps2(ahead, distance_m, -now_mps2)
            self._chasing = True
        return self._final_mps2(ahead, distance_m, -now_mps2, rested=rested)

    def _eased_mps(self, from_mps2: float, to_mps2: float) -> float:
        """Speed that is still lost while a brake notch changes to a smaller one."""
        fall_mps2 = max(0.0, from_mps2 - to_mps2)
        mean_mps2 = (from_mps2 + to_mps2) / 2.0 + self._resistance_mps2
        return mean_mps2 * fall_mps2 / self._config.limits.jerk_mps3

    def _must_ease(self, ahead: PredictedState, now_mps2: float) -> bool:
        scheme = self._config.chasing
        begin_mps = scheme.blending_begin_mps * (1.0 + scheme.blending_spread_ratio)
        lost_mps = self._eased_mps(-now_mps2, scheme.small_decel_mps2)
        return ahead.speed_mps - lost_mps <= begin_mps

    def _small_notch_mps2(self, ahead: PredictedState, distance_m: float, now_mps2: float) -> float:
        """The notch that leads from here to the end of blending, within its bounds.

        The brake first eases from the present notch. This loss is counted for the planned notch.
        """
        scheme = self._config.chasing
        end_mps = chase_from_mps(scheme)
        lost_mps = self._eased_mps(now_mps2, scheme.small_decel_mps2)
        ease_s = max(0.0, now_mps2 - scheme.small_decel_mps2) / self._config.limits.jerk_mps3
        begin_mps = ahead.speed_mps - lost_mps
        distance_m -= (ahead.speed_mps + begin_mps) / 2.0 * ease_s
        after_m = self._curve.at_speed(end_mps).distance_m + scheme.blending_reserve_m
        room_m = max(0.1, distance_m - after_m)
        squares = begin_mps**2 - end_mps**2
        wanted_mps2 = squares / (2.0 * room_m) - self._resistance_mps2
        low_mps2 = max(self._last_mps2, scheme.small_decel_min_mps2 - self._resistance_mps2)
        high_mps2 = scheme.small_decel_max_mps2 - min(0.0, self._resistance_mps2)
        wanted_mps2 = min(high_mps2, max(low_mps2, wanted_mps2))
        if abs(wanted_mps2 - now_mps2) < KEPT_RATIO * SMALL_STEP_MPS2:
            return now_mps2
        # The notch may still grow in blending, but a train that is too slow after it cannot be
        # corrected. Therefore the choice is slightly too small.
        levels_mps2 = self._levels_mps2
        fitting = [level for level in levels_mps2 if level >= wanted_mps2 - SMALL_SPARE_MPS2]
        return fitting[0] if fitting else levels_mps2[-1]

    def _final_mps2(
        self, ahead: PredictedState, distance_m: float, now_mps2: float, *, rested: bool
    ) -> float:
        """b = v**2 / 2d: first to where the last notch begins, then with that notch to the stop."""
        scheme = self._config.chasing
        if not rested:
            return -now_mps2
        speed_mps = ahead.speed_mps
        last_decel_mps2 = self._last_mps2 + self._resistance_mps2
        eased_mps = max(0.0, speed_mps - self._eased_mps(now_mps2, self._last_mps2))
        if self._lasting:
            beyond_m = speed_mps * speed_mps / (2.0 * last_decel_mps2) - distance_m
            if beyond_m <= scheme.stop_tolerance_m:
                return -self._last_mps2
        elif eased_mps <= scheme.last_speed_mps * LAST_SOONER_RATIO:
            fits = eased_mps * eased_mps <= 2.0 * last_decel_mps2 * distance_m
            if fits or eased_mps <= scheme.last_speed_mps * LAST_LATER_RATIO:
                self._lasting = True
                return -self._last_mps2
        return -self._nearest_mps2(speed_mps, distance_m, now_mps2)

    def _nearest_mps2(self, speed_mps: float, distance_m: float, now_mps2: float) -> float:
        """The notch nearest to the needed one, with a hysteresis of three quarters of a step."""
        scheme = self._config.chasing
        last_mps = scheme.last_speed_mps
        room_m = distance_m - self._last_m
        squares = speed_mps * speed_mps - last_mps * last_mps
        if speed_mps < LAST_SOONER_RATIO * last_mps or room_m <= 0.0:
            room_m, squares = max(LEAST_ROOM_M, distance_m), speed_mps * speed_mps
        needed_mps2 = squares / (2.0 * room_m) - self._resistance_mps2
        if speed_mps < LAST_SOONER_RATIO * last_mps:
            # The brake that is applied when the train comes to rest is felt as a jolt.
            most_mps2 = scheme.chase_decel_mps2 - min(0.0, self._resistance_mps2)
            needed_mps2 = min(needed_mps2, max(most_mps2, self._last_mps2))
        # A released brake answers with a new delay. Only a train that is much too slow rolls
        # without brake.
        levels_mps2 = self._levels_mps2
        if not self._lasting and needed_mps2 < ROLL_RATIO * self._last_mps2:
            return 0.0
        needed_mps2 = min(max(needed_mps2, self._last_mps2), now_mps2 + STEP_UP_MPS2)
        best_mps2 = min(levels_mps2, key=lambda level_mps2: abs(level_mps2 - needed_mps2))
        kept_mps2 = max(KEPT_LEAST_MPS2, KEPT_RATIO * abs(best_mps2 - now_mps2))
        return now_mps2 if abs(needed_mps2 - now_mps2) < kept_mps2 else best_mps2
