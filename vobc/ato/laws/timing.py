"""Speed control of Green CBTC ([Lin]) for one train: on time, below a permissible speed.

Each cycle gives the permissible target speed V_top in closed form. Remaining distance and time give
the timing target speed V_time. The lower one is the target speed. [Lin] does not say how the train
follows it and parks; both are done by the predictive law.
"""

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Final

from firmware_py.trackdb import LineMap
from vobc.ato.laws.law import Drive, Target
from vobc.ato.laws.over_predictive import OverPredictive
from vobc.ato.motion import gradient, profile
from vobc.ato.motion.running_time import RunningTime
from vobc.ato.settings.ato import AtoConfig
from vobc.kinematics import SERVICE_FROM_COAST_OR_BRAKE, SERVICE_FROM_TRACTION, v_top_mps
from vobc.vocabulary import AtoInput

NS_PER_S: Final = 1_000_000_000
LEAST_DECEL_MPS2: Final = 0.2
"""Least deceleration assumed for V_top, however steep the downhill gradient."""
FAR_S: Final = 10.0
"""Longer than any reaction time of the service brake."""
AGAIN_FAR_M: Final = 20.0
"""Distance beyond S_cfg at which parking for a moved stopping point ends."""


class TimingState(IntEnum):
    STATIONARY = 0
    START_UP = 1
    AUTOMATIC = 2
    PARKING = 3


class TimingGuard(IntEnum):
    """Guards of figure 1 of [Lin] by their numbers there, with the missing ones added."""

    MOVES = 1
    """The train is released."""
    FAST = 2
    """Faster than V_cfg."""
    NEAR = 3
    """Nearer to the stopping point than S_cfg, or already braking for it."""
    STANDS = 4
    SLOW = 5
    """Slower than the speed at which automatic operation ends, which is below V_cfg."""
    FAR = 6
    """The stopping point has moved away."""


TRANSITIONS: Final[Mapping[TimingState, tuple[tuple[TimingGuard, TimingState], ...]]] = {
    TimingState.STATIONARY: ((TimingGuard.MOVES, TimingState.START_UP),),
    TimingState.START_UP: (
        (TimingGuard.STANDS, TimingState.STATIONARY),
        (TimingGuard.NEAR, TimingState.PARKING),
        (TimingGuard.FAST, TimingState.AUTOMATIC),
    ),
    TimingState.AUTOMATIC: (
        (TimingGuard.STANDS, TimingState.STATIONARY),
        (TimingGuard.NEAR, TimingState.PARKING),
        (TimingGuard.SLOW, TimingState.START_UP),
    ),
    TimingState.PARKING: (
        (TimingGuard.STANDS, TimingState.STATIONARY),
        (TimingGuard.FAR, TimingState.START_UP),
    ),
}
"""Transitions of each state in order of priority."""


def next_state(state: TimingState, holds: Mapping[TimingGuard, bool]) -> TimingState:
    """Make at most one transition per cycle."""
    for guard, to in TRANSITIONS[state]:
        if holds[guard]:
            return to
    return state


