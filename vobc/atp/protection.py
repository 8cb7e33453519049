"""One step of protection: inputs, ceiling, stations, mode, emergencies, supervision, verdict."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from can_dbc.cab import CabMode, Desk
from can_dbc.vobc import Cause, Inhibit, OperatingMode, Supervision
from firmware_py.trackdb import LineMap
from vobc.atp.braking import SafeBraking
from vobc.atp.ceiling import CeilingMap
from vobc.atp.config import AtpConfig
from vobc.atp.doors import SHUT
from vobc.atp.emergencies import latched_after, present
from vobc.atp.energy_check import EnergyCheck, Replicas
from vobc.atp.fixed_ceilings import FixedCeilings
from vobc.atp.guard_inputs import NOWHERE, GuardInputs
from vobc.atp.health import BrakeUnitWatch, Resets, StopWatch, clock_stepped
from vobc.atp.inputs import (
    ALARMS,
    AUTHORITY,
    DESK,
    DOORS,
    FLAGS,
    LOCALISATION,
    silent,
    unready,
)
from vobc.atp.modes import UNHEEDED, next_mode
from vobc.atp.movement import Movements
from vobc.atp.reasons import INTERVENTIONS, reason_of, shown_intervention, words_of
from vobc.atp.rollback import RollbackWatch
from vobc.atp.station import StationGuard, StationVerdict
from vobc.atp.supervision import next_state
from vobc.atp.verdict import ProtectionVerdict
from vobc.vocabulary import Ceiling, CycleInput, Interval, Motion, Orders

__all__ = ["Protection", "ProtectionVerdict"]

MOVING_STATES: Final = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
INHIBITS: Final = tuple(Inhibit(number) for number in range(2 * Inhibit.CENTRE_SILENT))
"""Flag sets by number. The lookup is faster than operators on an IntFlag."""
HEEDED: Final = {mode: ~int(flags) for mode, flags in UNHEEDED.items()}


class _ReceivedInputs(NamedTuple):
    """Inputs of desk, centre and brake unit, checked for their age."""

    desk: Desk | None
    orders: Orders | None
    resets: int
    """Sources that reset the emergency brake in this cycle, as flags of `Reset`."""
    brake_unit_braked: bool


class _CheckedCeiling(NamedTuple):
    """Ceiling of full supervision, with what the second computation says of it."""

    ceiling: Ceiling
    replicas_disagree: bool
    energy_exceeded: bool


class Protection:
    """State of protection: mode, supervision, latched causes and reference places of the train."""

    def __init__(
        self,
        config: AtpConfig,
        line: LineMap,
        *,
        train_length_m: float,
        cycle_s: float,
        car_lengths_m: Sequence[float] = (),
        true_per_counted: float = 1.0,
    ) -> None:
        """Args:
        car_lengths_m: of a train whose door unit opens single cars, from the front.
        true_per_counted: greatest true distance of one metre that odometry counts.
        """
        self._config = config
        self._cycle_s = cycle_s
        braking = SafeBraking(
            guaranteed_decel_mps2=config.guaranteed_decel_mps2,
            runaway_mps2=config.runaway_mps2,
            runaway_s=config.runaway_s(cycle_s),
            build_up_s=config.brake_build_up_s,
        )
        self._ceilings = CeilingMap(config, braking, line, train_length_m=train_length_m)
        self._flat = FixedCeilings(config)
        check = EnergyCheck(config, line, train_length_m=train_length_m, cycle_s=cycle_s)
        self._replicas = Replicas(config, check)
        self._station = StationGuard(
            config, line, train_length_m=train_length_m, car_lengths_m=car_lengths_m
        )
        self._rollback = RollbackWatch(
            config,
            line,
            train_length_m=train_length_m,
            cycle_s=cycle_s,
            true_per_counted=true_per_counted,
        )
        self._resets = Resets()
        self._brake_unit = BrakeUnitWatch(config)
        self._stop_watch = StopWatch(config)
        self._movement = Movements()
        self._bypass = False
        self._state = Supervision.NO_AUTHORITY
        self._mode = OperatingMode.STANDBY
        self._latched: tuple[Cause, ...] = ()
        self._present: tuple[Cause, ...] = ()
        self._emergency_number = 0
        self._line_end_m = line.end_m

    def step(
        self,
        image: CycleInput,
        motion: Motion | None,
        *,
        odometer_usable: bool,
        not_finite: bool,
        stopping_at_m: float | None = None,
    ) -> ProtectionVerdict:
        """Decide once per cycle.

        Args:
            not_finite: the cycle before ended in the safe output because a number was not finite.
            stopping_at_m: the stopping point of operation in the cycle before. It affects only jogs
                and overshoots, never the supervision of movement.
        """
        gone = silent(image, self._config, odometer_usable=odometer_usable)
        missing = gone | unready(image, motion)
        received = self._receive(image, gone)
        if motion is None:
            return self._blind(image, missing)
        station = self._station.step(
            image,
            motion,
            gone=gone,
            emergency=self._state is Supervision.EMERGENCY,
            may_move=self._state in MOVING_STATES,
            stopping_at_m=stopping_at_m,
        )
        full = self._full_ceiling(image, motion)
        # The bypass takes effect only at standstill. In motion it would brake a fast train to the
        # bypass speed.
        self._bypass = station.door_bypass and (self._bypass or motion.standing)
        if self._bypass:
            missing &= ~DOORS
        inputs = self._guard_inputs(
            image,
            motion,
            station,
            received,
            full,
            silent=gone,
            missing=missing,
            not_finite=not_finite,
        )
        self._mode = next_mode(self._mode, inputs)
        self._jog(motion, station)
        ceiling = self._ceiling(image, motion, full.ceiling, missing)
        inputs = self._move_on(motion, inputs._replace(mode=self._mode, ceiling=ceiling))
        return self._verdict(image, motion, station, inputs)

    def permitted_ahead_mps(self, image: CycleInput, front_m: Interval, way_m: float) -> float:
        """Permitted speed of full supervision `way_m` ahead of here, for operation. It supervises
        nothing.
        """
        orders = image.orders
        there_m = Interval(front_m.low + way_m, front_m.best + way_m, front_m.high + way_m)
        restrictions = () if orders is None else orders.restrictions
        end_m = self._end_m(image, front_m)
        return self._ceilings.at(there_m, end_m, restrictions).permitted_mps

    # Inputs.

    def _fresh_orders(self, image: CycleInput) -> Orders | None:
        return image.orders if image.orders_age_s <= self._config.orders_age_max_s else None

    def _receive(self, image: CycleInput, gone: int) -> _ReceivedInputs:
        """Read desk, centre and brake unit. These do not depend on the odometer."""
        desk, orders = None if gone & DESK else image.desk, self._fresh_orders(image)
        return _ReceivedInputs(
            desk=desk,
            orders=orders,
            resets=self._resets.step(desk, orders, self._emergency_number),
            brake_unit_braked=self._brake_unit.step(
                image.brake, released=self._state in MOVING_STATES, dt_s=image.dt_s
            ),
        )

    def _full_ceiling(self, image: CycleInput, motion: Motion) -> _CheckedCeiling:
        """Ceiling of full supervision. The second computation checks it from the same inputs."""
        if not motion.localised:
            return _CheckedCeiling(NOWHERE, replicas_disagree=False, energy_exceeded=False)
        orders, front_m = image.orders, motion.front_m
        end_m = self._end_m(image, front_m)
        restrictions = () if orders is None else orders.restrictions
        full = self._ceilings.at(front_m, end_m, restrictions)
        agree = self._replicas.agree(
            full.emergency_mps, front_m, motion.speed_mps.high, end_m, restrictions
        )
        return _CheckedCeiling(
            full, replicas_disagree=not agree, energy_exceeded=self._replicas.exceeded
        )

    def _end_m(self, image: CycleInput, front_m: Interval) -> float:
        """End of authority. Nothing is permitted beyond the map, whatever the wayside believes."""
        authority = image.authority
        return front_m.low if authority is None else min(authority.end_m, self._line_end_m)

    def _guard_inputs(
        self,
        image: CycleInput,
        motion: Motion,
        station: StationVerdict,
        received: _ReceivedInputs,
        full: _CheckedCeiling,
        *,
        silent: int,
        missing: int,
        not_finite: bool,
    ) -> GuardInputs:
        """Everything that a guard may rely on. Mode and latched causes are those before now."""
        config, movement = self._config, self._movement
        movement.look(motion)
        desk, orders = received.desk, received.orders
        at_desk = desk is not None and desk.mode is CabMode.MANUAL
        asked = desk is not None and desk.restricted_requested
        allowed = orders is not None and orders.restricted
        automatic = desk is not None and desk.mode is CabMode.AUTO
        # While the centre is silent, its last order stays valid where that is the safe side.
        last = image.orders
        return GuardInputs(
            config,
            speed_mps=motion.speed_mps,
            standing=motion.standing,
            standstill=motion.standstill,
            rollback_m=movement.rollback_m,
            rollback_room_m=self._rollback.room_m(movement.rollback_m, motion),
            held_movement_m=movement.held_m,
            jog_movement_m=movement.jog_m,
            behind_jog_m=movement.behind_jog_m,
            missing=missing,
            silent=silent,
            authority_age_s=image.authority_age_s,
            restrictions_age_s=image.orders_age_s,
            full_mps=full.ceiling.permitted_mps,
            sleep_ordered=last is not None and not last.awake,
            person_at_desk=at_desk,
            sight_asked=at_desk and (asked or allowed),
            creep_ordered=automatic and orders is not None and orders.creep,
            jog_granted=station.jog_permitted,
            stop_by_mps=self._stop_watch.stop_by_mps(
                station.stop_now, speed_mps=motion.speed_mps.best, dt_s=image.dt_s
            ),
            resets=received.resets,
            overshot_little=station.self_release,
            button_pressed=desk is not None and not desk.emergency_released,
            ordered_to_stop=last is not None and last.emergency,
            station_cause=station.emergency,
            brake_unit_braked=received.brake_unit_braked,
            overruns=image.overruns,
            clock_stepped=clock_stepped(
                image.dt_s,
                image.overruns,
                cycle_s=self._cycle_s,
                tolerance_s=config.clock_tolerance_s,
            ),
            not_finite=not_finite,
            replicas_disagree=full.replicas_disagree,
            energy_exceeded=full.energy_exceeded,
            mode=self._mode,
            latched=self._latched,
        )

    # Decisions.

    def _jog(self, motion: Motion, station: StationVerdict) -> None:
        if self._mode is OperatingMode.JOG:
            self._movement.jogs(motion, station.jog_back_m)
        else:
            self._movement.jogs_no_more(motion)

    def _ceiling(self, image: CycleInput, motion: Motion, full: Ceiling, missing: int) -> Ceiling:
        """Ceiling of the mode. On sight it is a fixed speed, lowered by what is known ahead."""
        flat, mode = self._flat, self._mode
        if mode is OperatingMode.JOG:
            return flat.under(full, flat.jog)
        if mode is OperatingMode.RESTRICTED or mode is OperatingMode.CREEP:
            sight = flat.restricted if mode is OperatingMode.RESTRICTED else flat.creep
            if missing & LOCALISATION:
                return sight
            if not missing & AUTHORITY:
                return flat.under(full, sight)
            return flat.under(self._endless_ceiling(image, motion.front_m), sight)
        return flat.under(full, flat.restricted) if self._bypass else full

    def _endless_ceiling(self, image: CycleInput, front_m: Interval) -> Ceiling:
        """Limits and end of the line, and restrictions of the centre, without an authority."""
        restrictions = () if image.orders is None else image.orders.restrictions
        known = self._ceilings.at(front_m, self._line_end_m, restrictions)
        return replace(known, distance_to_authority_m=0.0)

    def _move_on(self, motion: Motion, inputs: GuardInputs) -> GuardInputs:
        """Latch causes and step the supervision. Returns the inputs with the latched causes."""
        before = self._state
        causes = latched_after(before, inputs)
        self._latch(causes, present(causes, inputs))
        inputs = inputs._replace(latched=self._latched)
        self._state = next_state(before, inputs)
        if self._state is Supervision.EMERGENCY:
            # The train is to be held where it comes to rest.
            self._movement.held_here(motion)
        elif self._state is not before and self._state is Supervision.NO_AUTHORITY:
            self._movement.restart(motion)
        return inputs

    def _latch(self, causes: tuple[Cause, ...], now: tuple[Cause, ...] = ()) -> None:
        """Count each cause that comes, so that a reset for an earlier one does not release it.

        Args:
            now: causes that are present in this cycle. One that was gone and comes again counts.
        """
        for cause in causes:
            again = cause in now and cause not in self._present
            self._emergency_number += again or cause not in self._latched
        self._latched, self._present = causes, now

    # Outputs.

    def _blind(self, image: CycleInput, missing: int) -> ProtectionVerdict:
        """Verdict while odometry has no motion yet: the train is held."""
        if self._state in MOVING_STATES:
            self._latch((Cause.VITAL_INPUT_LOST,))
            self._state = Supervision.EMERGENCY
        inputs = GuardInputs(
            self._config,
            missing=missing,
            authority_age_s=image.authority_age_s,
            restrictions_age_s=image.orders_age_s,
            mode=self._mode,
            latched=self._latched,
        )
        reason = reason_of(self._state, inputs)
        return ProtectionVerdict(
            supervision=self._state,
            cause=words_of(reason, inputs),
            intervention=INTERVENTIONS[self._state],
            reason=reason,
            missing=FLAGS[missing],
            ceiling=None,
            doors_locked=False,
            emergency_released=False,
            service_brake=True,
            traction_permitted=False,
            hold=True,
            doors=SHUT,
            mode=self._mode,
            emergency_cause=self._cause,
            emergency_number=self._emergency_number,
        )

    def _verdict(
        self, image: CycleInput, motion: Motion, station: StationVerdict, inputs: GuardInputs
    ) -> ProtectionVerdict:
        state, mode, ceiling = self._state, self._mode, inputs.ceiling
        may_move = state in MOVING_STATES
        doors = image.doors
        locked = doors is not None and doors.closed_and_locked and not inputs.silent & DOORS
        inhibits = self._inhibits(station)
        # Station inhibits last until the train has moved some distance. A single pulse does not end
        # them.
        kept = inhibits != 0
        traction_permitted = (
            may_move
            and state is not Supervision.SERVICE
            and (locked or self._bypass)
            and ceiling.permitted_mps > 0.0
            and not kept
        )
        reason = reason_of(state, inputs)
        intervention, shown = shown_intervention(
            state, reason, permitted=traction_permitted, kept=kept, locked=locked or self._bypass
        )
        jogs = mode is OperatingMode.JOG and may_move and station.jog_permitted
        back_m = station.jog_back_m if jogs else 0.0
        asleep = mode is OperatingMode.ASLEEP
        return ProtectionVerdict(
            supervision=state,
            cause=words_of(reason, inputs),
            intervention=intervention,
            reason=shown,
            missing=FLAGS[inputs.missing],
            ceiling=ceiling,
            doors_locked=locked,
            emergency_released=may_move,
            service_brake=not may_move or state is Supervision.SERVICE,
            traction_permitted=traction_permitted,
            # A standing train without traction would roll where the track is not level.
            hold=(
                state is Supervision.NO_AUTHORITY
                or kept
                or (motion.standing and not traction_permitted)
            ),
            doors=SHUT if asleep or state is Supervision.EMERGENCY else station.doors,
            door_cars=station.door_cars,
            mode=mode,
            emergency_cause=self._cause,
            emergency_number=self._emergency_number,
            departure_inhibits=INHIBITS[inhibits],
            doors_withheld=station.withheld,
            reverse_permitted=back_m > 0.0,
            jog_permitted=jogs,
            jog_to_tag=station.jog_to_tag,
            jog_back_m=back_m,
            jog_attempts=station.jog_attempts,
            stop_now=station.stop_now,
            stop_next=station.stop_next or bool(inputs.missing & ALARMS),
            keep_doors_open=station.keep_doors_open and not asleep,
            creep=mode is OperatingMode.CREEP,
            replicas_agree=not inputs.replicas_disagree,
            alarm_raised=station.alarm_raised,
            door_bypass=self._bypass,
        )

    def _inhibits(self, station: StationVerdict) -> int:
        mode = self._mode
        inhibits = int(station.inhibits) & HEEDED[mode]
        return inhibits | Inhibit.ASLEEP if mode is OperatingMode.ASLEEP else inhibits

    @property
    def _cause(self) -> Cause:
        return self._latched[0] if self._latched else Cause.NONE
