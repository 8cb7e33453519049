"""One control cycle on one page: odometry, protection, operation, arbitration, in this order."""

from dataclasses import replace
from typing import Final, Protocol

from can_dbc.cab import CabMode
from can_dbc.doors import DoorState, DoorStatus
from can_dbc.vobc import Inhibit, Missing, OperatingMode, Supervision
from firmware_py.trackdb import LineMap
from vobc.arbitration import BRAKED_DEMAND, arbitrate, inertia_kg, manual_demand, most_accel_mps2
from vobc.ato import Ato, current_loop
from vobc.ato.settings.ato import AtoConfig
from vobc.atp import Protection, ProtectionVerdict
from vobc.config import VobcConfig
from vobc.odometry import Odometry
from vobc.vocabulary import (
    AtoDemand,
    AtoInput,
    CycleInput,
    CycleOutput,
    Interval,
    Mission,
    Motion,
    OdometryRecord,
)
from vobc.zones import EvacuationHold, NeutralSections, ZoneHold

ATO_STATES: Final = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
NOT_FOR_DRIVING: Final = int(Missing.DOORS | Missing.ALARMS)
"""Inputs not needed for driving. Protection keeps a standing train, and a moving one continues to
the next stop."""

KEPT: Final = ~int(Inhibit.DOORS | Inhibit.PLATFORM_DOORS | Inhibit.AUTHORITY)
"""Inhibits that keep doors open. Doors close only for departure, so door locks and authority must
not keep them open for ever."""
COVERED_MPS: Final = 1.2
"""Distance of the greatest possible speed from the likeliest one that the margins of operation
cover. It is larger only without a radar."""
VAGUE_RATIO: Final = 1.5
"""Reduction of the ceiling relative to the uncertainty, which grows while the train brakes."""
VAGUE_SLOPE: Final = 4.0
"""Growth of the reduction from `COVERED_MPS` on. It keeps the ceiling free of steps."""
STRONG_MPS2: Final = 1.0
"""Guaranteed emergency brake rate from which the braking of each law stays below the permitted
speed by its own curves."""
SUPPLY_AGE_MAX_S: Final = 0.5
"""Greatest age of a voltage: five periods of the high-voltage box."""


class Operation(Protocol):
    """Any component that drives the train within the limits of protection."""

    def step(self, inputs: AtoInput) -> AtoDemand: ...


