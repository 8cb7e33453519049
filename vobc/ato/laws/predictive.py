"""Predictive law: it identifies brake and train while driving, predicts, and replans in each cycle.

The jerk-limited reference and the PIDs are as in [Allotta 2013]. They act on the speed predicted
past dead time and lag, with the reference acceleration fed forward. From the start of braking to
the stop one brake application follows one curve. The law replans this curve to the stopping point
in each cycle.
"""

import math
from typing import Final

from firmware_py.trackdb import LineMap
from vobc import vocabulary
from vobc.ato.laws.law import Drive, Target
from vobc.ato.model.adhesion import AdhesionEstimate
from vobc.ato.model.ceiling_forecast import CeilingOutlook, SmoothFront
from vobc.ato.model.predictor import PredictedState
from vobc.ato.model.train_model import TrainModel
from vobc.ato.motion import gradient, profile, trapezoid
from vobc.ato.motion.pid import Pid
from vobc.ato.motion.rate_limiter import RateLimiter
from vobc.ato.settings.ato import AtoConfig
from vobc.ato.settings.pid import PidGains

LEAST_SPEED_MPS: Final = 0.05
LEAST_TIME_TO_GO_S: Final = 0.8
"""Bounds below which the correction towards the stopping point no longer grows. The rest is open
loop anyway."""
LEAST_SHARE: Final = 0.2
MOST_SHARE: Final = 2.5
"""Bounds of the corrected deceleration, relative to the curve's."""
STEADY_FROM_MPS: Final = 0.1
LEAST_LEFT_M: Final = 0.02
"""Bounds of speed and distance below which a correction would only be felt."""
FAULTY_GAIN_RATIO: Final = -0.28
"""Estimated gain below which the brake counts as faulty and not as weak. The estimate ends at -0.3.
"""
SLOW_MPS: Final = 1.0
"""Approximate speed at which motors hand over to friction."""
REJOIN_M: Final = 1.0
"""Spare distance above which a train too slow to reach the stopping point accelerates again."""
CHANGE_OVER_S: Final = 0.3
"""Planned time between the end of traction and the start of braking."""
HOLD_BACK_MPS: Final = 0.5
"""Greatest lead of the reference over a train that cannot follow."""
OVER_CEILING_PER_S: Final = 0.8
"""Deceleration for each m/s above the ceiling expected when the brake acts."""
FLAT_MPS2: Final = 0.02
"""Reference acceleration below which the speed counts as constant."""
KEPT_ON_S: Final = 3.0
"""A brake application that ends this shortly before the stop is held until the stop."""
RELEASE_LAGS: Final = 2.0
"""Number of lags after the longest dead time until a brake released by another source is off."""
BRAKE_AGAIN_MPS2: Final = 0.12
"""Deceleration that is lacking at the end of an uphill stop, from which the brake is applied again.
"""
PULL_CORRECTION_RATIO: Final = 4.0
"""Gain of the correction by traction. It acts sooner than the brake, so it may correct later."""
PULL_LEAD_S: Final = 0.05
"""Time by which traction leads its lag, for the cycle that passes before it acts."""
PULL_REST_MPS: Final = 0.03
"""Speed from which the deceleration goes to zero with the speed."""
PULL_GENTLY_MPS: Final = 0.25
MOST_GENTLE_SHARE: Final = 1.1
"""Speed below which a late train no longer decelerates more than this, relative to the curve. A
stronger end would be felt as a jolt, and gains a centimetre or two."""
LOOK_AHEAD_RATIO: Final = 1.3
"""Range of the search for lower limits, relative to the braking distance."""


