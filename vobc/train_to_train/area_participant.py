"""State of a train in one area: as member, as candidate and as master."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from firmware_py.trackdb.areas import AreaMap
from vobc.train_to_train.guards import TrainGuards
from vobc.train_to_train.lease import ArbiterRequest, Lease, LeaseState
from vobc.train_to_train.master import Master
from vobc.train_to_train.member import AreaMember
from vobc.train_to_train.message_heads import MessageHead, MessageHeads
from vobc.train_to_train.occupancy import UNBOUNDED_M, TrainTable
from vobc.train_to_train.roles import ROLES, RoleGuardInputs, next_role
from vobc.train_to_train.vocabulary import AreaMemory, OwnTrain, Role, T2tConfig
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseRequest,
    Phase,
    StandbySync,
    SwitchKind,
    SwitchStep,
    SyncAck,
    T2tMessage,
    TrainReport,
)
from zenoh_config.timers import NS_PER_MS

COMMANDING: Final = (Role.FENCING, Role.MASTER)
DOUBLED_MAX: Final = 5
"""Number of failed candidacies up to which the wait after one doubles, to 2.5 s at least."""
FOR_NONE: Final = (0, 0)
"""Marks a train that is ready for no switch. Terms and switches are never numbered 0."""


class AreaParticipant:
    def __init__(
        self,
        config: T2tConfig,
        guards: TrainGuards,
        line: AreaMap,
        area: int,
        *,
        speaker: MessageHeads,
        memory: AreaMemory,
        now_ns: int,
        chance: "Chance",
    ) -> None:
        self.role = Role.OUTSIDE
        self.member = AreaMember(
            config, guards.member, boot=speaker.boot, memory=memory, now_ns=now_ns
        )
        self.stored = memory
        """Memory of this area as last handed out for storage."""
        self.lease = Lease(config, guards.lease)
        self.master: Master | None = None
        self.area = line.area(area)
        self.refused: list[str] = []
        """Reasons of refused authorities and terms in this step."""
        self._ready = FOR_NONE
        """Term and nonce of the planned switch for which this train is ready."""
        self._config, self._guards, self._line, self._speaker = config, guards, line, speaker
        self._chance = chance
        self._table = TrainTable()
        """Train records that a standby receives. The records of a new master start from them."""
        self._report_ns = now_ns
        self._applied_ns = now_ns
        """When the present candidacy began."""
        self._quiet_until_ns = now_ns
        """Time until which the train does not apply again, after a lost candidacy."""
        self._called = False
        self._was_called = False
        """The present candidacy began because the master called this train to take over."""
        self._failures = 0
        """Number of candidacies that failed since a master was last received."""
        self._fenced = False
        """A train reported a higher term than that of the newest candidacy."""
        self._heard_ns = now_ns
        """When the last message of this area arrived from another device."""

    # Received messages.

    def on_message(self, message: T2tMessage, now_ns: int) -> list[T2tMessage]:
        """Process a message. The result is the immediate answer."""
        self._heard_ns = now_ns
        return self._takes(message, now_ns)

    def _takes(self, message: T2tMessage, now_ns: int) -> list[T2tMessage]:
        return ROUTES.get(type(message), AreaParticipant._passes_on)(self, message, now_ns)

    def _on_heartbeat(self, heartbeat: Heartbeat, now_ns: int) -> list[T2tMessage]:
        accepted = self.member.on_heartbeat(heartbeat, now_ns)
        if accepted and heartbeat.phase is Phase.ISSUING:
            # One that is still fencing, as this train itself may be, may yet lose its lease.
            self._failures = 0
        secured = self._config.grants is not None
        if not accepted and secured and heartbeat.term > self.member.memory.seen_term:
            self.refused.append("term not proven")
        return []

    def _on_authority(self, authority: AreaAuthority, now_ns: int) -> list[T2tMessage]:
        refused = self.member.takes(authority, now_ns)
        self.refused += [refused] if refused else []
        return []

    def _on_lease_answer(self, answer: LeaseAnswer, now_ns: int) -> list[T2tMessage]:
        self.lease.on_message(answer, now_ns)
        self.member.confirm(self.lease.confirmed_term, self.lease.owner_of)
        return []

    def _on_switch_step(self, step: SwitchStep, now_ns: int) -> list[T2tMessage]:
        """A member that is ready answers the master. All other steps are for the members."""
        if step.kind is SwitchKind.READY:
            return self._passes_on(step, now_ns)
        return self._on_switch(step, now_ns)

    def _on_report(self, report: TrainReport, now_ns: int) -> list[T2tMessage]:
        self._fenced |= report.term > self.lease.term and self.member.believes_reported(report.term)
        if self.role is Role.STANDBY and report.localised:
            record = self._table.of(report.source, rear_m=report.rear_min_m, now_ns=now_ns)
            record.on_message(report, now_ns, term=report.term, jog_m=self._config.jog_m)
        return self._passes_on(report, now_ns)

    def _passes_on(self, message: T2tMessage, now_ns: int) -> list[T2tMessage]:
        """Give the message to the master, if this train is it."""
        if self.master is not None:
            self.master.on_message(message, now_ns)
        return []

    def _on_sync(self, sync: StandbySync, now_ns: int) -> list[T2tMessage]:
        if not self.member.fences(sync):
            return []
        self._table.takes_sync(sync.entries, now_ns)
        return [SyncAck(*self._head(now_ns, sync.source), sync.sequence)]

    def _on_switch(self, step: SwitchStep, now_ns: int) -> list[T2tMessage]:
        if not self.member.fences(step):
            return []
        own = self._speaker.address
        if step.kind is SwitchKind.ABORT:
            self._ready, self._called = FOR_NONE, False
        elif step.kind is SwitchKind.PREPARE:
            if self._ready != (step.term, step.nonce):
                self._ready = step.term, step.nonce
                self._report_ns = now_ns
            if step.successor == own and self.role is Role.STANDBY:
                head = self._head(now_ns, step.source)
                return [SwitchStep(*head, SwitchKind.READY, step.nonce, own)]
        elif step.kind is SwitchKind.RESIGN:
            self._called |= self.role is Role.STANDBY
        elif step.successor == own and (step.term, step.nonce) == self._ready:
            self._called = True
        return []

    # Decisions.

    def next_due_ns(self, now_ns: int) -> int:
        """When the passing of time next makes a difference.

        A turn or a silence that has ended without effect is not counted again.
        """
        due_ns = self._report_ns
        if self.master is not None:
            lease = self.lease
            due_ns = min(due_ns, self.master.next_due_ns(), lease.renewal_due_ns(), lease.until_ns)
            turn_ns = self._deaf_ns()
        elif self.role is Role.CANDIDATE:
            due_ns = min(due_ns, self.lease.asks_again_ns())
            turn_ns = self.lease.attempt_ends_ns()
        else:
            turn_ns = max(self._turn_ns(), self._quiet_until_ns)
        return min(due_ns, turn_ns) if turn_ns > now_ns else due_ns

    def step(
        self, now_ns: int, own: OwnTrain, *, concerned: bool, relation: tuple[int, int]
    ) -> list[T2tMessage]:
        """Update the role, then return the messages of that role.

        Args:
            relation: the area that the train comes from, and the train ahead of it there.
        """
        if self.role is Role.OUTSIDE:
            self.member.master_heard_ns = now_ns
        sent = self._change_role(now_ns, own, concerned=concerned)
        if self.role is Role.OUTSIDE:
            return sent
        reports = self._report(now_ns, own, relation)
        sent += reports
        if self.role is Role.CANDIDATE and now_ns >= self.lease.asks_again_ns():
            sent += self._ask(now_ns, self.lease.ask_again(now_ns))
        if self.master is not None:
            sent += self._command(self.master, now_ns, own, reports, concerned=concerned)
        return sent

    def _change_role(self, now_ns: int, own: OwnTrain, *, concerned: bool) -> list[T2tMessage]:
        sent: list[T2tMessage] = []
        # A lease or roster that is granted at once takes effect in the same step.
        for _ in range(len(ROLES)):
            sight = self._sight(now_ns, own, concerned=concerned)
            role = next_role(self.role, sight)
            if role is self.role:
                break
            before, self.role = self.role, role
            sent += self._leave(before, sight, now_ns)
            sent += self._enter(role, now_ns)
        return sent

    def _sight(self, now_ns: int, own: OwnTrain, *, concerned: bool) -> RoleGuardInputs:
        master = self.master
        gone = not own.localised or not concerned
        may_command = not gone and not own.out_of_service
        silent = now_ns >= max(self._turn_ns(), self._quiet_until_ns)
        away = not may_command
        return RoleGuardInputs(
            concerned=concerned,
            member=self.member.is_young(now_ns),
            named_standby=self.member.standby == self._speaker.address,
            apply_now=silent or self._called,
            may_command=may_command,
            candidacy_lost=self.lease.lost(now_ns) or away or self._master_is_back(now_ns),
            lease_granted=self.lease.state is LeaseState.HELD,
            lease_runs=self.lease.runs(now_ns),
            fenced=self._is_fenced(),
            roster_kept=master is not None and master.roster.kept is not None,
            # A master out of service stays master until another train takes over.
            relieved=gone and master is not None and not master.has_others,
            deaf=master is not None and self._is_deaf(master, now_ns),
        )

    def _master_is_back(self, now_ns: int) -> bool:
        """No arbiter answers this candidate, and it receives the master again."""
        heard = not self._was_called and self.member.master_heard_ns > self._applied_ns
        return heard and self.lease.is_late(now_ns)

    def _deaf_ns(self) -> int:
        return self._heard_ns + self._config.timers.silence_ms * NS_PER_MS

    def _is_deaf(self, master: Master, now_ns: int) -> bool:
        """Whether this master receives nothing, or nothing from any train.

        Its own messages may still arrive, so the others would go on waiting for it.
        """
        somebody_waits = master.succession.standby != NO_TRAIN
        return somebody_waits and (
            now_ns >= self._deaf_ns() or master.receives_from_no_train(now_ns)
        )

    def _turn_ns(self) -> int:
        """When the master's silence has lasted long enough for this train to apply."""
        timers = self._config.timers
        rank = 0 if self.member.standby == self._speaker.address else self.member.rank
        return self.member.master_heard_ns + (timers.silence_ms + rank * timers.rank_ms) * NS_PER_MS

    def _leave(self, role: Role, sight: RoleGuardInputs, now_ns: int) -> list[T2tMessage]:
        if role is Role.CANDIDATE and self.role is not Role.FENCING:
            self._failures += 1
            self._quiet_until_ns = self._next_try_ns(now_ns)
            return self._ask(now_ns, self.lease.give_back(now_ns))
        if role in COMMANDING and self.role not in COMMANDING:
            if role is Role.FENCING:
                # The lease was too short to commit a roster. The next one may be no longer.
                self._failures += 1
                self._quiet_until_ns = self._next_try_ns(now_ns)
            standby = NO_TRAIN if self.master is None else self.master.succession.standby
            self.master = None
            self.member.master_heard_ns = now_ns
            if now_ns >= self._deaf_ns():
                # The arbiters still receive this train, although it receives nothing. Its requests
                # would only obstruct a train with a working receiver.
                self._quiet_until_ns = now_ns + 2 * self._config.timers.lease_ms * NS_PER_MS
            sent = self._ask(now_ns, self.lease.give_back(now_ns))
            if standby != NO_TRAIN and not sight.fenced:
                sent.append(SwitchStep(*self._head(now_ns, standby), SwitchKind.RESIGN, 0, standby))
            return sent
        return []

    def _is_fenced(self) -> bool:
        """This train, or a train that reports to it, received a higher term than its own."""
        newer = self.member.memory.seen_term > self.lease.term
        return newer or self._fenced or self.lease.beaten

    def _next_try_ns(self, now_ns: int) -> int:
        """When this train applies again after a lost candidacy.

        The standby asks again when the lease that blocked it has expired. A train that lost against
        another candidate, and every other train, waits for a random time. It doubles with each
        failure.
        """
        blocked_ns = self.lease.wait_until_ns
        if blocked_ns and self.member.standby == self._speaker.address:
            return max(now_ns, blocked_ns) + NS_PER_MS
        backoff_ns = self._config.backoff_ms * NS_PER_MS << min(self._failures - 1, DOUBLED_MAX)
        return max(now_ns, blocked_ns) + backoff_ns + self._chance.below(backoff_ns)

    def _enter(self, role: Role, now_ns: int) -> list[T2tMessage]:
        if role is Role.CANDIDATE:
            return self._apply(now_ns)
        if role is Role.FENCING:
            self._take_command(now_ns)
        elif role is Role.MASTER:
            self._failures = 0
        elif role is not Role.STANDBY:
            self._table = TrainTable()
        return []

    def _apply(self, now_ns: int) -> list[T2tMessage]:
        memory = self.member.memory
        request = self.lease.ask(now_ns, seen_term=memory.seen_term, tried_term=memory.tried_term)
        self.member.memory = memory._replace(tried_term=request.term)
        self._was_called, self._applied_ns = self._called, now_ns
        self._fenced = self._called = False
        return self._ask(now_ns, request)

    def _take_command(self, now_ns: int) -> None:
        self.member.memory = self.member.memory._replace(
            seen_term=self.lease.term, owner=self._speaker.address
        )
        self._report_ns = now_ns
        self.master = Master(
            self._config,
            self._guards.master,
            self._line,
            self.area.number,
            speaker=self._speaker,
            lease=self.lease,
            table=self._table,
            now_ns=now_ns,
        )
        self._table = TrainTable()

    def _ask(self, now_ns: int, request: ArbiterRequest) -> list[T2tMessage]:
        """Send the same request to every arbiter."""
        area = self.area.number
        return [
            LeaseRequest(
                *self._speaker.head(now_ns, to=arbiter, area=area, term=request.term),
                *(request.kind, request.nonce, request.successor, request.less_ns),
                *(len(self._config.arbiters), self._config.timers.lease_ms),
            )
            for arbiter in self._config.arbiters
        ]

    def _command(
        self,
        master: Master,
        now_ns: int,
        own: OwnTrain,
        reports: Sequence[TrainReport],
        *,
        concerned: bool,
    ) -> list[T2tMessage]:
        sent: list[T2tMessage] = []
        for report in reports:
            master.on_message(report, now_ns)
        away = own.out_of_service or not own.localised or not concerned
        successor = self.lease.successor
        spoken = master.step(now_ns, away=away)
        if now_ns >= self.lease.renewal_due_ns() or self.lease.successor != successor:
            sent += self._ask(now_ns, self.lease.renew(now_ns))
        for message in spoken:
            # The master obeys its own messages like any member.
            if message.destination in (BROADCAST, self._speaker.address):
                self._obeys(message, now_ns)
        return sent + [m for m in spoken if m.destination != self._speaker.address]

    def _obeys(self, message: T2tMessage, now_ns: int) -> None:
        if isinstance(message, Heartbeat | AreaAuthority):
            self._takes(message, now_ns)
        elif isinstance(message, SwitchStep) and message.kind is not SwitchKind.COMMIT:
            self._on_switch(message, now_ns)

    # Reports.

    def vouch(self, now_ns: int, own: OwnTrain) -> list[TrainReport]:
        """Report to the master of an area that does not concern the train, half as often as a
        member.

        A member of any area reports often enough already.
        """
        if self.member.beat_ns == 0:
            return []
        sent = self._report(now_ns, own, (0, NO_TRAIN))
        if sent:
            self._report_ns += self._config.timers.cycle_ms * NS_PER_MS
        return sent

    def _report(self, now_ns: int, own: OwnTrain, relation: tuple[int, int]) -> list[TrainReport]:
        if now_ns < self._report_ns and not self.member.new_promise:
            return []
        self.member.new_promise = False
        period_ns = self._config.timers.cycle_ms * NS_PER_MS
        self._report_ns = now_ns + period_ns
        member = self.member
        latent_m = UNBOUNDED_M if member.latent_m is None else member.latent_m
        comes_from, behind = relation
        # A switch that the master of another term prepared does not concern this one.
        ready_nonce = self._ready[1] if self._ready[0] == member.memory.seen_term else 0
        report = TrainReport(
            *self._speaker.head(
                now_ns, to=BROADCAST, area=self.area.number, term=member.memory.seen_term
            ),
            localised=own.localised,
            front_min_m=own.front_min_m,
            front_max_m=own.front_max_m,
            rear_min_m=own.rear_min_m,
            protected_m=min(own.rests_m, own.rear_min_m + self._config.jog_m),
            speed_mps=own.speed_mps,
            standstill=own.standstill,
            latent_m=latent_m,
            held_end_m=member.held_end_m(own.front_max_m),
            easy_m=own.easy_m,
            held_term=member.newest[0],
            held_sequence=max(member.newest[1], 0),
            member=member.held is not None,
            behind=behind,
            comes_from=comes_from,
            axles=own.axles,
            out_of_service=own.out_of_service,
            ready_nonce=ready_nonce,
            # A report to itself has no transmission delay.
            echo_ns=member.beat_ns if self.master is None else now_ns,
        )
        return [report]

    def _head(self, now_ns: int, to: int) -> MessageHead:
        term = self.member.memory.seen_term
        return self._speaker.head(now_ns, to=to, area=self.area.number, term=term)


class Chance:
    """Random numbers that differ between trains and repeat from run to run (xorshift64*)."""

    def __init__(self, seed: int) -> None:
        self._state = (seed * 0x9E3779B97F4A7C15 + 0x2545F4914F6CDD1D) % 2**64 or 1

    def below(self, limit: int) -> int:
        """A number from 0 to `limit` - 1."""
        state = self._state
        state ^= state >> 12
        state ^= (state << 25) % 2**64
        state ^= state >> 27
        self._state = state
        return (state * 0x2545F4914F6CDD1D % 2**64 >> 16) % limit


ROUTES: Final[
    Mapping[type[T2tMessage], Callable[[AreaParticipant, Any, int], list[T2tMessage]]]
] = {
    Heartbeat: AreaParticipant._on_heartbeat,
    AreaAuthority: AreaParticipant._on_authority,
    LeaseAnswer: AreaParticipant._on_lease_answer,
    StandbySync: AreaParticipant._on_sync,
    SwitchStep: AreaParticipant._on_switch_step,
    TrainReport: AreaParticipant._on_report,
}
"""Method for each type of message that a member or standby acts on. Others are for the master."""
