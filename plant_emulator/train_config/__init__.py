"""True properties of the train: the consist files as frozen, checked values."""

from plant_emulator.train_config.brakes import (
    BrakeConfig,
    DeadTimeKind,
    ElectricBrakeConfig,
    EmergencyBrakeConfig,
    HoldingBrakeConfig,
    PneumaticConfig,
    ServiceBrakeConfig,
)
from plant_emulator.train_config.equipment import (
    DoorConfig,
    RailConfig,
    ResistorConfig,
    SupplyConfig,
    TractionConfig,
)
from plant_emulator.train_config.loops import LoopConfig
from plant_emulator.train_config.ranges import Spread, UniformSource
from plant_emulator.train_config.sensors import (
    NOMINAL_WHEEL_M,
    PULSES_PER_TURN,
    SensorConfig,
    TachoConfig,
)
from plant_emulator.train_config.tables import EfficiencyMap, EffortPoint, effort_n
from plant_emulator.train_config.train import (
    PACKAGE,
    CarConfig,
    ConsistModel,
    CouplerConfig,
    ResistanceConfig,
    TrainConfig,
    load_train,
    seen_from_other_cab,
    with_overrides,
)

__all__ = [
    "BrakeConfig",
    "CarConfig",
    "ConsistModel",
    "CouplerConfig",
    "DeadTimeKind",
    "DoorConfig",
    "UniformSource",
    "EfficiencyMap",
    "EffortPoint",
    "ElectricBrakeConfig",
    "EmergencyBrakeConfig",
    "HoldingBrakeConfig",
    "LoopConfig",
    "NOMINAL_WHEEL_M",
    "PACKAGE",
    "PULSES_PER_TURN",
    "PneumaticConfig",
    "RailConfig",
    "ResistorConfig",
    "ResistanceConfig",
    "SensorConfig",
    "ServiceBrakeConfig",
    "Spread",
    "SupplyConfig",
    "TachoConfig",
    "TractionConfig",
    "TrainConfig",
    "load_train",
    "seen_from_other_cab",
    "effort_n",
    "with_overrides",
]
