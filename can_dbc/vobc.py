"""What the VOBC tells the rest of the train, and whoever looks at the bus, about itself."""

import enum
from dataclasses import dataclass

from can_dbc.binding import frame


class Supervision(enum.IntEnum):
    """State of the protection (ATP)."""

    NO_AUTHORITY = 0
    """Held at standstill: something that movement needs is missing."""
    NOMINAL = 1
    WARNING = 2
    SERVICE = 3
    """Service brake by protection, until the speed is back under the ceiling."""
    EMERGENCY = 4
    """Emergency brake, latched until reset at standstill."""


class AtoPhase(enum.IntEnum):
    """What the automatic operation (ATO) is doing."""

    OFF = 0
    HOLDING = 1
    DEPARTING = 2
    RUNNING = 3
    APPROACHING = 4
    """Braking towards the stopping point, before tag T1."""
    STOPPING = 5
    """Inside the three-tag stop, from T1 on."""
    STOPPED = 6
    DOORS_OPEN = 7
    DOORS_CLOSING = 8


class Missing(enum.IntFlag):
    """What the controller waits for; 0 when nothing is missing."""

    NOTHING = 0
    BRAKE = 1
    TRACTION = 2
    ODOMETER = 4
    DOORS = 8
    DESK = 16
    TAG_READER = 32
    AUTHORITY = 64
    LOCALISATION = 128


@frame("vobc.dbc", "VOBC_STATUS")
@dataclass(frozen=True, slots=True)
class VobcStatus:
    supervision: Supervision
    ato_phase: AtoPhase
    missing: Missing
    localised: bool
    slip_detected: bool
    work_us: float
    """Execution time of the control cycle before this one."""
    cycle_slips: int
    """Cycles missed since start, modulo 64."""


@frame("vobc.dbc", "VOBC_MOTION")
@dataclass(frozen=True, slots=True)
class VobcMotion:
    speed_mps: float
    ceiling_mps: float
    """Permitted speed now: the least of line limits, braking curve and end of authority."""
    emergency_mps: float
    """Speed at which the emergency brake comes."""


@frame("vobc.dbc", "VOBC_POSITION")
@dataclass(frozen=True, slots=True)
class VobcPosition:
    front_m: float
    """Best estimate of the front coupler's chainage."""
    uncertainty_m: float
    """The position interval lies within front_m ± this; one end of it may be nearer."""


@frame("vobc.dbc", "VOBC_TARGET")
@dataclass(frozen=True, slots=True)
class VobcTarget:
    distance_to_stop_m: float
    """To the next stopping point, negative past it; the largest value when there is none."""
    distance_to_authority_m: float