class Controller:
    """State of the on-board controller between cycles. It never reads a clock."""

    def __init__(
        self,
        config: VobcConfig,
        line: LineMap,
        mission: Mission,
        start: OdometryRecord,
        operation: Operation | None = None,
    ) -> None:
        """`operation` replaces the configured automatic operation.

        Raises ValueError for an unknown strategy.
        """
        self._config = config
        self._cycle_s = config.cycle_ms / 1000.0
        self._line = line
        self._train = config.train
        self._odometry = Odometry(config.odometry, config.train, line, start)
        self._protection = Protection(
            config.atp,
            line,
            train_length_m=config.train.length_m,
            cycle_s=self._cycle_s,
            car_lengths_m=config.train.car_lengths_m,
            true_per_counted=config.true_per_counted,
        )
        self._operation = operation or Ato(
            _within_service_brake(config), line, mission.start.stop_m, mission.stops
        )
        self._looks_ahead = config.atp.guaranteed_decel_mps2 < STRONG_MPS2
        self._neutral = NeutralSections(config, line)
        self._hold = ZoneHold(config, line)
        self._evacuation = EvacuationHold(config, line)
        self._manual_mps2 = 0.0
        self._weighed = False
        self._weighed_kg = config.train.full_load_kg
        self._not_finite = False
        self._stopping_at_m: float | None = None
        self.verdict: ProtectionVerdict | None = None
        """Verdict of protection in the last cycle."""

    @property
    def rejected_tags(self) -> int:
        return self._odometry.rejected_tags

    def record(self) -> OdometryRecord:
        """State to keep over a power cycle. It is meant for a standing train."""
        return self._odometry.record()

    def step(self, inputs: CycleInput) -> CycleOutput:
        """Decide once. Missing, stale or non-finite inputs lead to the restrictive result."""
        motion = self._odometry.step(inputs)
        self._weigh(inputs, motion)
        verdict = self._protection.step(
            inputs,
            motion,
            odometer_usable=self._odometry.usable,
            not_finite=self._not_finite,
            stopping_at_m=self._stopping_at_m,
        )
        self.verdict = verdict
        demand = self._demand(inputs, motion, verdict)
        self._stopping_at_m = demand.stopping_at_m
        if motion is not None and self._neutral.off(motion):
            verdict = replace(verdict, traction_permitted=False)
        output = arbitrate(
            verdict, demand, motion, inputs.desk, train=self._train, load_kg=self._weighed_kg
        )
        self._not_finite = output.motion is None and motion is not None
        if motion is not None and motion.standstill and (zone := self._hold.stands_in(motion)):
            output = replace(output, stands_in=zone)
        return self._with_currents(output)

    def _with_currents(self, output: CycleOutput) -> CycleOutput:
        """Add the currents for a train with current loops. The safe output has none."""
        stage = self._config.ato.output
        if stage.stage != "current_loop" or output.motion is None:
            return output
        currents = current_loop.reference(
            output.force_n,
            output.service_decel_mps2,
            inertia_kg=inertia_kg(self._train, self._weighed_kg),
            config=stage,
        )
        return replace(output, currents=currents)

    def _demand(
        self, inputs: CycleInput, motion: Motion | None, verdict: ProtectionVerdict
    ) -> AtoDemand:
        """Demand of the driver or of operation.

        Operation runs in every cycle, so that it can take over smoothly.
        """
        desk = inputs.desk
        if motion is None or verdict.ceiling is None or desk is None:
            return BRAKED_DEMAND
        automatic = self._operation.step(self._ato_input(inputs, motion, verdict))
        if desk.mode is not CabMode.MANUAL:
            self._manual_mps2 = 0.0
            return automatic if desk.mode is CabMode.AUTO else BRAKED_DEMAND
        manual = manual_demand(
            desk,
            self._manual_mps2,
            motion.standing,
            train=self._train,
            # A stepped clock causes no jerk: the change is limited to that of one cycle.
            jerk_mps=self._config.manual_jerk_mps3 * min(inputs.dt_s, self._cycle_s),
        )
        self._manual_mps2 = manual.accel_mps2
        return manual

    def _ato_input(
        self, inputs: CycleInput, motion: Motion, verdict: ProtectionVerdict
    ) -> AtoInput:
        assert verdict.ceiling is not None
        front_m = motion.front_m.best
        brake, doors, traction = inputs.brake, inputs.doors, inputs.traction
        enabled = (
            inputs.desk is not None
            and inputs.desk.mode is CabMode.AUTO
            and verdict.supervision in ATO_STATES
            and (verdict.creep or not int(verdict.missing) & ~NOT_FOR_DRIVING)
        )
        traction_ratio = 0.0 if traction is None else traction.effort_available_ratio
        most_mps2 = most_accel_mps2(
            motion.speed_mps.best, train=self._train, load_kg=self._weighed_kg
        )
        possible_ratio = 0.0 if self._neutral.eases(motion) else traction_ratio
        return AtoInput(
            now_ns=inputs.now_ns,
            dt_s=inputs.dt_s,
            enabled=enabled,
            front_m=front_m,
            speed_mps=motion.speed_mps.best,
            accel_mps2=motion.accel_mps2,
            standstill=motion.standstill,
            accepted_tag_ids=motion.accepted_tag_ids,
            gradient_permille=self._line.mean_gradient_permille(
                front_m - self._train.length_m, front_m
            ),
            ceiling_mps=self._usable_mps(inputs, motion, verdict) - _vague_mps(motion.speed_mps),
            authority_end_m=self._usable_end_m(inputs, motion),
            load_kg=self._weighed_kg,
            traction_ratio=traction_ratio,
            traction_mps2=possible_ratio * most_mps2,
            doors_locked=verdict.doors_locked or verdict.door_bypass,
            doors_open=not verdict.doors_locked and self._platform_side_open(doors, front_m),
            door_enabled=verdict.doors.left or verdict.doors.right,
            holding_applied=brake is not None and brake.holding_applied,
            departure_permitted=not verdict.departure_inhibits,
            skip_next=inputs.orders is not None
            and inputs.orders.skip_next
            and not verdict.stop_next,
            stop_next=verdict.stop_next,
            stop_now=verdict.stop_now,
            keep_doors_open=verdict.keep_doors_open,
            jog_permitted=verdict.jog_permitted,
            jog_to_tag=verdict.jog_to_tag,
            jog_back_m=verdict.jog_back_m,
            creep=verdict.creep,
            protection_brakes=verdict.service_brake,
            kept_at_platform=bool(int(verdict.departure_inhibits) & KEPT),
            ahead_m=motion.front_m.high - front_m,
            slips=motion.adhesion_lost,
            line_voltage_v=_line_voltage_v(inputs),
        )

    def _usable_mps(self, inputs: CycleInput, motion: Motion, verdict: ProtectionVerdict) -> float:
        """Permitted speed for operation: with a weak emergency brake also that at the place where
        a brake demand of now acts fully.
        """
        assert verdict.ceiling is not None
        here_mps = verdict.ceiling.permitted_mps
        if not self._looks_ahead or verdict.mode is not OperatingMode.AUTHORISED:
            return here_mps
        way_m = max(0.0, motion.speed_mps.best) * self._config.ato.brake_acts_s
        ahead_mps = self._protection.permitted_ahead_mps(inputs, motion.front_m, way_m)
        return min(here_mps, ahead_mps)

    def _usable_end_m(self, inputs: CycleInput, motion: Motion) -> float:
        """End of the authority that operation may use: the zones of the line may take it back."""
        if inputs.authority is None:
            return motion.front_m.best
        end_m = self._hold.end_m(min(inputs.authority.end_m, self._line.end_m), motion)
        return self._evacuation.end_m(end_m, motion, inputs.dt_s)

    def _weigh(self, inputs: CycleInput, motion: Motion | None) -> None:
        """Update the load. Passengers board only a standing train, so a load reported on the way is
        ignored.

        Until the first report the train counts as full.
        """
        standing = motion is None or motion.standing
        if inputs.load is not None and (standing or not self._weighed):
            self._weighed = True
            self._weighed_kg = inputs.load.load_kg

    def _platform_side_open(self, doors: DoorStatus | None, front_m: float) -> bool:
        if doors is None:
            return False
        station = min(self._line.stations, key=lambda station: abs(station.stop_m - front_m))
        left, right = doors.left is DoorState.OPEN, doors.right is DoorState.OPEN
        return (station.side.left and left) or (station.side.right and right)


def _within_service_brake(config: VobcConfig) -> AtoConfig:
    """Settings of operation whose greatest brake demand the train's service brake can give."""
    limits = config.ato.limits
    most_mps2 = min(limits.brake_demand_max_mps2, config.train.service_decel_max_mps2)
    return replace(config.ato, limits=replace(limits, brake_demand_max_mps2=most_mps2))


def _line_voltage_v(inputs: CycleInput) -> float | None:
    supply = inputs.supply
    if supply is None or not supply.breaker_closed or inputs.supply_age_s > SUPPLY_AGE_MAX_S:
        return None
    return supply.line_voltage_v


def _vague_mps(speed_mps: Interval) -> float:
    """Reduction of the ceiling for an uncertain speed, beyond what the margins cover."""
    ahead_mps = speed_mps.high - speed_mps.best
    return max(0.0, min(VAGUE_RATIO * ahead_mps, VAGUE_SLOPE * (ahead_mps - COVERED_MPS)))
