"""Alarms of the train: obstacle, fire, and movement while the controller was off."""

from collections.abc import Sequence
from dataclasses import replace

from plant_emulator.faults.declared_wayside import ColdMoved, Fire, Obstacle
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.world import World


class AlarmEffects:
    """Applies alarms; among several cold movements the largest counts."""

    def __init__(self, world: World) -> None:
        def burn(found: Sequence[bool]) -> None:
            world.alarms = replace(world.alarms, no_fire=not found)

        def touch(found: Sequence[bool]) -> None:
            world.alarms = replace(world.alarms, no_obstacle=not found)

        def move(found: Sequence[ColdMoved]) -> None:
            world.cold.forced_m = max((each.moved_m for each in found), default=None)
            world.cold.monitored = all(each.monitored for each in found)

        self._fire = SharedSetting[bool](burn)
        self._obstacle = SharedSetting[bool](touch)
        self._cold = SharedSetting[ColdMoved](move)

    def of(self, plan: FaultPlan) -> Effect | None:
        """Return the effect of an alarm; None for a fault of another place."""
        match plan.parameters:
            case Obstacle():
                return SettingFault(plan.index, (self._obstacle, True))
            case Fire():
                return SettingFault(plan.index, (self._fire, True))
            case ColdMoved():
                return SettingFault(plan.index, (self._cold, plan.parameters))
        return None
