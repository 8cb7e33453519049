"""Checks whether a fault of the train or the wayside changed anything in the last step.

A weak brake changes nothing until it is applied, and an unread tag changes nothing where no tag
lies. A run in which a fault never changed anything does not show how the train reacts to it.
"""

from collections.abc import Callable
from typing import Any

from can_dbc.doors import DoorState
from plant_emulator.actuators.doors import DoorSide
from plant_emulator.faults.declared_loops import LoopOffset
from plant_emulator.faults.declared_train import (
    AntennaDead,
    BrakeLate,
    BrakeStuck,
    BrakeUnitFailed,
    BrakeWeak,
    DoorDeaf,
    DoorLockLost,
    DoorObstacle,
    DoorOpens,
    DoorsOf,
    DopplerWrong,
    EmergencyLate,
    HoldingLate,
    HoldingSticks,
    ImuBias,
    LineVoltage,
    LoadCell,
    LowAdhesion,
    PowerSectionOff,
    TachoDrift,
    TachoInterference,
    TachoStuck,
    TagDisplaced,
    TractionLate,
    TractionRunaway,
    TractionWeak,
    TrainLonger,
    WheelSlide,
    WheelSlip,
    WheelWear,
)
from plant_emulator.faults.declared_wayside import (
    AuthorityWithdrawn,
    CentreSilent,
    ColdMoved,
    DoorsNotAuthorised,
    OtherDatabase,
    PlatformDoorObstacle,
    PlatformDoorsUnlocked,
    RearUnprotected,
    RouteSet,
    SignalStop,
    SwitchLost,
    SwitchStray,
    SwitchStuck,
    TrackClosed,
    WrongMap,
    WrongSideAuthorised,
)
from plant_emulator.faults.effects_desk import change_of
from plant_emulator.faults.kinds import FaultPlace
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.wayside.railway import Railway
from plant_emulator.world import World
from zenoh_config.messages import RefusedReason

Touch = Callable[[], bool]
"""Check that is called once after each step of the plant in which the fault is active."""


def touch_of(plan: FaultPlan, world: World, railway: Railway) -> Touch:
    """Return the check of one fault.

    A kind without a check of its own counts as changing a value in every step.
    """
    parameters = plan.parameters
    if plan.kind.place is FaultPlace.DESK:
        change = change_of(plan)
        return lambda: any(getattr(world.own_desk, key) != change[key] for key in change)
    if plan.kind.place is FaultPlace.DOORS:
        return _of_doors(parameters, world)
    if plan.kind.place is FaultPlace.WAYSIDE:
        return _of_wayside(parameters, railway)
    for kind in (_of_brake, _of_effort, _of_wheels, _of_other_sensors):
        if touch := kind(parameters, world):
            return touch
    return _always


def _always() -> bool:
    return True


def _never() -> bool:
    return False


def _when(counts: bool, touch: Touch) -> Touch:
    """Return the check, or one that is never true if the fault's parameters have no effect."""
    return touch if counts else _never


def _changed(read: Callable[[], Any], by: Callable[[Any, Any], bool]) -> Touch:
    """Return a check whether a reading changed in this way since the last step."""
    before = read()

    def touch() -> bool:
        nonlocal before
        last, before = before, read()
        return by(last, before)

    return touch


def _grew(read: Callable[[], float]) -> Touch:
    return _changed(read, lambda last, now: now > last)


def _fell(read: Callable[[], float]) -> Touch:
    return _changed(read, lambda last, now: now < last)


def _of_brake(parameters: Any, world: World) -> Touch | None:
    brake, service = world.brake, world.brake.service
    match parameters:
        case BrakeLate(delay_s=delay_s):
            return _when(delay_s > 0.0, lambda: service.works)
        case BrakeWeak(gain_ratio=gain_ratio):
            return _when(gain_ratio != 1.0, lambda: service.works)
        case BrakeStuck():
            return lambda: service.held_back
        case BrakeUnitFailed(share_ratio=share_ratio):
            return _when(share_ratio > 0.0, lambda: brake.applied)
        case EmergencyLate(delay_s=delay_s):
            return _when(delay_s > 0.0, _grew(lambda: brake.emergency_wanted))
        case HoldingLate(delay_s=delay_s):
            return _when(delay_s > 0.0, _grew(lambda: brake.holding_wanted))
        case HoldingSticks(delay_s=delay_s):
            return _when(delay_s > 0.0, _fell(lambda: brake.holding_wanted))
    return None


def _of_effort(parameters: Any, world: World) -> Touch | None:
    traction = world.traction
    match parameters:
        case TractionRunaway():
            return lambda: traction.force_n > 0.0
        case TractionWeak(gain_ratio=gain_ratio):
            asked = gain_ratio != 1.0
            return _when(asked, lambda: traction.said_n > 0.0 and not traction.traction_cut)
        case TractionLate(delay_s=delay_s):
            less, no_more = _fell(lambda: traction.said_n), _fell(lambda: traction.permission)
            return _when(delay_s > 0.0, lambda: less() | no_more())
        case LoopOffset(offset_ma=offset_ma):
            return _when(offset_ma != 0.0, _always)
        case LineVoltage(voltage_v=voltage_v):
            return _when(voltage_v != world.train.supply.no_load_v, _always)
        case PowerSectionOff(section=section):
            return lambda: world.is_in(section)
    return None


