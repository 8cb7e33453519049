"""The scheme of [Allotta 2013], corrected for the delay of the brake.

References over the place, three sections before the stop and four sets of gains are those of the
paper. The PIDs act on the state predicted past the dead time, and the acceleration of the reference
is fed forward. Gradient and resistance are compensated, and a single brake application ends the
run.
"""

import dataclasses
from typing import Final

from firmware_py.trackdb import LineMap, TagKind
from vobc import vocabulary
from vobc.ato.laws import pid_reference
from vobc.ato.laws.law import Drive, Target
from vobc.ato.laws.pid_reference import ReferencePoint, SpeedCurve
from vobc.ato.model.ceiling_forecast import CeilingOutlook, SmoothFront
from vobc.ato.model.predictor import PredictedState
from vobc.ato.model.train_model import TrainModel
from vobc.ato.motion import gradient, profile
from vobc.ato.motion.pid import Pid
from vobc.ato.settings.ato import AtoConfig
from vobc.ato.settings.pid import PidGains, falling_decel

FLAT_MPS2: Final = 0.02
"""Reference acceleration below which the speed counts as constant."""
SET_OFF_M: Final = 0.05
"""Least distance ahead at which a rise is read. At its start its speed is 0."""
CHANGE_OVER_S: Final = 1.5
"""Planned time between the end of traction and the start of braking."""
REJOIN_M: Final = 1.0
REJOIN_S: Final = 2.0
"""Spare distance and time to the braking curve at which the train accelerates again."""
AT_T3_M: Final = 0.5
"""Distance from its expected place within which a tag counts as T3."""
ERROR_MAX_MPS: Final = 1.0
"""Limit of the speed error. It prevents wind-up if the train cannot follow."""
OVER_CEILING_PER_S: Final = 0.8
"""Deceleration for each m/s above the ceiling expected when the brake acts."""
LEAST_COAST_MPS2: Final = 0.02


class Fall:
    """A braking curve to a stop or limit. `at_m` is its end."""

    __slots__ = ("at_m", "curve", "stops")

    def __init__(self, curve: SpeedCurve, at_m: float, *, stops: bool) -> None:
        self.curve = curve
        self.at_m = at_m
        self.stops = stops

    def point(self, front_m: float) -> ReferencePoint:
        return self.curve.at(max(0.0, self.at_m - front_m))


class PositionSection:
    """From T3 to the stop: x = v t - b t² / 2 + e t³ / 6, from the state at T3."""

    __slots__ = ("_decel_mps2", "_ease_mps3", "_since_s", "_start_mps", "_stop_s", "_way_m")

    def __init__(self, speed_mps: float, way_m: float, last_mps2: float) -> None:
        self._start_mps = speed_mps
        self._way_m = way_m
        self._decel_mps2, self._stop_s = falling_decel(speed_mps, way_m, last_mps2)
        self._ease_mps3 = max(0.0, self._decel_mps2 - last_mps2) / self._stop_s
        self._since_s = 0.0

    def step(self, dt_s: float) -> tuple[float, ReferencePoint]:
        """Remaining distance of the reference, and its motion there."""
        self._since_s = min(self._stop_s, self._since_s + dt_s)
        t, v, b, e = self._since_s, self._start_mps, self._decel_mps2, self._ease_mps3
        left_m = self._way_m - t * (v - t * (b / 2.0 - t * e / 6.0))
        return left_m, ReferencePoint(max(0.0, v - t * (b - t * e / 2.0)), b - e * t, e)


