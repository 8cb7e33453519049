"""What supervision decrees to the wayside of a line, and what the wayside says of it to all."""

import enum
from dataclasses import dataclass
from typing import NamedTuple

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import T2tMessage


class DecreeKind(enum.IntEnum):
    HOLD = 1
    """The train stays at the present or next platform."""
    LET_GO = 2
    SKIP = 3
    """It passes the next station."""
    CALL = 4
    """It stops there after all."""
    EMERGENCY = 5
    """Remote emergency brake: it is applied and stays."""
    RELEASE = 6
    RESTRICT = 7
    """No train is faster than `limit_mps` from `start_m` to `end_m`."""
    LIFT = 8
    CLOSE = 9
    """No train enters what lies between `start_m` and `end_m`."""
    OPEN = 10


@dataclass(frozen=True, slots=True)
class Decree(T2tMessage):
    """Supervision to the wayside: let this be so from now on. Said again until it is answered."""

    echo_ns: int
    """`stamp_ns` of a LineState: a decree that was long on its way is refused."""
    kind: DecreeKind
    train: int
    """NOBODY where it is about a stretch."""
    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True, slots=True)
class Removal(T2tMessage):
    """Supervision to the master of an area: a person has seen that this train is not there any
    more, so that nobody need wait behind it. Said again until it is answered.
    """

    echo_ns: int
    """`stamp_ns` of the newest heartbeat of `destination`: what was long on its way is refused."""
    train: int


class RemovalState(enum.IntEnum):
    GONE = 1
    """It is not on the roster, and that is kept."""
    COMMITTING = 2
    HEARD = 3
    """It was heard lately, or may still hold an authority that is young enough."""
    AXLES = 4
    """Axles are counted where it may be, and no train that stands there explains them."""
    TOO_OLD = 5


@dataclass(frozen=True, slots=True)
class RemovalAnswer(T2tMessage):
    """The master to supervision: what came of a removal."""

    train: int
    state: RemovalState


class DecreeAnswer(enum.IntEnum):
    NONE = 0
    """None was heard yet."""
    DONE = 1
    UNKNOWN_TRAIN = 2
    """It never told its status."""
    NO_STRETCH = 3
    """Off the line, without length, or with a limit that is none."""
    FULL = 4
    NOT_THERE = 5
    """What is to be taken back was never decreed."""
    NOT_STORED = 6
    """The disk did not take it, so it is not so."""
    TOO_OLD = 7


class TrainDecree(NamedTuple):
    """What supervision wants of one train."""

    train: int
    hold: bool
    skip: bool
    emergency: bool
    releases: int
    """How often an emergency was reset."""


class LeaseReason(enum.IntEnum):
    """Why a train was granted an area."""

    FIRST = 1
    """Nobody had it."""
    RAN_OUT = 2
    """The lease of the one before had run out: it died, hung or was cut off."""
    HANDED_OVER = 3
    """The one before had named it."""
    AGAIN = 4
    """It had it before, gave it up or lost it, and asked under a new term."""


class LeaseNote(NamedTuple):
    """What the wayside saw its arbiters grant last in one area."""

    area: int
    train: int
    granted_term: int
    before: int
    """Who had it before; NOBODY: nobody."""
    reason: LeaseReason
    since_ns: int
    """By the wayside's clock, as its `stamp_ns` is."""


class RosterPlace(NamedTuple):
    """A train that arbiters keep on the roster of an area."""

    area: int
    train: int


@dataclass(frozen=True, slots=True)
class LineState(T2tMessage):
    """The wayside to all, at once and every half second: what is decreed, and the last answer."""

    answered_boot: int
    """Boot and sequence of the decree that `answer` is for."""
    answered: int
    answer: DecreeAnswer
    trains: tuple[TrainDecree, ...]
    """All that ever told their status."""
    leases: tuple[LeaseNote, ...]
    restrictions: tuple[SpeedRestriction, ...]
    closed: tuple[SpeedRestriction, ...]
    silent: tuple[RosterPlace, ...] = ()
    """Trains on rosters of which the wayside has heard nothing for a second; others wait behind
    them. Foremost first, area by area.
    """
