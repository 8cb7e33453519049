"""Conversion of a cycle's output into bus frames."""

import math
from collections.abc import Sequence
from typing import Final

from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import Frame, binding_of
from can_dbc.brake import BrakeCommand
from can_dbc.codec import Encoder
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, NodeState
from can_dbc.doors import ALL_CARS, DoorCars, DoorCommand
from can_dbc.nodes import Node
from can_dbc.traction import TractionCommand
from can_dbc.vobc import (
    Cause,
    EventKind,
    TargetKind,
    VobcEvent,
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
)
from vobc.vocabulary import SAFE_CURRENTS, CycleOutput, Event, Interval, SupervisedTarget
from vobc.wire.evidence import SOURCE_IDS

SENT_KINDS: Final[tuple[type[Frame], ...]] = (
    BrakeCommand,
    TractionCommand,
    DoorCommand,
    DoorCars,
    AnalogueCommand,
    VobcStatus,
    VobcMotion,
    VobcPosition,
    VobcTarget,
    VobcMode,
    VobcLimits,
    VobcSupervision,
    VobcEvent,
    HEARTBEATS[Node.VOBC],
    EMERGENCIES[Node.VOBC],
)
SLIPS_PERIOD: Final = 64
EVENT_PERIOD: Final = 65536
SPEED_REACH_STEP_MPS: Final = 0.05
SPEED_REACH_MAX_MPS: Final = 1.55
POSITION_STEP_M: Final = 0.01
"""Resolution of front and uncertainty in their frame. Each is rounded to the nearest step."""
FRONT: Final = next(each for each in binding_of(VobcPosition).fields if each.name == "front_m")
NO_TARGET: Final = SupervisedTarget(TargetKind.NONE, 0.0, math.inf)
PROTECTION_ERROR: Final = 0xFF01
"""Manufacturer-specific EMCY code: the emergency brake is latched. Its detail is the `Cause`."""
PROTECTION_REGISTER: Final = 0x81


def vital_frames(output: CycleOutput) -> tuple[Frame, Frame]:
    """Commands to brake and traction, brake first."""
    return (
        BrakeCommand(
            service_decel_mps2=output.service_decel_mps2,
            emergency_released=output.emergency_released,
            holding_released=output.holding_released,
        ),
        TractionCommand(
            force_n=output.force_n,
            direction=output.direction,
            traction_permitted=output.traction_permitted,
        ),
    )


def analogue_frame(output: CycleOutput) -> Frame:
    """Current references. Only for a train that takes its reference from current loops."""
    currents = output.currents or SAFE_CURRENTS
    return AnalogueCommand(traction_ma=currents.traction_ma, brake_ma=currents.brake_ma)


def door_frame(output: CycleOutput) -> Frame:
    """Command for the doors. `door_cars_frame` enables single cars instead of whole sides."""
    whole = output.door_cars == ALL_CARS
    return DoorCommand(
        enable_left=output.enable_left and whole,
        enable_right=output.enable_right and whole,
        open_left=output.open_left,
        open_right=output.open_right,
    )


def door_cars_frame(output: CycleOutput) -> DoorCars:
    """Enabled cars, where not the whole train is beside the platform; else no car."""
    cars = 0 if output.door_cars == ALL_CARS else output.door_cars
    return DoorCars(
        left_cars=cars if output.enable_left else 0,
        right_cars=cars if output.enable_right else 0,
    )


def status_frame(output: CycleOutput, *, work_us: float, slips: int) -> Frame:
    motion = output.motion
    return VobcStatus(
        supervision=output.supervision,
        ato_phase=output.ato_phase,
        missing=output.missing,
        localised=motion is not None and motion.localised and _can_be_sent(motion.front_m),
        slip_detected=motion is not None and motion.slip,
        work_us=work_us,
        cycle_slips=slips % SLIPS_PERIOD,
    )


