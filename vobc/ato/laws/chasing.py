"""Control by chasing time ([Wu 2022]): the gentlest notch that still reaches the curve in time.

State and reference are predicted over the brake's dead time and lag. While the train brakes, a bank
of hypotheses identifies the dead time and the gain of the brake, but not below blending if friction
is late there. Each notch brakes by its level and the gradient. The law takes a notch by the time in
which it closes the gap to the curve. Two additions of the paper can be switched off: early braking,
and a small brake through blending.
"""

from dataclasses import replace
from typing import Final

from firmware_py.trackdb import LineMap
from vobc import vocabulary
from vobc.ato.laws import catch_time, notch_choice
from vobc.ato.laws.chasing_states import Chase, ChasingState, next_state
from vobc.ato.laws.law import Drive, Target
from vobc.ato.laws.notch_choice import NotchTarget
from vobc.ato.laws.notch_ending import StopEnding, chase_from_mps, last_notch_mps2
from vobc.ato.model.ceiling_forecast import CeilingOutlook, SmoothFront
from vobc.ato.model.predictor import PredictedState
from vobc.ato.model.train_model import TrainModel
from vobc.ato.motion import gradient, profile, trapezoid
from vobc.ato.motion.step_curve import StepCurve
from vobc.ato.settings.ato import AtoConfig, within_notches

LEAST_SPEED_MPS: Final = 0.3
"""Speed below which the conversion of a gap in metres into one in speed no longer grows."""
COAST_KEPT_S: Final = 2.0
"""Additional coasting time to the curve from which a coasting train applies traction again."""
REJOIN_M: Final = 1.0
"""Least spare distance at which a braking to a stop is abandoned."""
LOOK_AHEAD_RATIO: Final = 1.3
"""Range of the search for lower limits, relative to the braking distance."""
JOIN_MAX_S: Final = 2.5
"""Greatest time that a notch taken early is held before the normal rule applies."""
AT_TARGET_MPS: Final = 0.1

Curve = profile.ReferenceBrakingCurve | StepCurve


