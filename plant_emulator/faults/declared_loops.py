"""Faults of the current loops from which traction and service brake may take their reference."""

import enum
from dataclasses import dataclass

from plant_emulator.faults.kinds import FaultPlace, Hazard, check_range, fault


class LoopOf(enum.Enum):
    """Which loop the fault affects."""

    TRACTION = "traction"
    BRAKE = "brake"
    BOTH = "both"


@fault("loop_break", FaultPlace.ACTUATOR, Hazard.NO_BRAKE, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class LoopBreak:
    """A wire of a current loop is open: it carries no current, and its unit gives no effort."""

    loop: LoopOf = LoopOf.BRAKE


@fault("loop_offset", FaultPlace.ACTUATOR, Hazard.NO_BRAKE, Hazard.OVERSPEED)
@dataclass(frozen=True, slots=True)
class LoopOffset:
    """A current loop carries this much more than the module sets."""

    offset_ma: float = -1.0
    loop: LoopOf = LoopOf.BRAKE

    def __post_init__(self) -> None:
        check_range(self, "offset_ma", -20.0, 20.0)


@fault("loop_short", FaultPlace.ACTUATOR, Hazard.LOST_SERVICE)
@dataclass(frozen=True, slots=True)
class LoopShort:
    """A current loop is shorted to a supply: above 20 mA the brake is full and traction is cut."""

    current_ma: float = 22.0
    """Current on the wire, whatever the module sets."""
    loop: LoopOf = LoopOf.BRAKE

    def __post_init__(self) -> None:
        check_range(self, "current_ma", 0.0, 24.0)


LOOP_FAULTS = (LoopBreak, LoopOffset, LoopShort)
