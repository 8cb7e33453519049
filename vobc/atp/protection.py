"""One step of protection: inputs, ceiling, supervision and doors in this order, to one verdict."""

from dataclasses import dataclass

from can_dbc.vobc import Cause, Inhibit, Missing, OperatingMode, Supervision, Withheld
from firmware_py.trackdb import LineMap
from vobc.atp.braking import SafeBraking
from vobc.atp.ceiling import CeilingMap
from vobc.atp.config import AtpConfig
from vobc.atp.doors import SHUT, DoorEnable, enabled_doors, platform_at
from vobc.atp.inputs import (
    BRAKE,
    DESK,
    DOORS,
    FLAGS,
    ODOMETER,
    TRACTION,
    in_words,
    silent,
    unready,
)
from vobc.atp.supervision import Seen, cause_of, in_cause_words, next_state
from vobc.vocabulary import Ceiling, CycleInput, Motion

MOVING_STATES = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)

STATE_WORDS = {
    Supervision.NOMINAL: "",
    Supervision.WARNING: "speed over the warning limit",
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """What protection says in one cycle; operation may only ask for less."""

    supervision: Supervision
    cause: str
    missing: Missing
    ceiling: Ceiling | None
    doors_locked: bool
    """Heard freshly; a door unit that is silent has no locked doors."""
    emergency_released: bool
    service_brake: bool
    """Full service brake whatever operation asks for."""
    traction_permitted: bool
    hold: bool
    """The holding brake stays on."""
    doors: DoorEnable
    mode: OperatingMode = OperatingMode.STANDBY
    emergency_cause: Cause = Cause.NONE
    departure_inhibits: Inhibit = Inhibit.NONE
    """Why the train may not set off from where it stands."""
    doors_withheld: Withheld = Withheld.NONE
    reverse_permitted: bool = False
    """Traction may act backwards: a jog."""
    jog_permitted: bool = False
    jog_back_m: float = 0.0
    """How far back from where it stands the train may jog."""
    jog_attempts: int = 0
    stop_now: bool = False
    """Operation is to come to rest wherever it is; protection brakes only if it does not."""
    stop_next: bool = False
    """A stop at the next station is not to be left out."""
    keep_doors_open: bool = False
    creep: bool = False
    """Operation may drive on sight at the permitted speed."""
    replicas_agree: bool = True
    alarm_raised: bool = False
    door_bypass: bool = False


class Protection:
    """Holds what protection remembers: its state, why it brakes, and where the train was."""

    def __init__(
        self, config: AtpConfig, line: LineMap, *, train_length_m: float, cycle_s: float
    ) -> None:
        self._config = config
        self._line = line
        braking = SafeBraking(
            guaranteed_decel_mps2=config.guaranteed_decel_mps2,
            runaway_mps2=config.runaway_mps2,
            # A speed may be reached just after a cycle has looked, and the next one may be late.
            runaway_s=config.sensing_s + 2.0 * cycle_s + config.traction_cut_s,
            build_up_s=config.brake_build_up_s,
        )
        self._ceilings = CeilingMap(config, braking, line, train_length_m=train_length_m)
        self._state = Supervision.NO_AUTHORITY
        self._cause: Cause | None = None
        self._foremost_m = 0.0
        self._held_at_m = 0.0
        self._reset_was_pressed = True

    def step(
        self,
        seen: CycleInput,
        motion: Motion | None,
        *,
        odometer_usable: bool,
        not_finite: bool,
    ) -> Verdict:
        """Decide once. `not_finite` says that the cycle before ended in the safe output by that."""
        gone = silent(seen, self._config, odometer_usable=odometer_usable)
        missing = gone | unready(seen, motion)
        if motion is None:
            return self._blind(missing)
        end_m = seen.authority.end_m if seen.authority is not None else motion.front_m.low
        ceiling = self._ceilings.at(motion.front_m, end_m)
        facts = self._facts(seen, motion, ceiling, missing, gone, not_finite=not_finite)
        self._move_on(facts, motion.travel_m)
        return self._verdict(seen, motion, ceiling, missing, gone)

    def _blind(self, missing: int) -> Verdict:
        """Nothing was ever heard of the wheels: the train is held, nothing else is known."""
        return Verdict(
            supervision=self._state,
            cause=_waiting(missing),
            missing=FLAGS[missing],
            ceiling=None,
            doors_locked=False,
            emergency_released=False,
            service_brake=True,
            traction_permitted=False,
            hold=True,
            doors=SHUT,
        )

    def _facts(
        self,
        seen: CycleInput,
        motion: Motion,
        ceiling: Ceiling,
        missing: int,
        gone: int,
        *,
        not_finite: bool,
    ) -> Seen:
        desk = seen.desk if not gone & DESK else None
        pressed = desk is not None and desk.reset_requested
        # A reset that is pressed all the time, or was pressed before the desk fell silent, is none.
        fresh_reset = pressed and not self._reset_was_pressed
        self._reset_was_pressed = pressed or desk is None
        self._foremost_m = max(self._foremost_m, motion.travel_m)
        return Seen(
            limits=self._config,
            speed_mps=motion.speed_mps,
            ceiling=ceiling,
            standing=motion.standing,
            standstill=motion.standstill,
            missing=missing,
            silent=gone,
            authority_age_s=seen.authority_age_s,
            rollback_m=self._foremost_m - motion.travel_m,
            held_movement_m=abs(motion.travel_m - self._held_at_m),
            button_pressed=desk is not None and not desk.emergency_released,
            overruns=seen.overruns,
            not_finite=not_finite,
            reset=fresh_reset,
        )

    def _move_on(self, facts: Seen, travel_m: float) -> None:
        before = self._state
        self._state = next_state(before, facts)
        if self._state is Supervision.EMERGENCY:
            if before is not Supervision.EMERGENCY:
                self._cause = cause_of(before, facts)
            # Where it comes to rest is where it is to be held.
            self._held_at_m = travel_m
        else:
            self._cause = None
            if self._state is not before and self._state is Supervision.NO_AUTHORITY:
                self._held_at_m = self._foremost_m = travel_m

    def _verdict(
        self, seen: CycleInput, motion: Motion, ceiling: Ceiling, missing: int, gone: int
    ) -> Verdict:
        state = self._state
        may_move = state in MOVING_STATES
        doors = seen.doors
        locked = doors is not None and doors.closed_and_locked and not missing & DOORS
        return Verdict(
            supervision=state,
            cause=self._words(missing, seen),
            missing=FLAGS[missing],
            ceiling=ceiling,
            doors_locked=locked,
            emergency_released=may_move,
            service_brake=not may_move or state is Supervision.SERVICE,
            traction_permitted=(
                may_move
                and state is not Supervision.SERVICE
                and locked
                and ceiling.permitted_mps > 0.0
            ),
            hold=state is Supervision.NO_AUTHORITY or (not may_move and motion.standing),
            doors=self._doors(seen, motion, gone),
        )

    def _doors(self, seen: CycleInput, motion: Motion, gone: int) -> DoorEnable:
        if not motion.standstill:
            return SHUT
        config, brake, traction = self._config, seen.brake, seen.traction
        return enabled_doors(
            standstill=not gone & ODOMETER,
            platform=platform_at(
                self._line.stations,
                motion.front_m,
                window_m=config.door_window_m + config.door_declared_m,
            )
            if motion.localised
            else None,
            holding_applied=brake is not None and brake.holding_applied and not gone & BRAKE,
            traction_cut=traction is not None and traction.traction_cut and not gone & TRACTION,
            emergency=self._state is Supervision.EMERGENCY,
        )

    def _words(self, missing: int, seen: CycleInput) -> str:
        if self._cause is not None:
            return in_cause_words(self._cause)
        if self._state is Supervision.NO_AUTHORITY:
            return _waiting(missing)
        if self._state is Supervision.SERVICE:
            limit_s = self._config.authority_service_ratio * self._config.authority_age_max_s
            if seen.authority_age_s >= limit_s:
                return "movement authority is getting old"
            return "speed over the service brake limit"
        return STATE_WORDS[self._state]


def _waiting(missing: int) -> str:
    return (
        f"waits for {in_words(FLAGS[missing])}" if missing else "waits until standstill is proven"
    )
