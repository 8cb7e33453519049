"""Model of the moving train: its speed, and the delay of its brake.

The dead time of the brake is random for each application, so each one starts a bank of hypotheses.
What is left of the previous application keeps its own dead time. Every hypothesis has a dead time
and a filter of speed, disturbance and gain. Its cost is its prediction error of the speed, and the
costs determine the weights. When friction takes over from the motors, a second bank does the same
for the delay of friction.
"""

import math
from typing import Final

from vobc.ato.model.blending import Handover
from vobc.ato.model.model_bank import ModelBank
from vobc.ato.model.motion_filter import SURPRISE_MPS, MotionFilter
from vobc.ato.model.predictor import (
    MeanInputLag,
    Pipeline,
    PredictedState,
    Remains,
    response,
    settling,
)
from vobc.ato.settings.ato import WEAK_RATIO, BrakeBelief, TractionBelief
from vobc.vocabulary import BrakeFinding

SETTLE_LAGS: Final = 5.0
"""Number of lags after the longest dead time until a released brake counts as off."""
DECIDED_S: Final = 3.0
"""Duration of an application after which its dead time is known well enough to examine friction."""
FILTER_ORDER: Final = 3.0
FILTER_TIME_RATIO: Final = 8.0 / 3.0
"""A second-order filter with all three poles at w underestimates a speed of constant jerk J by 3 J
/ w². The error builds up within about 8 / (3 w)."""
UNUSUAL_S: Final = 1.9
UNUSUAL_COST: Final = 8.0
"""Cost that a hypothesis of a longer dead time than this starts with."""
CLEAR_MPS2: Final = 0.3
"""Estimated deceleration by the brake from which its dead time is known."""
FINDING_MPS: Final = 1.0
"""Least speed for a finding about the brake. Below it the motors hand over to friction."""
LATE_WEIGHT: Final = 0.5
"""Weight of the longest dead time from which it is the best hypothesis."""
WEAK_MOST_RATIO: Final = -0.13
"""Upper bound of the gain below which a brake is weak. The bound lies 0.04 above the estimate or
more, and estimates of usual brakes reach -0.15."""
TRACTION_INSTANT_S: Final = 0.15
"""Uncertainty of the traction delay."""
FULL_MPS2: Final = 0.8
"""Typical height of a demand ramp. Timing errors accumulate over such a ramp."""