class Predictive:
    __slots__ = (
        "_braking",
        "_by_notches",
        "_ceiling",
        "_config",
        "_curve",
        "_demand_mps2",
        "_dt_s",
        "_faulty",
        "_front",
        "_governor",
        "_gravity_mps2",
        "_limits",
        "_line",
        "_manner",
        "_model",
        "_peak_mps",
        "_pid",
        "_planned_for",
        "_pulls",
        "_rail",
        "_rejoin_m",
        "_release_s",
        "_released_s",
        "_slowing_to",
        "_wanted_mps2",
        "most_mps",
        "speed_mps",
    )

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        self._config = config
        self._line = line
        self._dt_s = dt_s
        weak_ratio = config.braking.weak_ratio
        self._model = TrainModel(config.brake, config.traction, dt_s, weak_ratio=weak_ratio)
        self._governor = RateLimiter(config.traction.jerk_mps3, config.traction.smoothing_s, dt_s)
        self._pid = Pid()
        self._rail = AdhesionEstimate(config, line)
        self._manner = self._rail.manner
        self._limits = self._manner.limits
        self._demand_mps2 = 0.0
        self._by_notches = config.output.stage == "notches"
        self._faulty = False
        """Since the departure the brake was found faulty."""
        self._wanted_mps2: float | None = None
        """Brake demand of the cycle before. None: the train did not brake."""
        self._curve = profile.curve_to_stop(config, line, line.end_m)
        self._planned_for: tuple[Target, float, bool] | None = None
        self._peak_mps = 0.0
        self._rejoin_m = REJOIN_M
        self._braking = False
        self._pulls = False
        """Gravity alone brakes at the end of an uphill stop, and traction takes from it."""
        self._slowing_to = -1
        self._front = SmoothFront()
        self._ceiling = CeilingOutlook()
        self._gravity_mps2 = 0.0
        brake = config.brake
        self._release_s = brake.dead_times_s[-1] + RELEASE_LAGS * brake.lag_s
        """How long the ATP brake keeps acting after its release."""
        self._released_s = math.inf
        self.most_mps = math.inf
        """Target speed of a law above this one. Cruising does not exceed it."""
        self.speed_mps = 0.0

    @property
    def brake_dead_time_s(self) -> float:
        """Dead time identified in the present application, or the expected one before."""
        return self._model.dead_time_s

    def observe(self, inputs: vocabulary.AtoInput, cycles: int) -> None:
        self._gravity_mps2 = gradient.decel_on_mps2(self._config, inputs.gradient_permille)
        self._gravity_mps2 += gradient.resistance_mps2(self._config, self._model.speed_mps)
        # If another source brakes, the speed says nothing about this law's demands, and a slip says
        # little about the rail. Wheels that slide under this law's brake make it weaker, and the
        # model learns that.
        self._released_s += self._dt_s * cycles
        if inputs.protection_brakes and inputs.speed_mps > SLOW_MPS:
            self._released_s = 0.0
        released = not inputs.protection_brakes and self._released_s >= self._release_s
        ours = inputs.enabled and released
        self._rail.observe(inputs.now_ns, slips=inputs.slips and ours)
        self._model.step(inputs.speed_mps, self._gravity_mps2, cycles, ours=ours)
        self._faulty = self._faulty or self._model.gain_ratio < FAULTY_GAIN_RATIO
        before_mps, self.speed_mps = self.speed_mps, self._model.speed_mps
        dt_s = self._dt_s * cycles
        moved_m = (before_mps + self.speed_mps) / 2.0 * dt_s
        self._front.step(inputs.front_m, moved_m=moved_m, at_tag=bool(inputs.accepted_tag_ids))
        self._ceiling.step(inputs.ceiling_mps, dt_s)

    def rest(self) -> None:
        self._model.rest()
        self.speed_mps = 0.0

    def set_off(self, inputs: vocabulary.AtoInput, demand_mps2: float) -> None:
        self._braking = self._pulls = self._faulty = False
        self._slowing_to = -1
        self._planned_for = None
        self._model.meet(inputs.speed_mps)
        self._resume_cruise(demand_mps2)

    def issued(self, demand_mps2: float) -> None:
        self._demand_mps2 = demand_mps2
        self._model.issue(demand_mps2)

    def drive(self, inputs: vocabulary.AtoInput, target: Target) -> Drive:
        target_m = target.at_m
        if not self._braking and self._slowing_to < 0:
            self._manner = self._rail.manner
            self._limits = self._manner.limits
        limit_mps = self._limits.under_train_mps(self._front.front_m)
        self._plan(self._front.front_m, target, limit_mps)
        ahead = self._model.ahead_of_brake(self._front.front_m, self._gravity_mps2)
        ceiling_mps = self._ceiling.in_mps(self._model.dead_time_s)
        if self._pulls and self._braking:
            return self._pull_to_stop(ahead, target)
        self._note_stop_braking(ahead, target_m)
        slowing = self._note_slowing(ahead, self._front.front_m)
        if not self._braking and slowing is None:
            margin_mps = self._config.speed.margin_mps
            top_mps = min(limit_mps, ceiling_mps) - margin_mps
            self._wanted_mps2 = None
            target_mps = max(0.0, min(top_mps, self._peak_mps, self.most_mps))
            return self._kept_on(self._cruise(inputs, target_mps), ahead, target_m)
        decel_mps2 = self._braking_decel_mps2(ahead, target_m, slowing)
        over_mps = ahead.speed_mps - ceiling_mps
        if over_mps > 0.0:
            decel_mps2 += OVER_CEILING_PER_S * over_mps
        demand_mps2 = self._brake_demand_mps2(decel_mps2, ahead, target)
        if demand_mps2 == 0.0 and not self._pulls:
            self._model.renew_disturbance()
        self._pulls = demand_mps2 == 0.0
        # The ramp starts from the demand last sent, so that the brake comes on as gently as
        # planned.
        onset_mps2 = self._config.braking.onset_jerk_mps3 * inputs.dt_s
        demand_mps2 = max(demand_mps2, self._onset_from_mps2() - onset_mps2)
        self._wanted_mps2 = demand_mps2
        reference_mps = self._reference_mps(self._front.front_m, target_m, slowing)
        return Drive(
            demand_mps2,
            reference_mps,
            self._braking,
            weak_mps2=self._weak_mps2(),
            brake_finding=self._finding(),
        )

    def _finding(self) -> vocabulary.BrakeFinding | None:
        """Late or weak brake. On a slippery rail the wheels may slide, which makes it seem weak."""
        if not self._braking or self._rail.slippery:
            return None
        return self._model.finding()

    def _weak_mps2(self) -> float:
        """Brake demand beyond the comfort limit that a weak brake needs to reach this limit.

        On a slippery rail a higher demand would only let the wheels slide. A brake that gave next
        to nothing is faulty. It may act again at any time, and then strongly.
        """
        if self._rail.slippery or self._faulty:
            return 0.0
        gain_ratio = min(0.0, self._model.most_gain_ratio)
        return self._config.limits.accel_mps2 * (1.0 / (1.0 + gain_ratio) - 1.0)

    def _onset_from_mps2(self) -> float:
        """Start of the ramp.

        With notches it is the wanted demand, as the demand sent would never reach a notch.
        """
        if not self._by_notches or self._wanted_mps2 is None:
            return self._demand_mps2
        return min(self._demand_mps2, self._wanted_mps2)

    def _reference_mps(
        self, front_m: float, target_m: float, slowing: profile.LowerLimit | None
    ) -> float:
        """Speed of the curve here, linearised about the present speed: dv = e * b / v.

        Before the brake acts, the curve is above any permitted speed.
        """
        curve, end_m = self._curve, target_m
        if not self._braking and slowing is not None:
            curve, end_m = slowing.curve, slowing.at_m
        speed_mps = max(LEAST_SPEED_MPS, self.speed_mps)
        point = curve.at_speed(speed_mps)
        spare_m = end_m - front_m - point.distance_m
        curve_mps = speed_mps + spare_m * point.decel_mps2 / speed_mps
        return max(0.0, min(self._peak_mps, curve_mps))

    # Planning.

    def curve_to(self, target: Target) -> profile.ReferenceBrakingCurve:
        """Braking curve of this train on this rail to a target."""
        config, line = self._manner.config, self._line
        if not target.at_station:
            gain_ratio = self._model.least_gain_ratio
            return profile.curve_to_authority(config, line, target.at_m, gain_ratio=gain_ratio)
        return profile.curve_to_stop(
            config,
            line,
            target.at_m,
            gain_ratio=self._model.least_gain_ratio,
            late_friction=self._model.friction_may_be_late,
        )

    def _plan(self, front_m: float, target: Target, limit_mps: float) -> None:
        """Plan the curve to a target and the peak speed before it when target or limit change."""
        manner = self._manner
        key = (target, limit_mps, self._rail.slippery)
        if key == self._planned_for:
            return
        config = manner.config
        self._planned_for = key
        self._curve = self.curve_to(target)
        # A tag near the end of authority may give some metres back. The train creeps through them.
        self._rejoin_m = REJOIN_M if target.at_station else config.station.least_run_m
        self._peak_mps = profile.peak_speed_mps(
            max(0.0, self.speed_mps),
            target.at_m - front_m,
            self._curve,
            accel_mps2=manner.accel_mps2,
            jerk_mps3=config.limits.jerk_mps3,
            change_over_s=CHANGE_OVER_S + config.traction.smoothing_s,
            limit_mps=limit_mps,
        )

    # Braking.

    def _note_stop_braking(self, ahead: PredictedState, target_m: float) -> None:
        distance_m = target_m - ahead.front_m - self._gap_m(self._curve, ahead, target_m)
        if not self._braking:
            self._braking = self._must_begin(self._curve, ahead, distance_m)
            return
        point = self._curve.at_speed(ahead.speed_mps)
        spare_m = distance_m - point.distance_m
        correction_m = self._config.braking.correction_ratio * spare_m
        if spare_m > self._rejoin_m and correction_m > ahead.speed_mps * point.time_to_go_s:
            self._braking = False
            self._planned_for = None
            self._resume_cruise(-self._model.brake_mps2)

    def _note_slowing(self, ahead: PredictedState, front_m: float) -> profile.LowerLimit | None:
        """The lower limit ahead that is braked for. None: there is none."""
        index = self._limits.next_lowering(front_m)
        if self._slowing_to >= 0 and index > self._slowing_to:
            self._slowing_to = -1
            self._resume_cruise(-self._model.brake_mps2)
        if self._slowing_to >= 0:
            return self._limits.lowering(self._slowing_to)
        reach_m = LOOK_AHEAD_RATIO * ahead.speed_mps * (ahead.speed_mps + 2.0)
        lowering = self._limits.lowering(index)
        while lowering is not None and lowering.at_m - front_m < reach_m:
            if ahead.speed_mps > lowering.curve.end_mps and self._must_begin(
                lowering.curve, ahead, lowering.at_m - ahead.front_m
            ):
                self._slowing_to = index
                return lowering
            index += 1
            lowering = self._limits.lowering(index)
        return None

    def _must_begin(
        self, curve: profile.ReferenceBrakingCurve, ahead: PredictedState, distance_m: float
    ) -> bool:
        """Whether the change from the present acceleration to the curve's ends on the curve or
        beyond.
        """
        now_mps2 = self._governor.accel_mps2
        to_mps2 = -curve.at_speed(ahead.speed_mps).decel_mps2
        after_mps, travel_m = trapezoid.swing(
            ahead.speed_mps,
            from_mps2=max(now_mps2, to_mps2),
            to_mps2=to_mps2,
            jerk_mps3=self._config.braking.onset_jerk_mps3,
        )
        return distance_m - travel_m <= curve.at_speed(max(0.0, after_mps)).distance_m

    def _braking_decel_mps2(
        self, ahead: PredictedState, target_m: float, slowing: profile.LowerLimit | None
    ) -> float:
        decel_mps2 = 0.0
        if self._braking:
            decel_mps2 = self._follow_mps2(self._curve, ahead, target_m)
        if slowing is not None:
            decel_mps2 = max(decel_mps2, self._follow_mps2(slowing.curve, ahead, slowing.at_m))
        return decel_mps2

    def _follow_mps2(
        self, curve: profile.ReferenceBrakingCurve, ahead: PredictedState, end_m: float
    ) -> float:
        """Deceleration that leads back onto the curve before its end.

        With e metres to spare, de/dt = v * (b / b_ref - 1). The demand b = b_ref * (1 - k * e / (v
        * t_go)) makes e decrease with the k-th power of the time to go. The curve's deceleration
        decreases at a known rate, which compensates the lag of the brake.
        """
        point = curve.at_speed(ahead.speed_mps)
        left_m = end_m - ahead.front_m - self._gap_m(curve, ahead, end_m)
        share_ratio = self._share_ratio(
            point, ahead, left_m, gain=self._config.braking.correction_ratio, most_ratio=MOST_SHARE
        )
        led_mps2 = point.decel_mps2 - self._model.build_up_s(ahead.speed_mps) * point.ease_mps3
        decel_mps2 = max(0.0, led_mps2) * share_ratio
        if curve.end_mps == 0.0 and ahead.speed_mps > STEADY_FROM_MPS:
            # Far beyond the curve only constant braking from now on still ends at the stopping
            # point.
            steady_mps2 = ahead.speed_mps**2 / (2.0 * max(LEAST_LEFT_M, left_m))
            decel_mps2 = max(decel_mps2, steady_mps2)
        return decel_mps2

    @staticmethod
    def _share_ratio(
        point: profile.CurvePoint,
        ahead: PredictedState,
        left_m: float,
        *,
        gain: float,
        most_ratio: float,
    ) -> float:
        """Deceleration that corrects the distance to spare, relative to the curve's."""
        room_m = max(LEAST_SPEED_MPS, ahead.speed_mps) * max(LEAST_TIME_TO_GO_S, point.time_to_go_s)
        share_ratio = 1.0 - gain * (left_m - point.distance_m) / room_m
        return min(most_ratio, max(LEAST_SHARE, share_ratio))

    def _gap_m(
        self, curve: profile.ReferenceBrakingCurve, ahead: PredictedState, end_m: float
    ) -> float:
        """Distance without brake before the end of a curve to a standstill.

        Uphill the brake provides only a part of the deceleration, and only that part is missing.
        """
        if curve.end_mps > 0.0:
            return 0.0
        decel_mps2 = curve.at_speed(SLOW_MPS).decel_mps2
        brake_mps2 = decel_mps2 - gradient.decel_at_mps2(self._config, self._line, end_m)
        if brake_mps2 <= 0.0:
            return 0.0
        return self._model.gap_m(ahead.speed_mps, brake_mps2) * brake_mps2 / decel_mps2

    def _brake_demand_mps2(self, decel_mps2: float, ahead: PredictedState, target: Target) -> float:
        """Brake demand after gradient and resistance.

        The brake is never released, except uphill before a stop where gravity alone is enough.
        """
        asked_mps2 = decel_mps2 - self._rolling_mps2(ahead)
        asked_mps2 /= 1.0 + self._model.gain_at(ahead.speed_mps)
        return -max(self._least_brake_mps2(ahead, target), asked_mps2)

    def _rolling_mps2(self, ahead: PredictedState) -> float:
        """Deceleration of the train there without traction and brake."""
        config = self._config
        gravity_mps2 = gradient.decel_at_mps2(config, self._line, ahead.front_m)
        gravity_mps2 += gradient.resistance_mps2(config, ahead.speed_mps)
        return gravity_mps2 - self._model.disturbance_mps2

    def _least_brake_mps2(self, ahead: PredictedState, target: Target) -> float:
        """Least brake demand. Uphill it is less, once gravity alone brakes like the curve."""
        least_mps2 = self._config.braking.least_decel_mps2
        if self._by_notches or not (self._braking and target.at_station):
            return least_mps2
        if self._curve.at_speed(ahead.speed_mps).decel_mps2 > self._rolling_mps2(ahead):
            return least_mps2
        gravity_mps2 = gradient.decel_at_mps2(self._config, self._line, ahead.front_m)
        return max(0.0, least_mps2 - max(0.0, gravity_mps2))

    def _pull_to_stop(self, ahead: PredictedState, target: Target) -> Drive:
        """Drive the end of an uphill stop by traction, which answers sooner than the brake."""
        lacking_mps2 = self._follow_mps2(self._curve, ahead, target.at_m)
        self._pulls = lacking_mps2 - self._rolling_mps2(ahead) < BRAKE_AGAIN_MPS2
        near, left_mps2 = self._model.ahead_of_traction(self._front.front_m, self._gravity_mps2)
        point = self._curve.at_speed(near.speed_mps)
        share_ratio = self._share_ratio(
            point,
            near,
            target.at_m - near.front_m,
            gain=PULL_CORRECTION_RATIO,
            most_ratio=MOST_SHARE if near.speed_mps > PULL_GENTLY_MPS else MOST_GENTLE_SHARE,
        )
        build_up_s = self._config.traction.lag_s + PULL_LEAD_S
        decel_mps2 = max(0.0, point.decel_mps2 - build_up_s * point.ease_mps3) * share_ratio
        # At rest, traction holds the train against gravity until the holding brake does.
        decel_mps2 *= min(1.0, near.speed_mps / PULL_REST_MPS)
        demand_mps2 = self._rolling_mps2(near) + left_mps2 - decel_mps2
        demand_mps2 = min(self._config.limits.accel_mps2, max(0.0, demand_mps2))
        reference_mps = self._reference_mps(self._front.front_m, target.at_m, None)
        return Drive(demand_mps2, reference_mps, braking=True, pulls=True)

    # Cruising.

    def coast(self) -> None:
        """A law above this one coasts: the reference does not accelerate. Otherwise the train would
        brake sooner for its stop, as if traction had to end first.
        """
        if self._governor.accel_mps2 > 0.0:
            self._resume_cruise(0.0)

    def _resume_cruise(self, accel_mps2: float) -> None:
        self._governor.restart(max(0.0, self._model.speed_mps), accel_mps2)
        self._pid.reset()

    def _cruise(self, inputs: vocabulary.AtoInput, target_mps: float) -> Drive:
        config, governor = self._config, self._governor
        limit_mps2 = config.limits.accel_mps2
        available_mps2 = config.traction.rated_accel_mps2 * inputs.traction_ratio
        # The limit leaves room for resistance, so that the demand can follow the reference.
        uphill_mps2 = max(0.0, self._gravity_mps2 - self._model.disturbance_mps2)
        rise_mps2 = max(0.0, min(self._manner.accel_mps2, available_mps2) - uphill_mps2)
        governor.step(target_mps, rise_mps2=rise_mps2, fall_mps2=limit_mps2)
        predicted_mps = self._model.ahead_of_traction_mps(self._gravity_mps2)
        governor.hold_back(predicted_mps + HOLD_BACK_MPS)
        ahead_mps2 = governor.accel_mps2 + self._gravity_mps2 - self._model.disturbance_mps2
        feedback_mps2 = self._pid.step(
            self._gains(governor.accel_mps2),
            governor.speed_mps - predicted_mps,
            self._dt_s,
            low_mps2=-limit_mps2 - ahead_mps2,
            high_mps2=limit_mps2 - ahead_mps2,
        )
        demand_mps2 = ahead_mps2 + feedback_mps2
        band_mps2 = 0.0 if self._model.brake_asked else config.speed.coast_band_mps2
        if -band_mps2 < demand_mps2 < 0.0:
            demand_mps2 = 0.0
        # At a ceiling of 0 the train rests instead of creeping on by noise.
        most_mps2 = min(available_mps2, self._most_traction_mps2()) if target_mps > 0.0 else 0.0
        return Drive(min(demand_mps2, most_mps2), governor.speed_mps, False)

    def _kept_on(self, drive: Drive, ahead: PredictedState, target_m: float) -> Drive:
        """Hold a brake that is on shortly before the stop's braking.

        A new application would have another dead time than the one identified.
        """
        least_mps2 = -self._config.braking.least_decel_mps2
        if self._demand_mps2 >= 0.0 or drive.accel_mps2 <= least_mps2:
            return drive
        curve_m = self._curve.at_speed(ahead.speed_mps).distance_m
        spare_m = target_m - ahead.front_m - self._gap_m(self._curve, ahead, target_m) - curve_m
        if spare_m > KEPT_ON_S * ahead.speed_mps:
            return drive
        return Drive(least_mps2, drive.reference_mps, False)

    def _most_traction_mps2(self) -> float:
        """Greatest traction demand. On a slippery rail a higher one only spins the wheels."""
        return self._manner.accel_mps2 + (0.0 if self._rail.slippery else FLAT_MPS2)

    def _gains(self, reference_mps2: float) -> PidGains:
        speed = self._config.speed
        if reference_mps2 > FLAT_MPS2:
            return speed.rising
        return speed.falling if reference_mps2 < -FLAT_MPS2 else speed.constant
