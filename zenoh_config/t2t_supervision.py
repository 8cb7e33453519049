"""Commands of supervision to the wayside of a line, and the wayside's state of them for all."""

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
    """The train passes the next station."""
    CALL = 4
    """The train stops at the next station after all."""
    EMERGENCY = 5
    """Remote emergency brake: it is applied and stays applied."""
    RELEASE = 6
    RESTRICT = 7
    """No train may exceed `limit_mps` from `start_m` to `end_m`."""
    LIFT = 8
    CLOSE = 9
    """No train may enter the stretch from `start_m` to `end_m`."""
    OPEN = 10


@dataclass(frozen=True, slots=True)
class Decree(T2tMessage):
    """A command of supervision to the wayside. It is repeated until it is answered."""

    echo_ns: int
    """`stamp_ns` of a LineState; a command with an old one is refused."""
    kind: DecreeKind
    train: int
    """The train; 0 in commands about a stretch."""
    start_m: float
    end_m: float
    limit_mps: float


@dataclass(frozen=True, slots=True)
class Removal(T2tMessage):
    """Supervision tells the master of an area that a person has verified that this train is gone.

    Other trains then need not wait behind it. The message is repeated until it is answered.
    """

    echo_ns: int
    """`stamp_ns` of the newest heartbeat of `destination`; a message with an old one is refused."""
    train: int


class RemovalState(enum.IntEnum):
    GONE = 1
    """The train is not on the roster, and that is committed."""
    COMMITTING = 2
    HEARD = 3
    """The train communicated recently, or may still hold a valid authority."""
    AXLES = 4
    """Axles are counted where it may be, and no other train accounts for them."""
    TOO_OLD = 5


@dataclass(frozen=True, slots=True)
class RemovalAnswer(T2tMessage):
    """The master tells supervision the result of a removal."""

    train: int
    state: RemovalState


class DecreeAnswer(enum.IntEnum):
    NONE = 0
    """No command was received yet."""
    DONE = 1
    UNKNOWN_TRAIN = 2
    """The train never sent its status."""
    NO_STRETCH = 3
    """The stretch is off the line, has no length, or has an invalid limit."""
    FULL = 4
    NOT_THERE = 5
    """The command to take back was never given."""
    NOT_STORED = 6
    """The disk did not store the command, so it has no effect."""
    TOO_OLD = 7


class TrainDecree(NamedTuple):
    """Commands of supervision for one train."""

    train: int
    hold: bool
    skip: bool
    emergency: bool
    releases: int
    """Number of emergency resets."""


class LeaseReason(enum.IntEnum):
    """Why a train was granted an area."""

    FIRST = 1
    """No train held the area before."""
    RAN_OUT = 2
    """The lease of the previous train had expired: that train failed, hung or was cut off."""
    HANDED_OVER = 3
    """The previous train had named it as successor."""
    AGAIN = 4
    """The train had the area before, gave it up or lost it, and requested it under a new term."""


class LeaseNote(NamedTuple):
    """Last grant of an area that the wayside saw at its arbiters."""

    area: int
    train: int
    granted_term: int
    before: int
    """Previous holder; 0: none."""
    reason: LeaseReason
    since_ns: int
    """Instant by the wayside's clock, like its `stamp_ns`."""


class RosterPlace(NamedTuple):
    """A train that arbiters store on the roster of an area."""

    area: int
    train: int


@dataclass(frozen=True, slots=True)
class LineState(T2tMessage):
    """The wayside sends the commands in force and the last answer to all, on changes and every half
    second.
    """

    answered_boot: int
    """Boot and sequence of the command that `answer` is for."""
    answered: int
    answer: DecreeAnswer
    trains: tuple[TrainDecree, ...]
    """All trains that have sent a status."""
    leases: tuple[LeaseNote, ...]
    restrictions: tuple[SpeedRestriction, ...]
    closed: tuple[SpeedRestriction, ...]
    silent: tuple[RosterPlace, ...] = ()
    """Trains on rosters from which the wayside has received nothing for a second; others wait
    behind them. Foremost first, area by area."""
