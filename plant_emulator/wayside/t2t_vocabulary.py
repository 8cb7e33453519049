"""What goes into and comes out of a step of the wayside where trains command themselves."""

from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import ObjectState, RosterEntry, T2tMessage
from zenoh_config.t2t_supervision import TrainDecree

M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class WaysideStepped(Generic[M]):
    """Do it in this order: store, then move or lock, then send."""

    memory: M | None
    """To be on the disk before anything is sent; None: as it was."""
    out: tuple[T2tMessage, ...]


class LeaseMemory(NamedTuple):
    """What an arbiter must never forget of one area."""

    area: int
    promised: int = 0
    """Highest term granted."""
    holder: int = 0
    successor: int = 0
    roster_term: int = 0
    roster_version: int = 0
    roster: tuple[RosterEntry, ...] = ()


@dataclass(frozen=True, slots=True)
class ArbiterMemory:
    boot: int = 0
    areas: tuple[LeaseMemory, ...] = field(default=())


@dataclass(frozen=True, slots=True)
class ObjectMemory:
    """What a wayside object must never forget."""

    boot: int = 0
    seen_term: int = 0
    owner: int = 0
    state: ObjectState = ObjectState.FREE
    claim_term: int = 0
    nonce: int = 0


@dataclass(frozen=True, slots=True)
class CentreMemory:
    """What supervision decreed and has not taken back."""

    trains: tuple[TrainDecree, ...] = ()
    restrictions: tuple[SpeedRestriction, ...] = ()
    closed: tuple[SpeedRestriction, ...] = ()