class PidPredicted:
    __slots__ = (
        "_ceiling",
        "_config",
        "_contribution_mps2",
        "_dt_s",
        "_fall",
        "_front",
        "_gains",
        "_gravity_mps2",
        "_limits",
        "_line",
        "_model",
        "_peak_mps",
        "_pid",
        "_planned_for",
        "_position",
        "_rise",
        "_rise_from_m",
        "_slowings",
        "_stop",
        "_t3_met",
        "_t3_places_m",
        "speed_mps",
    )

    def __init__(self, config: AtoConfig, line: LineMap, dt_s: float) -> None:
        self._config = config
        self._line = line
        self._dt_s = dt_s
        brake = config.brake
        if not config.pid.identify_delay:
            brake = dataclasses.replace(brake, dead_times_s=(brake.expected_dead_time_s,))
        self._model = TrainModel(brake, config.traction, dt_s)
        self._pid = Pid()
        self._gains: PidGains | None = None
        self._contribution_mps2 = 0.0
        self._limits = profile.SpeedLimits(config, line)
        self._t3_places_m = {
            tag.tag_id: tag.position_m for tag in line.tags if tag.kind is TagKind.T3
        }
        self._t3_met = False
        self._position: PositionSection | None = None
        self._front = SmoothFront()
        self._ceiling = CeilingOutlook()
        self._gravity_mps2 = 0.0
        self._planned_for: tuple[Target, float] | None = None
        self._peak_mps = 0.0
        self._rise = SpeedCurve(0.0, 0.0)
        self._rise_from_m = 0.0
        self._stop = Fall(SpeedCurve(0.0, 0.0), 0.0, stops=True)
        self._slowings: list[Fall] = []
        self._fall: Fall | None = None
        self.speed_mps = 0.0

    @property
    def brake_dead_time_s(self) -> float:
        """Dead time identified in the present application, or the expected one before."""
        return self._model.dead_time_s

    def observe(self, inputs: vocabulary.AtoInput, cycles: int) -> None:
        self._gravity_mps2 = gradient.decel_on_mps2(self._config, inputs.gradient_permille)
        self._gravity_mps2 += gradient.resistance_mps2(self._config, self._model.speed_mps)
        self._model.step(inputs.speed_mps, self._gravity_mps2, cycles)
        if not inputs.enabled:
            # Another source brakes, so the speed says nothing about this law's demands.
            self._model.meet(inputs.speed_mps)
        self.speed_mps = self._model.speed_mps
        dt_s = self._dt_s * cycles
        self._front.step(
            inputs.front_m, moved_m=self.speed_mps * dt_s, at_tag=bool(inputs.accepted_tag_ids)
        )
        self._ceiling.step(inputs.ceiling_mps, dt_s)
        for tag_id in inputs.accepted_tag_ids:
            self._t3_met = self._t3_met or tag_id in self._t3_places_m

    def rest(self) -> None:
        self._model.rest()
        self.speed_mps = 0.0

    def set_off(self, inputs: vocabulary.AtoInput, demand_mps2: float) -> None:
        self._model.meet(inputs.speed_mps)
        self._pid.reset()
        self._gains, self._contribution_mps2 = None, 0.0
        self._fall, self._position, self._t3_met = None, None, False
        self._planned_for = None

    def issued(self, demand_mps2: float) -> None:
        self._model.issue(demand_mps2)

    def drive(self, inputs: vocabulary.AtoInput, target: Target) -> Drive:
        front_m = self._front.front_m
        self._plan(front_m, target)
        ahead = self._model.ahead_of_brake(front_m, self._gravity_mps2)
        run = self._run_reference(front_m)
        fall = self._choose_fall(front_m, ahead, run.speed_mps)
        if fall is None:
            return self._follow_run(inputs, run)
        return self._follow_fall(fall, ahead)

    # Planning.

    def _plan(self, front_m: float, target: Target) -> None:
        """Plan the curves to the target when the target or the limit under the train changes."""
        config, line = self._config, self._line
        limit_mps = self._limits.under_train_mps(front_m) - config.speed.margin_mps
        key = (target, limit_mps)
        if key == self._planned_for:
            return
        self._planned_for = key
        speed_mps = max(0.0, self.speed_mps)
        peak_mps = pid_reference.peak_mps(
            config,
            line,
            from_mps=speed_mps,
            way_m=target.at_m - front_m,
            at_m=target.at_m,
            at_station=target.at_station,
            limit_mps=max(0.0, limit_mps),
            change_over_s=CHANGE_OVER_S,
        )
        falling = self._fall is not None
        if falling:
            # The end of a braking curve may move while it is followed. Its start stays.
            peak_mps = max(peak_mps, self._peak_mps)
        self._peak_mps = peak_mps
        self._start_rise(front_m, speed_mps)
        curve = pid_reference.stop_curve(
            config, line, target.at_m, peak_mps, at_station=target.at_station
        )
        self._stop = Fall(curve, target.at_m, stops=True)
        self._slowings = self._slowings_before(front_m, target.at_m)
        fall = self._fall
        if fall is not None:
            self._fall = self._stop if fall.stops else self._same_slowing(fall)

    def _slowings_before(self, front_m: float, end_m: float) -> list[Fall]:
        """Braking curves to limits before `end_m` that are lower than the planned speed."""
        falls: list[Fall] = []
        index = self._limits.next_lowering(front_m)
        lowering = self._limits.lowering(index)
        while lowering is not None and lowering.at_m < end_m:
            if lowering.curve.end_mps < self._peak_mps:
                curve = pid_reference.slow_down(
                    self._config,
                    to_mps=lowering.curve.end_mps,
                    decel_mps2=lowering.curve.steady_decel_mps2,
                    top_mps=self._peak_mps,
                )
                falls.append(Fall(curve, lowering.at_m, stops=False))
            index += 1
            lowering = self._limits.lowering(index)
        return falls

    def _same_slowing(self, fall: Fall) -> Fall | None:
        for slowing in self._slowings:
            if slowing.at_m == fall.at_m:
                return slowing
        return None

    def _start_rise(self, front_m: float, speed_mps: float) -> None:
        limits = self._config.limits
        self._rise_from_m = front_m
        self._rise = pid_reference.rise(
            speed_mps,
            0.0,
            self._peak_mps,
            accel_mps2=limits.accel_mps2,
            jerk_mps3=self._config.pid.rise_jerk_mps3,
        )

    # Choice of the lowest reference.

    def _run_reference(self, front_m: float) -> ReferencePoint:
        """The lower of running profile and ceiling while the train does not brake."""
        point = self._rise.at(max(SET_OFF_M, front_m - self._rise_from_m))
        horizon_s = self._config.traction.dead_time_s
        margin_mps = self._config.speed.margin_mps
        ceiling_mps = max(0.0, self._ceiling.in_mps(horizon_s) - margin_mps)
        if ceiling_mps >= point.speed_mps:
            return point
        # When the ceiling rises, the acceleration starts from there.
        self._start_rise(front_m, min(ceiling_mps, max(0.0, self.speed_mps)))
        fall_mps2 = self._ceiling.in_mps(0.0) - self._ceiling.in_mps(1.0)
        return ReferencePoint(ceiling_mps, -fall_mps2, 0.0)

    def _choose_fall(self, front_m: float, ahead: PredictedState, run_mps: float) -> Fall | None:
        """The braking curve with the lowest speed when a demand given now acts. None: none
        applies.
        """
        chosen = self._kept_fall(front_m, ahead)
        least_mps = run_mps if chosen is None else chosen.point(ahead.front_m).speed_mps
        for fall in (self._stop, *self._slowings):
            way_m = fall.at_m - ahead.front_m
            if way_m >= fall.curve.length_m or (way_m < 0.0 and not fall.stops):
                continue
            speed_mps = fall.point(ahead.front_m).speed_mps
            if speed_mps < least_mps:
                chosen, least_mps = fall, speed_mps
        self._fall = chosen
        return chosen

    def _kept_fall(self, front_m: float, ahead: PredictedState) -> Fall | None:
        """A braking curve ends at its end, or when the train would no longer reach its end."""
        fall = self._fall
        if fall is None:
            return None
        if not fall.stops:
            if front_m < fall.at_m:
                return fall
        elif not self._falls_short(fall, ahead):
            return fall
        self._planned_for = None
        self._fall, self._position = None, None
        self._start_rise(front_m, max(0.0, self.speed_mps))
        return None

    def _falls_short(self, fall: Fall, ahead: PredictedState) -> bool:
        if self._position is not None:
            return False
        to_go_m = fall.at_m - ahead.front_m
        spare_m = to_go_m - fall.curve.place_of_m(ahead.speed_mps)
        if spare_m > REJOIN_M + REJOIN_S * ahead.speed_mps:
            return True
        coast_mps2 = self._help_mps2(ahead) + self._config.pid.least_decel_mps2
        coast_mps2 = max(LEAST_COAST_MPS2, coast_mps2)
        reach_m = ahead.speed_mps * ahead.speed_mps / (2.0 * coast_mps2)
        return to_go_m - reach_m > REJOIN_M

    # Following a braking curve.

    def _follow_fall(self, fall: Fall, ahead: PredictedState) -> Drive:
        to_go_m = fall.at_m - ahead.front_m
        point = fall.point(ahead.front_m)
        if fall.stops:
            self._note_t3(to_go_m, ahead.speed_mps)
        if fall.stops and self._position is not None:
            left_m, point = self._position.step(self._dt_s)
            gains = self._config.pid.position
            error, slope = to_go_m - left_m, point.speed_mps - ahead.speed_mps
        else:
            gains = self._falling_gains(fall, to_go_m)
            error = _within(point.speed_mps - ahead.speed_mps, ERROR_MAX_MPS)
            slope = None
        most_mps2 = self._config.limits.accel_mps2
        feedback_mps2 = self._feedback(gains, error, slope, -most_mps2, most_mps2)
        led_mps2 = self._model.build_up_s(ahead.speed_mps) * point.jerk_mps3
        decel_mps2 = point.accel_mps2 - led_mps2 - feedback_mps2
        over_mps = ahead.speed_mps - self._ceiling.in_mps(self._model.dead_time_s)
        if over_mps > 0.0:
            decel_mps2 += OVER_CEILING_PER_S * over_mps
        asked_mps2 = decel_mps2 - self._help_mps2(ahead)
        asked_mps2 /= 1.0 + self._model.gain_ratio
        demand_mps2 = -max(self._config.pid.least_decel_mps2, asked_mps2)
        return Drive(demand_mps2, point.speed_mps, fall.stops)

    def _note_t3(self, to_go_m: float, speed_mps: float) -> None:
        """The position loop begins at T3. Without that tag the stop is made under speed control."""
        if not self._t3_met or self._position is not None:
            return
        if 0.0 < to_go_m <= self._config.pid.t3_m + AT_T3_M and speed_mps > 0.0:
            last_mps2 = self._config.pid.last_decel_mps2
            self._position = PositionSection(speed_mps, to_go_m, last_mps2)

    def _falling_gains(self, fall: Fall, to_go_m: float) -> PidGains:
        scheme = self._config.pid
        return scheme.constant if fall.stops and to_go_m <= scheme.t2_m else scheme.falling

    def _help_mps2(self, ahead: PredictedState) -> float:
        """Deceleration without the brake."""
        gravity_mps2 = gradient.decel_at_mps2(self._config, self._line, ahead.front_m)
        gravity_mps2 += gradient.resistance_mps2(self._config, ahead.speed_mps)
        return gravity_mps2 - self._model.disturbance_mps2

    # Accelerating and running: traction, and sometimes a light brake.

    def _follow_run(self, inputs: vocabulary.AtoInput, point: ReferencePoint) -> Drive:
        config = self._config
        limit_mps2 = config.limits.accel_mps2
        available_mps2 = config.traction.rated_accel_mps2 * inputs.traction_ratio
        predicted_mps = self._model.ahead_of_traction_mps(self._gravity_mps2)
        forward_mps2 = min(point.accel_mps2, max(0.0, available_mps2))
        forward_mps2 += config.traction.lag_s * point.jerk_mps3
        ahead_mps2 = forward_mps2 + self._gravity_mps2 - self._model.disturbance_mps2
        feedback_mps2 = self._feedback(
            self._running_gains(point.accel_mps2),
            _within(point.speed_mps - predicted_mps, ERROR_MAX_MPS),
            None,
            -limit_mps2 - ahead_mps2,
            min(limit_mps2, available_mps2) - ahead_mps2,
        )
        demand_mps2 = ahead_mps2 + feedback_mps2
        band_mps2 = 0.0 if self._model.brake_asked else config.speed.coast_band_mps2
        if -band_mps2 < demand_mps2 < 0.0:
            demand_mps2 = 0.0
        # At a ceiling of 0 the train rests instead of creeping on by noise.
        most_mps2 = available_mps2 if point.speed_mps > 0.0 else 0.0
        return Drive(min(demand_mps2, most_mps2), point.speed_mps, False)

    def _running_gains(self, reference_mps2: float) -> PidGains:
        scheme = self._config.pid
        if reference_mps2 > FLAT_MPS2:
            return scheme.rising
        return scheme.falling if reference_mps2 < -FLAT_MPS2 else scheme.constant

    def _feedback(
        self,
        gains: PidGains,
        error: float,
        slope: float | None,
        low_mps2: float,
        high_mps2: float,
    ) -> float:
        """One PID step. Changed gains continue from the previous output."""
        if gains is not self._gains:
            if self._gains is not None:
                self._pid.take_over(
                    gains, error=error, output_mps2=self._contribution_mps2, slope=slope or 0.0
                )
            self._gains = gains
        self._contribution_mps2 = self._pid.step(
            gains, error, self._dt_s, low_mps2=low_mps2, high_mps2=high_mps2, slope=slope
        )
        return self._contribution_mps2


def _within(value: float, bound: float) -> float:
    return min(bound, max(-bound, value))
