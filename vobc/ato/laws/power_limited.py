"""Power-limited running curves ([Ninh]): lower notch-off speed, coasting, and a long gentle brake.

At departure the law plans notch-off speed and power limit for the time left by the timetable. While
coasting it adapts the power limit to the remaining time. A late train brakes with more power, up to
that of the motors. A train that is still late omits the gentle brake. Then the predictive law
brakes it on its curve, which friction shares, as at the end of every stop. An even later train does
not coast either. Limits, ceiling and the stop itself are those of the predictive law.

Where a lower limit lies ahead, the plan is a speed to hold and the place from which to coast. Each
second the law moves that place so that the train arrives in time.
"""

import math
from enum import IntEnum
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.ato.laws.law import Drive, Target
from vobc.ato.laws.over_predictive import OverPredictive
from vobc.ato.laws.power_plan import PowerBrake, PowerPlan, PowerPlanner
from vobc.ato.settings.ato import AtoConfig
from vobc.vocabulary import AtoInput

NS_PER_S: Final = 1_000_000_000
CORRECTION_RATIO: Final = 2.0
"""Gain of the correction towards the stop, as in the predictive law."""
LEAST_SHARE: Final = 0.3
LEAST_SPEED_MPS: Final = 1.0
LATE_S: Final = 0.5
"""Delay with full electric braking from which the train also brakes with friction."""
VERY_LATE_S: Final = 3.0
"""Delay from which the train does not coast. Friction makes up for two or three seconds of it."""
NEAR_MPS: Final = 0.2
"""Tolerance of the notch-off speed. The last part of an acceleration is slow."""
REGAIN_M: Final = 100.0
"""Distance to the place from which to coast above which a coasting train gains speed again."""
HOLDING_MPS2: Final = 0.1
"""Deceleration of the predictive law above which a coasting train slows for a limit or the ceiling.
"""


class RunStage(IntEnum):
    FREE = 0
    """The predictive law drives: without a timetable, or once it brakes into the stop."""
    GAINING = 1
    COASTING = 2
    BRAKING = 3


