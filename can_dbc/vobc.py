"""State that the VOBC sends to the rest of the train and to observers of the bus."""

import enum
from dataclasses import dataclass

from can_dbc.binding import complete, frame


class Supervision(enum.IntEnum):
    """State of the protection (ATP)."""

    NO_AUTHORITY = 0
    """Held at standstill: an input that movement needs is missing."""
    NOMINAL = 1
    WARNING = 2
    SERVICE = 3
    """Service brake by protection, until the speed is back below the ceiling."""
    EMERGENCY = 4
    """Emergency brake, latched until reset at standstill."""


class AtoPhase(enum.IntEnum):
    """Phase of the automatic operation (ATO)."""

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
    JOGGING = 9
    """Moves forwards or back to a stopping point that was missed."""
    CREEPING = 10
    """Runs at restricted speed by order of the centre, up to the next place where a better mode is
    possible."""


class Missing(enum.IntFlag):
    """Inputs that the controller is missing; 0 without one."""

    NOTHING = 0
    BRAKE = 1
    TRACTION = 2
    ODOMETER = 4
    DOORS = 8
    DESK = 16
    TAG_READER = 32
    AUTHORITY = 64
    LOCALISATION = 128
    ALARMS = 256
    """Obstacle and fire detection."""


class OperatingMode(enum.IntEnum):
    """Kind of movement that the protection supervises."""

    ASLEEP = 0
    """No traction, no doors; waits for the order to wake."""
    STANDBY = 1
    """Awake and held: an input that movement needs is missing."""
    RESTRICTED = 2
    """On sight at restricted speed, without authority or position; a person at the desk is
    responsible."""
    CREEP = 3
    """Like RESTRICTED without a driver, ordered by the centre."""
    AUTHORISED = 4
    """Full supervision inside a movement authority."""
    JOG = 5
    """A short movement, in either direction, to a stopping point that was missed."""


class Cause(enum.IntEnum):
    """Why the emergency brake is on."""

    NONE = 0
    OVERSPEED = 1
    AUTHORITY_OLD = 2
    ROLLBACK = 3
    HELD_TRAIN_MOVED = 4
    VITAL_INPUT_LOST = 5
    LOCALISATION_LOST = 6
    BUTTON = 7
    OVERRUN = 8
    NOT_FINITE = 9
    BRAKE_UNIT = 10
    """The brake unit applied it without a command."""
    REMOTE = 11
    """Ordered by the centre."""
    OBSTACLE = 12
    DOOR_UNLOCKED = 13
    """A door was unlocked before the train was clear of the platform."""
    PASSENGER_ALARM = 14
    """The passenger alarm was pulled at a platform or on departure from it."""
    OVERSHOT = 15
    """The stopping point was passed by more than a metre."""
    WRONG_DIRECTION = 16
    REPLICAS_DISAGREE = 17
    CLOCK_STEPPED = 18
    JOG_EXCEEDED = 19
    """A jog was too long, too fast, or one more than permitted."""
    PAST_AUTHORITY = 20
    """The front may stand beyond the end of its authority."""
    ASLEEP_MOVED = 21


class Inhibit(enum.IntFlag):
    """Why a train may not depart; 0 when it may."""

    NONE = 0
    DOORS = 1
    PLATFORM_DOORS = 2
    AUTHORITY = 4
    HOLD = 8
    PASSENGER_ALARM = 16
    FIRE = 32
    OBSTACLE = 64
    ASLEEP = 128
    EMERGENCY = 256
    CENTRE_SILENT = 512


class Withheld(enum.IntFlag):
    """Why no door is enabled; 0 when a side is."""

    NONE = 0
    MOVING = 1
    NOT_LOCALISED = 2
    NO_PLATFORM = 4
    MISALIGNED = 8
    NOT_HELD = 16
    TRACTION = 32
    EMERGENCY = 64
    NOT_AUTHORISED = 128
    CENTRE_SILENT = 256
    OFF_PLATFORM = 512
    """At its stopping point the train is not surely beside the platform, and no car of a train with
    doors by car is."""


class Intervention(enum.IntEnum):
    """What the protection does in a cycle."""

    NONE = 0
    WARNING = 1
    NO_TRACTION = 2
    """The train may coast or brake, but protection withholds traction."""
    SERVICE_BRAKE = 3
    EMERGENCY_BRAKE = 4
    HELD = 5
    """Service and holding brake at standstill, because movement is not permitted yet."""


class ReasonCode(enum.IntEnum):
    """Why the protection intervenes. Values up to 21 are those of `Cause`."""

    NONE = 0
    OVERSPEED = 1
    AUTHORITY_OLD = 2
    ROLLBACK = 3
    HELD_TRAIN_MOVED = 4
    VITAL_INPUT_LOST = 5
    LOCALISATION_LOST = 6
    BUTTON = 7
    OVERRUN = 8
    NOT_FINITE = 9
    BRAKE_UNIT = 10
    REMOTE = 11
    OBSTACLE = 12
    DOOR_UNLOCKED = 13
    PASSENGER_ALARM = 14
    OVERSHOT = 15
    WRONG_DIRECTION = 16
    REPLICAS_DISAGREE = 17
    CLOCK_STEPPED = 18
    JOG_EXCEEDED = 19
    PAST_AUTHORITY = 20
    ASLEEP_MOVED = 21
    OVER_WARNING_LIMIT = 32
    OVER_SERVICE_LIMIT = 33
    AUTHORITY_AGES = 34
    RESTRICTIONS_AGE = 35
    SIGHT_NOT_PERMITTED = 36
    """The permission for a movement on sight has ended."""
    STOP_NOT_OBEYED = 37
    """Operation does not stop although requested."""
    INPUT_MISSING = 38
    AUTHORITY_MISSING = 39
    STANDSTILL_NOT_PROVEN = 40
    TRAIN_ASLEEP = 41
    DEPARTURE_INHIBITED = 42
    DOORS_NOT_LOCKED = 43
    NO_SPEED_PERMITTED = 44
    CONTROLLER_ENDS = 45


