"""Faults of brakes and traction."""

import math
from collections.abc import Sequence
from typing import Any

from plant_emulator.faults.declared_loops import (
    LOOP_FAULTS,
    LoopBreak,
    LoopOf,
    LoopOffset,
    LoopShort,
)
from plant_emulator.faults.declared_train import (
    BrakeLate,
    BrakeStuck,
    BrakeUnitFailed,
    BrakeWeak,
    EmergencyLate,
    HoldingLate,
    HoldingSticks,
    TractionLate,
    TractionRunaway,
    TractionWeak,
)
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.world import World

LoopFault = LoopBreak | LoopOffset | LoopShort


class ActuatorEffects:
    """Combines concurrent faults of the actuators.

    Delays and offsets add, ratios multiply. Among several runaways the strongest pushes, and it
    obeys the cut-off only if all do. Among several shorts the highest current counts.
    """

    def __init__(self, world: World) -> None:
        brake, traction = world.brake, world.traction
        inertia_kg = world.consist.inertia_kg

        def run_away(found: Sequence[TractionRunaway]) -> None:
            traction.run_away(
                max((each.accel_mps2 * inertia_kg for each in found), default=None),
                obeys_cut_off=all(each.obeys_cut_off for each in found),
            )

        self._loops = SharedSetting[LoopFault](lambda found: _disturb_loops(world, found))
        self._late_s = SharedSetting[float](lambda found: brake.delay_service(sum(found, 0.0)))
        self._weak_ratio = SharedSetting[float](
            lambda found: brake.weaken_service(math.prod(found, start=1.0))
        )
        self._stuck = SharedSetting[bool](lambda found: brake.stick(any(found)))
        self._working_ratio = SharedSetting[float](
            lambda found: brake.fail(math.prod(found, start=1.0))
        )
        self._emergency_late_s = SharedSetting[float](
            lambda found: brake.delay_emergency(sum(found, 0.0))
        )
        self._holding_late_s = SharedSetting[float](
            lambda found: brake.delay_holding(sum(found, 0.0))
        )
        self._holding_sticks_s = SharedSetting[float](
            lambda found: brake.delay_holding_release(sum(found, 0.0))
        )
        self._runaway = SharedSetting[TractionRunaway](run_away)
        self._traction_ratio = SharedSetting[float](
            lambda found: traction.weaken(math.prod(found, start=1.0))
        )
        self._traction_late_s = SharedSetting[float](
            lambda found: traction.delay_removal(sum(found, 0.0))
        )

    def of(self, plan: FaultPlan) -> Effect:
        setting = self._setting(plan.parameters)
        assert setting is not None, f"{plan.kind.name} has no effect"
        return SettingFault(plan.index, setting)

    def _setting(self, parameters: Any) -> tuple[SharedSetting[Any], Any] | None:
        if isinstance(parameters, LOOP_FAULTS):
            return self._loops, parameters
        match parameters:
            case BrakeLate():
                return self._late_s, parameters.delay_s
            case BrakeWeak():
                return self._weak_ratio, parameters.gain_ratio
            case BrakeStuck():
                return self._stuck, True
            case BrakeUnitFailed():
                return self._working_ratio, 1.0 - parameters.share_ratio
            case EmergencyLate():
                return self._emergency_late_s, parameters.delay_s
            case HoldingLate():
                return self._holding_late_s, parameters.delay_s
            case HoldingSticks():
                return self._holding_sticks_s, parameters.delay_s
            case TractionRunaway():
                return self._runaway, parameters
            case TractionWeak():
                return self._traction_ratio, parameters.gain_ratio
            case TractionLate():
                return self._traction_late_s, parameters.delay_s
        return None


def _disturb_loops(world: World, found: Sequence[LoopFault]) -> None:
    assert world.loops is not None, "faults of loops on a train without"
    for which, loop in ((LoopOf.TRACTION, world.loops.traction), (LoopOf.BRAKE, world.loops.brake)):
        here = [each for each in found if each.loop in (which, LoopOf.BOTH)]
        shorts_ma = [each.current_ma for each in here if isinstance(each, LoopShort)]
        loop.disturb(
            offset_ma=sum(each.offset_ma for each in here if isinstance(each, LoopOffset)),
            short_ma=max(shorts_ma, default=None),
            broken=any(isinstance(each, LoopBreak) for each in here),
        )
