"""Restarted trains of the roster: still in place, or away and back again.

Theory
------
A roster entry is valid for one *incarnation* of its train. A restarted train gets no authority by
it, because the master cannot know what happened meanwhile: the train may have been taken off the
line, moved by hand, or passed by another one. If the train is in its old place, the master renews
the entry. Otherwise the entry ends, and the train applies like an unregistered one.

Result for each entry whose train reports a new incarnation (`RestartPlace`):

- IN_PLACE: the entry is renewed with the new incarnation;
- GONE: the entry ends; the train applies again where it stands;
- UNSURE: the entry stays as an obstacle, and the train gets no authority. So do two restarted
  trains that changed places, until a person removes them.

The decision compares intervals. With R as the place of the entry's rear, [r, f] as the reported
interval from least rear to greatest front, and N as any neighbour on the roster:

    gone back    greatest rear < R - (rollback + jog back)
    overtaken    a train behind reports a rear beyond f
    overtakes    the greatest rear of a train ahead is below r

Each of the three contradicts "it stayed in place". The entry then ends only if axle counters agree
(`sieved`: standing trains account for all axles around it; `left`: other trains account for all
axles where its foremost axle would be). Without such evidence the result is UNSURE, since another
device may report under the same number.

If nothing contradicts, the train is in place when either

- the master received the former incarnation less than RECENT_NS ago, as a train cannot leave the
  line and come back in that time, or
- every train behind was received, and no known place contradicts the order of the roster.

Invariants:

1. A renewed entry never lets a train pass another one: the order of the roster is the order on the
   track.
2. A doubt keeps the obstacle: UNSURE issues nothing and frees nothing.
3. Restarted trains in a row do not wait for each other. Their reports count as places, because
   trains never pass each other on the line.

References: [EN 50159] for messages of an earlier incarnation, [IEEE 1474.1] for
non-communicating trains. docs/design/train_to_train.md has the protocol around these rules.
"""

import enum
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from vobc.train_to_train.admission import (
    AdmissionGuardInputs,
    are_known,
    is_over_border,
    is_sieved,
    line_of,
)
from vobc.train_to_train.guards import MasterGuards
from vobc.train_to_train.inference import Conclusions
from vobc.train_to_train.occupancy import UNBOUNDED_M, TrainRecord, rear_max_m
from vobc.train_to_train.roster import Order
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import NO_TRAIN, RosterEntry, TrainReport

RECENT_NS: Final = 10_000_000_000
"""Shortest time in which a train can leave the line and come back."""
SHORTEST_M: Final = 15.0
"""Lower bound of a train's length."""


class RestartPlace(enum.Enum):
    IN_PLACE = "in place"
    GONE = "gone"
    UNSURE = "unsure"
    """The train keeps its roster entry as an obstacle and gets no authority."""


class Neighbour(NamedTuple):
    """Another train on the roster."""

    rear_m: float
    """Its rear was here, or is farther on."""
    heard: bool
    """Its place is known from the registered incarnation, or from a recent report of a new one."""
    rear_max_m: float = UNBOUNDED_M
    """Farthest place that its rear has reached. By default this is unknown."""
    restarted_m: tuple[float, float] | None = None
    """Least and greatest place of its rear by the reports of a new incarnation, if it may have
    stayed on the line. If two restarted trains changed places, the master cannot know which one was
    away."""

    @property
    def told_m(self) -> float:
        return self.rear_m if self.restarted_m is None else max(self.rear_m, self.restarted_m[0])

    def is_behind(self, rear_m: float) -> bool:
        """Whether it is behind this place by the reports of its new incarnation."""
        return self.restarted_m is not None and self.restarted_m[1] < rear_m


class Former(NamedTuple):
    """What is known of the former incarnation and of its neighbours on the roster."""

    record: TrainRecord
    behind: Sequence[Neighbour]
    ahead: Sequence[Neighbour] = ()


class RestartEvidence(NamedTuple):
    sieved: bool
    """The train stands, and standing trains account for all axles around it."""
    left: bool
    """Other trains at rest account for all axles from the place of its foremost axle to the train
    ahead, or to the end of the area. On a line without axle counters its own report is the only
    evidence."""
    recent: bool
    """This master received a report of the former incarnation so recently that the train cannot
    have been away."""


def whereabouts(
    former: Former, report: TrainReport, evidence: RestartEvidence, *, behind_rear_m: float
) -> RestartPlace:
    """Compare the place of a restarted train with its roster entry.

    The report is of the new incarnation, and the train knows its place.
    """
    gone_back = _is_farther_back(report, former.record, behind_rear_m)
    overtaken = any(each.rear_m > report.front_max_m for each in former.behind)
    overtakes = any(each.rear_max_m < report.rear_min_m for each in former.ahead)
    proven = evidence.sieved or evidence.left
    if gone_back or overtaken or overtakes:
        # Another device may report under the same number. The axle counts are independent evidence.
        return RestartPlace.GONE if proven else RestartPlace.UNSURE
    if evidence.recent:
        return RestartPlace.IN_PLACE
    confirmed = _confirmed_by_neighbours(former, report)
    return RestartPlace.IN_PLACE if confirmed else RestartPlace.UNSURE


def _confirmed_by_neighbours(former: Former, report: TrainReport) -> bool:
    """Whether the neighbours of a train that may have been away confirm the order."""
    heard = all(each.heard for each in former.behind)
    restarted = [each for each in former.behind if each.restarted_m is not None]
    behind = all(each.is_behind(report.rear_min_m) for each in restarted)
    # The known place of a train ahead may be old. It may have run on, or been passed.
    ahead = all(each.told_m >= report.front_max_m for each in former.ahead)
    return heard and behind and ahead