class TargetKind(enum.IntEnum):
    """Place ahead that lowers the permitted speed most."""

    NONE = 0
    """The limits under the train are lower than every braking curve."""
    LINE_LIMIT = 1
    RESTRICTION = 2
    """A temporary speed restriction of the centre."""
    END = 3
    """End of the movement authority, or of the line without an authority."""


class EventKind(enum.IntEnum):
    """Event that the controller decided or detected."""

    SUPERVISION = 1
    MODE = 2
    EMERGENCY_APPLIED = 3
    EMERGENCY_RELEASED = 4
    SERVICE_BRAKE = 5
    TAG_ACCEPTED = 6
    TAG_REJECTED = 7
    TAG_MISSED = 8
    LOCALISATION_LOST = 9
    LOCALISATION_FOUND = 10
    SLIP_BEGAN = 11
    SLIP_ENDED = 12
    WHEEL_CALIBRATED = 13
    DOORS_ENABLED = 14
    DOORS_WITHHELD = 15
    DEPARTURE_INHIBITED = 16
    DEPARTURE_PERMITTED = 17
    AUTHORITY_CHANGED = 18
    ORDERS_CHANGED = 19
    INPUT_LOST = 20
    INPUT_BACK = 21
    FRAME_REJECTED = 22
    RADIO_REFUSED = 23
    JOG_BEGAN = 24
    JOG_ENDED = 25
    ALARM_RAISED = 26
    ALARM_CLEARED = 27
    DOOR_BYPASS = 28
    REPLICAS_DISAGREE = 29
    OVERRUN = 30
    MEMORY_LOST = 31
    WOKEN = 32
    PUT_TO_SLEEP = 33
    BRAKE_LATE = 34
    BRAKE_WEAK = 35
    STOPPED_IN_ZONE = 36


@frame("vobc.dbc", "VOBC_STATUS")
@dataclass(frozen=True, slots=True)
class VobcStatus:
    supervision: Supervision
    ato_phase: AtoPhase
    missing: Missing
    localised: bool
    slip_detected: bool
    work_us: float
    """Execution time of the previous control cycle."""
    cycle_slips: int
    """Cycles missed since start, modulo 64."""


@frame("vobc.dbc", "VOBC_MOTION")
@dataclass(frozen=True, slots=True)
class VobcMotion:
    speed_mps: float
    ceiling_mps: float
    """Permitted speed now: the lowest of line limits, braking curve and end of authority."""
    emergency_mps: float
    """Speed at which the emergency brake applies."""


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
    """Distance to the next stopping point, negative past it; the largest value without one."""
    distance_to_authority_m: float


@frame("vobc.dbc", "VOBC_MODE")
@dataclass(frozen=True, slots=True)
class VobcMode:
    """Operating mode of the protection, and why it withholds departure or doors."""

    mode: OperatingMode
    cause: Cause
    departure_inhibits: Inhibit
    doors_withheld: Withheld
    jog_attempts: int
    """Number of jogs at this stop."""
    replicas_agree: bool
    """Both computations of the protection core gave the same result in this cycle."""
    alarm_raised: bool
    """Attendance by a person is required."""
    speed_reach_mps: float = 0.0
    """Largest difference, in either direction, between the true speed and the
    `VobcMotion.speed_mps` sent with it. It is rounded up; the largest value means that or more."""


@frame("vobc.dbc", "VOBC_LIMITS")
@dataclass(frozen=True, slots=True)
class VobcLimits:
    """Limits between those of `VobcMotion`. For information; the protection does not read them."""

    warning_mps: float
    """Speed at which the protection warns."""
    service_mps: float
    """Speed at which the protection applies the service brake."""


@frame("vobc.dbc", "VOBC_SUPERVISION")
@dataclass(frozen=True, slots=True)
class VobcSupervision:
    """What the protection does and why, and its most restrictive target. For information."""

    intervention: Intervention
    reason: ReasonCode
    target_kind: TargetKind
    target_mps: float
    """Speed permitted at the target; 0 without one."""
    target_distance_m: float
    """Distance from the foremost possible front to the target; the largest value without one."""


@frame("vobc.dbc", "VOBC_EVENT")
@dataclass(frozen=True, slots=True)
class VobcEvent:
    """An event, sent once, in the order of the event numbers."""

    event: EventKind
    cause: int
    """The `Cause` of an emergency; otherwise a number that depends on the event: a tag, a mode,
    flags, an identifier; 0 without one."""
    number: int
    """Number of the event since start, from 1 on, modulo 65536; a gap means a lost event."""
    frame_a: int
    """Identifier of the frame that caused the event; 0 without one."""
    frame_b: int


complete("vobc.dbc")
