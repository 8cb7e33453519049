"""Faults of the line that feeds the train, and of its main breaker."""

from plant_emulator.faults.declared_train import BreakerOpen, LineVoltage, PowerSectionOff
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.world import World


class SupplyEffects:
    """Applies faults of the supply; among several voltages the last of the scenario counts."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._no_load_v: float | None = None
        self._closed = True
        self._voltage_v = SharedSetting[float](
            lambda found: self._connect(found[-1] if found else None)
        )
        self._open = SharedSetting[bool](lambda found: self._switch(not found))
        self._off = SharedSetting[str](world.switch_off)

    def of(self, plan: FaultPlan) -> Effect:
        parameters = plan.parameters
        if isinstance(parameters, LineVoltage):
            return SettingFault(plan.index, (self._voltage_v, parameters.voltage_v))
        if isinstance(parameters, PowerSectionOff):
            return SettingFault(plan.index, (self._off, parameters.section))
        assert isinstance(parameters, BreakerOpen), f"{plan.kind.name} has no effect"
        return SettingFault(plan.index, (self._open, True))

    def _connect(self, no_load_v: float | None) -> None:
        self._no_load_v = no_load_v
        self._world.connect_supply(no_load_v, breaker_closed=self._closed)

    def _switch(self, closed: bool) -> None:
        self._closed = closed
        self._world.connect_supply(self._no_load_v, breaker_closed=closed)
