"""Outputs of the controller in one cycle, and its events."""

import enum
import math
from dataclasses import dataclass
from typing import Final

from can_dbc.doors import ALL_CARS
from can_dbc.nodes import Direction
from can_dbc.vobc import (
    AtoPhase,
    Cause,
    EventKind,
    Inhibit,
    Intervention,
    Missing,
    OperatingMode,
    ReasonCode,
    Supervision,
    Withheld,
)
from vobc.vocabulary.motion import Ceiling, Motion
from vobc.vocabulary.operation import BrakeFinding


class Source(enum.Enum):
    """Input on which a decision was based. Module `wire` knows its frame or message."""

    TACHO = "TACHO"
    DOPPLER = "DOPPLER"
    IMU = "IMU"
    COLD = "COLD_MOVEMENT"
    BRAKE = "BRAKE_STATUS"
    TRACTION = "TRACTION_STATUS"
    DOORS = "DOOR_STATUS"
    DESK = "DESK"
    TAG_READER = "TAG_READER_HEALTH"
    ALARMS = "TRAIN_ALARMS"
    SUPPLY = "LINE_SUPPLY"
    TAG = "tag telegram"
    AUTHORITY = "movement authority"
    ORDERS = "orders"
    CLOCK = "clock"


@dataclass(frozen=True, slots=True)
class Event:
    """A decision or observation of the controller in one cycle."""

    kind: EventKind
    words: str
    """Text of the event and its reason, for the log and for people."""
    sources: tuple[Source, ...] = ()
    """Inputs of the decision, the most important one first."""
    number: int = 0
    """Number sent on the bus with the kind: a `Cause`, a tag or a flag. 0: none."""


@dataclass(frozen=True, slots=True)
class CurrentReference:
    """Currents that the output module should drive in the current loops."""

    traction_ma: float
    brake_ma: float


@dataclass(frozen=True, slots=True)
class CycleOutput:
    """All outputs of the controller in one cycle."""

    force_n: float
    direction: Direction
    traction_permitted: bool
    service_decel_mps2: float
    emergency_released: bool
    holding_released: bool
    enable_left: bool
    enable_right: bool
    open_left: bool
    open_right: bool
    supervision: Supervision
    ato_phase: AtoPhase
    missing: Missing
    motion: Motion | None
    ceiling: Ceiling | None
    target_mps: float
    accel_demand_mps2: float
    distance_to_stop_m: float
    cause: str
    """Reason why protection holds or brakes. Empty: it does neither."""
    mode: OperatingMode = OperatingMode.STANDBY
    emergency_cause: Cause = Cause.NONE
    emergency_number: int = 0
    """Number of the present emergency, or of the last one, since the start. A reset of the centre
    names it."""
    intervention: Intervention = Intervention.EMERGENCY_BRAKE
    """What protection does, with `reason`. Only for display."""
    reason: ReasonCode = ReasonCode.CONTROLLER_ENDS
    departure_inhibits: Inhibit = Inhibit.NONE
    doors_withheld: Withheld = Withheld.NONE
    jog_attempts: int = 0
    replicas_agree: bool = True
    alarm_raised: bool = False
    """The train needs a person on site: passenger alarm, fire, obstacle, or a stop that it cannot
    correct."""
    door_bypass: bool = False
    """The train may depart although its doors are not proven locked."""
    door_cars: int = ALL_CARS
    """Cars to which the enabled sides apply: bit 0 is the front car."""
    stands_in: str = ""
    """Zone in which the train stands and should not. Empty: none."""
    currents: CurrentReference | None = None
    """None for a train that takes its reference from the bus, and for the safe output."""
    brake_finding: BrakeFinding | None = None
    """Only in the cycle in which operation found a late or weak brake."""


MAX_SERVICE_DECEL_MPS2: Final = 2.0
"""Greatest demand that the frame can carry. The brake unit limits it to its capability."""

SAFE_CURRENTS: Final = CurrentReference(traction_ma=3.8, brake_ma=18.0)
"""Currents of the safe output: no traction, full service brake, both loops healthy."""

SAFE_OUTPUT: Final = CycleOutput(
    force_n=0.0,
    direction=Direction.NEUTRAL,
    traction_permitted=False,
    service_decel_mps2=MAX_SERVICE_DECEL_MPS2,
    emergency_released=False,
    holding_released=False,
    enable_left=False,
    enable_right=False,
    open_left=False,
    open_right=False,
    supervision=Supervision.EMERGENCY,
    ato_phase=AtoPhase.OFF,
    missing=Missing.NOTHING,
    motion=None,
    ceiling=None,
    target_mps=0.0,
    accel_demand_mps2=0.0,
    distance_to_stop_m=math.inf,
    cause="safe output",
)
