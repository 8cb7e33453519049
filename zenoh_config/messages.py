"""Radio messages between trains and wayside, and their addresses."""

import enum
from dataclasses import dataclass
from typing import Final

WAYSIDE: Final = 0
"""Address of the wayside; trains have 1..MAX_ADDRESS."""
MAX_ADDRESS: Final = 65535


@dataclass(frozen=True, slots=True)
class PositionReport:
    """A train reports its guaranteed position interval.

    Chainages of the line; they may be negative.
    """

    train: int
    """The train that sends the report."""
    boot: int
    """Incarnation of the train's controller. It increases with every start, so that an answer to an
    earlier incarnation is not taken for an answer to this one."""
    sequence: int
    """Strictly increasing within one incarnation."""
    stamp_ns: int
    """Sender's monotonic clock at sending. It has no meaning to others; an authority echoes it."""
    front_min_m: float
    front_max_m: float
    """The front coupler is in [front_min_m, front_max_m]."""
    rear_min_m: float
    """The rear coupler is not behind this place."""
    speed_mps: float
    """Best estimate, signed, positive forwards."""
    standstill: bool
    """Zero speed is proven."""
    destination: int = WAYSIDE
    parameters: int = 0
    """Version of the train's vital parameters."""


@dataclass(frozen=True, slots=True)
class MovementAuthority:
    """The front of `train` must never pass `end_m`."""

    train: int
    """The train that the authority is for."""
    boot: int
    """Incarnation of the report that the authority answers."""
    term: int
    """Fencing token of the issuer's lease; an authority with a lower term than seen before is
    void."""
    sequence: int
    """Strictly increasing within one term, over all trains or for each."""
    echo_stamp_ns: int
    """`stamp_ns` of the answered report; it gives the age in the receiver's own clock."""
    end_m: float
    """Chainage on the line."""
    source: int = WAYSIDE
    stamp_ns: int = 0
    """Issuer's monotonic clock at sending, for logs; no decision uses it."""
    rear_m: float | None = None
    """The rear is protected back to this place, so the train may move back to it; None: it may not
    move back."""
    parameters: int = 0
    """`parameters` of the answered report."""


@dataclass(frozen=True, slots=True)
class TrainStatus:
    """Status that a train sends to centre and platforms, even while it is not localised."""

    train: int
    boot: int
    sequence: int
    """Strictly increasing within one incarnation, with its own counter."""
    stamp_ns: int
    mode: int
    """Number of the `OperatingMode` on the train bus."""
    supervision: int
    cause: int
    """Number of the `Cause` of an emergency; 0 without one."""
    localised: bool
    standstill: bool
    front_m: float
    """Best estimate; valid only while localised."""
    doors_locked: bool
    open_left: bool
    """Doors on this side are enabled and commanded open; platform doors open with them."""
    open_right: bool
    passenger_alarm: bool
    fire: bool
    obstacle: bool
    alarm_raised: bool
    """Attendance by a person is required."""
    destination: int = WAYSIDE
    emergency_number: int = 0
    """Number of the present emergency, or of the last one, in this incarnation; 0 before the
    first."""


@dataclass(frozen=True, slots=True)
class SpeedRestriction:
    """A temporary speed restriction of the centre; both ends are included."""

    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True, slots=True)
class TrainOrders:
    """Orders of centre and platform to one train. Every answer repeats the full state."""

    train: int
    boot: int
    sequence: int
    """Strictly increasing over the life of the issuer."""
    echo_stamp_ns: int
    """`stamp_ns` of the answered status."""
    awake: bool
    hold: bool
    """Do not depart from the next or present platform."""
    skip_next: bool
    """Do not stop at the next station."""
    stop_next: bool
    """Stop at the next station, whatever the plan is, and stay."""
    emergency: bool
    """Apply the emergency brake and keep it applied."""
    releases: int
    """Number of emergency resets by the centre; each increase is one reset of
    `released_emergency`."""
    creep: bool
    """The train may creep although it lacks position or authority."""
    restricted: bool
    """A person may drive the train on sight."""
    doors_left: bool
    """Doors may open on this side of the present platform."""
    doors_right: bool
    platform_doors_locked: bool
    """All platform doors at the train's station are closed; true without platform doors."""
    restrictions: tuple[SpeedRestriction, ...] = ()
    source: int = WAYSIDE
    stamp_ns: int = 0
    released_emergency: int = 0
    """`emergency_number` of the status that the centre had when it gave the last reset."""


RESTRICTIONS_MAX: Final = 8
"""Maximum number of restrictions in one message of orders."""

Message = PositionReport | MovementAuthority | TrainStatus | TrainOrders


class RefusedReason(enum.Enum):
    TOO_SHORT = "too short"
    TOO_LONG = "too long"
    WRONG_CODE = "wrong safety code"
    UNKNOWN_VERSION = "unknown version"
    UNKNOWN_TYPE = "unknown type"
    WRONG_FIELDS = "wrong fields"
    INVALID_VALUE = "invalid value"
    WRONG_SOURCE = "wrong source"
    WRONG_DESTINATION = "wrong destination"
    WRONG_BOOT = "wrong boot incarnation"
    OLD_TERM = "old term"
    TERM_LEAPS = "term too far ahead"
    NOT_NEWER = "repeated or out of order"
    TOO_OLD = "too old"
    FROM_THE_FUTURE = "from the future"
    OTHER_RULES = "of other arbiters or timers"
    OTHER_DATABASE = "of another track database"
    OTHER_PARAMETERS = "of other vital parameters"


@dataclass(frozen=True, slots=True)
class Refused:
    """A message that must not be used, and why."""

    reason: RefusedReason
    detail: str
