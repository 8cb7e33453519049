"""The automatic operation: drives from stop to stop, works the doors, dwells and departs."""

import math
from collections.abc import Sequence
from typing import Final

from can_dbc.vobc import AtoPhase
from firmware_py.trackdb import LineMap, Station
from vobc.ato.laws import make_strategy
from vobc.ato.laws.law import Drive, Strategy, Target
from vobc.ato.laws.slow_movement import SlowDrive
from vobc.ato.mode import DRIVING, SETTING_OFF, PhaseGuardInputs, next_phase
from vobc.ato.model.receding_authority import RecedingEnd
from vobc.ato.motion import gradient
from vobc.ato.motion.shaper import Shaper
from vobc.ato.next_stop import StopPlan
from vobc.ato.output import make_stage
from vobc.ato.settings.ato import AtoConfig, within_notches
from vobc.vocabulary import AtoDemand, AtoInput, BrakeFinding

NS_PER_S: Final = 1_000_000_000
UNDER_WAY_MPS: Final = 0.3
"""Speed above which a departing train is under way. It is well above speed noise and rollback."""
MOVING_MPS: Final = 0.5
"""Minimum speed at which ATO takes over a moving train."""
DISABLED_DECEL_MPS2: Final = 0.65
"""Deceleration requested while ATO is disabled and the train is moving."""
CYCLES_MAX: Final = 40
"""Greatest number of cycles, missed ones included, that a law makes up for in one step. Protection
brakes after three missed ones, so more only happen when the clock was set."""
HOLD_HELP_MPS2: Final = 0.02
"""Margin of traction over gravity at which the holding brake is released uphill."""
LEVEL_MPS2: Final = 0.01
LEAST_CEILING_MPS: Final = 1.0
"""Least ceiling for a departure."""
AHEAD_STEP_M: Final = 0.1
AHEAD_GROWS_RATIO: Final = 1.2
"""Growth of the assumed position error on the way to the stop."""
USUAL_CYCLE_S: Final = 0.05
CYCLE_MARGIN_MPS: Final = 11.0
"""Growth of the margin before the end of authority with a cycle longer than the usual one.
Protection assumes that traction runs away for two cycles more: at 1 m/s that takes 9 m for each
second of cycle time. The rest is for odometry, which then shows the speed less often."""
FINEST_JOG_BACK_M: Final = 0.1
"""Least distance for a jog back. A jog forwards may be shorter: it may reach a tag, even from
slightly past the stopping point."""
JOG_PAST_M: Final = 0.05
"""Target of a jog forwards, as distance past the stopping point. There the antenna reaches the
stop's tag."""
JOG_TO_TAG_M: Final = 0.15
"""Target of a jog to a tag, as distance past the stopping point or past the present place. The tag
was not read, so the estimate of the place is too far ahead."""
JOG_BACK_PAST_M: Final = 0.12
"""Target of a jog back, as distance short of the stopping point. The antenna must pass the tag
again; otherwise the place stays too uncertain for doors after a slide in emergency braking."""
JOG_BACK_SPARE_M: Final = 0.05
"""How much further a jog back may end than planned."""
JOG_WIDENS_RATIO: Final = 0.1
"""Widening of the interval ahead of the estimate over the distance of a jog back, at most."""
JOG_SPREAD_M: Final = 0.15
"""Greatest distance of a jog's end from its target. Including it, a jog stays within its reach."""
HELP_WAITS_S: Final = 30.0
"""Time without progress after which the train calls for help. It stands at or off a stop without
opening doors, or does not move under way."""
HOLD_SOONER_MPS: Final = 0.012
"""Excess over the usual speed at which the holding brake is applied while traction still pulls."""
PULL_PATIENCE_S: Final = 1.0
"""Greatest time for which traction waits for the holding brake after an uphill stop."""
JOG_MOVED_MPS: Final = 0.05
JOG_PATIENCE_S: Final = 12.0
"""Time after which a jog that has not moved the train ends. It counts as an attempt."""


