"""Handover of braking from motors to friction at low speed, with friction that may be late.

Above one speed the motors brake, below a lower one friction does, and in between they share. On
some trains the compressed air is late, so a part of the braking is missing meanwhile. The delay
shows in each handover. Every hypothesis has a filter of its own, and its cost is what it cannot
explain.
"""

import math
from collections.abc import Sequence
from typing import Final

from vobc.ato.model.model_bank import ModelBank
from vobc.ato.model.motion_filter import MotionFilter
from vobc.ato.model.predictor import Pipeline
from vobc.ato.settings.ato import BrakeBelief

LATE_COST: Final = 1.0
"""Prior cost of late friction. Before any evidence friction counts as in time."""
KEPT_COST: Final = 14.0
"""Greatest cost that is carried over from one application to the next."""
LATE_FROM_RATIO: Final = 0.02
"""Probability of late friction below which it counts as in time."""


class Handover:
    """State of the handover, per unit of mass and before gains."""

    __slots__ = (
        "_bank",
        "_belief",
        "_dt_s",
        "_keep_ratios",
        "_output",
        "_pipeline",
        "_taps",
        "air_s",
        "friction_mps2",
        "late_ratio",
        "under_way",
    )

    def __init__(self, belief: BrakeBelief, dt_s: float) -> None:
        delays_s = belief.air_delays_s
        self._belief = belief
        self._dt_s = dt_s
        self._pipeline = Pipeline(dt_s, delays_s[-1] + dt_s)
        self._taps = tuple(self._pipeline.tap(delay_s) for delay_s in delays_s)
        self._keep_ratios = tuple(self._keep_ratio(delay_s) for delay_s in delays_s)
        self._output = [0.0] * len(delays_s)
        self._bank = ModelBank(len(delays_s), dt_s)
        self._bank.know([0.0 if delay_s == 0.0 else LATE_COST for delay_s in delays_s])
        self.under_way = False
        """The hypotheses about friction are active."""
        self.air_s = 0.0
        """Estimated delay of friction."""
        self.late_ratio = 0.0
        """Probability that friction is late."""
        self.friction_mps2 = 0.0
        """Friction deceleration that has arrived."""
        self._agree()

    @property
    def may_be_late(self) -> bool:
        return self.late_ratio > LATE_FROM_RATIO

    @property
    def late(self) -> bool:
        """Friction may be late and provides a part of the braking."""
        return self.under_way and self.may_be_late

    def gap_m(self, speed_mps: float, unit_mps2: float) -> float:
        """Expected distance without brake that is still to come when friction takes over."""
        if not self.may_be_late:
            return 0.0
        belief = self._belief
        share_ratio = unit_mps2 / belief.motors_mps2
        fade_mps = belief.fade_begin_mps - belief.fade_end_mps
        middle_mps = belief.fade_end_mps + share_ratio * fade_mps / 2.0
        gap_s = self.air_s + self.late_ratio * belief.air_lag_s
        return middle_mps * gap_s * (1.0 - self.friction_ratio(speed_mps, unit_mps2))

    def _keep_ratio(self, delay_s: float) -> float:
        """Decay per cycle.

        Friction with a short delay builds up as quickly; without delay, at once.
        """
        lag_s = min(self._belief.air_lag_s, delay_s)
        return math.exp(-self._dt_s / lag_s) if lag_s > 0.0 else 0.0

    def friction_ratio(self, speed_mps: float, unit_mps2: float) -> float:
        """Share of friction in the braking: what exceeds the motors' present capability."""
        belief = self._belief
        faded = (speed_mps - belief.fade_end_mps) / (belief.fade_begin_mps - belief.fade_end_mps)
        most_mps2 = belief.motors_mps2 * min(1.0, max(0.0, faded))
        return 0.0 if unit_mps2 <= most_mps2 else 1.0 - most_mps2 / unit_mps2

    def end(self) -> None:
        """End the application. Its evidence is kept up to a limit."""
        self.under_way = False
        self._bank.know(self._bank.costs(KEPT_COST))
        self._output = [0.0] * len(self._output)
        self._agree()

    def begin(self, motion: MotionFilter) -> None:
        """Friction takes over."""
        self.under_way = True
        self._bank.begin(motion)

    def renew_disturbance(self) -> None:
        self._bank.renew_disturbance()

    def _agree(self) -> None:
        bank = self._bank
        self.air_s = bank.mean(self._belief.air_delays_s)
        self.friction_mps2 = bank.mean(self._output)
        self.late_ratio = 1.0 - bank.weights[0]

    def note(self, for_friction_mps2: float) -> None:
        """Note the friction share of this cycle."""
        self._pipeline.push(for_friction_mps2)

    def step(
        self,
        motion: MotionFilter,
        measured_mps: float,
        *,
        push_mps2: float,
        motors_mps2: float,
        blur_m2_per_s2: float,
    ) -> None:
        """One cycle of every hypothesis, after `note`. `motion` becomes their weighted mean."""
        bank, outputs, pipeline = self._bank, self._output, self._pipeline
        for index in bank.alive:
            mean_mps2 = pipeline.mean(self._taps[index])
            before_mps2 = outputs[index]
            after_mps2 = mean_mps2 + (before_mps2 - mean_mps2) * self._keep_ratios[index]
            outputs[index] = after_mps2
            # Friction without delay has built up with the brake unit, so the mean is its effort.
            friction_mps2 = (before_mps2 + after_mps2) / 2.0 if index > 0 else mean_mps2
            bank.step(
                index,
                measured_mps,
                push_mps2=push_mps2,
                braked_mps2=motors_mps2 + friction_mps2,
                friction_mps2=friction_mps2 if index > 0 else 0.0,
                blur_m2_per_s2=blur_m2_per_s2,
            )
        bank.weigh()
        bank.agree(motion)
        self._agree()

    def walk(
        self,
        motion: MotionFilter,
        units_mps2: Sequence[float],
        *,
        steady_mps2: float,
        reach_s: float,
    ) -> tuple[float, float]:
        """Distance and speed until a demand given now acts.

        The motors act after `reach_s`. The share of friction adds its part of the air delay.

        Args:
            units_mps2: output of the brake unit in each coming cycle; the last one stays.
            steady_mps2: acceleration by everything but the brake.
        """
        dt_s, air_s = self._dt_s, self.air_s
        motors_gain = 1.0 + motion.gain_ratio
        friction_gain = motors_gain + motion.friction_ratio
        keep_ratio = self._keep_ratio(air_s)
        speed_mps, friction_mps2, travel_m, at_s, step = (
            motion.speed_mps,
            self.friction_mps2,
            0.0,
            0.0,
            0,
        )
        newer: list[float] = []
        ratio = self.friction_ratio(speed_mps, units_mps2[0])
        while speed_mps > 0.0 and at_s < reach_s + air_s * ratio - dt_s / 2.0:
            unit_mps2 = units_mps2[min(step, len(units_mps2) - 1)]
            ratio = self.friction_ratio(speed_mps, unit_mps2)
            newer.append(unit_mps2 * ratio)
            age_s = air_s - at_s - dt_s
            if age_s >= 0.0:
                mean_mps2 = self._pipeline.mean(self._pipeline.tap(age_s))
            else:
                mean_mps2 = newer[max(0, min(step, round(step - air_s / dt_s)))]
            after_mps2 = mean_mps2 + (friction_mps2 - mean_mps2) * keep_ratio
            braked_mps2 = unit_mps2 * (1.0 - ratio) * motors_gain
            braked_mps2 += (friction_mps2 + after_mps2) / 2.0 * friction_gain
            friction_mps2 = after_mps2
            accel_mps2 = steady_mps2 - braked_mps2
            travel_m += (speed_mps + accel_mps2 * dt_s / 2.0) * dt_s
            speed_mps += accel_mps2 * dt_s
            at_s += dt_s
            step += 1
        return travel_m, max(0.0, speed_mps)
