"""The arbiter grants each area's lease to one train at a time, under terms that only increase."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from plant_emulator.wayside.grants import Grants
from plant_emulator.wayside.order_gate import OrderGate
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, LeaseMemory, WaysideStepped
from zenoh_config.messages import RefusedReason
from zenoh_config.t2t import (
    LAST_TRAIN,
    TERM_STEP_MAX,
    Heartbeat,
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    ObjectClaim,
    RosterAck,
    RosterCommit,
    SignedGrant,
    T2tMessage,
)
from zenoh_config.t2t_supervision import RemovalAnswer
from zenoh_config.term_grants import GrantSigner
from zenoh_config.timers import LineTimers


class Plea(NamedTuple):
    """A request together with the arbiter's state of the area."""

    source: int
    term: int
    lease: LeaseMemory
    expired: bool


def term_is_new(plea: Plea) -> bool:
    return plea.term > plea.lease.promised


def term_in_reach(plea: Plea) -> bool:
    """Accept no term that no honest train can have come to.

    A train accepts a term up to one step above the confirmed ones, and then asks for a higher one.
    """
    return plea.term <= plea.lease.promised + 2 * TERM_STEP_MAX


def lease_is_free(plea: Plea) -> bool:
    """Accept if the lease has expired, or if the requester is the named successor or the holder
    itself.
    """
    return plea.expired or plea.source in (plea.lease.successor, plea.lease.holder)


def by_holder(plea: Plea) -> bool:
    """Accept only the holder of this very term.

    A holder of a later term has raised the acknowledged term.
    """
    return plea.source == plea.lease.holder and plea.term == plea.lease.promised


@dataclass(frozen=True, slots=True)
class ArbiterGuards:
    """Conditions of the arbiter; replaceable for tests and simulators only."""

    term_is_new: Callable[[Plea], bool] = term_is_new
    term_in_reach: Callable[[Plea], bool] = term_in_reach
    lease_is_free: Callable[[Plea], bool] = lease_is_free
    by_holder: Callable[[Plea], bool] = by_holder
    waits_after_start: bool = True
    """Grant no new lease for a whole lease time after a start, because a lease granted before may
    still be valid."""