class PowerLimitedRun(OverPredictive):
    __slots__ = (
        "_brake",
        "_late",
        "_look_again_ns",
        "_planner",
        "_target",
        "plan",
        "stage",
    )

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        super().__init__(config, line, dt_s)
        self._target: Target | None = None
        self._planner: PowerPlanner | None = None
        self._brake: PowerBrake | None = None
        self._look_again_ns = 0
        self._late = False
        """The train is late even with full electric braking."""
        self.plan: PowerPlan | None = None
        """The present plan. None: there is no timetable."""
        self.stage = RunStage.FREE

    def rest(self) -> None:
        super().rest()
        self.stage = RunStage.FREE

    def set_off(self, inputs: AtoInput, demand_mps2: float) -> None:
        super().set_off(inputs, demand_mps2)
        self._target = None
        self.stage = RunStage.FREE

    def drive(self, inputs: AtoInput, target: Target) -> Drive:
        if target != self._target:
            self._begin(inputs, target)
        free = self._drives.drive(inputs, target)
        if self.plan is None or free.braking:
            self.stage = RunStage.FREE if self.plan is None or free.braking else self.stage
            return free
        self._advance(inputs, target)
        if self.stage is RunStage.COASTING:
            self._drives.coast()
            # Slowing for a limit or the ceiling has priority.
            slows = free.accel_mps2 < -HOLDING_MPS2
            return Drive(free.accel_mps2 if slows else 0.0, free.reference_mps, False)
        if self.stage is RunStage.BRAKING:
            demand_mps2 = min(free.accel_mps2, -self._limited_mps2(inputs, target))
            onset_mps2 = self._config.braking.onset_jerk_mps3 * inputs.dt_s
            demand_mps2 = max(demand_mps2, self._demand_mps2 - onset_mps2)
            return Drive(demand_mps2, self.speed_mps, False)
        return free

    def _begin(self, inputs: AtoInput, target: Target) -> None:
        """Plan from here for a new target or arrival time."""
        self._target = target
        self.plan = None
        self.stage = RunStage.FREE
        self._late = False
        self._drives.most_mps = math.inf
        if target.due_ns is None or not target.at_station:
            return
        curve = self._drives.curve_to(target)
        planner = PowerPlanner(self._config, self._line, target.at_m, curve, load_kg=inputs.load_kg)
        left_s = (target.due_ns - inputs.now_ns) / NS_PER_S
        top_mps = self._top_mps(inputs.front_m, target.at_m)
        self._planner = planner
        plan = planner.plan(inputs.front_m, max(0.0, self.speed_mps), left_s, top_mps)
        if plan.time_s > left_s + LATE_S:
            # No curve takes so little time, so the train runs as fast as the line permits.
            return
        self.plan = plan
        self._drives.most_mps = self.plan.notch_off_mps
        self._brake = planner.brake(self._planned_w)
        self._look_again_ns = inputs.now_ns
        self.stage = RunStage.GAINING

    @property
    def _planned_w(self) -> float:
        assert self.plan is not None
        return self._config.power_limited.spare_ratio * self.plan.power_w

    def _top_mps(self, front_m: float, at_m: float) -> float:
        """The highest limit on the way, less the margin of cruising."""
        high_mps = self._line.limit_mps(front_m)
        for section in self._line.speed_sections:
            if section.start_m < at_m and section.end_m > front_m:
                high_mps = max(high_mps, section.limit_mps)
        return high_mps - self._config.speed.margin_mps

    def _advance(self, inputs: AtoInput, target: Target) -> None:
        """Advance by at most one stage. Ending traction at the jerk limit still gains some
        speed.
        """
        assert self.plan is not None
        speed_mps = self.speed_mps
        pulls_mps2 = max(0.0, self._demand_mps2)
        after_mps = speed_mps + pulls_mps2**2 / (2.0 * self._config.limits.jerk_mps3)
        coast_from_m = self.plan.coast_from_m
        if self.stage is RunStage.GAINING and (
            after_mps >= self.plan.notch_off_mps - NEAR_MPS
            if coast_from_m is None
            else inputs.front_m >= coast_from_m
        ):
            self.stage = RunStage.COASTING
        looks = coast_from_m is not None or self.stage is RunStage.COASTING
        if (
            looks
            and self.stage in (RunStage.GAINING, RunStage.COASTING)
            and inputs.now_ns >= self._look_again_ns
        ):
            self._look_again_ns = inputs.now_ns + round(
                self._config.power_limited.look_s * NS_PER_S
            )
            self._look_again(inputs, target)
        if self.stage in (RunStage.GAINING, RunStage.COASTING):
            assert self._brake is not None
            delay_s = self._drives.brake_dead_time_s
            reach_m = target.at_m - inputs.front_m - speed_mps * delay_s
            if not self._late and reach_m <= self._brake.from_speed(speed_mps).way_m:
                self.stage = RunStage.BRAKING

    def _look_again(self, inputs: AtoInput, target: Target) -> None:
        """Update the power limit for the remaining time. It is fixed once the train brakes."""
        assert self._planner is not None
        assert self.plan is not None
        assert target.due_ns is not None
        left_s = (target.due_ns - inputs.now_ns) / NS_PER_S
        if self.plan.coast_from_m is not None and (
            self.stage is RunStage.GAINING or self._planner.lowered(inputs.front_m)
        ):
            self._look_past_limits(inputs.front_m, left_s, target.at_m)
            return
        power_w = self._planner.limit_w(inputs.front_m, self.speed_mps, left_s)
        late_s = self._planner.coasted_s(inputs.front_m, self.speed_mps, power_w) - left_s
        self._late = late_s > LATE_S
        if late_s > VERY_LATE_S:
            self.plan, self.stage = None, RunStage.FREE
            self._drives.most_mps = math.inf
            return
        self.plan = self.plan._replace(power_w=power_w)
        self._brake = self._planner.brake(self._planned_w)

    def _look_past_limits(self, front_m: float, left_s: float, at_m: float) -> None:
        """Move the place from which to coast, and gain speed again if it is far ahead."""
        assert self._planner is not None
        assert self.plan is not None
        held_mps = self.plan.notch_off_mps
        place_m = self._planner.coast_from_m(front_m, self.speed_mps, left_s, held_mps)
        if place_m is None:
            held_mps = self._top_mps(front_m, at_m)
            place_m = self._planner.coast_from_m(front_m, self.speed_mps, left_s, held_mps)
        self.plan = self.plan._replace(
            notch_off_mps=held_mps, coast_from_m=at_m if place_m is None else place_m
        )
        self._drives.most_mps = held_mps
        if place_m is None or place_m > front_m + REGAIN_M:
            self.stage = RunStage.GAINING

    def _limited_mps2(self, inputs: AtoInput, target: Target) -> float:
        """Brake effort: at most the power limit, less if the train would stop short."""
        assert self._brake is not None
        assert self._planner is not None
        assert self.plan is not None
        speed_mps = max(LEAST_SPEED_MPS, self.speed_mps)
        braked = self._brake.from_speed(speed_mps)
        spare_m = target.at_m - inputs.front_m - braked.way_m
        room_m = speed_mps * max(1.0, braked.time_s)
        share_ratio = 1.0 - CORRECTION_RATIO * spare_m / room_m
        asked_mps2 = share_ratio * self._planned_w / (self._planner.mass_kg * speed_mps)
        limit_mps2 = self.plan.power_w / (self._planner.mass_kg * speed_mps)
        least_mps2 = LEAST_SHARE * min(limit_mps2, self._config.braking.decel_mps2)
        most_mps2 = min(limit_mps2, self._config.braking.decel_mps2)
        return min(most_mps2, max(least_mps2, asked_mps2))
