"""Effects of the wayside on a train: orders, signals, platform doors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from plant_emulator.faults.declared_train import DoorsOf
from plant_emulator.faults.declared_wayside import (
    AtsHold,
    AtsSkip,
    AtsStopNext,
    AuthorityWithdrawn,
    CentreSilent,
    CreepOrder,
    DoorsNotAuthorised,
    OtherDatabase,
    PlatformDoorObstacle,
    PlatformDoorsUnlocked,
    RearUnprotected,
    RemoteEmergency,
    RemoteRelease,
    RestrictedOrder,
    RouteSet,
    SignalStop,
    Sleep,
    SwitchLost,
    SwitchStray,
    SwitchStuck,
    TemporaryRestriction,
    TrackClosed,
    WrongMap,
    WrongSideAuthorised,
)
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.wayside.centre import NORMAL, Centre
from plant_emulator.wayside.railway import Railway
from zenoh_config.messages import SpeedRestriction

Change = Mapping[str, Any]
"""Changed fields of the centre's standing orders."""


class WaysideEffects:
    """Combines concurrent events of the wayside.

    An order is in force while any event gives it; all restrictions and signals apply.
    """

    def __init__(self, railway: Railway) -> None:
        zone, centre, doors = railway.zone, railway.centre, railway.doors
        self._centre = centre

        def unprotect(found: Sequence[bool]) -> None:
            zone.rear_protected = not found

        true_version = zone.database

        def resurvey(found: Sequence[bool]) -> None:
            zone.database = centre.database = true_version ^ bool(found)

        def hush(found: Sequence[bool]) -> None:
            centre.silent = bool(found)

        def obstruct(found: Sequence[bool]) -> None:
            doors.obstructed = bool(found)

        def shift(found: Sequence[float]) -> None:
            zone.shift_m = sum(found, 0.0)

        self._machines = {} if railway.interlocking is None else railway.interlocking.machines
        self._switches: dict[tuple[str, str], SharedSetting[bool]] = {}
        self._routes = SharedSetting[str](_signaller(railway))
        self._closed = SharedSetting[str](_closes(railway))
        self._shifted = SharedSetting[float](shift)
        self._orders = SharedSetting[Change](self._order)
        self._signals = SharedSetting[float](zone.show_stop)
        self._withdrawn = SharedSetting[bool](lambda found: zone.withdraw(bool(found)))
        self._unprotected = SharedSetting[bool](unprotect)
        self._resurveyed = SharedSetting[bool](resurvey)
        self._silent = SharedSetting[bool](hush)
        self._unlocked = SharedSetting[bool](lambda found: doors.lose_proof(bool(found)))
        self._obstructed = SharedSetting[bool](obstruct)

    def _order(self, changes: Sequence[Change]) -> None:
        orders = NORMAL
        for change in changes:
            added = change.get("restrictions", ())
            orders = replace(orders, **{**change, "restrictions": (*orders.restrictions, *added)})
        self._centre.standing = orders

    def of(self, plan: FaultPlan) -> Effect:
        if isinstance(plan.parameters, RemoteRelease):
            return Released(self._centre)
        setting = self._setting(plan.parameters)
        assert setting is not None, f"{plan.kind.name} has no effect"
        return SettingFault(plan.index, setting)

    def _switch(self, name: str, fault: str) -> SharedSetting[bool]:
        """The setting of one fault of a switch, which several faults may share."""
        machine = self._machines[name]

        def turn(found: Sequence[bool]) -> None:
            setattr(machine, fault, bool(found))

        return self._switches.setdefault((name, fault), SharedSetting[bool](turn))

    def _setting(self, parameters: Any) -> tuple[SharedSetting[Any], Any] | None:
        match parameters:
            case SignalStop(position_m=position_m):
                return self._signals, position_m
            case AuthorityWithdrawn():
                return self._withdrawn, True
            case SwitchLost(switch=switch):
                return self._switch(switch, "lost"), True
            case SwitchStray(switch=switch):
                return self._switch(switch, "strays"), True
            case SwitchStuck(switch=switch):
                return self._switch(switch, "stuck"), True
            case RouteSet(route=route):
                return self._routes, route
            case TrackClosed(track=track):
                return self._closed, track
            case WrongMap(shift_m=shift_m):
                return self._shifted, shift_m
            case RearUnprotected():
                return self._unprotected, True
            case OtherDatabase():
                return self._resurveyed, True
            case CentreSilent():
                return self._silent, True
            case PlatformDoorsUnlocked():
                return self._unlocked, True
            case PlatformDoorObstacle():
                return self._obstructed, True
        change = _change(parameters)
        return None if change is None else (self._orders, change)


def _signaller(railway: Railway) -> Callable[[Sequence[str]], None]:
    interlocking = railway.interlocking
    return (lambda found: None) if interlocking is None else interlocking.set_by_hand


def _closes(railway: Railway) -> Callable[[Sequence[str]], None]:
    interlocking = railway.interlocking

    def close(found: Sequence[str]) -> None:
        if interlocking is not None:
            interlocking.closed = frozenset(found)

    return close


def _change(parameters: Any) -> Change | None:
    match parameters:
        case AtsHold():
            return {"hold": True}
        case AtsSkip():
            return {"skip_next": True}
        case AtsStopNext():
            return {"stop_next": True}
        case RemoteEmergency():
            return {"emergency": True}
        case Sleep():
            return {"awake": False}
        case CreepOrder():
            return {"creep": True}
        case RestrictedOrder():
            return {"restricted": True}
        case WrongSideAuthorised():
            return {"wrong_side": True}
        case DoorsNotAuthorised(side=side):
            sides = {DoorsOf.LEFT: "withheld_left", DoorsOf.RIGHT: "withheld_right"}
            return {name: True for of, name in sides.items() if side in (of, DoorsOf.BOTH)}
        case TemporaryRestriction(start_m=start_m, end_m=end_m, limit_mps=limit_mps):
            low_m, high_m = sorted((start_m, end_m))
            return {"restrictions": (SpeedRestriction(low_m, high_m, limit_mps),)}
    return None


class Released:
    """Gives one reset when the event begins; its end does not take the reset back."""

    def __init__(self, centre: Centre) -> None:
        self._centre = centre

    def begin(self, now_ns: int) -> None:
        self._centre.release()

    def end(self, now_ns: int) -> None: ...

    def step(self, now_ns: int) -> bool:
        return False
