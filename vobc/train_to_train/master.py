"""A train that commands an area: it receives reports, keeps roster and objects, and issues
authorities.

Theory
------
A master is the one train that may issue authorities in an area under one *term*. Arbiters grant it
a *lease*; a majority decides, so two masters of one term cannot exist. The master computes, and the
arbiters only count votes and store the roster.

States of a master:

- lease and term (`lease`): without a running lease it sends nothing;
- roster (`roster`): the trains of the area in line order. It is *proposed* by the master and
  *committed* when a majority of arbiters has stored it;
- records (`occupancy`): per train the newest report, the authorities that are outstanding, and the
  place that is kept free for it while it is silent;
- track and objects (`axle_counting`, `objects`): occupied sections, locked switches, closures;
- applicants and restarted trains (`admission`, `restart`): they report without a valid entry.

Phases: *fencing* until the first roster is committed and the track is known, then *issuing*. Each
cycle updates the roster, the objects and the authorities, in this order.

Equations. With rear_min as the least place of a train's rear, the authority of the train behind
ends at

    min(end of the area,
        rear_min of the train ahead - (rollback + jog back),
        start of the first barred stretch ahead,
        front_max + longest authority)

A train ahead counts with the worst of what it may do: its own outstanding authorities, and its
place since the last report. A silent train keeps its place until axle counters show it clear.

Invariants:

1. At most one master issues authorities of a term, and none within the margin of the lease's end
   (INV-19, INV-25). Members refuse messages of a lower term (INV-20, INV-29).
2. Authorities of two trains never overlap, also across masters and areas (INV-21, INV-22). No train
   gets track because of a roster entry that is not committed.
3. A section that axle counters show occupied, and that known trains do not account for, bars the
   trains behind. Only a *sieved* train proves that no shadow train is next to it.
4. A train that was never received, or restarted, gets no authority before it is on a committed
   roster in its present incarnation.

References: [Xu] for the master that computes for its area, [Raft] for term and majority,
[Gray 1989] for the lease, [IEEE 1474.1] for the safe separation of trains.
docs/design/train_to_train.md has the whole protocol.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final

from firmware_py.trackdb.areas import AreaMap
from vobc.train_to_train import admission
from vobc.train_to_train.admission import (
    AdmissionGuardInputs,
    Waiting,
    admitted,
    foremost_first,
    is_sieved,
)
from vobc.train_to_train.authority import (
    AreaBounds,
    BarredTrack,
    Course,
    back_to_m,
    end_of_authority_m,
)
from vobc.train_to_train.axle_counting import TrackView, restrictions_for, view_of
from vobc.train_to_train.guards import Freshness, MasterGuards
from vobc.train_to_train.inference import Conclusions
from vobc.train_to_train.lease import Lease
from vobc.train_to_train.message_heads import MessageHead, MessageHeads
from vobc.train_to_train.objects import TrackObjects
from vobc.train_to_train.occupancy import TrainRecord, TrainTable
from vobc.train_to_train.removals import Removals, TrackObservation
from vobc.train_to_train.restart import RestartedTrains
from vobc.train_to_train.roster import Order, Roster
from vobc.train_to_train.succession import Succession
from vobc.train_to_train.surroundings import AreaObservation, Surroundings
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    BROADCAST,
    NO_TRAIN,
    SUPERVISION,
    Admission,
    AdmissionState,
    AreaAuthority,
    Heartbeat,
    LineOrder,
    ObjectClaim,
    ObjectStatus,
    OrderKind,
    Phase,
    RosterAck,
    RosterCommit,
    StandbySync,
    SwitchKind,
    SwitchStep,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import Removal, RemovalAnswer
from zenoh_config.timers import NS_PER_MS

APPLICANTS_MAX: Final = 64


class Master:
    """Master of an area from the grant of the lease to its end, under one term."""

    def __init__(
        self,
        config: T2tConfig,
        guards: MasterGuards,
        line: AreaMap,
        area: int,
        *,
        speaker: MessageHeads,
        lease: Lease,
        table: TrainTable,
        now_ns: int,
    ) -> None:
        """Begin to command. `table` holds what a standby already knows; otherwise it is empty."""
        self.term = lease.term
        self.succession = Succession(speaker.address, config.switch_limit_ms * NS_PER_MS)
        self.roster = Roster(lease.term, lease.adopted, config.majority, guards)
        self._config, self._guards, self._line = config, guards, line
        self._area = line.area(area)
        self._space = AreaBounds(
            self._area.end_m, (), config.rollback_m, config.jog_m, config.longest_authority_m
        )
        self._speaker, self._lease = speaker, lease
        self._known = Conclusions(lease.term, table, config, guards)
        self._objects = TrackObjects(lease.term, line.objects_in(area), guards)
        self._track: TrackView | None = None
        self._applicants: dict[int, tuple[TrainReport, int]] = {}
        self._around = Surroundings(self._known, line, area)
        self._removals = Removals(config, guards, self._known)
        self._unfit: set[int] = set()
        """Trains that supervision has ordered out of service."""
        self._left: TrainRecord | None = None
        """The last sieved train that left the area. Its axles may still be counted."""
        self._beat_ns = self._cycle_ns = now_ns
        self._was_ready = False
        self._newborns = RestartedTrains(config, guards)
        self._known.begin_with(self.roster.proposed, now_ns)

    def on_message(self, message: T2tMessage, now_ns: int) -> None:
        """Process a message. Types without a route do not concern a master."""
        route = ROUTES.get(type(message))
        if route is not None:
            route(self, message, now_ns)

    def _on_roster_ack(self, ack: RosterAck, _: int) -> None:
        if ack.source in self._config.arbiters:
            self.roster.on_message(ack)

    def _on_object_status(self, status: ObjectStatus, _: int) -> None:
        self._objects.on_message(status)

    def _on_track_status(self, status: TrackStatus, _: int) -> None:
        if status.term == self.term:
            self._track = view_of(status, self._line)

    def _on_switch_step(self, step: SwitchStep, _: int) -> None:
        if step.kind is SwitchKind.READY and step.term == self.term:
            self.succession.switch.is_ready(step.source, step.nonce)

    def _on_removal(self, removal: Removal, now_ns: int) -> None:
        self._removals.on_message(removal, now_ns)

    def _on_report(self, report: TrainReport, now_ns: int) -> None:
        train = report.source
        boot = self.roster.boots().get(train)
        self._around.on_message(report, now_ns)
        if boot is not None and boot != report.boot:
            self._newborns.on_message(report, now_ns)
            self._known.on_restarted_report(report)
        elif boot is not None:
            self._newborns.forgets(train)
            self._applicants.pop(train, None)
            record = self._known.records[train]
            record.on_message(report, now_ns, term=self.term, jog_m=self._config.jog_m)
            if not record.served:
                self._cycle_ns = min(self._cycle_ns, now_ns)
        elif self._has_passed(report.rear_min_m) or self._around.is_far(report):
            self._applicants.pop(train, None)
            self._around.passes(report, now_ns)
        elif train in self._applicants or len(self._applicants) < APPLICANTS_MAX:
            self._applicants[train] = (report, now_ns)

    def _on_order(self, order: LineOrder, _: int) -> None:
        record = self._known.records.get(order.train)
        if order.kind is OrderKind.SWITCH_MASTER:
            self.succession.wanted = order.train
        elif order.kind is OrderKind.OUT_OF_SERVICE:
            self._unfit.add(order.train)
        elif order.kind is OrderKind.IN_SERVICE:
            self._unfit.discard(order.train)
        elif record is not None:
            record.stopped = order.kind is OrderKind.STOP

    # Decisions.

    def next_due_ns(self) -> int:
        return min(self._beat_ns, self._cycle_ns) if self._was_ready else self._beat_ns

    def step(self, now_ns: int, *, away: bool) -> list[T2tMessage]:
        """All messages to send now. There are none unless the lease still holds when they have
        left.

        Args:
            away: this train should stop commanding soon, because it leaves or cannot continue.
        """
        sent: list[T2tMessage] = []
        if not self._lease.runs(now_ns):
            return sent
        if now_ns >= self._cycle_ns and self._is_ready(now_ns):
            self._cycle_ns = _next(self._cycle_ns, now_ns, self._config.timers.cycle_ms)
            sent += self._cycle(now_ns, away=away)
        if now_ns >= self._beat_ns:
            self._beat_ns = _next(self._beat_ns, now_ns, self._config.timers.heartbeat_ms)
            sent += self._beat(now_ns)
        return sent

    def _is_ready(self, now_ns: int) -> bool:
        """Whether the trains of the area and the state of its track are known. Before, the master
        issues no authority.
        """
        self._was_ready = self.roster.kept is not None and self._track_is_known(now_ns)
        return self._was_ready

    def _beat(self, now_ns: int) -> list[T2tMessage]:
        phase = Phase.FENCING if self.roster.kept is None else Phase.ISSUING
        sent: list[T2tMessage] = [
            Heartbeat(
                *self._head(now_ns, BROADCAST),
                *(phase, self.succession.standby, self.roster.version, self._lease.proof()),
            )
        ]
        if self.roster.pending:
            sent += [
                RosterCommit(*self._head(now_ns, each), self.roster.version, self.roster.proposed)
                for each in self.roster.missing(self._config.arbiters)
            ]
        return sent + self.succession.steps(now_ns, self._head)

    def _cycle(self, now_ns: int, *, away: bool) -> list[T2tMessage]:
        if self._track is not None:
            self._known.advance_silent(now_ns, self._track)
        self._known.take_proofs(self.roster.proposed, now_ns)
        sent: list[T2tMessage] = []
        if not self.roster.pending:
            sent += self._keep_roster(now_ns)
        sent += [
            RemovalAnswer(*self._head(now_ns, SUPERVISION), train, state)
            for train, state in self._removals.answers(self.roster)
        ]
        self._succeed(now_ns, away=away)
        sent += self._claims(now_ns)
        return sent + self._authorities(now_ns)

    # The roster.

    def _keep_roster(self, now_ns: int) -> list[T2tMessage]:
        """Remove departed trains, update sieved ones, then admit at most one applicant after
        another.
        """
        sent: list[T2tMessage] = []
        records = self._known.records
        gone = self._removals.gone(self.roster, self._sight, now_ns)
        order: Order = self.roster.proposed
        passed = [e for e in order if self._has_passed(records[e.train].rear_m)]
        order = tuple([e for e in order if e not in passed and e.train not in gone])
        order, elsewhere = self._newborns.settle(
            order, lambda report: self._scene(now_ns, report, inside=True), self._known, now_ns
        )
        left = [records[each.train] for each in passed if self._guards.sieved(each.sieved)]
        self._left = left[-1] if left else self._left
        changed = order != self.roster.proposed
        self._applicants.update({report.source: (report, at_ns) for report, at_ns in elsewhere})
        self._applicants = {
            train: each
            for train, each in self._applicants.items()
            if self._known.is_alive(each[1], now_ns)
        }
        for train, (report, received_at_ns) in sorted(self._applicants.items(), key=foremost_first):
            if not (report.localised and self._known.is_recent(report, now_ns)):
                continue
            scene = self._scene(now_ns, report)
            result = admitted(order, report, scene, self._config, self._guards)
            if isinstance(result, Waiting):
                sent.append(Admission(*self._head(now_ns, train), result.state, result.waits_for))
                continue
            order, changed = result, True
            record = self._known.table.of(train, rear_m=report.rear_min_m, now_ns=received_at_ns)
            record.on_message(report, received_at_ns, term=self.term, jog_m=self._config.jog_m)
            sent.append(Admission(*self._head(now_ns, train), AdmissionState.COMMITTING, NO_TRAIN))
        order, sieved = self._sieve(order, now_ns)
        if changed or sieved:
            self.roster.propose([e._replace(rear_m=records[e.train].rear_m) for e in order])
            self._known.table.forget_but([entry.train for entry in order])
            self._beat_ns = now_ns
        return sent

    def _has_passed(self, rear_m: float) -> bool:
        """The train has left the area for good, even if it rolls or jogs back."""
        return rear_m >= self._area.end_m + self._config.behind_rear_m

    def _sieve(self, order: Order, now_ns: int) -> tuple[Order, bool]:
        sieved, look = [], None
        for entry in order:
            record = self._known.records[entry.train]
            report, entry = record.report, entry._replace(stopped=record.stopped)
            if not entry.sieved and report is not None:
                scene = self._around.scene(entry.train, look := look or self._look(now_ns))
                entry = entry._replace(sieved=is_sieved(report, scene, self._config.behind_axle_m))
            sieved.append(entry)
        return tuple(sieved), tuple(sieved) != order

    def _look(self, now_ns: int) -> AreaObservation:
        return self._around.look(self.roster.proposed, self._strangers(), self._track, now_ns)

    def _scene(
        self, now_ns: int, newcomer: TrainReport, *, inside: bool = False
    ) -> AdmissionGuardInputs:
        return self._around.scene(newcomer.source, self._look(now_ns), inside=inside)

    def _sight(self, now_ns: int) -> TrackObservation:
        return self._around.sight(self._strangers(), self._track, now_ns)

    def _strangers(self) -> list[tuple[TrainReport, int]]:
        return [*self._applicants.values(), *self._newborns.told()]

    # Objects.

    def _claims(self, now_ns: int) -> list[T2tMessage]:
        planned = self._objects.plan(
            needed=self._known.is_needed,
            reaches=lambda site: self._known.reaches(site, self.roster.proposed),
        )
        return [
            ObjectClaim(*self._head(now_ns, WAYSIDE), site.number, claim.kind, claim.nonce)
            for site, claim in planned
        ]

    def _authorities(self, now_ns: int) -> list[T2tMessage]:
        commanded = self.roster.may_be_commanded()
        barred = [*self._objects.stretches(), *(self._track.closed if self._track else ())]
        barred += admission.kept_free(self._strangers(), self.roster.boots(), self._config)
        issued: list[T2tMessage] = []
        ahead: TrainRecord | None = None
        alone: TrainRecord | None = None
        kept = True
        for rank, entry in enumerate(self.roster.proposed, start=1):
            record = self._known.records[entry.train]
            sieved, told = self._guards.sieved(entry.sieved), self._known.is_told(record, now_ns)
            if entry.train in commanded and sieved and told:
                # A shadow train may be near a train that is not sieved. That train's sections then
                # prove nothing.
                beyond_m = self._known.within_m(record, now_ns, sure=alone is ahead)
                open_end = (self._area.end_m, self._left)
                hidden = self._known.hidden(record, beyond_m, alone, self._track, open_end, now_ns)
                hidden += [] if kept else [self._known.no_farther(record, now_ns)]
                authority = self._authority(now_ns, record, ahead, [*barred, *hidden], rank)
                issued += [] if authority is None else [authority]
            ahead, alone = record, record if sieved else None
            # The next master may not know a train that is not committed. No train gets track on its
            # account.
            kept = entry.train in commanded
        return [*self._sync(now_ns), *issued]

    def _authority(
        self,
        now_ns: int,
        record: TrainRecord,
        ahead: TrainRecord | None,
        barred: list[BarredTrack],
        rank: int,
    ) -> AreaAuthority | None:
        report = record.report
        if report is None:
            return None
        course = Course(
            rear_m=record.rear_m,
            front_max_m=report.front_max_m,
            easy_m=report.easy_m,
            granted_m=record.granted_m,
            ahead_m=self._known.ahead_m(record, report, ahead),
            stopped=record.stopped,
        )
        space = self._space.barred_by(barred)
        end_m = end_of_authority_m(course, space)
        rear_m = back_to_m(course, space)
        if end_m is None or end_m < rear_m:
            return None
        head = self._head(now_ns, record.train)
        record.issued(head.sequence, end_m, life_ns=self._known.life_ns)
        return AreaAuthority(
            *head,
            report.boot,
            report.stamp_ns,
            end_m,
            rear_m,
            NO_TRAIN if ahead is None else ahead.train,
            rank,
            restrictions_for(
                self._track.restrictions if self._track else (), rear_m=rear_m, end_m=end_m
            ),
        )

    def _sync(self, now_ns: int) -> list[T2tMessage]:
        """Records for the standby. They are sent before the authorities that they concern."""
        standby = self.succession.standby
        if standby == NO_TRAIN:
            return []
        head = self._head(now_ns, standby)
        return [StandbySync(*head, self.roster.version, self._known.sync_entries())]

    def is_fit(self, train: int, now_ns: int) -> bool:
        """Whether a train may be standby or master.

        It is another train, reports, is committed, has acknowledged the term and is in service.
        """
        if train in self._unfit or train == self._speaker.address:
            return False
        return train in self.roster.may_be_commanded() and self._known.is_fit(train, now_ns)

    def _succeed(self, now_ns: int, *, away: bool) -> None:
        """Update the standby and the planned switch."""
        succession, own = self.succession, self._speaker.address
        heard = [
            (each.train, each.ready_nonce)
            for each in self._known.records.values()
            if each.ready_nonce is not None
            and each.train != own
            and self._known.is_alive(each.received_at_ns, now_ns)
        ]
        heard += self._newborns.ready(self._known, now_ns)
        succession.choose_standby(
            [e.train for e in self.roster.proposed if self.is_fit(e.train, now_ns)]
        )
        changed = succession.step(
            now_ns,
            away=away or own in self._unfit,
            fit=lambda train: self.is_fit(train, now_ns),
            ready=heard,
        )
        if changed:
            self._lease.successor = succession.named
            self._beat_ns = now_ns

    @property
    def has_others(self) -> bool:
        """Another train is on the roster or applies."""
        own = self._speaker.address
        return bool((self._on_roster() | set(self._applicants)) - {own})

    def receives_from_no_train(self, now_ns: int) -> bool:
        """There are several other trains, and none of them reports."""
        return self._known.all_silent(self._speaker.address, now_ns)

    def _on_roster(self) -> set[int]:
        return {entry.train for entry in self.roster.proposed}

    def _track_is_known(self, now_ns: int) -> bool:
        if not self._line.sections:
            return True
        limit_ns = self._config.timers.authority_ms * NS_PER_MS
        seen_ns = now_ns - limit_ns - 1 if self._track is None else self._track.seen_ns
        return self._guards.track_known(Freshness(now_ns - seen_ns, limit_ns))

    def _head(self, now_ns: int, to: int) -> MessageHead:
        return self._speaker.head(now_ns, to=to, area=self._area.number, term=self.term)


def _next(due_ns: int, now_ns: int, period_ms: int) -> int:
    """The next due time of a periodic task. Missed periods are skipped."""
    period_ns = period_ms * NS_PER_MS
    return due_ns + (1 + (now_ns - due_ns) // period_ns) * period_ns


ROUTES: Final[Mapping[type[T2tMessage], Callable[[Master, Any, int], None]]] = {
    TrainReport: Master._on_report,
    RosterAck: Master._on_roster_ack,
    ObjectStatus: Master._on_object_status,
    TrackStatus: Master._on_track_status,
    SwitchStep: Master._on_switch_step,
    LineOrder: Master._on_order,
    Removal: Master._on_removal,
}
"""Method of a master for each type of message that it acts on."""