class TimedRun(OverPredictive):
    __slots__ = (
        "_braking",
        "_far_m",
        "_limits",
        "_look_again_ns",
        "_running",
        "_target",
        "_time_mps",
        "state",
    )

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        super().__init__(config, line, dt_s)
        self._limits = profile.SpeedLimits(config, line)
        most_mps = max(section.limit_mps for section in line.speed_sections)
        self._far_m = most_mps * (FAR_S + most_mps / (2.0 * LEAST_DECEL_MPS2))
        """Distance within which the weakest assumed braking ends from any speed of the line."""
        self._braking = False
        self._target: Target | None = None
        self._running: RunningTime | None = None
        self._look_again_ns = 0
        self._time_mps = math.inf
        self.state = TimingState.STATIONARY

    def rest(self) -> None:
        super().rest()
        self.state = TimingState.STATIONARY

    def set_off(self, inputs: AtoInput, demand_mps2: float) -> None:
        super().set_off(inputs, demand_mps2)
        self._target = None
        self._braking = False

    def drive(self, inputs: AtoInput, target: Target) -> Drive:
        self.state = next_state(self.state, self._guards(inputs, target))
        self._drives.most_mps = self._target_mps(inputs, target)
        drive = self._drives.drive(inputs, target)
        self._braking = drive.braking
        return drive

    def _guards(self, inputs: AtoInput, target: Target) -> dict[TimingGuard, bool]:
        settings, speed_mps = self._config.timing, self.speed_mps
        to_stop_m = target.at_m - inputs.front_m
        braking_m = speed_mps * speed_mps / (2.0 * settings.decel_mps2)
        parking_m = max(settings.parking_m, braking_m + settings.parking_spare_m)
        return {
            TimingGuard.MOVES: not inputs.holding_applied or speed_mps > 0.0,
            TimingGuard.FAST: speed_mps > settings.start_up_mps,
            TimingGuard.NEAR: to_stop_m < parking_m or self._braking,
            TimingGuard.STANDS: inputs.standstill and inputs.holding_applied,
            TimingGuard.SLOW: speed_mps < settings.slowed_mps,
            TimingGuard.FAR: to_stop_m > parking_m + AGAIN_FAR_M and not self._braking,
        }

    # Target speeds.

    def _target_mps(self, inputs: AtoInput, target: Target) -> float:
        """Equation (12) with alpha = 1: V_time where it is below V_top.

        Parking follows its own curve below the previous target speed.
        """
        if self.state is TimingState.PARKING:
            return self._time_mps
        if target != self._target:
            self._plan(inputs, target)
        top_mps = self._top_mps(inputs)
        if self.state is TimingState.AUTOMATIC and inputs.now_ns >= self._look_again_ns:
            self._look_again_ns = inputs.now_ns + round(self._config.timing.look_s * NS_PER_S)
            self._time_mps = self._timing_mps(inputs, target)
        return self._combined_mps(inputs, top_mps, self._time_mps)

    def _combined_mps(self, inputs: AtoInput, top_mps: float, timing_mps: float) -> float:
        return min(top_mps, timing_mps)

    def _plan(self, inputs: AtoInput, target: Target) -> None:
        self._target = target
        self._look_again_ns = 0
        self._time_mps = math.inf
        curve = self._drives.curve_to(target)
        self._running = RunningTime(self._config, self._line, inputs.front_m, target.at_m, curve)

    def _timing_mps(self, inputs: AtoInput, target: Target) -> float:
        """V_time. It is infinite without a timetable."""
        if target.due_ns is None or self._running is None:
            return math.inf
        left_s = (target.due_ns - inputs.now_ns) / NS_PER_S
        high_mps = self._line.limit_mps(inputs.front_m)
        for section in self._line.speed_sections:
            if section.start_m < target.at_m and section.end_m > inputs.front_m:
                high_mps = max(high_mps, section.limit_mps)
        return self._running.speed_for_mps(
            inputs.front_m,
            self.speed_mps,
            left_s,
            low_mps=self._config.timing.least_mps,
            high_mps=high_mps,
        )

    def _top_mps(self, inputs: AtoInput) -> float:
        """V_top towards every lower limit ahead, by the train's present demand."""
        pulls = self._demand_mps2 > 0.0
        reaction = SERVICE_FROM_TRACTION if pulls else SERVICE_FROM_COAST_OR_BRAKE
        top_mps = math.inf
        index = self._limits.next_lowering(inputs.front_m)
        far_m = inputs.front_m + self._far_m
        while (lowering := self._limits.lowering(index)) is not None and lowering.at_m < far_m:
            index += 1
            end_mps = lowering.curve.end_mps
            to_limit_mps = v_top_mps(
                lowering.at_m - inputs.front_m,
                decel_mps2=self._decel_mps2(inputs.front_m, lowering.at_m),
                accel_mps2=self._demand_mps2,
                reaction=reaction,
                target_mps=end_mps,
            )
            top_mps = min(top_mps, max(end_mps, to_limit_mps))
        return top_mps

    def _decel_mps2(self, front_m: float, limit_m: float) -> float:
        """b' of V_top: on the steepest downhill gradient between the train's rear and the limit."""
        rear_m = front_m - self._config.train_length_m
        falls_permille = min(0.0, self._line.worst_gradient_permille(rear_m, limit_m))
        help_mps2 = gradient.decel_on_mps2(self._config, falls_permille)
        return max(LEAST_DECEL_MPS2, self._config.timing.decel_mps2 + help_mps2)