def motion_frames(output: CycleOutput) -> Sequence[Frame]:
    """Speed and position. No frames are sent for unknown values."""
    motion, ceiling = output.motion, output.ceiling
    if motion is None or ceiling is None:
        return ()
    front_m = motion.front_m
    return (
        VobcMotion(
            speed_mps=motion.speed_mps.best,
            ceiling_mps=ceiling.permitted_mps,
            emergency_mps=ceiling.emergency_mps,
        ),
        VobcPosition(front_m=front_m.best, uncertainty_m=_reach_m(front_m)),
    )


def _can_be_sent(front_m: Interval) -> bool:
    """The frame can carry this place."""
    return FRONT.minimum <= front_m.best <= FRONT.maximum


def _reach_m(front_m: Interval) -> float:
    """Distance from the best estimate to the farther end. It includes the rounding of the frame.

    The frame clips a place beyond its range to the end of the range. Its largest uncertainty then
    says that the place is unknown.
    """
    if not _can_be_sent(front_m):
        return math.inf
    return max(front_m.high - front_m.best, front_m.best - front_m.low) + POSITION_STEP_M


def target_frames(output: CycleOutput) -> Sequence[Frame]:
    """Distances ahead. If there is no stop, the frame carries its largest distance."""
    if output.ceiling is None:
        return ()
    return (
        VobcTarget(
            distance_to_stop_m=output.distance_to_stop_m,
            distance_to_authority_m=output.ceiling.distance_to_authority_m,
        ),
    )


def limit_frames(output: CycleOutput) -> Sequence[Frame]:
    """Limits, intervention and most restrictive target. Without a ceiling there are no limits."""
    ceiling = output.ceiling
    target = NO_TARGET if ceiling is None or ceiling.target is None else ceiling.target
    supervised = VobcSupervision(
        intervention=output.intervention,
        reason=output.reason,
        target_kind=target.kind,
        target_mps=target.speed_mps,
        target_distance_m=target.distance_m,
    )
    if output.motion is None or ceiling is None:
        return (supervised,)
    return VobcLimits(ceiling.warning_mps, ceiling.service_mps), supervised


def mode_frame(output: CycleOutput) -> Frame:
    return VobcMode(
        mode=output.mode,
        cause=output.emergency_cause,
        departure_inhibits=output.departure_inhibits,
        doors_withheld=output.doors_withheld,
        jog_attempts=output.jog_attempts,
        replicas_agree=output.replicas_agree,
        alarm_raised=output.alarm_raised,
        speed_reach_mps=0.0 if output.motion is None else _speed_reach_mps(output.motion.speed_mps),
    )


def _speed_reach_mps(speed_mps: Interval) -> float:
    """Margin from the best estimate's magnitude to the bounds in both directions, in whole
    steps.
    """
    reach_mps = max(speed_mps.high, -speed_mps.low) - abs(speed_mps.best)
    if not reach_mps < SPEED_REACH_MAX_MPS:
        return SPEED_REACH_MAX_MPS
    return math.ceil(reach_mps / SPEED_REACH_STEP_MPS) * SPEED_REACH_STEP_MPS


def event_frame(event: Event, number: int) -> Frame:
    """One event with its first two source frames. Tags and radio messages have no identifier.

    A refused frame is its own source.
    """
    ids = [SOURCE_IDS[source] for source in event.sources if source in SOURCE_IDS]
    if event.kind is EventKind.FRAME_REJECTED:
        ids = [event.number]
    return VobcEvent(
        event=event.kind,
        cause=event.number,
        number=number % EVENT_PERIOD,
        frame_a=ids[0] if ids else 0,
        frame_b=ids[1] if len(ids) > 1 else 0,
    )


def heartbeat(state: NodeState) -> Frame:
    return HEARTBEATS[Node.VOBC](state)


def emergency_message(cause: Cause | None) -> Frame:
    """EMCY message for a latched emergency brake. None: the emergency has ended."""
    message = EMERGENCIES[Node.VOBC]
    if cause is None:
        return message(0, 0, 0)
    return message(PROTECTION_ERROR, PROTECTION_REGISTER, int(cause))


def make_encoder() -> Encoder:
    """An encoder prepared for all frames of the controller, so that no cycle waits for it."""
    return Encoder(SENT_KINDS)
