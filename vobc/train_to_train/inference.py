"""Conclusions that a master draws from the reports of its trains, under its own term."""

from collections.abc import Sequence

from firmware_py.trackdb.areas import ObjectSite
from vobc.train_to_train.authority import Bar, BarredTrack
from vobc.train_to_train.axle_counting import TrackView, hidden_between, moved_on_m, way_m
from vobc.train_to_train.guards import Acknowledgement, Freshness, MasterGuards, Reach
from vobc.train_to_train.occupancy import UNBOUNDED_M, TrainRecord, TrainTable, rear_max_m
from vobc.train_to_train.roster import Order
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import RosterEntry, SyncEntry, TrainReport
from zenoh_config.timers import NS_PER_MS


class Conclusions:
    def __init__(
        self, term: int, table: TrainTable, config: T2tConfig, guards: MasterGuards
    ) -> None:
        self.table = table
        self.term, self._config, self._guards = term, config, guards
        self._silence_ns = config.timers.authority_ms * NS_PER_MS // 2
        """Time without a report after which a train counts as silent. An authority that answers an
        older report would soon be too old."""
        self.life_ns = 2 * config.timers.authority_ms * NS_PER_MS
        """Age of a report after which no train accepts an authority that answers it, whatever the
        clock drift."""

    @property
    def records(self) -> dict[int, TrainRecord]:
        return self.table.records

    def begin_with(self, roster: Order, now_ns: int) -> None:
        """Keep exactly these trains. The stored rear of a train never moves it backwards."""
        for entry in roster:
            self.add(entry, now_ns)
        self.table.forget_but([entry.train for entry in roster])

    def add(self, entry: RosterEntry, now_ns: int) -> TrainRecord:
        record = self.table.of(entry.train, rear_m=entry.rear_m, now_ns=now_ns)
        if record.boot != entry.boot:
            # Reports of another incarnation say nothing about the one on the roster.
            record = TrainRecord(entry.train, entry.rear_m, now_ns, boot=entry.boot)
            self.records[entry.train] = record
        record.stopped = entry.stopped
        if record.report is None:
            record.rear_m = max(record.rear_m, entry.rear_m)
        return record

    def reborn(self, report: TrainReport, received_at_ns: int) -> None:
        """Record that a train restarted in its old place.

        It accepts no authority of its former incarnation any more.
        """
        former = self.records[report.source]
        record = TrainRecord(report.source, report.rear_min_m, received_at_ns)
        record.on_message(report, received_at_ns, term=self.term, jog_m=self._config.jog_m)
        record.stopped = former.stopped
        self.records[report.source] = record

    def on_restarted_report(self, report: TrainReport) -> None:
        """Note the reach of a restarted train that is registered under its former incarnation.

        It accepts no authority of that incarnation any more.
        """
        record = self.records[report.source]
        if report.term == self.term and report.boot > record.boot:
            record.restarted_m = report.latent_m
            if report.localised:
                record.restarted_rear_m = rear_max_m(report)

    def has_promised(self, record: TrainRecord) -> bool:
        """The train has acknowledged this term and obeys no older one."""
        return self._guards.has_promised(Acknowledgement(record.term, self.term))

    def is_told(self, record: TrainRecord, now_ns: int) -> bool:
        """The train has acknowledged this term and is still in communication."""
        return self.has_promised(record) and self.is_alive(record.received_at_ns, now_ns)

    def is_fit(self, train: int, now_ns: int) -> bool:
        """The train reports, has acknowledged the term, and is in service by its own report."""
        record = self.records.get(train)
        return (
            record is not None
            and record.report is not None
            and not record.report.out_of_service
            and self.is_told(record, now_ns)
        )

    def all_silent(self, own: int, now_ns: int) -> bool:
        """Several other trains reported under this term, and none of them for two silence periods.

        It is then more likely that this master's receiver has failed than that all the trains have.
        """
        received_at_ns = [
            each.received_at_ns
            for each in self.records.values()
            if each.report is not None and each.train != own
        ]
        limit_ns = 2 * self._config.timers.silence_ms * NS_PER_MS
        return len(received_at_ns) > 1 and now_ns - max(received_at_ns) >= limit_ns

    def is_alive(self, received_at_ns: int, now_ns: int) -> bool:
        return self._guards.report_alive(Freshness(now_ns - received_at_ns, self._silence_ns))

    def is_recent(self, report: TrainReport, now_ns: int) -> bool:
        """Whether the content of the report is current."""
        return self.is_of_last(self._silence_ns, report, now_ns)

    def is_of_last(self, limit_ns: int, report: TrainReport, now_ns: int) -> bool:
        """Whether the report echoes a heartbeat of this master that is younger than the limit.

        A report under another term echoes none. The time of arrival is no measure, because the
        report may have been delayed.
        """
        if report.term != self.term or report.echo_ns == 0:
            return False
        return self._guards.report_recent(Freshness(now_ns - report.echo_ns, limit_ns))

    def is_placed(self, record: TrainRecord, now_ns: int) -> bool:
        """Whether the train's reported place under this term is current.

        Otherwise its rear may be far beyond, and a shadow train may be in the sections that it was
        in.
        """
        return not record.lost and self.spoke_just_now(record, now_ns)

    def spoke_just_now(self, record: TrainRecord, now_ns: int) -> bool:
        """Whether its last reported place is current, even if it has lost its position since."""
        return record.report is not None and self.is_recent(record.report, now_ns)

    def farther_m(self, record: TrainRecord, report: TrainReport, now_ns: int) -> float:
        """Greatest distance that the train may be ahead of its last reported place."""
        if self.is_recent(report, now_ns):
            return way_m(now_ns - report.echo_ns)
        return (record.granted_m if self.has_promised(record) else UNBOUNDED_M) - report.front_max_m

    def rear_max_m(self, report: TrainReport, now_ns: int) -> float:
        """Farthest place of the rear now, for a train with a recent report."""
        return rear_max_m(report) + way_m(now_ns - report.echo_ns)

    def reserved_m(self, order: Sequence[RosterEntry]) -> dict[int, float]:
        """Farthest place that each train may reach by any authority.

        The authority of a train that has not acknowledged the term is unknown. It never went beyond
        the rear of the train ahead, so that train's own bound holds for it, too. This is only
        certain for trains that have not restarted. A restarted train may have come back behind the
        others, so its bound holds for itself alone.
        """
        reserved_m: dict[int, float] = {}
        bound_m = UNBOUNDED_M
        for entry in order:
            record = self.records[entry.train]
            own_m = UNBOUNDED_M
            if self.has_promised(record):
                own_m = record.granted_m
                bound_m = min(bound_m, own_m)
            elif record.restarted_rear_m >= record.rear_m - self._config.behind_rear_m:
                own_m = record.restarted_m
            reserved_m[entry.train] = own_m if own_m < UNBOUNDED_M else bound_m
        return reserved_m

    def reaches(self, site: ObjectSite, order: Sequence[RosterEntry]) -> list[Reach]:
        behind_m = self._config.behind_rear_m
        return [
            Reach(reserved_m, self.records[train].rear_m - behind_m, site.start_m, site.end_m)
            for train, reserved_m in self.reserved_m(order).items()
        ]

    def is_needed(self, site: ObjectSite) -> bool:
        """A train approaches the object, or might come back to it."""
        ahead_m, behind_m = self._config.claim_ahead_m, self._config.behind_rear_m
        reports = [each.report for each in self.records.values() if each.report is not None]
        return any(
            each.rear_min_m - behind_m < site.end_m and each.front_max_m + ahead_m >= site.start_m
            for each in reports
        )

    def take_proofs(self, order: Sequence[RosterEntry], now_ns: int) -> None:
        """Advance the known rear of each train ahead by the authority of the train behind it.

        An authority proves how far the train ahead had come. An old report proves nothing, because
        the train ahead may have been moved since. A train that reports its own place needs no
        proof, and the authority may be that of a hostile master.
        """
        ahead: TrainRecord | None = None
        placed = False
        for entry in order:
            record = self.records[entry.train]
            recent = self.spoke_just_now(record, now_ns)
            if ahead is not None and recent and self.has_promised(record) and not placed:
                proven_m = record.rear_ahead_m(self._config.behind_rear_m)
                ahead.rear_m = max(ahead.rear_m, proven_m)
            ahead = record
            placed = self.is_placed(record, now_ns)

    def advance_silent(self, now_ns: int, track: TrackView) -> None:
        """Advance the rear of silent trains as the sections behind them clear."""
        for record in self.records.values():
            silent_ns = now_ns - record.received_at_ns
            later_ns = track.seen_ns - record.received_at_ns
            if silent_ns > self._silence_ns and self._guards.cleared_after(later_ns):
                record.rear_m = moved_on_m(track, record, overhang_m=self._config.overhang_m)

    def ahead_m(
        self, record: TrainRecord, report: TrainReport, ahead: TrainRecord | None
    ) -> float | None:
        """Protected rear of the nearest train ahead.

        That is the next one on the roster, or any train farther on. A train may have been moved
        past others by hand.
        """
        rears_m = [] if ahead is None else [ahead.rear_m]
        rears_m += [
            each.rear_m
            for each in self.records.values()
            if each is not record and each.report and each.rear_m >= report.front_max_m
        ]
        return min(rears_m, default=None)

    def within_m(self, record: TrainRecord, now_ns: int, *, sure: bool) -> float:
        """Place from which on an occupied section cannot be this train's own.

        Valid only for a train that has acknowledged the term and is in communication.

        Args:
            sure: no shadow train hides near the train ahead. Otherwise the sections within this
                train's authority may be occupied by the train ahead, and the authority is not
                shortened for them.
        """
        granted_m, report = record.granted_m, record.report
        if not sure or report is None:
            return granted_m
        return min(granted_m, report.front_max_m + self.farther_m(record, report, now_ns))

    def hidden(
        self,
        record: TrainRecord,
        beyond_m: float,
        ahead: TrainRecord | None,
        track: TrackView | None,
        open_end: tuple[float, TrainRecord | None],
        now_ns: int,
    ) -> list[BarredTrack]:
        """Occupied sections ahead of a train that no known train accounts for.

        If the place of the next train is not current, its own sections count, too, but only beyond
        the present authority. Nothing is taken back there, and nothing more is granted.

        If this train's own report is not current, it may or may not have accepted its authority.
        The sections within that authority may be its own, so it gets nothing more.
        """
        found, report = self.hidden_before(beyond_m, ahead, track, open_end), record.report
        if ahead is not None and not self.is_placed(ahead, now_ns):
            ahead, granted_m = None, record.granted_m
            found = found or [
                BarredTrack(max(each.start_m, granted_m), max(each.end_m, granted_m), each.bar)
                for each in self.hidden_before(beyond_m, ahead, track, open_end)
            ]
        if report is not None and not self.is_recent(report, now_ns):
            doubtful = self.hidden_before(report.front_max_m, ahead, track, open_end)
            found += [each._replace(bar=Bar.UNSURE) for each in doubtful]
        return found

    def no_farther(self, record: TrainRecord, now_ns: int) -> BarredTrack:
        """Bar that keeps a train within the authority that it already has.

        If the train's report is not current, it gets no new authority beyond what it last reported.
        """
        if self.spoke_just_now(record, now_ns):
            return BarredTrack(record.granted_m, UNBOUNDED_M, Bar.SHUT)
        return BarredTrack(record.latent_m, UNBOUNDED_M, Bar.UNSURE)

    def hidden_before(
        self,
        beyond_m: float,
        ahead: TrainRecord | None,
        track: TrackView | None,
        open_end: tuple[float, TrainRecord | None],
    ) -> list[BarredTrack]:
        """An occupied section that no known train can be in.

        Args:
            beyond_m: the train behind occupies no section that begins here or farther on.
            ahead: the next train, if no shadow train hides near it. None: its own sections count,
                too.
            open_end: without such a train, the limit of the search and the train that last went
                beyond it.
        """
        if track is None:
            return []
        (before_m, nearest), since_ns, then_m = open_end, track.seen_ns, -UNBOUNDED_M
        if ahead is not None:
            nearest = ahead
        else:
            within = [each for each in track.occupied if each.end_m <= before_m]
            track = track._replace(occupied=tuple(within))
        if nearest is not None:
            behind_m = self._config.behind_rear_m
            before_m, since_ns = nearest.rear_m - behind_m, nearest.received_at_ns
            then_m = nearest.rear_then_m(track.seen_ns) - behind_m
        found = hidden_between(
            track, beyond_m=beyond_m, before_m=before_m, ahead_ns=since_ns, then_m=then_m
        )
        if found is None:
            return []
        # A shadow train has an overhang behind its last axle and may roll back.
        return [found._replace(start_m=found.start_m - self._config.behind_axle_m)]

    def sync_entries(self) -> tuple[SyncEntry, ...]:
        return tuple(
            [
                SyncEntry(r.train, r.rear_m, min(r.granted_m, UNBOUNDED_M), r.boot)
                for r in self.records.values()
            ]
        )
