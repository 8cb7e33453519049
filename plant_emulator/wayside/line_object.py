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
    """A claim or release together with the object's state."""

    claim: ObjectClaim
    memory: ObjectMemory
    release_wanted: bool
    occupied: bool


def newer_claim(demand: Demand) -> bool:
    """Accept only newer claims.

    Nonces of one master increase, so its last message voids earlier ones.
    """
    claim, memory = demand.claim, demand.memory
    return (claim.term, claim.nonce) > (memory.claim_term, memory.nonce)


def no_train_in_it(demand: Demand) -> bool:
    """Accept a release only if the object itself detects no train: it never moves under a train."""
    return demand.claim.kind is ClaimKind.CLAIM or not demand.occupied


def free_to_lock(demand: Demand) -> bool:
    """Refuse to lock an object that is free and open, or free and requested to open."""
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
    """Conditions of the object; replaceable for tests and simulators only."""

    term_not_old: Callable[[ObjectTerm], bool] = term_not_old
    owner_of_term: Callable[[ObjectTerm], bool] = owner_of_term
    newer_claim: Callable[[Demand], bool] = newer_claim
    no_train_in_it: Callable[[Demand], bool] = no_train_in_it
    free_to_lock: Callable[[Demand], bool] = free_to_lock


class LineObject:
    """Sends its status at every change and every heartbeat period, from WAYSIDE to BROADCAST.

    It receives heartbeats and claims of all trains.
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
        """Start from the stored `memory`.

        With None, because it is unreadable, the object stays FAILED and stores nothing.
        """
        stored = memory or ObjectMemory(state=ObjectState.FAILED)
        self.memory = replace(stored, boot=stored.boot + 1)
        self.site = site
        self.refused = 0
        """Number of claims and heartbeats that were refused."""
        self._forgotten = memory is None
        self._guards = guards or ObjectGuards()
        self._area = area
        self._period_ns = timers.heartbeat_ms * NS_PER_MS
        self._due_ns = start_ns
        self._sequence = 0
        self._sent: tuple[ObjectMemory, bool, bool] | None = None
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
        failed: bool = False,
    ) -> WaysideStepped[ObjectMemory]:
        """Process messages and return the memory to store and the messages to send.

        `self.memory.state` tells afterwards whether the object may move. The object must be locked
        before its locked state is stored, and may move only after its free state is stored.
        Otherwise it would count as locked after a restart while it is open.

        Args:
            release_wanted: the object is requested to move or open.
            occupied: a train stands in it.
            failed: it is not proven to lie as it is locked. While it is locked it then reports
                itself as failed, so that no authority leads over it.
        """
        failed = failed and self.memory.state is ObjectState.LOCKED
        before = self.memory
        for message in heard:
            if not self._on_message(message, release_wanted=release_wanted, occupied=occupied):
                self.refused += 1
        changed = self.memory is not before or not self._stored
        self._stored = True
        out: tuple[T2tMessage, ...] = ()
        if now_ns >= self._due_ns or self._sent != (self.memory, release_wanted, failed):
            self._due_ns = now_ns + self._period_ns
            self._sent = (self.memory, release_wanted, failed)
            out = (self._status(now_ns, release_wanted=release_wanted, failed=failed),)
        # An unreadable memory stays unreadable over the next start, too.
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
            and guards.no_train_in_it(demand)
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

    def _status(self, now_ns: int, *, release_wanted: bool, failed: bool) -> ObjectStatus:
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
            ObjectState.FAILED if failed else memory.state,
            memory.claim_term,
            memory.nonce,
            release_wanted,
        )
