"""What trains and wayside tell each other by radio, and who is meant by a number."""

import enum
from dataclasses import dataclass
from typing import Final

WAYSIDE: Final = 0
"""Address of the wayside; trains have 1..MAX_ADDRESS."""
MAX_ADDRESS: Final = 65535


@dataclass(frozen=True, slots=True)
class PositionReport:
    """A train tells where it is for certain. Chainages of the line; they may be negative."""

    train: int
    """Who sends it."""
    boot: int
    """Incarnation of the train's controller: grows with every start, so that nothing said to an
    earlier one can be taken for an answer to this one."""
    sequence: int
    """Strictly increasing within one incarnation."""
    stamp_ns: int
    """Sender's monotonic clock at sending. To others it is no time; an authority echoes it."""
    front_min_m: float
    front_max_m: float
    """The front coupler stands in [front_min_m, front_max_m]."""
    rear_min_m: float
    """The rear coupler stands nowhere behind this."""
    speed_mps: float
    """Best estimate, signed, positive forwards."""
    standstill: bool
    """Zero speed is proven."""
    destination: int = WAYSIDE


@dataclass(frozen=True, slots=True)
class MovementAuthority:
    """The front of `train` must never pass `end_m`."""

    train: int
    """Whom it is for."""
    boot: int
    """Incarnation that it answers."""
    term: int
    """Fencing token of the issuer's lease; a lower one than seen before is void."""
    sequence: int
    """Strictly increasing within one term, over all trains or for each."""
    echo_stamp_ns: int
    """`stamp_ns` of the report that it answers: its age in the receiver's own clock."""
    end_m: float
    """Chainage on the line."""
    source: int = WAYSIDE
    stamp_ns: int = 0
    """Issuer's monotonic clock at sending, for logs; no decision rests on it."""
    rear_m: float | None = None
    """The rear is protected back to here, so that the train may move back so far; None: not at
    all."""


@dataclass(frozen=True, slots=True)
class TrainStatus:
    """What a train tells centre and platforms about itself, also while it is not located."""

    train: int
    boot: int
    sequence: int
    """Strictly increasing within one incarnation, by a count of its own."""
    stamp_ns: int
    mode: int
    """Number of the `OperatingMode` on the train bus."""
    supervision: int
    cause: int
    """Number of the `Cause` of an emergency; 0 without one."""
    localised: bool
    standstill: bool
    front_m: float
    """Best estimate; only while localised."""
    doors_locked: bool
    open_left: bool
    """Doors are enabled and asked to open on this side: platform doors open with them."""
    open_right: bool
    passenger_alarm: bool
    fire: bool
    obstacle: bool
    alarm_raised: bool
    """Somebody has to come."""
    destination: int = WAYSIDE


@dataclass(frozen=True, slots=True)
class SpeedRestriction:
    """A temporary one, from the centre; both ends included."""

    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True, slots=True)
class TrainOrders:
    """What centre and platform have to say to one train: a state, said anew in every answer."""

    train: int
    boot: int
    sequence: int
    """Strictly increasing over the life of the issuer."""
    echo_stamp_ns: int
    """`stamp_ns` of the status that it answers."""
    awake: bool
    hold: bool
    """Do not depart from the next or present platform."""
    skip_next: bool
    """Do not stop at the next station."""
    stop_next: bool
    """Stop at the next station, whatever the plan says, and stay."""
    emergency: bool
    """Apply the emergency brake and keep it."""
    releases: int
    """How often the centre has reset an emergency so far; a step up is one reset."""
    creep: bool
    """The train may creep although it lacks place or authority."""
    restricted: bool
    """A person may drive it on sight."""
    doors_left: bool
    """Doors may open on this side of the present platform."""
    doors_right: bool
    platform_doors_locked: bool
    """All platform doors at the train's station are shut; true where there are none."""
    restrictions: tuple[SpeedRestriction, ...] = ()
    source: int = WAYSIDE
    stamp_ns: int = 0


RESTRICTIONS_MAX: Final = 8
"""In one message of orders."""

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
    NOT_NEWER = "repeated or out of order"
    TOO_OLD = "too old"
    FROM_THE_FUTURE = "from the future"
    OTHER_RULES = "of other arbiters or timers"


@dataclass(frozen=True, slots=True)
class Refused:
    """A message that must not be acted on, and why."""

    reason: RefusedReason
    detail: str