def _of_wheels(parameters: Any, world: World) -> Touch | None:
    rail_ratio = world.train.rail.adhesion_ratio

    def moves() -> bool:
        return world.speed_mps != 0.0

    match parameters:
        case WheelSlip(slip_ratio=ratio) | WheelSlide(slide_ratio=ratio):
            return _when(ratio != 0.0, moves)
        case TachoInterference(pulses_per_s=ratio) | TrainLonger(extra_m=ratio):
            return _when(ratio != 0.0, _always)
        case LoadCell(share_ratio=ratio):
            return _when(ratio != 1.0 and world.train.passengers_kg > 0.0, _always)
        case TachoDrift(ratio_per_s=ratio):
            return _when(ratio != 0.0, moves)
        case TachoStuck():
            return moves
        case WheelWear(diameter_ratio=ratio):
            return _when(ratio != 1.0, moves)
        case LowAdhesion(adhesion_ratio=ratio):
            return _when(ratio < rail_ratio, lambda: world.drive_n != 0.0 or world.brake_n != 0.0)
    return None


def _of_other_sensors(parameters: Any, world: World) -> Touch | None:
    reader = world.tag_reader
    match parameters:
        case DopplerWrong(error_ratio=ratio):
            return _when(ratio != 0.0, lambda: world.speed_mps != 0.0)
        case ImuBias(bias_mps2=bias_mps2):
            return _when(bias_mps2 != 0.0, _always)
        case TagDisplaced():
            return _grew(lambda: reader.displaced_read)
        case AntennaDead(hidden=hidden):
            return _grew(lambda: reader.tags_lost) if hidden else _always
        case ColdMoved(moved_m=moved_m, monitored=monitored):
            return _when(moved_m != 0.0 or not monitored, _always)
    return None


def _of_doors(parameters: Any, world: World) -> Touch:
    doors = world.doors

    def sides(of: DoorsOf) -> tuple[DoorSide, ...]:
        left = (doors.left,) if of is not DoorsOf.RIGHT else ()
        return (*left, doors.right) if of is not DoorsOf.LEFT else left

    match parameters:
        case DoorLockLost():
            return lambda: all(side.state is DoorState.LOCKED for side in sides(DoorsOf.BOTH))
        case DoorOpens(side=of):
            return lambda: any(side.state is not DoorState.LOCKED for side in sides(of))
        case DoorObstacle(side=of):
            return lambda: any(side.state is DoorState.OBSTRUCTED for side in sides(of))
        case DoorDeaf(side=of):
            return lambda: any(
                doors.wanted_open(side) and side.state in (DoorState.LOCKED, DoorState.CLOSING)
                for side in sides(of)
            )
    raise AssertionError(f"{type(parameters).__name__} is not a fault of the doors")


def _of_switches(parameters: Any, railway: Railway) -> Touch | None:
    interlocking = railway.interlocking
    assert interlocking is not None
    machines = interlocking.machines
    match parameters:
        case SwitchLost():
            return _always
        case SwitchStray(switch=switch):
            return lambda: machines[switch].detected is not machines[switch].aim
        case SwitchStuck(switch=switch):
            return lambda: machines[switch].detected is not machines[switch].aim
        case RouteSet(route=route):
            return lambda: interlocking.is_set(route)
        case TrackClosed(track=track):
            return lambda: interlocking.needs(track)
    return None


def _of_wayside(parameters: Any, railway: Railway) -> Touch:
    zone, centre, doors = railway.zone, railway.centre, railway.doors
    if railway.interlocking is not None and (touch := _of_switches(parameters, railway)):
        return touch
    match parameters:
        case SignalStop(position_m=position_m):
            return lambda: zone.latest is not None and zone.latest.end_m == position_m
        case AuthorityWithdrawn() | RearUnprotected():
            return _grew(lambda: zone.answered)
        case WrongMap(shift_m=shift_m):
            return _when(shift_m != 0.0, _grew(lambda: zone.answered))
        case OtherDatabase():
            return _grew(lambda: centre.refusals[RefusedReason.OTHER_DATABASE])
        case CentreSilent():
            return _grew(lambda: centre.unanswered)
        case DoorsNotAuthorised():
            return _grew(lambda: centre.withheld)
        case WrongSideAuthorised():
            return lambda: (
                centre.latest is not None
                and (centre.latest.doors_left or centre.latest.doors_right)
            )
        case PlatformDoorsUnlocked():
            return lambda: doors.all_closed and not doors.all_locked
        case PlatformDoorObstacle():
            return _grew(lambda: doors.obstacles_met)
    # All other kinds are orders, which every answer carries.
    return _grew(lambda: centre.answered)