class Chasing:
    __slots__ = (
        "_ceiling",
        "_chase",
        "_config",
        "_curve",
        "_demand_mps2",
        "_dt_s",
        "_ending",
        "_front",
        "_gravity_mps2",
        "_joining_s",
        "_limits",
        "_line",
        "_model",
        "_planned_for",
        "_rejoin_m",
        "_since_s",
        "_slowing_to",
        "_stopping",
        "notch_mps2",
        "speed_mps",
        "state",
    )

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        config = within_notches(config)
        scheme = config.chasing
        self._config = config
        self._line = line
        self._dt_s = dt_s
        self._model = self._make_model(config, dt_s)
        self._limits = profile.SpeedLimits(config, line)
        self._curve: Curve = StepCurve((scheme.decel_mps2,), ())
        self._ending = StopEnding(config)
        self._planned_for: Target | None = None
        self._rejoin_m = REJOIN_M
        self._front = SmoothFront()
        self._ceiling = CeilingOutlook()
        self._chase = Chase()
        self._gravity_mps2 = 0.0
        self._demand_mps2 = 0.0
        self._stopping = False
        self._slowing_to = -1
        self._since_s = 0.0
        self._joining_s = 0.0
        self.state = ChasingState.COAST
        self.notch_mps2 = 0.0
        """The present notch as a demand. The demand reaches it at the jerk limit."""
        self.speed_mps = 0.0

    @staticmethod
    def _make_model(config: AtoConfig, dt_s: float) -> TrainModel:
        scheme, brake = config.chasing, config.brake
        expected_s = min(max(scheme.dead_time_s, brake.dead_times_s[0]), brake.dead_times_s[-1])
        # Late friction has settings of its own in this law.
        brake = replace(
            brake,
            expected_dead_time_s=expected_s,
            first_dead_time_s=expected_s,
            lag_s=scheme.lag_s,
            air_delays_s=(0.0,),
        )
        return TrainModel(brake, config.traction, dt_s, weak_ratio=config.braking.weak_ratio)

    @property
    def brake_dead_time_s(self) -> float:
        """Dead time identified in the present application, or the expected one before."""
        return self._model.dead_time_s

    def observe(self, inputs: vocabulary.AtoInput, cycles: int) -> None:
        self._gravity_mps2 = gradient.decel_on_mps2(self._config, inputs.gradient_permille)
        scheme = self._config.chasing
        # Friction that is late at the handover from the motors would pass for a weak brake.
        handover = scheme.air_delay_s > 0.0 and inputs.speed_mps <= scheme.blending_begin_mps
        ours = inputs.enabled and not inputs.protection_brakes and not handover
        self._model.step(
            inputs.speed_mps,
            self._gravity_mps2 + scheme.rolling_mps2,
            cycles,
            ours=ours,
        )
        self.speed_mps = self._model.speed_mps
        dt_s = self._dt_s * cycles
        self._since_s += dt_s
        self._joining_s = max(0.0, self._joining_s - dt_s)
        self._front.step(
            inputs.front_m, moved_m=self.speed_mps * dt_s, at_tag=bool(inputs.accepted_tag_ids)
        )
        self._ceiling.step(inputs.ceiling_mps, dt_s)

    def rest(self) -> None:
        self._model.rest()
        self.speed_mps = 0.0

    def set_off(self, inputs: vocabulary.AtoInput, demand_mps2: float) -> None:
        self._model.meet(inputs.speed_mps)
        self.state = ChasingState.BRAKE if demand_mps2 < 0.0 else ChasingState.COAST
        self._stopping = False
        self._slowing_to = -1
        self._planned_for = None
        self._joining_s = 0.0
        self._ending.reset()
        self._take(0.0)

    def issued(self, demand_mps2: float) -> None:
        self._demand_mps2 = demand_mps2
        self._model.issue(demand_mps2)

    def drive(self, inputs: vocabulary.AtoInput, target: Target) -> Drive:
        self._plan(target)
        ahead = self._ahead()
        stop = self._aim(self._curve, ahead, target.at_m, to_stop=target.at_station)
        slowing = self._slowing(ahead)
        free = self._free(ahead)
        self._look(ahead, target, stop, slowing, free)
        before, self.state = self.state, next_state(self.state, self._chase)
        aim = self._binding(stop, slowing, free)
        if self.state is ChasingState.BRAKE:
            if before is not ChasingState.BRAKE:
                self._begin_braking(aim, ahead)
            self._brake_on(inputs, ahead, target, aim)
        elif self.state is ChasingState.COAST:
            self._take(0.0)
        else:
            self._pull(inputs, free)
        reference_mps = self._reference_mps(target.at_m, slowing, free, ahead)
        return Drive(self.notch_mps2, reference_mps, self._stopping)

    # Prediction and references.

    def _ahead(self) -> PredictedState:
        """S_cur and v_cur when a brake demand given now acts (equation 3).

        The paper has S + v * t - b * t**2 / 2 with b the mean of the demands under way. Here the
        integrals are exact, and the gain of the brake is the identified one.
        """
        scheme = self._config.chasing
        later_s = scheme.lag_s
        if self._stopping and self.speed_mps <= scheme.blending_begin_mps:
            later_s += scheme.air_delay_s
        gravity_mps2 = self._gravity_mps2 + scheme.rolling_mps2
        return self._model.ahead_of_brake(self._front.front_m, gravity_mps2, later_s=later_s)

    @property
    def _brake_ratio(self) -> float:
        """Identified deceleration by the brake, relative to the demand."""
        return 1.0 + self._model.gain_ratio

    def _plan(self, target: Target) -> None:
        if target == self._planned_for:
            return
        config, scheme = self._config, self._config.chasing
        self._planned_for = target
        if not target.at_station:
            self._curve = profile.curve_to_authority(config, self._line, target.at_m)
            self._rejoin_m = config.station.least_run_m
            return
        self._rejoin_m = REJOIN_M
        gravity_mps2 = gradient.decel_at_mps2(config, self._line, target.at_m)
        steady_mps2 = profile.steady_decel_mps2(config, self._line, target.at_m)
        steady_mps2 = min(scheme.decel_mps2, steady_mps2)
        last_mps2 = last_notch_mps2(config, gravity_mps2) + gravity_mps2 + scheme.rolling_mps2
        chase_mps2 = max(scheme.chase_decel_mps2, last_mps2)
        small_mps2 = max(scheme.small_decel_mps2, chase_mps2)
        steady_mps2 = max(steady_mps2, small_mps2)
        if scheme.small_brake:
            decels_mps2 = (last_mps2, chase_mps2, small_mps2, steady_mps2)
            begin_mps = scheme.blending_begin_mps * (1.0 + scheme.blending_spread_ratio)
            tops_mps = (scheme.last_speed_mps, chase_from_mps(scheme), begin_mps)
            self._curve = StepCurve(decels_mps2, tops_mps)
        else:
            two_mps2, reserve_m = (last_mps2, steady_mps2), scheme.blending_reserve_m
            self._curve = StepCurve(two_mps2, (scheme.last_speed_mps,), reserve_m)
        self._ending.plan(self._curve, gravity_mps2)

    def _aim(
        self, curve: Curve, ahead: PredictedState, end_m: float, *, to_stop: bool
    ) -> NotchTarget:
        """Gap to a curve, linearised about the train's own speed: dv = spare * b / v."""
        point = curve.at_speed(ahead.speed_mps)
        spare_m = end_m - ahead.front_m - point.distance_m
        error_mps = -spare_m * point.decel_mps2 / max(LEAST_SPEED_MPS, ahead.speed_mps)
        run_s = catch_time.run_time_s(
            end_m - ahead.front_m, speed_mps=ahead.speed_mps, target_mps=curve.end_mps
        )
        within_s = self._config.chasing.chase_ratio * run_s
        return NotchTarget(error_mps, point.decel_mps2, within_s, spare_m, to_stop)

    def _free(self, ahead: PredictedState) -> NotchTarget:
        """The highest speed within limits and ceiling, as a reference of its own."""
        scheme = self._config.chasing
        horizon_s = self._model.dead_time_s + scheme.lag_s
        ceiling_mps = self._ceiling.in_mps(horizon_s)
        fall_mps2 = max(0.0, ceiling_mps - self._ceiling.in_mps(horizon_s + 1.0))
        limit_mps = self._limits.under_train_mps(self._front.front_m)
        top_mps = min(limit_mps, ceiling_mps) - self._config.speed.margin_mps
        if limit_mps <= ceiling_mps:
            fall_mps2 = 0.0
        error_mps = ahead.speed_mps - max(0.0, top_mps)
        return NotchTarget(error_mps, fall_mps2, scheme.cruise_chase_s, 0.0)

    def _slowing(self, ahead: PredictedState) -> tuple[NotchTarget, float, Curve] | None:
        """The lower limit ahead that is braked for, or the most demanding one ahead.

        None: there is none.
        """
        front_m = self._front.front_m
        index = self._limits.next_lowering(front_m)
        if self._slowing_to >= 0 and index > self._slowing_to:
            self._slowing_to = -1
        reach_m = LOOK_AHEAD_RATIO * ahead.speed_mps * (ahead.speed_mps + 4.0)
        best: tuple[NotchTarget, float, Curve] | None = None
        lowering = self._limits.lowering(index)
        while lowering is not None and lowering.at_m - front_m < reach_m:
            if ahead.speed_mps > lowering.curve.end_mps:
                aim = self._aim(lowering.curve, ahead, lowering.at_m, to_stop=False)
                if best is None or aim.error_mps > best[0].error_mps:
                    best = aim, lowering.at_m, lowering.curve
                if self._is_reached(aim, ahead):
                    self._slowing_to = max(index, self._slowing_to)
            index += 1
            lowering = self._limits.lowering(index)
        if best is None:
            self._slowing_to = -1
        return best

    def _is_reached(self, aim: NotchTarget, ahead: PredictedState) -> bool:
        scheme = self._config.chasing
        early_s = scheme.early_s if scheme.early_transition else 0.0
        return aim.spare_m <= ahead.speed_mps * early_s

    def _is_near(self, curve: Curve, ahead: PredictedState, end_m: float) -> bool:
        """Whether ending traction now leaves just the planned coasting time."""
        scheme = self._config.chasing
        after_mps, travel_m = trapezoid.swing(
            ahead.speed_mps,
            from_mps2=max(0.0, self._demand_mps2),
            to_mps2=0.0,
            jerk_mps3=self._config.limits.jerk_mps3,
        )
        spare_m = end_m - ahead.front_m - travel_m - curve.at_speed(after_mps).distance_m
        coast_s = scheme.coast_s + (scheme.early_s if scheme.early_transition else 0.0)
        if self.state is ChasingState.COAST:
            coast_s += COAST_KEPT_S
        return spare_m <= after_mps * coast_s

    def _look(
        self,
        ahead: PredictedState,
        target: Target,
        stop: NotchTarget,
        slowing: tuple[NotchTarget, float, Curve] | None,
        free: NotchTarget,
    ) -> None:
        """Update the inputs of the state guards."""
        scheme, chase = self._config.chasing, self._chase
        if not self._stopping:
            self._stopping = self._is_reached(stop, ahead)
        elif stop.error_mps < -scheme.resume_band_mps and stop.spare_m > self._rejoin_m:
            self._stopping = False
            self._ending.reset()
        chase.on_curve = self._stopping or self._slowing_to >= 0
        chase.near_curve = self._is_near(self._curve, ahead, target.at_m) or (
            slowing is not None and self._is_near(slowing[2], ahead, slowing[1])
        )
        chase.too_fast = free.error_mps > scheme.cruise_band_mps
        chase.at_target = free.error_mps > -AT_TARGET_MPS
        chase.too_slow = free.error_mps < -scheme.cruise_band_mps
        chase.braked = free.error_mps <= 0.0

    def _binding(
        self, stop: NotchTarget, slowing: tuple[NotchTarget, float, Curve] | None, free: NotchTarget
    ) -> NotchTarget:
        """The reference that the train exceeds most, among those that it brakes for."""
        aims = [free] if self._chase.too_fast or not self._chase.on_curve else []
        if slowing is not None and self._slowing_to >= 0:
            aims.append(slowing[0])
        if self._stopping:
            aims.append(stop)
        return max(aims or [free], key=lambda aim: aim.error_mps)

    # Notches.

    def _take(self, notch_mps2: float) -> None:
        if notch_mps2 != self.notch_mps2:
            self.notch_mps2 = notch_mps2
            self._since_s = 0.0

    def _resistance_mps2(self, front_m: float) -> float:
        gravity_mps2 = gradient.decel_at_mps2(self._config, self._line, front_m)
        return gravity_mps2 + self._config.chasing.rolling_mps2 - self._model.disturbance_mps2

    def _begin_braking(self, aim: NotchTarget, ahead: PredictedState) -> None:
        """Before the curve, take the notch nearest to its deceleration. It builds up meanwhile."""
        if aim.error_mps >= 0.0 or not self._chase.on_curve:
            return
        wanted_mps2 = aim.decel_mps2 - self._resistance_mps2(ahead.front_m)
        levels_mps2 = self._config.output.brake_levels_mps2
        wanted_mps2 /= self._brake_ratio
        level_mps2 = min(levels_mps2, key=lambda one_mps2: abs(one_mps2 - wanted_mps2))
        self._take(-level_mps2)
        self._joining_s = JOIN_MAX_S

    def _brake_on(
        self, inputs: vocabulary.AtoInput, ahead: PredictedState, target: Target, aim: NotchTarget
    ) -> None:
        scheme = self._config.chasing
        if self._joining_s > 0.0 and aim.error_mps < -scheme.quiet_band_mps:
            return
        self._joining_s = 0.0
        rested = self._since_s >= scheme.dwell_s
        if aim.to_stop:
            notch_mps2 = self._ending.notch_mps2(
                ahead,
                target.at_m - ahead.front_m,
                measured_mps=inputs.speed_mps,
                now_mps2=self.notch_mps2,
                rested=rested,
                brake_ratio=self._brake_ratio,
                drift_mps2=self._model.disturbance_mps2,
            )
            if notch_mps2 is not None:
                self._take(notch_mps2)
                return
        if rested:
            self._take(self._chosen_brake_mps2(ahead, aim))

    def _chosen_brake_mps2(self, ahead: PredictedState, aim: NotchTarget) -> float:
        """Notch by the rule with its hysteresis.

        If none fits and the train is too fast, the strongest.
        """
        resistance_mps2 = self._resistance_mps2(ahead.front_m)
        levels_mps2 = [-level_mps2 for level_mps2 in self._config.output.brake_levels_mps2]
        if not (aim.to_stop and self.notch_mps2 < 0.0):
            # A released brake answers with a new delay, so the least notch stays on before a stop.
            levels_mps2.insert(0, 0.0)
        return self._pick(aim, levels_mps2, resistance_mps2)

    def _pick(self, aim: NotchTarget, levels_mps2: list[float], resistance_mps2: float) -> float:
        scheme, now_mps2 = self._config.chasing, self.notch_mps2
        return notch_choice.picked(
            scheme, aim, now_mps2, levels_mps2, resistance_mps2, self._brake_ratio
        )

    def _pull(self, inputs: vocabulary.AtoInput, free: NotchTarget) -> None:
        """Traction and cruising: the same rule towards a constant speed, without the brake."""
        config = self._config
        if self._since_s < config.chasing.dwell_s:
            return
        available_mps2 = min(
            config.limits.accel_mps2, config.traction.rated_accel_mps2 * inputs.traction_ratio
        )
        levels_mps2 = [
            level_mps2
            for level_mps2 in reversed(config.output.traction_levels_mps2)
            if level_mps2 <= available_mps2
        ]
        levels_mps2.append(0.0)
        resistance_mps2 = self._gravity_mps2 + config.chasing.rolling_mps2
        resistance_mps2 -= self._model.disturbance_mps2
        self._take(self._pick(free, levels_mps2, resistance_mps2))

    def _reference_mps(
        self,
        end_m: float,
        slowing: tuple[NotchTarget, float, Curve] | None,
        free: NotchTarget,
        ahead: PredictedState,
    ) -> float:
        """Reference speed at the present front: a curve's while braking for it, otherwise the
        highest.
        """
        reference_mps = max(0.0, ahead.speed_mps - free.error_mps)
        if slowing is not None:
            reference_mps = min(reference_mps, self._curve_mps(slowing[2], slowing[1]))
        return min(reference_mps, self._curve_mps(self._curve, end_m))

    def _curve_mps(self, curve: Curve, end_m: float) -> float:
        room_m = end_m - self._front.front_m
        if isinstance(curve, StepCurve):
            return curve.speed_at_mps(room_m)
        speed_mps = max(LEAST_SPEED_MPS, self.speed_mps)
        point = curve.at_speed(speed_mps)
        return max(0.0, speed_mps + (room_m - point.distance_m) * point.decel_mps2 / speed_mps)
