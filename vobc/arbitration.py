"""Arbitration: protection overrules operation, and the demand becomes force and brake."""

import math
from dataclasses import replace
from typing import Final

from can_dbc.cab import CabMode, Desk
from can_dbc.nodes import Direction
from can_dbc.vobc import AtoPhase, Cause, ReasonCode, Supervision
from vobc.atp import ProtectionVerdict
from vobc.vocabulary import (
    SAFE_OUTPUT,
    AtoDemand,
    Ceiling,
    CycleOutput,
    Motion,
    TrainBelief,
)

FULL_LEVER_PERCENT: Final = 100.0
NOT_FINITE_CAUSE: Final = "a number was not finite"

BRAKED_DEMAND: Final = AtoDemand(
    accel_mps2=-math.inf,
    hold=True,
    open_doors=False,
    phase=AtoPhase.OFF,
    target_mps=0.0,
    distance_to_stop_m=math.inf,
)
"""Demand if no one drives: full service brake, and the train is held."""


def arbitrate(
    verdict: ProtectionVerdict,
    demand: AtoDemand,
    motion: Motion | None,
    desk: Desk | None,
    *,
    train: TrainBelief,
    load_kg: float,
) -> CycleOutput:
    """Combine verdict and demand. In each part the more restrictive one counts.

    Any number that is not finite gives the safe output.
    """
    if not _finite(demand, motion, verdict.ceiling, load_kg):
        return _not_finite(verdict)
    force_n, decel_mps2 = effort(demand.accel_mps2, train=train, load_kg=load_kg)
    if verdict.service_brake:
        decel_mps2 = train.service_decel_max_mps2
    hold = demand.hold or verdict.hold
    # Traction against the holding brake is permitted only while operation departs against it.
    permitted = verdict.traction_permitted and (not hold or force_n > 0.0)
    if not permitted or decel_mps2 > 0.0:
        force_n = 0.0
    if demand.reverse and not verdict.reverse_permitted:
        permitted, force_n = False, 0.0
    left, right = verdict.doors
    open_left, open_right = _doors_asked(demand, desk)
    return CycleOutput(
        force_n=force_n,
        direction=_direction(permitted, reverse=demand.reverse),
        traction_permitted=permitted,
        service_decel_mps2=decel_mps2,
        emergency_released=verdict.emergency_released,
        holding_released=not hold,
        enable_left=left,
        enable_right=right,
        open_left=left and open_left,
        open_right=right and open_right,
        door_cars=verdict.door_cars,
        supervision=verdict.supervision,
        ato_phase=demand.phase,
        missing=verdict.missing,
        motion=motion,
        ceiling=verdict.ceiling,
        target_mps=demand.target_mps,
        accel_demand_mps2=max(demand.accel_mps2, -train.service_decel_max_mps2),
        distance_to_stop_m=demand.distance_to_stop_m,
        cause=verdict.cause,
        mode=verdict.mode,
        emergency_cause=verdict.emergency_cause,
        emergency_number=verdict.emergency_number,
        intervention=verdict.intervention,
        reason=verdict.reason,
        departure_inhibits=verdict.departure_inhibits,
        doors_withheld=verdict.doors_withheld,
        jog_attempts=verdict.jog_attempts,
        replicas_agree=verdict.replicas_agree,
        alarm_raised=verdict.alarm_raised or demand.calls_for_help,
        door_bypass=verdict.door_bypass,
        brake_finding=demand.brake_finding,
    )


def _doors_asked(demand: AtoDemand, desk: Desk | None) -> tuple[bool, bool]:
    """Requested doors, left and right, by the driver or by operation."""
    if desk is not None and desk.mode is CabMode.MANUAL:
        return desk.open_left_requested, desk.open_right_requested
    return demand.open_doors, demand.open_doors


def _direction(permitted: bool, *, reverse: bool) -> Direction:
    if not permitted:
        return Direction.NEUTRAL
    return Direction.REVERSE if reverse else Direction.FORWARD


def effort(accel_mps2: float, *, train: TrainBelief, load_kg: float) -> tuple[float, float]:
    """Traction force in N and service brake deceleration in m/s², never both.

    The force is limited to the rated one. The motors limit the power themselves. A limit by the
    measured speed would pass on every jump that a tag causes in it.
    """
    if accel_mps2 <= 0.0:
        return 0.0, min(-accel_mps2, train.service_decel_max_mps2)
    return min(inertia_kg(train, load_kg) * accel_mps2, train.rated_force_n), 0.0


def most_accel_mps2(speed_mps: float, *, train: TrainBelief, load_kg: float) -> float:
    """Acceleration by full traction at this speed, before gradient and resistance."""
    most_n = train.rated_force_n
    if speed_mps > 0.0:
        most_n = min(most_n, train.rated_power_w / speed_mps)
    return most_n / inertia_kg(train, load_kg)


def inertia_kg(train: TrainBelief, load_kg: float) -> float:
    """Inertia of the train. Rotating parts add to the tare mass only."""
    return train.tare_kg * (1.0 + train.rotating_mass_ratio) + load_kg


def manual_demand(
    desk: Desk, before_mps2: float, standing: bool, *, train: TrainBelief, jerk_mps: float
) -> AtoDemand:
    """Demand of the lever, changed by at most `jerk_mps` in this cycle.

    A NaN lever position gives a NaN demand, because `min` and `max` then keep their first argument.
    """
    share_ratio = max(min(desk.lever_percent / FULL_LEVER_PERCENT, 1.0), -1.0)
    full_mps2 = train.rated_force_n / (train.tare_kg * (1.0 + train.rotating_mass_ratio))
    if share_ratio < 0.0:
        full_mps2 = train.service_decel_max_mps2
    wanted_mps2 = share_ratio * full_mps2
    accel_mps2 = max(min(wanted_mps2, before_mps2 + jerk_mps), before_mps2 - jerk_mps)
    return AtoDemand(
        accel_mps2=accel_mps2,
        hold=standing and share_ratio <= 0.0,
        open_doors=False,
        phase=AtoPhase.OFF,
        target_mps=0.0,
        distance_to_stop_m=math.inf,
    )


def _finite(
    demand: AtoDemand, motion: Motion | None, ceiling: Ceiling | None, load_kg: float
) -> bool:
    """No output is NaN or infinite.

    Exceptions: without a driver the demand is minus infinity, and there may be no stop ahead.
    """
    numbers = [demand.target_mps, load_kg]
    if demand is not BRAKED_DEMAND:
        numbers.append(demand.accel_mps2)
    if motion is not None:
        front, speed = motion.front_m, motion.speed_mps
        numbers += (front.low, front.best, front.high, speed.low, speed.best, speed.high)
        numbers += (motion.accel_mps2, motion.travel_m, motion.pulses_m)
    if ceiling is not None:
        numbers += (ceiling.permitted_mps, ceiling.warning_mps, ceiling.service_mps)
        numbers += (ceiling.emergency_mps, ceiling.distance_to_authority_m)
    return all(map(math.isfinite, numbers)) and not math.isnan(demand.distance_to_stop_m)


def _not_finite(verdict: ProtectionVerdict) -> CycleOutput:
    return replace(
        SAFE_OUTPUT,
        supervision=Supervision.EMERGENCY,
        missing=verdict.missing,
        cause=NOT_FINITE_CAUSE,
        mode=verdict.mode,
        emergency_cause=Cause.NOT_FINITE,
        emergency_number=verdict.emergency_number,
        reason=ReasonCode.NOT_FINITE,
    )
