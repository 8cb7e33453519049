"""The third party: grants each area's lease to one train at a time, under terms that only grow."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from plant_emulator.wayside.order_gate import OrderGate
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, LeaseMemory, WaysideStepped
from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import (
    LAST_TRAIN,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    RosterAck,
    RosterCommit,
    T2tMessage,
)
from zenoh_config.timers import LineTimers


class Plea(NamedTuple):
    """A request beside what the arbiter knows of the area."""

    source: int
    term: int
    lease: LeaseMemory
    expired: bool


def term_is_new(plea: Plea) -> bool:
    return plea.term > plea.lease.promised


def lease_is_free(plea: Plea) -> bool:
    """Run out, or asked for by the one whom the holder named, or by the holder itself."""
    return plea.expired or plea.source in (plea.lease.successor, plea.lease.holder)


def by_holder(plea: Plea) -> bool:
    """Of this very term: whoever holds a later one has a later promise."""
    return plea.source == plea.lease.holder and plea.term == plea.lease.promised


@dataclass(frozen=True, slots=True)
class ArbiterGuards:
    """Each replaceable, for tests and simulators only."""

    term_is_new: Callable[[Plea], bool] = term_is_new
    lease_is_free: Callable[[Plea], bool] = lease_is_free
    by_holder: Callable[[Plea], bool] = by_holder
    waits_after_start: bool = True
    """What it granted before it was cut off may still run, so that it grants nothing new for a
    whole lease."""


class Arbiter:
    def __init__(
        self,
        timers: LineTimers,
        *,
        address: int,
        memory: ArbiterMemory | None,
        start_ns: int,
        guards: ArbiterGuards | None = None,
        arbiters: int = 1,
    ) -> None:
        """`memory` as stored; None when it cannot be read: then it never grants anything. It stores
        nothing either, so that it is the same at the next start until a person has seen to it.

        Args:
            arbiters: how many the line has, this one among them.
        """
        stored = memory or ArbiterMemory()
        self.memory = replace(stored, boot=stored.boot + 1)
        self.gate = OrderGate(address)
        """Counts what it refuses by reason."""
        self._forgotten = memory is None
        self._timers, self._address, self._arbiters = timers, address, arbiters
        self._guards = guards or ArbiterGuards()
        self._free_ns = start_ns + timers.arbiter_lease_ns * self._guards.waits_after_start
        """From when on an area may be granted of which nothing was heard since the start."""
        self._expiries_ns: dict[int, int] = {}
        self._displaced_ns: dict[int, int] = {}
        """By area: until when the lease runs that a named successor took over."""
        self._sequence = 0
        self._stored = False

    def expiry_ns(self, area: int) -> int:
        """When the lease of an area has run out, as far as this arbiter knows."""
        return self._expiries_ns.get(area, self._free_ns)

    def lease(self, area: int) -> LeaseMemory:
        """What is kept of an area; of one never heard of, nothing is promised."""
        for each in self.memory.areas:
            if each.area == area:
                return each
        return LeaseMemory(area)

    def step(self, now_ns: int, heard: tuple[T2tMessage, ...]) -> WaysideStepped[ArbiterMemory]:
        before = self.memory
        out: list[T2tMessage] = []
        for message in heard:
            if self._forgotten or not self.gate.admits(message):
                continue
            if not 0 < message.source <= LAST_TRAIN:
                continue
            if isinstance(message, LeaseRequest):
                if self._agrees(message):
                    out.append(self._answer(message, now_ns))
            elif isinstance(message, RosterCommit) and self._keeps(message):
                out.append(RosterAck(*self._head(now_ns, message, message.term), message.version))
        changed = self.memory is not before or not self._stored
        self._stored = True
        if self._forgotten:
            # Else the next start would find a memory in which nothing was ever promised.
            return WaysideStepped(None, ())
        return WaysideStepped(self.memory if changed else None, tuple(out))

    def _agrees(self, request: LeaseRequest) -> bool:
        """Its sender counts on as many arbiters as there are, and on leases as long as they are."""
        rules = request.arbiters, request.lease_ms
        agrees = rules == (self._arbiters, self._timers.lease_ms)
        if not agrees:
            self.gate.refusals[RefusedReason.OTHER_RULES] += 1
        return agrees

    def _answer(self, request: LeaseRequest, now_ns: int) -> LeaseAnswer:
        granted = self._grants(request, now_ns)
        lease = self.lease(request.area)
        head = self._head(now_ns, request, lease.promised)
        kept = (lease.roster_term, lease.roster_version, lease.roster)
        if not granted or request.kind is not LeaseKind.ACQUIRE:
            kept = (0, 0, ())
        wait_ns = 0 if granted else max(0, self.expiry_ns(request.area) - now_ns)
        return LeaseAnswer(
            *head, granted, request.nonce, request.stamp_ns, lease.holder, wait_ns, *kept
        )

    def _grants(self, request: LeaseRequest, now_ns: int) -> bool:
        area, lease = request.area, self.lease(request.area)
        expiry_ns = self.expiry_ns(area)
        plea = Plea(request.source, request.term, lease, now_ns >= expiry_ns)
        guards = self._guards
        if request.kind is LeaseKind.ACQUIRE:
            if not guards.term_is_new(plea) or not guards.lease_is_free(plea):
                return False
            self._displaced_ns[area] = expiry_ns
            self._keep(lease._replace(promised=request.term, holder=request.source, successor=0))
        elif not guards.by_holder(plea):
            return False
        elif request.kind is LeaseKind.RELEASE:
            # Whoever was displaced by a successor that gives up may still command; if that was
            # before the start, for as long as anything that was granted then.
            self._expiries_ns[area] = max(now_ns, self._displaced_ns.get(area, self._free_ns))
            return False
        elif lease.successor != request.successor:
            self._keep(lease._replace(successor=request.successor))
        # Never shorter than what was granted before: its holder may count on that.
        granted_ns = now_ns + self._timers.arbiter_lease_ns - request.less_ns
        self._expiries_ns[area] = max(expiry_ns, granted_ns)
        return True

    def _keeps(self, commit: RosterCommit) -> bool:
        """A roster of the holder, and not one older than is kept."""
        lease = self.lease(commit.area)
        newer = (commit.term, commit.version) >= (lease.roster_term, lease.roster_version)
        if not newer or not self._guards.by_holder(Plea(commit.source, commit.term, lease, False)):
            return False
        kept = lease._replace(
            roster_term=commit.term, roster_version=commit.version, roster=commit.roster
        )
        if kept != lease:
            self._keep(kept)
        return True

    def _keep(self, changed: LeaseMemory) -> None:
        others = [each for each in self.memory.areas if each.area != changed.area]
        self.memory = replace(self.memory, areas=tuple(sorted([*others, changed])))

    def _head(
        self, now_ns: int, answered: T2tMessage, term: int
    ) -> tuple[int, int, int, int, int, int, int]:
        self._sequence += 1
        boot = self.memory.boot
        return (self._address, answered.source, answered.area, term, boot, self._sequence, now_ns)
