"""What a master knows of each train in its area: its place and the authorities that it may hold."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from zenoh_config.t2t import SectionState, SyncEntry, TrainReport

OUTSTANDING_MAX: Final = 64
"""Number of open authorities to one train that are tracked one by one.

This is more than can be valid at a time. For a train that receives nothing any more, the oldest
ones are merged.
"""
PLACES_MAX: Final = 8
"""Number of reports of one train kept with their time of arrival. They cover about one second."""
UNBOUNDED_M: Final = 1.0e6
"""Bound of a train whose authorities are unknown."""


class Sent(NamedTuple):
    """An authority that the master has sent to a train."""

    sequence: int
    end_m: float
    void_ns: int
    """Time from which on the train certainly refuses it."""


@dataclass(slots=True)
class TrainRecord:
    """State of one train as its master knows it."""

    train: int
    rear_m: float
    """Protected rear. The rear is here or farther on, or comes to rest here or farther on. The
    train or the axle counters have shown it."""
    received_at_ns: int
    """When its newest report arrived. Before the first report: when the record was made."""
    boot: int = 0
    """Incarnation of the train. 0: unknown."""
    report: TrainReport | None = None
    """Newest report in which the train knew its place."""
    term: int = 0
    """Term that it acknowledged last."""
    ready_nonce: int | None = None
    """Nonce of the planned switch for which it last reported ready. None: no report received."""
    latent_m: float = UNBOUNDED_M
    """Farthest place by its newest report, even if the train has lost its position."""
    served: bool = False
    """The train received an authority under this master's term."""
    restarted_m: float = UNBOUNDED_M
    """Farthest place by anything that it holds, for a train that has since restarted and obeys no
    older term."""
    restarted_rear_m: float = -UNBOUNDED_M
    """Farthest place of its rear in the new incarnation. Until its first report: nowhere on the
    line."""
    stopped: bool = False
    """Supervision has ordered the train to stop where it is."""
    sent: list[Sent] = field(default_factory=list)
    """Authorities that the train may still accept, or has accepted since its last report. Oldest
    first."""
    lost: bool = False
    """The train has lost its position by its newest report."""
    places: list[tuple[int, float]] = field(default_factory=list, compare=False)
    """Arrival time and protected rear of the latest reports, oldest first."""

    def on_message(self, report: TrainReport, now_ns: int, *, term: int, jog_m: float) -> None:
        """Update the record from a report that arrived in order.

        A moving train must come to rest before it can jog back, and it comes to rest farther on.
        The jog allowance therefore counts from the place of rest. No train comes nearer than the
        rollback distance.

        Args:
            term: the master's own term.
        """
        self.received_at_ns = now_ns
        self.term = report.term
        self.ready_nonce = report.ready_nonce
        self.latent_m = report.latent_m
        if report.held_term == term:
            self.sent = [each for each in self.sent if each.sequence > report.held_sequence]
        if report.term == term:
            # The train had received the echoed heartbeat when it sent this report. It has not
            # accepted any authority that was void by then.
            self.sent = [each for each in self.sent if report.echo_ns < each.void_ns]
        self.lost = not report.localised
        if self.lost:
            return
        rear_m = protected_rear_m(report, jog_m)
        newborn = report.boot != self.boot and self.boot != 0
        self.rear_m = rear_m if newborn else max(self.rear_m, rear_m)
        self.report, self.boot = report, report.boot
        if newborn:
            self.places.clear()
        self.places.append((now_ns, self.rear_m))
        del self.places[:-PLACES_MAX]

    def rear_then_m(self, at_ns: int) -> float:
        """Protected rear as known at that time. It is far behind if nothing was known."""
        return max(
            [m for received_at_ns, m in self.places if received_at_ns <= at_ns],
            default=-UNBOUNDED_M,
        )

    def issued(self, sequence: int, end_m: float, *, life_ns: int) -> None:
        """Note an authority that answers the newest report.

        Args:
            life_ns: age of a report after which no train accepts an authority that answers it.
        """
        self.served = True
        self.sent.append(Sent(sequence, end_m, self.received_at_ns + life_ns))
        if len(self.sent) > OUTSTANDING_MAX:
            first, second, *rest = self.sent
            self.sent = [second._replace(end_m=max(first.end_m, second.end_m)), *rest]

    def rear_ahead_m(self, behind_rear_m: float) -> float:
        """Least place of the rear of the next train ahead, given the authority of this train.

        It is valid only for a train that obeys no older term. A train that has lost its position
        reports how far it may still come, not what it holds. Another train may have been placed
        ahead of it since, farther on.
        """
        report = self.report
        if report is None or not report.member:
            return -UNBOUNDED_M
        return min(report.held_end_m, self.latent_m) + behind_rear_m

    @property
    def granted_m(self) -> float:
        """Farthest place of the front by any authority held, still acceptable, or given up."""
        return max([self.latent_m, *[each.end_m for each in self.sent]])


def protected_rear_m(report: TrainReport, jog_m: float) -> float:
    """Place behind which the rear does not come to rest, before it jogs or rolls back.

    A moving train must come to rest before it can jog back, and it comes to rest farther on. That
    counts up to the length of a jog.
    """
    return min(max(report.protected_m, report.rear_min_m), report.rear_min_m + jog_m)


def rear_max_m(report: TrainReport) -> float:
    """Farthest place of the rear: the reported rear plus the uncertainty of the front."""
    return report.rear_min_m + (report.front_max_m - report.front_min_m)


class TrainTable:
    """Records by train."""

    def __init__(self) -> None:
        self.records: dict[int, TrainRecord] = {}

    def of(self, train: int, *, rear_m: float, now_ns: int) -> TrainRecord:
        """Record of a train. A new record begins with this rear."""
        found = self.records.get(train)
        if found is None:
            found = self.records[train] = TrainRecord(train, rear_m, now_ns)
        return found

    def forget_but(self, trains: Iterable[int]) -> None:
        kept = set(trains)
        self.records = {train: each for train, each in self.records.items() if train in kept}

    def takes_sync(self, entries: Iterable[SyncEntry], now_ns: int) -> None:
        """Take over the entries that a master sent to its standby. They never move a rear
        backwards.
        """
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
    """Least place of a rear that was at `rear_m` or beyond when the sections were read.

    A train that moves only forwards has left the clear sections that begin at its old place. Only
    the overhang behind its last axle may still be in them.

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
