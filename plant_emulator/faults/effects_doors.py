"""Faults of the doors."""

from collections.abc import Callable, Collection

from plant_emulator.actuators.doors import DoorSide, DoorUnit
from plant_emulator.faults.declared_train import (
    DoorDeaf,
    DoorLockLost,
    DoorObstacle,
    DoorOpens,
    DoorsOf,
)
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.world import World


class DoorEffects:
    def __init__(self, world: World) -> None:
        doors = world.doors

        def block(side: DoorSide, on: bool) -> None:
            side.blocked = on

        def deafen(side: DoorSide, on: bool) -> None:
            side.deaf = on

        self._line_lost = SharedSetting[bool](lambda found: doors.lose_lock_line(bool(found)))
        self._forced = SharedSetting[DoorsOf](
            lambda found: doors.force_open(
                left=_is_of(DoorsOf.LEFT, found), right=_is_of(DoorsOf.RIGHT, found)
            )
        )
        self._blocked = SharedSetting[DoorsOf](lambda found: _on_sides(doors, found, block))
        self._deaf = SharedSetting[DoorsOf](lambda found: _on_sides(doors, found, deafen))

    def of(self, plan: FaultPlan) -> Effect:
        match plan.parameters:
            case DoorLockLost():
                return SettingFault(plan.index, (self._line_lost, True))
            case DoorOpens(side=side):
                return SettingFault(plan.index, (self._forced, side))
            case DoorObstacle(side=side):
                return SettingFault(plan.index, (self._blocked, side))
            case DoorDeaf(side=side):
                return SettingFault(plan.index, (self._deaf, side))
        raise AssertionError(f"{plan.kind.name} has no effect")


def _is_of(side: DoorsOf, found: Collection[DoorsOf]) -> bool:
    return side in found or DoorsOf.BOTH in found


def _on_sides(
    doors: DoorUnit, found: Collection[DoorsOf], change: Callable[[DoorSide, bool], None]
) -> None:
    change(doors.left, _is_of(DoorsOf.LEFT, found))
    change(doors.right, _is_of(DoorsOf.RIGHT, found))
