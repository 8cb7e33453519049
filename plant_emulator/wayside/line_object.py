"""A switch, crossing or platform track: locked for passing, or free to move or open."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from firmware_py.trackdb.areas import ObjectSite
from plant_emulator.wayside.t2t_vocabulary import ObjectMemory, WaysideStepped
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    BROADCAST,
    LAST_TRAIN,
    ClaimKind,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    T2tMessage,
)
from zenoh_config.timers import NS_PER_MS, LineTimers

NOTHING: Final[WaysideStepped[ObjectMemory]] = WaysideStepped(None, ())


class Demand(NamedTuple):
    """A claim or release beside what the object knows."""

    claim: ObjectClaim
    memory: ObjectMemory
    release_wanted: bool
    occupied: bool


def newer_claim(demand: Demand) -> bool:
    """Nonces of one master grow: what it said before it said the last thing is void."""
    claim, memory = demand.claim, demand.memory
    return (claim.term, claim.nonce) > (memory.claim_term, memory.nonce)


def nobody_in_it(demand: Demand) -> bool:
    """The interlocking's own look: nothing moves under a train, whoever allows it."""
    return demand.claim.kind is ClaimKind.CLAIM or not demand.occupied


def free_to_lock(demand: Demand) -> bool:
    """What is open, or asked to open while it is free, is not locked."""
    opens = demand.memory.state is ObjectState.FREE and demand.release_wanted
    return demand.claim.kind is ClaimKind.RELEASE or not opens


class ObjectTerm(NamedTuple):
    term: int
    source: int
    memory: ObjectMemory


def term_not_old(term: ObjectTerm) -> bool:
    return term.term >= term.memory.seen_term


def owner_of_term(term: ObjectTerm) -> bool:
    return term.term != term.memory.seen_term or term.source == term.memory.owner


@dataclass(frozen=True, slots=True)
class ObjectGuards:
    """Each replaceable, for tests and simulators only."""

    term_not_old: Callable[[ObjectTerm], bool] = term_not_old
    owner_of_term: Callable[[ObjectTerm], bool] = owner_of_term
    newer_claim: Callable[[Demand], bool] = newer_claim
    nobody_in_it: Callable[[Demand], bool] = nobody_in_it
    free_to_lock: Callable[[Demand], bool] = free_to_lock


class LineObject:
    """Says its status at every change and every heartbeat period, as WAYSIDE, to BROADCAST.

    It hears heartbeats and claims of every train.
    """

    def __init__(
        self,
        timers: LineTimers,
        site: ObjectSite,
        area: int,
        *,
        memory: ObjectMemory | None,
        start_ns: int,
        guards: ObjectGuards | None = None,
    ) -> None:
        """`memory` as stored; None when it cannot be read: it stays FAILED and stores nothing."""
        stored = memory or ObjectMemory(state=ObjectState.FAILED)
        self.memory = replace(stored, boot=stored.boot + 1)
        self.site = site
        self.refused = 0
        """Claims and heartbeats that were not acted on."""
        self._forgotten = memory is None
        self._guards = guards or ObjectGuards()
        self._area = area
        self._period_ns = timers.heartbeat_ms * NS_PER_MS
        self._due_ns = start_ns
        self._sequence = 0
        self._said: tuple[ObjectMemory, bool] | None = None
        self._stored = False

    def next_due_ns(self) -> int:
        return self._due_ns

    def step(
        self,
        now_ns: int,
        heard: tuple[T2tMessage, ...],
        *,
        release_wanted: bool,
        occupied: bool,
    ) -> WaysideStepped[ObjectMemory]:
        """`release_wanted`: it is asked to move or open; `occupied`: a train stands in it.

        `self.memory.state` says afterwards whether it may move. It has to be locked before it is
        stored that it is, and may move only after that is stored: else it would be taken for locked
        after a restart while it stands open.
        """
        before = self.memory
        for message in heard:
            if not self._on_message(message, release_wanted=release_wanted, occupied=occupied):
                self.refused += 1
        changed = self.memory is not before or not self._stored
        self._stored = True
        out: tuple[T2tMessage, ...] = ()
        if now_ns >= self._due_ns or self._said != (self.memory, release_wanted):
            self._due_ns = now_ns + self._period_ns
            self._said = (self.memory, release_wanted)
            out = (self._status(now_ns, release_wanted=release_wanted),)
        # What was forgotten stays forgotten, over the next start, too.
        changed = changed and not self._forgotten
        return WaysideStepped(self.memory if changed else None, out) if changed or out else NOTHING

    def _on_message(self, message: T2tMessage, *, release_wanted: bool, occupied: bool) -> bool:
        if not isinstance(message, Heartbeat | ObjectClaim) or message.area != self._area:
            return False
        if self._forgotten or not 0 < message.source <= LAST_TRAIN:
            return False
        guards, memory = self._guards, self.memory
        if isinstance(message, ObjectClaim) and message.number != self.site.number:
            return True
        term = ObjectTerm(message.term, message.source, memory)
        if not guards.term_not_old(term) or not guards.owner_of_term(term):
            return False
        if message.term > memory.seen_term:
            memory = replace(memory, seen_term=message.term, owner=message.source)
            self.memory = memory
        if isinstance(message, Heartbeat):
            return True
        demand = Demand(message, memory, release_wanted, occupied)
        if not (
            guards.newer_claim(demand)
            and guards.nobody_in_it(demand)
            and guards.free_to_lock(demand)
        ):
            return False
        locked = message.kind is ClaimKind.CLAIM
        self.memory = replace(
            memory,
            state=ObjectState.LOCKED if locked else ObjectState.FREE,
            claim_term=message.term,
            nonce=message.nonce,
        )
        return True

    def _status(self, now_ns: int, *, release_wanted: bool) -> ObjectStatus:
        self._sequence += 1
        memory = self.memory
        return ObjectStatus(
            WAYSIDE,
            BROADCAST,
            self._area,
            memory.seen_term,
            memory.boot,
            self._sequence,
            now_ns,
            self.site.number,
            memory.state,
            memory.claim_term,
            memory.nonce,
            release_wanted,
        )
