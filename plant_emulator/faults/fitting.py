"""Checks that the train has the parts that the faults of a scenario affect."""

from collections.abc import Iterable

from firmware_py.settings import SettingsError
from plant_emulator.faults.declared_loops import LOOP_FAULTS
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.train_config import TrainConfig


def check_fitting(faults: Iterable[FaultPlan], train: TrainConfig, source: str) -> None:
    """Raise SettingsError for a fault that would have no effect because the train lacks the
    part.
    """
    for plan in faults:
        if isinstance(plan.parameters, LOOP_FAULTS) and not train.loop.connected:
            raise SettingsError(
                f"{source}: fault[{plan.index}].kind: {plan.kind.name}: the train {train.name} has "
                "no current loops; choose one with loops, or set loop.connected of the real train"
            )