def of_masters(
    arbiters: Iterable[Grants], heard: Iterable[T2tMessage], *, majority: int
) -> list[T2tMessage]:
    """Leave out messages of masters under a term that no majority granted to their sender.

    Objects and track status obey terms, and the first owner of a term for good. A single arbiter
    may have granted the same term to another candidate, which lost.
    """
    known = list(arbiters)
    return [
        each
        for each in heard
        if not isinstance(each, Heartbeat | ObjectClaim | RemovalAnswer)
        or sum(arbiter.has_granted(each) for arbiter in known) >= majority
    ]


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
        signer: GrantSigner | None = None,
    ) -> None:
        """Start from the stored `memory`.

        With None, because it is unreadable, the arbiter grants and stores nothing. It therefore
        stays silent over restarts until a person repairs the memory.

        Args:
            arbiters: number of arbiters of the line, including this one.
            signer: signs its grants; None on a line that is not secured.
        """
        stored = memory or ArbiterMemory()
        self.memory = replace(stored, boot=stored.boot + 1)
        self.gate = OrderGate(address)
        """Refusals by reason."""
        self._forgotten = memory is None
        self._timers, self._address, self._arbiters = timers, address, arbiters
        self._guards, self._signer = guards or ArbiterGuards(), signer
        self._free_ns = start_ns + timers.arbiter_lease_ns * self._guards.waits_after_start
        """Earliest instant for granting an area for which no request was granted since the
        start."""
        self._expiries_ns: dict[int, int] = {}
        self._displaced_ns: dict[int, int] = {}
        """By area, expiry of the lease that a named successor took over."""
        self._sequence = 0
        self._stored = False

    def expiry_ns(self, area: int) -> int:
        """Instant at which the lease of an area has expired, as far as this arbiter knows."""
        return self._expiries_ns.get(area, self._free_ns)

    def lease(self, area: int) -> LeaseMemory:
        """Return the memory of an area; an unknown area has no acknowledged term."""
        for each in self.memory.areas:
            if each.area == area:
                return each
        return LeaseMemory(area)

    def has_granted(self, message: T2tMessage) -> bool:
        """Whether this arbiter granted the message's term to its sender."""
        lease = self.lease(message.area)
        return (lease.promised, lease.holder) == (message.term, message.source)

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
            # Otherwise the next start would find a memory in which no term is acknowledged.
            return WaysideStepped(None, ())
        return WaysideStepped(self.memory if changed else None, tuple(out))

    def _agrees(self, request: LeaseRequest) -> bool:
        """Check that the sender assumes the same number of arbiters and the same lease time."""
        rules = request.arbiters, request.lease_ms
        agrees = rules == (self._arbiters, self._timers.lease_ms)
        if not agrees:
            self.gate.refuse(RefusedReason.OTHER_RULES, request)
        return agrees

    def _answer(self, request: LeaseRequest, now_ns: int) -> LeaseAnswer:
        granted = self._grants(request, now_ns)
        lease = self.lease(request.area)
        head = self._head(now_ns, request, lease.promised)
        kept = (lease.roster_term, lease.roster_version, lease.roster)
        if not granted or request.kind is not LeaseKind.ACQUIRE:
            kept = (0, 0, ())
        wait_ns = 0 if granted else max(0, self.expiry_ns(request.area) - now_ns)
        grants = (self._signed(request),) if granted and self._signer is not None else ()
        return LeaseAnswer(
            *(*head, granted, request.nonce, request.stamp_ns, lease.holder, wait_ns),
            *(*kept, grants),
        )

    def _signed(self, request: LeaseRequest) -> SignedGrant:
        """Sign the grant of this request, up to the end that its holder may rely on."""
        assert self._signer is not None
        return self._signer.signed(
            area=request.area,
            term=request.term,
            holder=request.source,
            arbiter=self._address,
            end_ns=request.stamp_ns + self._timers.holder_lease_ns - request.less_ns,
        )

    def _grants(self, request: LeaseRequest, now_ns: int) -> bool:
        area, lease = request.area, self.lease(request.area)
        expiry_ns = self.expiry_ns(area)
        plea = Plea(request.source, request.term, lease, now_ns >= expiry_ns)
        guards = self._guards
        if request.kind is LeaseKind.ACQUIRE:
            if by_holder(plea):
                # The candidate repeats a request whose grant has not reached it yet.
                return self._extends(request, now_ns)
            if not (
                guards.term_is_new(plea)
                and guards.term_in_reach(plea)
                and guards.lease_is_free(plea)
            ):
                return False
            self._displaced_ns[area] = expiry_ns
            self._keep(lease._replace(promised=request.term, holder=request.source, successor=0))
        elif not guards.by_holder(plea):
            return False
        elif request.kind is LeaseKind.RELEASE:
            # A train that was displaced by a successor that now gives up may still command. If it
            # was displaced before this start, it may command for as long as any lease granted then.
            self._expiries_ns[area] = max(now_ns, self._displaced_ns.get(area, self._free_ns))
            return False
        elif lease.successor != request.successor:
            self._keep(lease._replace(successor=request.successor))
        return self._extends(request, now_ns)

    def _extends(self, request: LeaseRequest, now_ns: int) -> bool:
        """Never shorten a lease that was granted before, because its holder relies on it."""
        granted_ns = now_ns + self._timers.arbiter_lease_ns - request.less_ns
        self._expiries_ns[request.area] = max(self.expiry_ns(request.area), granted_ns)
        return True

    def _keeps(self, commit: RosterCommit) -> bool:
        """Store a roster of the holder unless it is older than the stored one."""
        lease = self.lease(commit.area)
        trains = [entry.train for entry in commit.roster]
        if len(set(trains)) != len(trains) or not all(0 < each <= LAST_TRAIN for each in trains):
            return False
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