class TrainModel:
    """State of the model.

    All quantities are per unit of mass: demands and disturbance are accelerations.
    """

    __slots__ = (
        *("_active", "_active_s", "_arrived", "_bank", "_brake", "_brake_belief", "_demand_mps2"),
        *("_dt_s", "_expected_s", "_found_s", "_handover", "_keep_ratios", "_lags_s", "_late_s"),
        *("_longest_s", "_motion", "_ours", "_output", "_prior_costs", "_quiet_cycles"),
        *("_remains", "_settle_cycles"),
        *("_taps", "_traction", "_traction_belief", "_traction_late", "_traction_now"),
        *("_traction_tap", "_trail", "_trail_ratio", "brake_mps2", "lag_s", "on_its_way_mps2"),
    )

    def __init__(
        self,
        brake: BrakeBelief,
        traction: TractionBelief,
        dt_s: float,
        *,
        weak_ratio: float = WEAK_RATIO,
    ) -> None:
        """`weak_ratio`: deviation of the gain that is assumed before it is measured, as two
        standard deviations.
        """
        count = len(brake.dead_times_s)
        self._brake_belief = brake
        self._traction_belief = traction
        self._dt_s = dt_s
        self._brake = Pipeline(dt_s, brake.dead_times_s[-1] + dt_s)
        self._traction = Pipeline(dt_s, traction.dead_time_s + dt_s)
        self._taps = tuple(self._brake.tap(dead_time_s) for dead_time_s in brake.dead_times_s)
        self._traction_tap = self._traction.tap(traction.dead_time_s)
        self._traction_now = MeanInputLag(traction.lag_s, dt_s)
        self._traction_late = MeanInputLag(traction.lag_s, dt_s)
        # A brake that acts sooner than its assumed build-up time also builds up sooner.
        self._lags_s = tuple(max(dt_s, min(brake.lag_s, each_s)) for each_s in brake.dead_times_s)
        self._keep_ratios = tuple(math.exp(-dt_s / lag_s) for lag_s in self._lags_s)
        self._settle_cycles = math.ceil((brake.dead_times_s[-1] + SETTLE_LAGS * brake.lag_s) / dt_s)
        self._demand_mps2 = 0.0
        self._motion = MotionFilter(dt_s, -weak_ratio / 2.0)
        """Weighted mean of the hypotheses, and the only filter while the brake is off."""
        self._bank = ModelBank(count, dt_s)
        self._prior_costs = tuple(
            UNUSUAL_COST if each_s > UNUSUAL_S else 0.0 for each_s in brake.dead_times_s
        )
        self._handover = Handover(brake, dt_s)
        self._output = [0.0] * count
        self._arrived = [0.0] * count
        """Output without dead time: its value when all demands under way have arrived."""
        filter_s = FILTER_TIME_RATIO / brake.speed_filter_rad_s
        self._trail_ratio = 1.0 - math.exp(-dt_s / filter_s)
        self._late_s = FILTER_ORDER / (brake.speed_filter_rad_s**2 * filter_s)
        self._trail = [0.0] * count
        """The output with the same lag as the filtered speed."""
        self._remains = Remains(dt_s)
        self._active = False
        self._active_s = 0.0
        self._ours = True
        self._quiet_cycles = 0
        self.brake_mps2 = 0.0
        """Estimated deceleration of the demands that have arrived, without the gain."""
        self.on_its_way_mps2 = 0.0
        """Value of it when all demands under way have arrived."""
        first_s = min(brake.first_dead_time_s, brake.dead_times_s[-1])
        self._expected_s = max(brake.expected_dead_time_s, first_s)
        """Dead time with which the next application is planned."""
        self._longest_s = brake.expected_dead_time_s
        """Longest dead time of an application so far."""
        self._found_s = self._expected_s
        """Dead time of the present application, or of the last one while it still acts."""
        self.lag_s = brake.lag_s

    def issue(self, demand_mps2: float) -> None:
        """Note the demand that is sent now and holds until the next cycle."""
        self._demand_mps2 = demand_mps2

    @property
    def dead_time_s(self) -> float:
        """Dead time of a demand given now. After a release the next application has another one."""
        if not self._quiet_cycles:
            return self._found_s
        return max(self._found_s, self._expected_s)

    @property
    def speed_mps(self) -> float:
        return self._motion.speed_mps

    @property
    def disturbance_mps2(self) -> float:
        """Acceleration that neither the demands nor the gradient explain."""
        return self._motion.disturbance_mps2

    @property
    def gain_ratio(self) -> float:
        """Estimated relative excess of the brake over the demand."""
        return self._motion.gain_ratio

    def gain_at(self, speed_mps: float) -> float:
        """The same at this speed, where late friction may provide a part of the braking."""
        handover, motion = self._handover, self._motion
        if not handover.late:
            return motion.gain_ratio
        share_ratio = handover.friction_ratio(speed_mps, self.on_its_way_mps2)
        return motion.gain_ratio + share_ratio * motion.friction_ratio

    @property
    def least_gain_ratio(self) -> float:
        """Lower bound of the gain, in all likelihood."""
        return self._motion.least_gain_ratio

    @property
    def most_gain_ratio(self) -> float:
        """Upper bound of the gain, in all likelihood."""
        return self._motion.most_gain_ratio

    def finding(self) -> BrakeFinding | None:
        """The brake if it is later or weaker than expected, once the application has shown that.

        The gain that is measured under a wrong dead time means nothing, so a late brake is not
        called weak.
        """
        known = self._active and self._active_s > DECIDED_S and self.brake_mps2 > CLEAR_MPS2
        if not known or self.speed_mps < FINDING_MPS:
            return None
        late = self._bank.weights[-1] > LATE_WEIGHT
        if not late and self.most_gain_ratio > WEAK_MOST_RATIO:
            return None
        return BrakeFinding(late, self._found_s, self.gain_ratio)

    @property
    def friction_may_be_late(self) -> bool:
        """Friction may be late at the next handover from the motors, or in the present one."""
        return self._handover.may_be_late

    def gap_m(self, speed_mps: float, decel_mps2: float) -> float:
        """Distance without brake that is still to come at a handover from motors to late
        friction.
        """
        return self._handover.gap_m(speed_mps, decel_mps2)

    def build_up_s(self, speed_mps: float) -> float:
        """Lag of the brake at this speed."""
        handover = self._handover
        if not handover.late:
            return self.lag_s
        air_s = min(self._brake_belief.air_lag_s, handover.air_s)
        return self.lag_s + air_s * handover.friction_ratio(speed_mps, self.on_its_way_mps2)

    @property
    def brake_asked(self) -> bool:
        return self._demand_mps2 < 0.0

    def rest(self) -> None:
        """Reset the motion of a standing train. Demands under way stay."""
        self.meet(0.0)

    def renew_disturbance(self) -> None:
        """The brake is released for the end of a stop: learn quickly what else acts."""
        self._motion.renew_disturbance()
        self._bank.renew_disturbance()
        self._handover.renew_disturbance()

    def meet(self, speed_mps: float) -> None:
        """Accept the measured speed, for example when taking over a moving train."""
        self._motion.start(speed_mps)
        if self._active and self._active_s > DECIDED_S:
            # The delay of this application stays known, even if another source has braked
            # meanwhile.
            self._handover.end()
            self._bank.begin(self._motion)
        else:
            self._start_hypotheses()

    def step(
        self, speed_mps: float, gravity_mps2: float, cycles: int, *, ours: bool = True
    ) -> None:
        """Advance to now under the previous demand, then correct towards the measured speed.

        Args:
            gravity_mps2: deceleration by gradient and running resistance.
            cycles: since the step before; more than one after an overrun.
            ours: operation's own demands move the train. Otherwise nothing is learned.
        """
        self._ours = ours
        for _ in range(cycles):
            self._advance(speed_mps, gravity_mps2)
        if not ours:
            self.meet(speed_mps)

    def _advance(self, speed_mps: float, gravity_mps2: float) -> None:
        demand_mps2 = self._demand_mps2
        brake_mps2 = -demand_mps2 if demand_mps2 < 0.0 else 0.0
        traction_mps2 = demand_mps2 if demand_mps2 > 0.0 else 0.0
        self._note_application(brake_mps2)
        self._brake.push(brake_mps2)
        self._traction.push(traction_mps2)
        self._traction_now.step(traction_mps2)
        before_mps2 = self._traction_late.value
        mean_mps2 = self._traction.mean(self._traction_tap)
        after_mps2 = self._traction_late.step(mean_mps2)
        push_mps2 = (before_mps2 + after_mps2) / 2.0 - gravity_mps2
        blur_m2_per_s2 = TRACTION_INSTANT_S**2 * abs(after_mps2 - before_mps2) * FULL_MPS2
        motion = self._motion
        if self._active:
            self._advance_banks(speed_mps, push_mps2, blur_m2_per_s2)
        else:
            self._handover.note(0.0)
            if self._ours:
                motion.step(
                    speed_mps, push_mps2=push_mps2, braked_mps2=0.0, blur_m2_per_s2=blur_m2_per_s2
                )
        if self._ours and abs(speed_mps - motion.speed_mps) > SURPRISE_MPS:
            motion.forget(speed_mps)
            self._start_hypotheses()

    def _advance_banks(self, speed_mps: float, push_mps2: float, blur_m2_per_s2: float) -> None:
        """One cycle of the brake under every active hypothesis. This is the hot loop."""
        handover, motion, bank = self._handover, self._motion, self._bank
        asked_mps2 = max(0.0, -self._demand_mps2)
        outputs, arrived, mean = self._output, self._arrived, self._brake.mean
        trail, trail_ratio, late_s = self._trail, self._trail_ratio, self._late_s
        learns = self._ours and not handover.under_way
        remains, dead_times_s = self._remains, self._brake_belief.dead_times_s
        remain_mps2, any_remains = remains.after(0.0), bool(remains)
        unit_mps2 = lag_mps = 0.0
        for index in bank.alive:
            keep_ratio = self._keep_ratios[index]
            mean_mps2 = mean(self._taps[index]) + remain_mps2
            then_mps2 = asked_mps2
            if any_remains:
                then_mps2 += remains.after(dead_times_s[index])
            arrived[index] = then_mps2 + (arrived[index] - then_mps2) * keep_ratio
            before_mps2 = outputs[index]
            after_mps2 = mean_mps2 + (before_mps2 - mean_mps2) * keep_ratio
            outputs[index] = after_mps2
            braked_mps2 = (before_mps2 + after_mps2) / 2.0
            unit_mps2 += bank.weights[index] * braked_mps2
            trail[index] += trail_ratio * (after_mps2 - trail[index])
            behind_mps = late_s * (after_mps2 - trail[index])
            lag_mps += bank.weights[index] * behind_mps
            if learns:
                bank.step(
                    index,
                    speed_mps - behind_mps,
                    push_mps2=push_mps2,
                    braked_mps2=braked_mps2,
                    friction_mps2=0.0,
                    blur_m2_per_s2=blur_m2_per_s2,
                )
        remains.step()
        self._active_s += self._dt_s
        for_friction_mps2 = unit_mps2 * handover.friction_ratio(motion.speed_mps, unit_mps2)
        handover.note(for_friction_mps2)
        if learns:
            bank.weigh()
            bank.agree(motion)
            if for_friction_mps2 > 0.0 and self._active_s > DECIDED_S:
                handover.begin(motion)
        elif self._ours:
            handover.step(
                motion,
                speed_mps - lag_mps,
                push_mps2=push_mps2,
                motors_mps2=unit_mps2 - for_friction_mps2,
                blur_m2_per_s2=blur_m2_per_s2,
            )
        self._agree()

    def _note_application(self, brake_mps2: float) -> None:
        """Start the bank at a new application. Stop it after long enough without brake."""
        if brake_mps2 > 0.0:
            if not self._active:
                self._active = True
                self._motion.renew_gain()
                self._start_hypotheses()
            elif self._quiet_cycles:
                self._begin_again()
            self._quiet_cycles = 0
        elif self._active:
            self._quiet_cycles += 1
            if self._quiet_cycles > self._settle_cycles:
                self._active = False
                self.on_its_way_mps2 = self.brake_mps2 = 0.0
                self._output = [0.0] * len(self._output)
                self._arrived = [0.0] * len(self._output)
                self._trail = [0.0] * len(self._output)
                self._remains.clear()
                self._handover.end()
                self._found_s = self._expected_s
                self.lag_s = self._brake_belief.lag_s

    def _begin_again(self) -> None:
        """Begin a new application of unknown dead time while the previous one still acts."""
        self._remains.add(self._brake.to_come(self._found_s))
        self._brake.clear()
        trail_mps2 = self._bank.mean(self._trail)
        for index, dead_time_s in enumerate(self._brake_belief.dead_times_s):
            self._output[index] = then_mps2 = self.brake_mps2
            self._trail[index] = trail_mps2
            for cycle in range(round(dead_time_s / self._dt_s)):
                mean_mps2 = self._remains.after(cycle * self._dt_s)
                then_mps2 = mean_mps2 + (then_mps2 - mean_mps2) * self._keep_ratios[index]
            self._arrived[index] = then_mps2
        self._bank.know(self._prior_costs)
        self._start_hypotheses()

    def _start_hypotheses(self) -> None:
        """Start all hypotheses from the present motion."""
        self._active_s = 0.0
        self._handover.end()
        # A discarded hypothesis has not followed the demand.
        for index in range(len(self._output)):
            if self._active and index not in self._bank.alive:
                self._output[index] = self.brake_mps2
                self._arrived[index] = self.on_its_way_mps2
                self._trail[index] = self.brake_mps2
        self._bank.know(self._prior_costs)
        self._bank.begin(self._motion)

    def _agree(self) -> None:
        bank, belief = self._bank, self._brake_belief
        self._found_s = bank.mean(belief.dead_times_s)
        self.lag_s = bank.mean(self._lags_s)
        self.brake_mps2 = bank.mean(self._output)
        if self._active_s > DECIDED_S and self.brake_mps2 > CLEAR_MPS2:
            self._expected_s = self._longest_s = max(self._longest_s, self._found_s)
        self.on_its_way_mps2 = bank.mean(self._arrived)

    def ahead_of_brake(
        self, front_m: float, gravity_mps2: float, *, later_s: float = 0.0
    ) -> PredictedState:
        """Predicted state when a brake demand given now begins to act.

        The present demand is assumed to last until then.

        Args:
            later_s: time after that for which the state is predicted.
        """
        horizon_s = self.dead_time_s + later_s
        steady_mps2 = self.disturbance_mps2 - gravity_mps2
        if self._active and self._handover.late:
            return self._ahead_of_friction(front_m, steady_mps2)
        single_mps, double_m = self._traction_response(horizon_s)
        if self._active:
            brake_mps, brake_m = self._brake_response(horizon_s)
            single_mps -= brake_mps * (1.0 + self.gain_ratio)
            double_m -= brake_m * (1.0 + self.gain_ratio)
        speed_mps = self.speed_mps + single_mps + steady_mps2 * horizon_s
        travel_m = (self.speed_mps + steady_mps2 * horizon_s / 2.0) * horizon_s + double_m
        return PredictedState(front_m + travel_m, max(0.0, speed_mps))

    def _ahead_of_friction(self, front_m: float, steady_mps2: float) -> PredictedState:
        """Prediction step by step, because the speed decides whether motors or friction brake.

        Traction is assumed to be off.
        """
        horizon_s = self.dead_time_s
        cycles = math.ceil((horizon_s + self._handover.air_s) / self._dt_s) + 1
        units_mps2 = self._units_mps2(cycles)
        travel_m, speed_mps = self._handover.walk(
            self._motion, units_mps2, steady_mps2=steady_mps2, reach_s=horizon_s
        )
        return PredictedState(front_m + travel_m, speed_mps)

    def _units_mps2(self, cycles: int) -> list[float]:
        """Mean output of the brake unit in each coming cycle. The present demand stays."""
        dt_s = self._dt_s
        keep_ratio = math.exp(-dt_s / self.lag_s)
        unit_mps2, asked_mps2 = self.brake_mps2, max(0.0, -self._demand_mps2)
        units_mps2: list[float] = []
        for cycle in range(cycles):
            age_s = self._found_s - (cycle + 1) * dt_s
            mean_mps2 = asked_mps2
            if age_s >= 0.0:
                mean_mps2 = self._brake.mean(self._brake.tap(age_s))
            mean_mps2 += self._remains.after(cycle * dt_s)
            after_mps2 = mean_mps2 + (unit_mps2 - mean_mps2) * keep_ratio
            units_mps2.append((unit_mps2 + after_mps2) / 2.0)
            unit_mps2 = after_mps2
        return units_mps2

    def ahead_of_traction(
        self, front_m: float, gravity_mps2: float
    ) -> tuple[PredictedState, float]:
        """Predicted state when a traction demand given now begins to act.

        The second result is the deceleration by the brake that is left when that demand has built
        up.
        """
        belief, dt_s = self._traction_belief, self._dt_s
        horizon_s = belief.dead_time_s
        steady_mps2 = self.disturbance_mps2 - gravity_mps2
        gained_mps, travel_m = self._traction_response(horizon_s)
        speed_mps = self.speed_mps + gained_mps + steady_mps2 * horizon_s
        travel_m += (self.speed_mps + steady_mps2 * horizon_s / 2.0) * horizon_s
        left_mps2 = 0.0
        if self._active:
            gain = 1.0 + self.gain_at(self.speed_mps)
            cycles = max(1, math.ceil((horizon_s + belief.lag_s) / dt_s))
            units_mps2 = self._units_mps2(cycles)
            left_mps2 = gain * units_mps2[-1]
            for cycle, unit_mps2 in enumerate(units_mps2):
                left_s = horizon_s - cycle * dt_s
                if left_s <= 0.0:
                    break
                share_s = min(dt_s, left_s)
                speed_mps -= gain * unit_mps2 * share_s
                travel_m -= gain * unit_mps2 * share_s * (left_s - share_s / 2.0)
        return PredictedState(front_m + travel_m, max(0.0, speed_mps)), left_mps2

    def ahead_of_traction_mps(self, gravity_mps2: float) -> float:
        """Speed when a traction demand given now begins to act. The brake is assumed to stay."""
        horizon_s = self._traction_belief.dead_time_s
        gained_mps, _ = self._traction_response(horizon_s)
        braked_mps2 = self.brake_mps2 * (1.0 + self.gain_at(self.speed_mps))
        steady_mps2 = self.disturbance_mps2 - gravity_mps2 - braked_mps2
        return self.speed_mps + gained_mps + steady_mps2 * horizon_s

    def _brake_response(self, horizon_s: float) -> tuple[float, float]:
        """Single and double integral of the deceleration until then."""
        single, double = response(
            self._brake,
            dead_time_s=self._found_s,
            lag_s=self.lag_s,
            output_now=self.brake_mps2,
            output_then=self.on_its_way_mps2,
            remains=self._remains,
        )
        rest_s = horizon_s - self._found_s
        if rest_s <= 0.0:
            return single, double
        then_mps2 = self.on_its_way_mps2
        later, later_double = settling(
            rest_s, lag_s=self.lag_s, output_now=then_mps2, asked=max(0.0, -self._demand_mps2)
        )
        return single + later, double + single * rest_s + later_double

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
        later, later_double = settling(
            rest_s, lag_s=belief.lag_s, output_now=then_mps2, asked=held_mps2
        )
        return single + later, double + single * rest_s + later_double
