"""What a master knows of the trains of its area: where each surely is, and what it may hold."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from zenoh_config.t2t import SectionState, SyncEntry, TrainReport

OUTSTANDING_MAX: Final = 64
"""Authorities on their way to one train that are told apart, which are more than are not void yet;
of one that hears nothing more are taken for one."""
PLACES_MAX: Final = 8
"""Reports of one train that are told apart by when they came: those of most of a second."""
UNBOUNDED_M: Final = 1.0e6
"""Reserved for a train of which nobody knows what it may hold."""


class Sent(NamedTuple):
    """An authority on its way to a train."""

    sequence: int
    end_m: float
    void_ns: int
    """From then on the train surely takes it no more."""


@dataclass(slots=True)
class TrainRecord:
    """One train, as far as its master knows."""

    train: int
    rear_m: float
    """Protected: the rear has been seen here or farther on, by the train or by detection, or comes
    to rest here or farther on."""
    heard_ns: int
    """When its newest report came; when the record was made, before."""
    boot: int = 0
    """Of the train's incarnation; 0: unknown."""
    report: TrainReport | None = None
    """The newest, from a time when the train knew where it was."""
    term: int = 0
    """That it promised last."""
    ready_nonce: int | None = None
    """Of the planned switch that it said last it is ready for; None: it has not been heard."""
    latent_m: float = UNBOUNDED_M
    """By its newest report, also of one that does not know where it is."""
    served: bool = False
    """It was given an authority under this master's term."""
    anew_m: float = UNBOUNDED_M
    """It began anew since, and obeys no older term: it comes no farther by all that it holds."""
    anew_rear_m: float = -UNBOUNDED_M
    """Its rear in that life, at the farthest; until it is heard of, nowhere on the line."""
    stopped: bool = False
    """Supervision has ordered its authority to end where it stands."""
    sent: list[Sent] = field(default_factory=list)
    """Authorities that it may yet take, or have taken since it spoke, oldest first."""
    lost: bool = False
    """By the newest report of all it does not know where it is."""
    places: list[tuple[int, float]] = field(default_factory=list, compare=False)
    """When it was heard lately, and its protected rear by then, oldest first."""

    def hears(self, report: TrainReport, now_ns: int, *, term: int, jog_m: float) -> None:
        """A report that came in order; `term` is the master's own.

        While a train moves it cannot jog back; it has to come to rest first, and that is farther
        on. So what a jog needs counts from there, and nobody is let nearer than it may roll back.
        """
        self.heard_ns = now_ns
        self.term = report.term
        self.ready_nonce = report.ready_nonce
        self.latent_m = report.latent_m
        if report.held_term == term:
            self.sent = [each for each in self.sent if each.sequence > report.held_sequence]
        if report.term == term:
            # What it echoes it had heard when it spoke; what was void by then it did not take.
            self.sent = [each for each in self.sent if report.echo_ns < each.void_ns]
        self.lost = not report.localised
        if self.lost:
            return
        rear_m = min(max(report.protected_m, report.rear_min_m), report.rear_min_m + jog_m)
        newborn = report.boot != self.boot and self.boot != 0
        self.rear_m = rear_m if newborn else max(self.rear_m, rear_m)
        self.report, self.boot = report, report.boot
        if newborn:
            self.places.clear()
        self.places.append((now_ns, self.rear_m))
        del self.places[:-PLACES_MAX]

    def rear_then_m(self, at_ns: int) -> float:
        """Protected rear as it had been heard by that instant; far behind, if it had not."""
        return max([m for heard_ns, m in self.places if heard_ns <= at_ns], default=-UNBOUNDED_M)

    def issued(self, sequence: int, end_m: float, *, life_ns: int) -> None:
        """In answer to what was heard last; `life_ns`: longer than an authority is taken after the
        report that it answers, by whatever clock.
        """
        self.served = True
        self.sent.append(Sent(sequence, end_m, self.heard_ns + life_ns))
        if len(self.sent) > OUTSTANDING_MAX:
            first, second, *rest = self.sent
            self.sent = [second._replace(end_m=max(first.end_m, second.end_m)), *rest]

    def rear_ahead_m(self, behind_rear_m: float) -> float:
        """Where the rear of the next train ahead must at least be, for this one to have been
        granted what it still may act upon. Only of a train that obeys no older term any more.

        Since it lost its place it says nothing of what it holds, but how far that still lets it
        come: farther on another may have been set before it since.
        """
        report = self.report
        if report is None or not report.member:
            return -UNBOUNDED_M
        return min(report.held_end_m, self.latent_m) + behind_rear_m

    @property
    def granted_m(self) -> float:
        """The farthest its front may come by anything that it holds, may yet take or gave up."""
        return max([self.latent_m, *[each.end_m for each in self.sent]])


def rear_max_m(report: TrainReport) -> float:
    """The farthest that the rear can be: beyond the one that is told by what the front is unsure
    of.
    """
    return report.rear_min_m + (report.front_max_m - report.front_min_m)


class TrainTable:
    """Records by train."""

    def __init__(self) -> None:
        self.records: dict[int, TrainRecord] = {}

    def of(self, train: int, *, rear_m: float, now_ns: int) -> TrainRecord:
        """The record of a train; a new one begins with this rear."""
        found = self.records.get(train)
        if found is None:
            found = self.records[train] = TrainRecord(train, rear_m, now_ns)
        return found

    def forget_but(self, trains: Iterable[int]) -> None:
        kept = set(trains)
        self.records = {train: each for train, each in self.records.items() if train in kept}

    def takes_sync(self, entries: Iterable[SyncEntry], now_ns: int) -> None:
        """What a master left to its standby; a rear never goes back by it."""
        for entry in entries:
            record = self.of(entry.train, rear_m=entry.rear_m, now_ns=now_ns)
            if record.boot < entry.boot:
                record = TrainRecord(entry.train, entry.rear_m, now_ns, boot=entry.boot)
                self.records[entry.train] = record
            if record.report is None and record.boot == entry.boot:
                record.rear_m = max(record.rear_m, entry.rear_m)


def cleared_to_m(
    rear_m: float,
    sections: Sequence[tuple[float, float, SectionState]],
    *,
    overhang_m: float,
) -> float:
    """How far forward a rear must be that stood at `rear_m` or beyond when all this was seen.

    A train that moves forwards only is not in clear sections that begin where it was: it is past
    them, but for what hangs over behind its last axle.

    Args:
        sections: start, end and state of each, in running order.
    """
    reached_m = rear_m
    for start_m, end_m, state in sections:
        if end_m <= reached_m:
            continue
        if start_m > reached_m or state.occupied:
            break
        reached_m = end_m
    return max(rear_m, reached_m - overhang_m)
