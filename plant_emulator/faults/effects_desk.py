"""Faults at the desk and by passengers: buttons, alarms and levers."""

from collections.abc import Mapping
from typing import Any

from plant_emulator.faults.declared_train import (
    DeskLever,
    DeskMode,
    DeskReset,
    EmergencyButton,
    PassengerAlarm,
)
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.world import World

Change = Mapping[str, Any]
"""Changed fields of the desk's frame."""


class DeskEffects:
    """Applies faults of the desk; if two set the same field, the later one of the scenario
    counts.
    """

    def __init__(self, world: World) -> None:
        self._changes = SharedSetting[Change](world.disturb_desk)

    def of(self, plan: FaultPlan) -> Effect:
        return SettingFault(plan.index, (self._changes, change_of(plan)))


def change_of(plan: FaultPlan) -> Change:
    """Return the fields of the desk's frame that the fault sets."""
    match plan.parameters:
        case PassengerAlarm():
            return {"no_passenger_alarm": False}
        case EmergencyButton():
            return {"emergency_released": False}
        case DeskMode(mode=mode):
            return {"mode": mode}
        case DeskLever(lever_percent=lever_percent):
            return {"lever_percent": lever_percent}
        case DeskReset():
            return {"reset_requested": True}
    raise AssertionError(f"{plan.kind.name} has no effect")
