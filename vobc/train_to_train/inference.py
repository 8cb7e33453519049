"""What a master may conclude from what it knows of its trains, under its own term."""

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
        """After this a train is silent: what answers its last report would soon be too old."""
        self.life_ns = 2 * config.timers.authority_ms * NS_PER_MS
        """No train takes an authority that answers a report so old, however clocks drift."""

    @property
    def records(self) -> dict[int, TrainRecord]:
        return self.table.records

    def begin_with(self, roster: Order, now_ns: int) -> None:
        """Keep these trains and no others; a rear never goes back by what arbiters kept."""
        for entry in roster:
            self.add(entry, now_ns)
        self.table.forget_but([entry.train for entry in roster])

    def add(self, entry: RosterEntry, now_ns: int) -> TrainRecord:
        record = self.table.of(entry.train, rear_m=entry.rear_m, now_ns=now_ns)
        if record.boot != entry.boot:
            # What was heard of another life says nothing of the one that arbiters kept.
            record = TrainRecord(entry.train, entry.rear_m, now_ns, boot=entry.boot)
            self.records[entry.train] = record
        record.stopped = entry.stopped
        if record.report is None:
            record.rear_m = max(record.rear_m, entry.rear_m)
        return record

    def reborn(self, report: TrainReport, heard_ns: int) -> None:
        """A train is where it was and begins anew; of authorities of its former life it takes none
        any more.
        """
        former = self.records[report.source]
        record = TrainRecord(report.source, report.rear_min_m, heard_ns)
        record.hears(report, heard_ns, term=self.term, jog_m=self._config.jog_m)
        record.stopped = former.stopped
        self.records[report.source] = record

    def hears_newborn(self, report: TrainReport) -> None:
        """Of authorities of the life that arbiters kept it takes none any more."""
        record = self.records[report.source]
        if report.term == self.term and report.boot > record.boot:
            record.anew_m = report.latent_m
            if report.localised:
                record.anew_rear_m = rear_max_m(report)

    def has_promised(self, record: TrainRecord) -> bool:
        """It obeys no older term any more."""
        return self._guards.has_promised(Acknowledgement(record.term, self.term))

    def is_told(self, record: TrainRecord, now_ns: int) -> bool:
        """It obeys no older term any more, and will hear what is said to it."""
        return self.has_promised(record) and self.is_alive(record.heard_ns, now_ns)

    def is_fit(self, train: int, now_ns: int) -> bool:
        """Heard of, promised, and in service by its own word."""
        record = self.records.get(train)
        return (
            record is not None
            and record.report is not None
            and not record.report.out_of_service
            and self.is_told(record, now_ns)
        )

    def all_silent(self, own: int, now_ns: int) -> bool:
        """Several others were heard under this command, and none of them for two silences: rather
        the master's ear than all their voices.
        """
        heard_ns = [
            each.heard_ns
            for each in self.records.values()
            if each.report is not None and each.train != own
        ]
        limit_ns = 2 * self._config.timers.silence_ms * NS_PER_MS
        return len(heard_ns) > 1 and now_ns - max(heard_ns) >= limit_ns

    def is_alive(self, heard_ns: int, now_ns: int) -> bool:
        return self._guards.report_alive(Freshness(now_ns - heard_ns, self._silence_ns))

    def is_recent(self, report: TrainReport, now_ns: int) -> bool:
        """What it says is true of just now."""
        return self.is_of_last(self._silence_ns, report, now_ns)

    def is_of_last(self, limit_ns: int, report: TrainReport, now_ns: int) -> bool:
        """By this master's own clock, which it echoes; one of another term echoes none. When it was
        heard says nothing of that: it may have been long on its way.
        """
        if report.term != self.term or report.echo_ns == 0:
            return False
        return self._guards.report_recent(Freshness(now_ns - report.echo_ns, limit_ns))

    def is_placed(self, record: TrainRecord, now_ns: int) -> bool:
        """It said under this command where it is, just now. Else its rear may be far beyond, and in
        the sections that it was in somebody else.
        """
        return not record.lost and self.spoke_just_now(record, now_ns)

    def spoke_just_now(self, record: TrainRecord, now_ns: int) -> bool:
        """What it said last of its place is true of just now; it may be lost since."""
        return record.report is not None and self.is_recent(record.report, now_ns)

    def farther_m(self, record: TrainRecord, report: TrainReport, now_ns: int) -> float:
        """How much farther than it said last a train may be if it said so a while ago."""
        if self.is_recent(report, now_ns):
            return way_m(now_ns - report.echo_ns)
        return (record.granted_m if self.has_promised(record) else UNBOUNDED_M) - report.front_max_m

    def rear_max_m(self, report: TrainReport, now_ns: int) -> float:
        """No farther has the rear come by now of a train that said this recently."""
        return rear_max_m(report) + way_m(now_ns - report.echo_ns)

    def reserved_m(self, order: Sequence[RosterEntry]) -> dict[int, float]:
        """By train, the farthest that it may come by anything that it was granted.

        What a train that has not promised holds is not known; but it was never granted more than
        the way to the rear of the train ahead, and so no more than that one may come to. Only who
        lives on is surely still ahead: who began anew may have left and come back behind the
        others, and bounds itself alone.
        """
        reserved_m: dict[int, float] = {}
        bound_m = UNBOUNDED_M
        for entry in order:
            record = self.records[entry.train]
            own_m = UNBOUNDED_M
            if self.has_promised(record):
                own_m = record.granted_m
                bound_m = min(bound_m, own_m)
            elif record.anew_rear_m >= record.rear_m - self._config.behind_rear_m:
                own_m = record.anew_m
            reserved_m[entry.train] = own_m if own_m < UNBOUNDED_M else bound_m
        return reserved_m

    def reaches(self, site: ObjectSite, order: Sequence[RosterEntry]) -> list[Reach]:
        behind_m = self._config.behind_rear_m
        return [
            Reach(reserved_m, self.records[train].rear_m - behind_m, site.start_m, site.end_m)
            for train, reserved_m in self.reserved_m(order).items()
        ]

    def is_needed(self, site: ObjectSite) -> bool:
        """A train comes near it, or might come back to it."""
        ahead_m, behind_m = self._config.claim_ahead_m, self._config.behind_rear_m
        reports = [each.report for each in self.records.values() if each.report is not None]
        return any(
            each.rear_min_m - behind_m < site.end_m and each.front_max_m + ahead_m >= site.start_m
            for each in reports
        )

    def take_proofs(self, order: Sequence[RosterEntry], now_ns: int) -> None:
        """What a train was granted proves how far the train ahead of it had come; what it said of
        that long ago does not, as the one ahead may have been moved since.
        """
        ahead: TrainRecord | None = None
        for entry in order:
            record = self.records[entry.train]
            recent = self.spoke_just_now(record, now_ns)
            if ahead is not None and recent and self.has_promised(record):
                proven_m = record.rear_ahead_m(self._config.behind_rear_m)
                ahead.rear_m = max(ahead.rear_m, proven_m)
            ahead = record

    def advance_silent(self, now_ns: int, track: TrackView) -> None:
        """A train that says nothing moves on as sections clear behind it."""
        for record in self.records.values():
            silent_ns = now_ns - record.heard_ns
            later_ns = track.seen_ns - record.heard_ns
            if silent_ns > self._silence_ns and self._guards.cleared_after(later_ns):
                record.rear_m = moved_on_m(track, record, overhang_m=self._config.overhang_m)

    def ahead_m(
        self, record: TrainRecord, report: TrainReport, ahead: TrainRecord | None
    ) -> float | None:
        """Protected rear of the train ahead: the next one on the roster, or any that is farther on
        whatever its place there, as somebody may have been moved past others by hand.
        """
        rears_m = [] if ahead is None else [ahead.rear_m]
        rears_m += [
            each.rear_m
            for each in self.records.values()
            if each is not record and each.report and each.rear_m >= report.front_max_m
        ]
        return min(rears_m, default=None)

    def within_m(self, record: TrainRecord, now_ns: int, *, sure: bool) -> float:
        """An occupied section from here on is not this train's own. Only of a train that is told.

        Args:
            sure: nobody hides near the train ahead. Else what this one was granted reaches into
                sections that may be that one's, and is not taken back for them.
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
        """Before a train, as `hidden_before`; also in sections of the next one if that may be out
        of them by now: there nothing is taken back, and nothing more is granted.

        Of a train that may not have heard for a while what it was told nobody knows whether it took
        what it was granted, and so whether it is itself in sections within that: it gets no more.
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
        """Where a train was granted nothing yet; one that may not have heard gets no other for the
        moment than what it says that it holds.
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
        """An occupied section that none of the trains known can be in.

        Args:
            beyond_m: the train behind is not in sections that begin here or farther on.
            ahead: the next train, if nobody hides near it; else its own sections count, too.
            open_end: without such a train, up to where, and who went beyond last.
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
            before_m, since_ns = nearest.rear_m - behind_m, nearest.heard_ns
            then_m = nearest.rear_then_m(track.seen_ns) - behind_m
        found = hidden_between(
            track, beyond_m=beyond_m, before_m=before_m, ahead_ns=since_ns, then_m=then_m
        )
        if found is None:
            return []
        # What hides hangs over behind its last axle, and may roll back.
        return [found._replace(start_m=found.start_m - self._config.behind_axle_m)]

    def sync_entries(self) -> tuple[SyncEntry, ...]:
        return tuple(
            [
                SyncEntry(r.train, r.rear_m, min(r.granted_m, UNBOUNDED_M), r.boot)
                for r in self.records.values()
            ]
        )