class Ato:
    """Serves `stops` in order, beginning with a stop at `start_m` unless it has no dwell time.

    Raises ValueError for an unknown strategy name.
    """

    def __init__(
        self, config: AtoConfig, line: LineMap, start_m: float, stops: Sequence[Station]
    ) -> None:
        if config.output.stage == "notches":
            config = within_notches(config)
        self._config = config
        self._line = line
        self._plan = StopPlan(line, start_m, stops, window_m=config.station.window_m)
        self._jogs = 0
        self._jog_s = 0.0
        self._jog_moved = False
        self._waits_s = 0.0
        self._jog_past_m = 0.0
        self._reverse = False
        self._overruled = False
        self._slow = SlowDrive(config)
        self._receding = RecedingEnd(config.authority)
        self._dwelt_s = 0.0
        self._asked_open_s = 0.0
        self._hold = True
        self._held_s = 0.0
        self._pull_s = 0.0
        self._released_s = config.station.release_s
        self._doors_wanted = False
        self._brake_reported = False
        """Since the departure a late or weak brake was reported."""
        self._dt_s = 0.0
        self._margin_m = config.authority.margin_m
        self._left: tuple[int, float] | None = None
        """Time and place of the departure from the last stop."""
        self._strategy: Strategy | None = None
        # Checks the strategy name now. The strategy in use is created when the cycle time is known.
        make_strategy(config, line, 1.0)
        self._shaper = Shaper(config.limits)
        self._stage = make_stage(config.output)
        self._sent_mps2 = 0.0
        self._seen = PhaseGuardInputs()
        self.phase = AtoPhase.OFF

    @property
    def next_stop(self) -> Station | None:
        """The stop that is approached or served. None: the list is empty."""
        return self._plan.next_stop

    @property
    def strategy(self) -> Strategy | None:
        """The active control law. None: before the first step."""
        return self._strategy

    def step(self, inputs: AtoInput) -> AtoDemand:
        """One cycle. `dt_s` of the first one is the nominal period."""
        strategy = self._strategy or self._begin(inputs)
        cycles = min(max(1, round(inputs.dt_s / self._dt_s)), CYCLES_MAX)
        strategy.observe(inputs, cycles)
        self._receding.step(inputs.authority_end_m, speed_mps=inputs.speed_mps, dt_s=inputs.dt_s)
        before = self.phase
        self._look(inputs)
        self.phase = next_phase(before, self._seen)
        if self.phase is not before:
            self._enter(before, inputs)
        drive = self._drive(inputs, strategy)
        self._decide_hold(inputs, drive)
        accel_mps2 = self._stage.step(self._shape(inputs, drive), inputs.dt_s)
        self._sent_mps2 = accel_mps2
        reverse = self.phase is AtoPhase.JOGGING and self._reverse
        # In reverse, traction acts against the direction that the strategy takes as forwards.
        strategy.issued(-accel_mps2 if reverse and accel_mps2 > 0.0 else accel_mps2)
        braked = accel_mps2 < 0.0 or inputs.protection_brakes
        self._released_s = 0.0 if braked else self._released_s + inputs.dt_s
        return self._demand(inputs, accel_mps2, drive)

    def _drive(self, inputs: AtoInput, strategy: Strategy) -> Drive:
        """Demand of the present phase, before comfort limits."""
        if self.phase not in DRIVING and self.phase not in SETTING_OFF:
            return self._stand_or_brake(inputs)
        overruled = inputs.stop_now or inputs.protection_brakes
        if overruled:
            self._overruled = True
            self._seen.braking = True
            return Drive(-DISABLED_DECEL_MPS2, 0.0, True)
        if self._overruled:
            # Another brake command has changed the motion, so the strategy restarts from the
            # present state.
            self._overruled = False
            strategy.set_off(inputs, self._sent_mps2)
            self._slow.begin(inputs.speed_mps)
        if self.phase is AtoPhase.JOGGING:
            return self._jog(inputs)
        if self.phase is AtoPhase.CREEPING:
            return self._slow.creep(inputs)
        drive = strategy.drive(inputs, self._target(inputs))
        self._seen.braking = drive.braking
        return drive

    def _jog(self, inputs: AtoInput) -> Drive:
        stop = self.next_stop
        late = not self._jog_moved and self._jog_s > JOG_PATIENCE_S
        if stop is None or late or not inputs.jog_permitted:
            self._slow.end()
        if inputs.accepted_tag_ids and not self._reverse:
            self._jog_past_m = min(self._jog_past_m, JOG_PAST_M)
        to_stop_m = 0.0 if stop is None else stop.stop_m - inputs.front_m
        distance_m = -to_stop_m if self._reverse else to_stop_m
        return self._slow.jog(inputs, distance_m + self._jog_past_m, reverse=self._reverse)

    def _begin(self, inputs: AtoInput) -> Strategy:
        self._dt_s = inputs.dt_s
        longer_s = max(0.0, inputs.dt_s - USUAL_CYCLE_S)
        self._margin_m = self._config.authority.margin_m + CYCLE_MARGIN_MPS * longer_s
        self._strategy = make_strategy(self._config, self._line, inputs.dt_s)
        return self._strategy

    def _demand(self, inputs: AtoInput, accel_mps2: float, drive: Drive) -> AtoDemand:
        stop = self.next_stop
        return AtoDemand(
            accel_mps2=accel_mps2,
            hold=self._hold,
            open_doors=(self._doors_wanted or inputs.keep_doors_open) and inputs.door_enabled,
            phase=self.phase,
            target_mps=drive.reference_mps,
            distance_to_stop_m=math.inf if stop is None else stop.stop_m - inputs.front_m,
            reverse=self._reverse and self.phase is AtoPhase.JOGGING,
            calls_for_help=self._calls_for_help(),
            stopping_at_m=None if stop is None or inputs.creep else stop.stop_m,
            brake_finding=self._new_finding(drive),
        )

    def _new_finding(self, drive: Drive) -> BrakeFinding | None:
        """A finding about the brake, once a departure at most."""
        if drive.brake_finding is None or self._brake_reported:
            return None
        self._brake_reported = True
        return drive.brake_finding

    # Inputs of the guards.

    def _look(self, inputs: AtoInput) -> None:
        work, situation, plan = self._config.station, self._seen, self._plan
        situation.enabled = inputs.enabled
        self._held_s = self._held_s + inputs.dt_s if inputs.holding_applied and self._hold else 0.0
        situation.resting = inputs.standstill and self._held_s >= work.settle_s
        situation.under_way = inputs.speed_mps > (
            MOVING_MPS if self.phase is AtoPhase.OFF else UNDER_WAY_MPS
        )
        plan.listen(inputs, working=self._working())
        self._leave_what_is_out_of_reach(inputs)
        stop = self.next_stop
        to_stop_m = math.inf if stop is None else stop.stop_m - inputs.front_m
        situation.creep = inputs.creep
        situation.in_stopping_zone = to_stop_m <= work.stopping_zone_m
        situation.at_stop = abs(to_stop_m) <= work.window_m and not inputs.creep
        situation.released = self._released_s >= work.release_s
        situation.doors_locked = inputs.doors_locked
        situation.doors_enabled = inputs.door_enabled and inputs.holding_applied
        situation.departure_permitted = inputs.departure_permitted
        situation.keep_doors_open = inputs.keep_doors_open
        situation.has_door_work = stop is not None and stop.dwell_s > 0.0
        if self.phase is AtoPhase.STOPPED and not situation.has_door_work:
            plan.served = plan.goal(working=True) is not None
        elif self.phase is AtoPhase.DOORS_OPEN:
            self._dwell(inputs)
        situation.served = plan.served
        situation.dwell_over = stop is not None and (
            self._dwelt_s >= stop.dwell_s or not situation.at_stop
        )
        situation.stays = inputs.kept_at_platform or plan.stays_at_present_stop()
        situation.may_go = self._may_go(inputs)
        self._waits_s = self._waits_s + inputs.dt_s if self._waits(inputs, to_stop_m) else 0.0
        situation.may_jog = self._may_jog(inputs, to_stop_m)
        self._watch_jog(inputs)

    def _waits(self, inputs: AtoInput, to_stop_m: float) -> bool:
        """The train stands at its stop, missed it within reach of a jog, or does not get going."""
        if self.phase is AtoPhase.STOPPED or (self.phase in DRIVING and inputs.standstill):
            return True
        held = self.phase is AtoPhase.HOLDING and not self._plan.served and not inputs.creep
        within_reach = abs(to_stop_m) <= self._config.station.jog_reach_m
        return held and within_reach and inputs.authority_end_m >= inputs.front_m + to_stop_m

    def _working(self) -> bool:
        """Doors at the present stop are open or about to open."""
        return self._plan.served or (
            self.phase in (AtoPhase.DOORS_OPEN, AtoPhase.DOORS_CLOSING) and self._seen.at_stop
        )

    def _leave_what_is_out_of_reach(self, inputs: AtoInput) -> None:
        """Skip a stop that is too far behind a standing train. The train does not reverse
        that far.
        """
        stop, plan = self.next_stop, self._plan
        if stop is None or plan.served or inputs.creep:
            return
        if not (self._seen.resting and inputs.enabled and inputs.departure_permitted):
            return
        if inputs.front_m - stop.stop_m > self._config.station.jog_reach_m and plan.give_up():
            self._jogs = 0

    def _dwell(self, inputs: AtoInput) -> None:
        self._asked_open_s += inputs.dt_s
        if inputs.doors_open or self._asked_open_s > self._config.station.doors_patience_s:
            self._dwelt_s += inputs.dt_s

    def _may_go(self, inputs: AtoInput) -> bool:
        """Whether the next movement may begin: on sight, or to the next stop if that is beyond a
        jog.
        """
        work = self._config.station
        if inputs.stop_now or inputs.ceiling_mps < LEAST_CEILING_MPS:
            return False
        if inputs.creep:
            return True
        goal = self._plan.goal(working=self.phase is AtoPhase.DOORS_OPEN and self._seen.at_stop)
        if goal is None or goal.stop_m - inputs.front_m <= work.jog_reach_m:
            return False
        room_m = self._reach(goal.stop_m, inputs).at_m - inputs.front_m
        return room_m >= work.least_run_m

    def _may_jog(self, inputs: AtoInput, to_stop_m: float) -> bool:
        work = self._config.station
        if self._plan.served or inputs.creep or inputs.stop_now or not inputs.jog_permitted:
            return False
        if self._jogs >= work.jog_attempts or not self._seen.resting:
            return False
        if to_stop_m < -FINEST_JOG_BACK_M and not inputs.jog_to_tag:
            back_m = -to_stop_m + JOG_BACK_PAST_M + JOG_SPREAD_M
            return -to_stop_m <= work.jog_reach_m and back_m <= inputs.jog_back_m
        reachable = inputs.authority_end_m >= inputs.front_m + max(0.0, to_stop_m)
        return to_stop_m <= work.jog_reach_m and reachable

    def _back_past_m(self, inputs: AtoInput, past_m: float) -> float:
        """How far short of the stopping point a jog back ends: past the tag, but where doors may
        open even if no tag narrows the interval, if there is such a place.

        Args:
            past_m: distance of the estimate past the stopping point, where the jog begins.
        """
        then_ahead_m = inputs.ahead_m + JOG_WIDENS_RATIO * past_m
        spare_m = self._config.station.window_m - then_ahead_m - JOG_BACK_SPARE_M
        return min(JOG_BACK_PAST_M, spare_m) if spare_m > 0.0 else JOG_BACK_PAST_M

    def _watch_jog(self, inputs: AtoInput) -> None:
        if self.phase is not AtoPhase.JOGGING:
            self._seen.jog_over = False
            return
        self._jog_s += inputs.dt_s
        self._jog_moved = self._jog_moved or abs(inputs.speed_mps) > JOG_MOVED_MPS
        ended = self._jog_moved or self._jog_s > JOG_PATIENCE_S
        self._seen.jog_over = self._seen.resting and ended

    def _calls_for_help(self) -> bool:
        seen = self._seen
        if self._waits_s > HELP_WAITS_S:
            return True
        used_up = self._jogs >= self._config.station.jog_attempts > 0
        return used_up and seen.resting and not seen.at_stop and self.phase is not AtoPhase.JOGGING

    def _target(self, inputs: AtoInput) -> Target:
        stop = self.next_stop
        stop_m = self._line.end_m if stop is None else stop.stop_m
        return self._reach(stop_m, inputs)

    def _reach(self, stop_m: float, inputs: AtoInput) -> Target:
        """Target of the movement: the stop, or a point before the end of authority.

        The stop is the target if the authority will cover it. Otherwise the foremost front keeps a
        margin to the end. The uncertainty is rounded up to steps, as each new target requires a new
        plan.
        """
        end_m = self._receding.at_least_m
        if end_m >= stop_m:
            return Target(stop_m, True, self._due_ns())
        ahead_m = math.ceil(AHEAD_GROWS_RATIO * inputs.ahead_m / AHEAD_STEP_M) * AHEAD_STEP_M
        return Target(end_m - self._margin_m - ahead_m, False)

    def _due_ns(self) -> int | None:
        """Timetable arrival at the next stop."""
        if self._left is None:
            return None
        left_ns, left_m = self._left
        run_s = self._plan.run_s(left_m)
        return None if run_s is None else left_ns + round(run_s * NS_PER_S)

    # Actions on a change of phase.

    def _enter(self, before: AtoPhase, inputs: AtoInput) -> None:
        assert self._strategy is not None
        phase = self.phase
        if phase is AtoPhase.DEPARTING:
            self._brake_reported = False
            if self._plan.served:
                self._dwelt_s, self._jogs = 0.0, 0
            # A timetable covers the run from station to station. A train that halts in between
            # keeps its delay.
            if self._plan.served or self._plan.at_station(inputs.front_m):
                self._left = inputs.now_ns, inputs.front_m
            self._plan.depart()
            self._strategy.set_off(inputs, self._sent_mps2)
        elif phase is AtoPhase.RUNNING and before in (AtoPhase.OFF, AtoPhase.CREEPING):
            self._left = None
            self._hold = False
            self._strategy.set_off(inputs, self._sent_mps2)
        elif phase is AtoPhase.JOGGING:
            self._jogs += 1
            self._jog_s, self._jog_moved = 0.0, False
            stop = self.next_stop
            past_m = 0.0 if stop is None else inputs.front_m - stop.stop_m
            self._reverse = past_m > FINEST_JOG_BACK_M and not inputs.jog_to_tag
            ahead_m = JOG_TO_TAG_M if inputs.jog_to_tag else JOG_PAST_M
            beyond_m = (
                self._back_past_m(inputs, past_m) if self._reverse else ahead_m + max(0.0, past_m)
            )
            spare_m = self._config.station.jog_reach_m - JOG_SPREAD_M - abs(past_m)
            self._jog_past_m = min(beyond_m, max(0.0, spare_m))
            self._slow.begin(0.0)
        elif phase is AtoPhase.CREEPING:
            self._hold = self._hold and before is not AtoPhase.OFF
            self._slow.begin(inputs.speed_mps)
        elif phase is AtoPhase.DOORS_OPEN:
            self._doors_wanted = True
            self._asked_open_s = 0.0
            self._plan.served = False
        elif phase is AtoPhase.DOORS_CLOSING:
            self._doors_wanted = False
            # Doors may have opened again at a stop that the plan has already left.
            self._plan.served = self._seen.at_stop

    # Outputs.

    def _stand_or_brake(self, inputs: AtoInput) -> Drive:
        """Demand outside the driving phases: hold at standstill, otherwise brake to a stop."""
        assert self._strategy is not None
        if not self._hold:
            return Drive(-DISABLED_DECEL_MPS2, 0.0, False)
        if inputs.standstill:
            self._strategy.rest()
        held = inputs.holding_applied and inputs.standstill
        return Drive(0.0 if held else -self._config.station.hold_decel_mps2, 0.0, False)

    def _decide_hold(self, inputs: AtoInput, drive: Drive) -> None:
        """The holding brake is applied as the train comes to rest and stays applied until
        departure.
        """
        assert self._strategy is not None
        uphill_mps2 = max(0.0, gradient.decel_on_mps2(self._config, inputs.gradient_permille))
        if self.phase is AtoPhase.JOGGING and self._reverse:
            uphill_mps2 = max(0.0, -gradient.decel_on_mps2(self._config, inputs.gradient_permille))
        if self.phase is AtoPhase.DEPARTING or (self.phase in SETTING_OFF and not drive.braking):
            needed_mps2 = uphill_mps2 + HOLD_HELP_MPS2 if uphill_mps2 > LEVEL_MPS2 else 0.0
            self._hold = self._hold and self._sent_mps2 < needed_mps2
            return
        work = self._config.station
        speed_mps = self._strategy.speed_mps
        if self.phase in (AtoPhase.JOGGING, AtoPhase.CREEPING):
            speed_mps = abs(inputs.speed_mps)
        early_mps = HOLD_SOONER_MPS if drive.pulls else uphill_mps2 * work.hold_lead_s
        slow = speed_mps <= work.hold_speed_mps + early_mps
        if slow and (drive.accel_mps2 <= 0.0 or drive.pulls):
            self._hold = True

    def _pulls_into_hold(self, inputs: AtoInput, drive: Drive) -> bool:
        """Traction at the end of an uphill stop stays until the holding brake is applied."""
        waits = drive.pulls and not inputs.holding_applied
        self._pull_s = self._pull_s + inputs.dt_s if waits else 0.0
        return waits and self._pull_s < PULL_PATIENCE_S

    def _shape(self, inputs: AtoInput, drive: Drive) -> float:
        wanted_mps2 = drive.accel_mps2
        drives = (self.phase in DRIVING or self.phase in SETTING_OFF) and not self._hold
        sets_off = self.phase in SETTING_OFF and wanted_mps2 >= 0.0
        if self._hold and not (sets_off or self.phase is AtoPhase.DEPARTING):
            wanted_mps2 = min(wanted_mps2, 0.0)
            if self._pulls_into_hold(inputs, drive):
                wanted_mps2 = drive.accel_mps2
            elif not (inputs.holding_applied and inputs.standstill):
                wanted_mps2 = -self._config.station.hold_decel_mps2
        # A traction notch that dwells would delay the start of braking.
        coming_off = drive.braking and self._sent_mps2 >= 0.0
        firm = not drives or self._overruled or coming_off
        # A missed cycle and a stepped clock look alike. The change is limited to that of one cycle.
        dt_s = min(inputs.dt_s, self._dt_s)
        picked_mps2 = self._stage.pick(wanted_mps2, dt_s, firm=firm)
        # A larger demand would become effective later without jerk limit, as soon as the motors can
        # give it.
        demand_mps2 = min(picked_mps2, inputs.traction_mps2)
        falling_mps2 = -gradient.decel_on_mps2(self._config, inputs.gradient_permille)
        lost_mps2 = max(0.0, falling_mps2) + drive.weak_mps2
        accel_mps2 = self._shaper.step(demand_mps2, dt_s, lost_mps2=lost_mps2)
        unready = self._hold and self.phase not in DRIVING | SETTING_OFF
        if accel_mps2 > 0.0 and (unready or (not inputs.doors_locked and not self._seen.under_way)):
            accel_mps2 = self._shaper.drop_traction()
        return accel_mps2