def _is_farther_back(report: TrainReport, record: TrainRecord, behind_rear_m: float) -> bool:
    """Whether the train is farther back than it can have rolled or jogged."""
    return rear_max_m(report) < record.rear_m - behind_rear_m


class RestartedTrains:
    """Reports of trains since they restarted."""

    def __init__(self, config: T2tConfig, guards: MasterGuards) -> None:
        self._config, self._guards = config, guards
        self._told: dict[int, tuple[TrainReport, int]] = {}

    def on_message(self, report: TrainReport, now_ns: int) -> None:
        self._told[report.source] = report, now_ns

    def forgets(self, train: int) -> None:
        self._told.pop(train, None)

    def told(self) -> list[tuple[TrainReport, int]]:
        """The newest report of each train, with its time of arrival."""
        return list(self._told.values())

    def ready(self, known: Conclusions, now_ns: int) -> list[tuple[int, int]]:
        """Trains that report, each with the switch for which it is ready."""
        return [
            (report.source, report.ready_nonce)
            for report, received_at_ns in self._told.values()
            if known.is_alive(received_at_ns, now_ns)
        ]

    def settle(
        self,
        order: Order,
        scene_of: Callable[[TrainReport], AdmissionGuardInputs],
        known: Conclusions,
        now_ns: int,
    ) -> tuple[Order, list[tuple[TrainReport, int]]]:
        """Renew the entries of trains in place and drop those of trains that left.

        The result is the new order and the reports of the dropped trains.
        """
        settled, gone = list[RosterEntry](), list[tuple[TrainReport, int]]()
        self._told = {t: e for t, e in self._told.items() if known.is_alive(e[1], now_ns)}
        for at, entry in enumerate(order):
            report, received_at_ns = self._told.get(entry.train, (None, now_ns))
            if report is None or not report.localised or not known.is_recent(report, now_ns):
                settled.append(entry)
                continue
            scene = scene_of(report)
            former = known.records[entry.train]
            told = former.report
            recent = told is not None and known.is_of_last(RECENT_NS, told, now_ns)
            ahead = settled[-1].train if settled else NO_TRAIN
            followers = [each for each in order[at + 1 :] if each.train in known.records]
            behind = [self._neighbour(each, known, now_ns) for each in followers]
            before = [self._neighbour(each, known, now_ns) for each in settled]
            life = Former(former, behind, before)
            found = self._find(ahead, life, report, scene, recent=recent)
            if found is RestartPlace.UNSURE:
                settled.append(entry)
                continue
            del self._told[entry.train]
            if found is RestartPlace.GONE:
                del known.records[entry.train]
                gone.append((report, received_at_ns))
            else:
                sieved = (recent and entry.sieved) or is_over_border(report, scene)
                sieved = sieved or is_sieved(report, scene, self._config.behind_axle_m)
                settled.append(RosterEntry(entry.train, report.rear_min_m, sieved, report.boot))
                known.reborn(report, received_at_ns)
        return tuple(settled), gone

    def _neighbour(self, entry: RosterEntry, known: Conclusions, now_ns: int) -> Neighbour:
        """A train of the roster as a neighbour of a restarted one.

        If only registered incarnations counted, restarted trains in a row would wait for each
        other. Trains never pass each other, so their places show their order.
        """
        record = known.records[entry.train]
        report, _ = self._told.get(entry.train, (None, now_ns))
        if report is None and record.report is not None:
            placed = known.is_placed(record, now_ns)
            farthest_m = known.rear_max_m(record.report, now_ns) if placed else UNBOUNDED_M
            return Neighbour(record.rear_m, heard=True, rear_max_m=farthest_m)
        if report is None or not report.localised or not known.is_recent(report, now_ns):
            return Neighbour(record.rear_m, heard=False)
        if _is_farther_back(report, record, self._config.behind_rear_m):
            # It came back elsewhere and no train passed it. Its own entry decides about that.
            return Neighbour(record.rear_m, heard=True)
        restarted_m = report.rear_min_m, known.rear_max_m(report, now_ns)
        return Neighbour(record.rear_m, heard=True, restarted_m=restarted_m)

    def _find(
        self,
        ahead: int,
        former: Former,
        report: TrainReport,
        scene: AdmissionGuardInputs,
        *,
        recent: bool,
    ) -> RestartPlace:
        config, record = self._config, former.record
        ahead_m = scene.area.end_m if ahead == NO_TRAIN else scene.records[ahead].rear_m
        # At least its foremost axle would be here. The preceding area's master judges the track
        # before the area.
        foremost_m = record.rear_m - config.behind_rear_m + SHORTEST_M - config.overhang_m
        from_m = max(foremost_m, scene.area.start_m)
        to_m = max(ahead_m, from_m + config.overhang_m)
        # It matters only which train the axles belong to now, not which train may be forgotten
        # later.
        there = scene._replace(standing=scene.there, at_rest=scene.there)
        evidence = RestartEvidence(
            sieved=(
                not is_over_border(report, scene) and is_sieved(report, there, config.behind_axle_m)
            ),
            left=(
                scene.counted is None
                or are_known(report, there, scene.counted, from_m=from_m, to_m=to_m)
            ),
            recent=recent,
        )
        found = whereabouts(former, report, evidence, behind_rear_m=config.behind_rear_m)
        if found is not RestartPlace.IN_PLACE:
            return found
        # A train across the border must satisfy the same condition as any other applicant there.
        in_line = self._guards.comes_in_line(line_of(report, scene, ahead))
        return found if in_line else RestartPlace.UNSURE
