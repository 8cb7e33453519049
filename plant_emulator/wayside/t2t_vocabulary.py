"""Inputs and outputs of a step of the wayside where trains command themselves."""

from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import ObjectState, RosterEntry, T2tMessage
from zenoh_config.t2t_supervision import TrainDecree

M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class WaysideStepped(Generic[M]):
    """Result of a step. Apply it in this order: store, then move or lock, then send."""

    memory: M | None
    """Memory to store before anything is sent; None: unchanged."""
    out: tuple[T2tMessage, ...]


class LeaseMemory(NamedTuple):
    """An arbiter's persistent state of one area."""

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
    """Persistent state of a wayside object."""

    boot: int = 0
    seen_term: int = 0
    owner: int = 0
    state: ObjectState = ObjectState.FREE
    claim_term: int = 0
    nonce: int = 0


@dataclass(frozen=True, slots=True)
class CentreMemory:
    """Commands of supervision that have not been taken back."""

    trains: tuple[TrainDecree, ...] = ()
    restrictions: tuple[SpeedRestriction, ...] = ()
    closed: tuple[SpeedRestriction, ...] = ()
