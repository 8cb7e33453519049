"""What operation believes of the moving train: its speed, and how late its brake answers.

The brake's dead time is drawn anew at each application, so each one starts a bank of hypotheses.
Every hypothesis predicts the speed with its own dead time; how badly it does so is its cost, and
the costs weigh the hypotheses. One filter of the motion is driven by what they agree on.
"""

import math
from typing import Final

from vobc.ato.config import BrakeBelief, TractionBelief
from vobc.ato.motion_filter import MotionFilter
from vobc.ato.predictor import Ahead, Lag, Pipeline, response

SPEED_PULL_PER_S: Final = 2.0
DISTURBANCE_PULL_PER_S2: Final = 1.0
"""Observer of a hypothesis, both poles at 1 rad/s: what it cannot explain quickly is cost."""
SETTLE_LAGS: Final = 5.0
"""So many lags after the longest dead time a released brake is taken to be off."""
NEVER_MATTERS: Final = 40.0
"""A hypothesis that is worse by this cost weighs less than rounding."""


class TrainModel:
    """All of it is per unit of mass: demands and disturbance are accelerations of the train."""

    __slots__ = (
        "_active",
        "_brake",
        "_brake_belief",
        "_brake_keep_ratio",
        "_brake_now",
        "_cost",
        "_count",
        "_demand_mps2",
        "_disturbance",
        "_dt_s",
        "_motion",
        "_output",
        "_quiet_cycles",
        "_settle_cycles",
        "_speed",
        "_taps",
        "_traction",
        "_traction_belief",
        "_traction_late",
        "_traction_now",
        "_traction_tap",
        "brake_mps2",
        "dead_time_s",
    )

    def __init__(self, brake: BrakeBelief, traction: TractionBelief, dt_s: float) -> None:
        count = len(brake.dead_times_s)
        self._brake_belief = brake
        self._traction_belief = traction
        self._dt_s = dt_s
        self._count = count
        self._brake = Pipeline(dt_s, brake.dead_times_s[-1] + dt_s)
        self._traction = Pipeline(dt_s, traction.dead_time_s + dt_s)
        self._taps = tuple(self._brake.tap(dead_time_s) for dead_time_s in brake.dead_times_s)
        self._traction_tap = self._traction.tap(traction.dead_time_s)
        self._brake_now = Lag(brake.lag_s, dt_s)
        """Driven without dead time: the output when all that is under way has arrived."""
        self._traction_now = Lag(traction.lag_s, dt_s)
        self._traction_late = Lag(traction.lag_s, dt_s)
        self._brake_keep_ratio = math.exp(-dt_s / brake.lag_s)
        self._settle_cycles = math.ceil((brake.dead_times_s[-1] + SETTLE_LAGS * brake.lag_s) / dt_s)
        self._demand_mps2 = 0.0
        self._motion = MotionFilter(dt_s)
        self._output = [0.0] * count
        self._speed = [0.0] * count
        self._disturbance = [0.0] * count
        self._cost = [0.0] * count
        self._active = False
        self._quiet_cycles = 0
        self.brake_mps2 = 0.0
        """Deceleration that was asked for and has arrived, as believed; the gain is apart."""
        self.dead_time_s = brake.expected_dead_time_s

    def issue(self, demand_mps2: float) -> None:
        """The demand that leaves now and stays until the next cycle."""
        self._demand_mps2 = demand_mps2

    @property
    def speed_mps(self) -> float:
        return self._motion.speed_mps

    @property
    def disturbance_mps2(self) -> float:
        """Acceleration that neither the demands nor the gradient explain."""
        return self._motion.disturbance_mps2

    @property
    def gain_ratio(self) -> float:
        """By how much the brake gives more than it was asked for, as believed."""
        return self._motion.gain_ratio

    @property
    def brake_asked(self) -> bool:
        return self._demand_mps2 < 0.0

    def rest(self) -> None:
        """The train stands: its motion is forgotten, the demands under way are not."""
        self.meet(0.0)

    def meet(self, speed_mps: float) -> None:
        """Take the speed as it is, on taking over a train that moves."""
        self._motion.start(speed_mps)
        self._start_hypotheses()

    def step(self, speed_mps: float, gravity_mps2: float, cycles: int) -> None:
        """Advance to now under the demand issued before, then lean towards the measured speed.

        Args:
            gravity_mps2: deceleration by the gradient under the train.
            cycles: since the step before; more than one after an overrun.
        """
        for _ in range(cycles):
            self._advance(speed_mps, gravity_mps2)

    def _advance(self, speed_mps: float, gravity_mps2: float) -> None:
        demand_mps2 = self._demand_mps2
        brake_mps2 = -demand_mps2 if demand_mps2 < 0.0 else 0.0
        traction_mps2 = demand_mps2 if demand_mps2 > 0.0 else 0.0
        self._note_application(brake_mps2)
        self._brake.push(brake_mps2)
        self._traction.push(traction_mps2)
        self._brake_now.step(brake_mps2)
        self._traction_now.step(traction_mps2)
        before_mps2 = self._traction_late.value
        mean_mps2 = self._traction.mean(self._traction_tap)
        after_mps2 = self._traction_late.step(mean_mps2)
        push_mps2 = (before_mps2 + after_mps2) / 2.0 - gravity_mps2
        brake_before_mps2 = self.brake_mps2
        if self._active:
            self._advance_bank(speed_mps, push_mps2)
            self._weigh()
        self._motion.step(
            speed_mps,
            push_mps2=push_mps2,
            braked_mps2=(brake_before_mps2 + self.brake_mps2) / 2.0,
        )

    def _advance_bank(self, speed_mps: float, push_mps2: float) -> None:
        """One observer step of each hypothesis; the hot loop, kept flat."""
        dt_s, keep_ratio = self._dt_s, self._brake_keep_ratio
        pull, disturbance_pull = SPEED_PULL_PER_S * dt_s, DISTURBANCE_PULL_PER_S2 * dt_s
        sigma_mps = self._brake_belief.speed_sigma_mps
        per_square = 1.0 / (sigma_mps * sigma_mps)
        mean, gain = self._brake.mean, 1.0 + self._motion.gain_ratio
        outputs, speeds = self._output, self._speed
        disturbances, costs = self._disturbance, self._cost
        for index, tap in enumerate(self._taps):
            mean_mps2 = mean(tap)
            before_mps2 = outputs[index]
            after_mps2 = mean_mps2 + (before_mps2 - mean_mps2) * keep_ratio
            outputs[index] = after_mps2
            braked_mps2 = (before_mps2 + after_mps2) / 2.0 * gain
            predicted_mps = speeds[index] + (push_mps2 - braked_mps2 + disturbances[index]) * dt_s
            error_mps = speed_mps - predicted_mps
            speeds[index] = predicted_mps + pull * error_mps
            disturbances[index] += disturbance_pull * error_mps
            costs[index] += error_mps * error_mps * per_square

    def _note_application(self, brake_mps2: float) -> None:
        """Brake from nothing starts the bank; long enough without brake puts it to sleep."""
        if brake_mps2 > 0.0:
            if not self._active:
                self._active = True
                self._motion.renew_gain()
                self._start_hypotheses()
            self._quiet_cycles = 0
        elif self._active:
            self._quiet_cycles += 1
            if self._quiet_cycles > self._settle_cycles:
                self._active = False
                self._brake_now.value = self.brake_mps2 = 0.0
                self._output = [0.0] * self._count
                self.dead_time_s = self._brake_belief.expected_dead_time_s

    def _start_hypotheses(self) -> None:
        """All begin alike from the motion as it is believed now."""
        count = self._count
        self._speed = [self._motion.speed_mps] * count
        self._disturbance = [self._motion.disturbance_mps2] * count
        self._cost = [0.0] * count

    def _weigh(self) -> None:
        least = min(self._cost)
        total = dead_time_s = brake_mps2 = 0.0
        for index, cost in enumerate(self._cost):
            worse = (cost - least) / 2.0
            if worse > NEVER_MATTERS:
                continue
            weight = math.exp(-worse)
            total += weight
            dead_time_s += weight * self._brake_belief.dead_times_s[index]
            brake_mps2 += weight * self._output[index]
        self.dead_time_s = dead_time_s / total
        self.brake_mps2 = brake_mps2 / total

    def ahead_of_brake(self, front_m: float, gravity_mps2: float) -> Ahead:
        """Where and how fast the train will be when a brake demand given now begins to bite.

        The traction demand of now is taken to stay until then.
        """
        horizon_s = self.dead_time_s
        single_mps, double_m = self._traction_response(horizon_s)
        if self._active:
            brake_mps, brake_m = response(
                self._brake,
                dead_time_s=horizon_s,
                lag_s=self._brake_belief.lag_s,
                output_now=self.brake_mps2,
                output_then=self._brake_now.value,
            )
            single_mps -= brake_mps * (1.0 + self.gain_ratio)
            double_m -= brake_m * (1.0 + self.gain_ratio)
        steady_mps2 = self.disturbance_mps2 - gravity_mps2
        speed_mps = self.speed_mps + single_mps + steady_mps2 * horizon_s
        travel_m = (self.speed_mps + steady_mps2 * horizon_s / 2.0) * horizon_s + double_m
        return Ahead(front_m + travel_m, max(0.0, speed_mps))

    def ahead_of_traction_mps(self, gravity_mps2: float) -> float:
        """The speed when a traction demand given now begins to act; the brake is taken to stay."""
        horizon_s = self._traction_belief.dead_time_s
        gained_mps, _ = self._traction_response(horizon_s)
        braked_mps2 = self.brake_mps2 * (1.0 + self.gain_ratio)
        steady_mps2 = self.disturbance_mps2 - gravity_mps2 - braked_mps2
        return self.speed_mps + gained_mps + steady_mps2 * horizon_s

    def _traction_response(self, horizon_s: float) -> tuple[float, float]:
        belief = self._traction_belief
        then_mps2 = self._traction_now.value
        single, double = response(
            self._traction,
            dead_time_s=belief.dead_time_s,
            lag_s=belief.lag_s,
            output_now=self._traction_late.value,
            output_then=then_mps2,
        )
        rest_s = horizon_s - belief.dead_time_s
        if rest_s <= 0.0:
            return single, double
        held_mps2 = max(0.0, self._demand_mps2)
        end_mps2 = held_mps2 + (then_mps2 - held_mps2) * math.exp(-rest_s / belief.lag_s)
        later = held_mps2 * rest_s - belief.lag_s * (end_mps2 - then_mps2)
        later_double = held_mps2 * rest_s**2 / 2.0 - belief.lag_s * (later - then_mps2 * rest_s)
        return single + later, double + single * rest_s + later_double
