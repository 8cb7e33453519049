"""Trains of the roster that began anew: whether one is still where it was, or left and came back.

A roster entry is for one incarnation of its train. Who begins anew gets nothing by it: nobody knows
what became of the train meanwhile. If it is where it was, the entry is renewed; if it is not, the
entry ends, and the train applies as a stranger does.
"""

import enum
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from vobc.train_to_train.admission import (
    AdmissionGuardInputs,
    Waiting,
    admitted,
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
from zenoh_config.t2t import NOBODY, RosterEntry, TrainReport

RECENT_NS: Final = 10_000_000_000
"""No train leaves the line and comes back within this."""
SHORTEST_M: Final = 15.0
"""No train is shorter."""


class RestartPlace(enum.Enum):
    IN_PLACE = "in place"
    GONE = "gone"
    UNSURE = "unsure"
    """It keeps its place on the roster, as an obstacle, and gets nothing."""
    BEFORE = "before"
    """It is before one that was ahead of it and began anew, too: nobody knows which was away."""


class Neighbour(NamedTuple):
    """Another train on the roster."""

    rear_m: float
    """It was there, or is farther on."""
    heard: bool
    """Where it is, in the life that arbiters kept, or lately in a new one."""
    rear_max_m: float = UNBOUNDED_M
    """Its rear has come no farther yet; by default nobody knows."""
    anew_m: tuple[float, float] | None = None
    """Where its rear is at least and at most by what it tells of a new life, if it may be that it
    has not been away: of two that began anew and changed places nobody knows which was."""

    @property
    def told_m(self) -> float:
        return self.rear_m if self.anew_m is None else max(self.rear_m, self.anew_m[0])

    def is_behind(self, rear_m: float) -> bool:
        """By what it tells of a new life."""
        return self.anew_m is not None and self.anew_m[1] < rear_m


class Former(NamedTuple):
    """What is known of the life before, and of those around it on the roster."""

    record: TrainRecord
    behind: Sequence[Neighbour]
    ahead: Sequence[Neighbour] = ()


class RestartEvidence(NamedTuple):
    sieved: bool
    """It stands, and all axles around are those of trains that say they stand there."""
    left: bool
    """All axles from where its foremost one would be up to the train ahead, or the end of the area,
    are of others at rest; or no axles are counted on this line, and its word is all there is."""
    recent: bool
    """This very master heard of its former life so lately that it cannot have been away."""


def whereabouts(
    former: Former, report: TrainReport, evidence: RestartEvidence, *, behind_rear_m: float
) -> RestartPlace:
    """The report is of the new life, and knows its place."""
    gone_back = _is_farther_back(report, former.record, behind_rear_m)
    overtaken = any(each.rear_m > report.front_max_m for each in former.behind)
    overtakes = any(each.rear_max_m < report.rear_min_m for each in former.ahead)
    if gone_back or overtaken or overtakes:
        # A word may be of somebody else by the same name; what is counted on the track is not.
        return RestartPlace.GONE if evidence.sieved or evidence.left else RestartPlace.UNSURE
    if evidence.recent:
        return RestartPlace.IN_PLACE
    unheard = not all(each.heard for each in former.behind)
    anew = [each for each in former.behind if each.anew_m is not None]
    changed = not all(each.is_behind(report.rear_min_m) for each in anew)
    # What is known of one ahead may be old: it has gone on since, or was passed.
    passed = [each for each in former.ahead if each.told_m < report.front_max_m]
    if changed or unheard or not all(each.is_behind(report.rear_min_m) for each in passed):
        return RestartPlace.UNSURE
    if not passed:
        return RestartPlace.IN_PLACE
    return RestartPlace.BEFORE if evidence.sieved or evidence.left else RestartPlace.UNSURE


def _is_farther_back(report: TrainReport, record: TrainRecord, behind_rear_m: float) -> bool:
    """Than it can have rolled or jogged from where it was."""
    return rear_max_m(report) < record.rear_m - behind_rear_m


class RestartedTrains:
    """What they told since they began anew, by train."""

    def __init__(self, config: T2tConfig, guards: MasterGuards) -> None:
        self._config, self._guards = config, guards
        self._told: dict[int, tuple[TrainReport, int]] = {}

    def hears(self, report: TrainReport, now_ns: int) -> None:
        self._told[report.source] = report, now_ns

    def forgets(self, train: int) -> None:
        self._told.pop(train, None)

    def told(self) -> list[tuple[TrainReport, int]]:
        """The newest of each, and when it came."""
        return list(self._told.values())

    def ready(self, known: Conclusions, now_ns: int) -> list[tuple[int, int]]:
        """Of those that are heard: who, and for which switch it is ready."""
        return [
            (report.source, report.ready_nonce)
            for report, heard_ns in self._told.values()
            if known.is_alive(heard_ns, now_ns)
        ]

    def settle(
        self,
        order: Order,
        scene_of: Callable[[TrainReport], AdmissionGuardInputs],
        known: Conclusions,
        now_ns: int,
    ) -> tuple[Order, list[tuple[TrainReport, int]]]:
        """The order without those that are gone, those in place renewed; and who is gone."""
        settled, gone = list[RosterEntry](), list[tuple[TrainReport, int]]()
        self._told = {t: e for t, e in self._told.items() if known.is_alive(e[1], now_ns)}
        for at, entry in enumerate(order):
            report, heard_ns = self._told.get(entry.train, (None, now_ns))
            if report is None or not report.localised or not known.is_recent(report, now_ns):
                settled.append(entry)
                continue
            scene = scene_of(report)
            former = known.records[entry.train]
            told = former.report
            recent = told is not None and known.is_of_last(RECENT_NS, told, now_ns)
            ahead = settled[-1].train if settled else NOBODY
            followers = [each for each in order[at + 1 :] if each.train in known.records]
            behind = [self._neighbour(each, known, now_ns) for each in followers]
            before = [self._neighbour(each, known, now_ns) for each in settled]
            life = Former(former, behind, before)
            found = self._find(ahead, life, report, scene, recent=recent)
            if found is RestartPlace.BEFORE:
                # Whichever was away: on the roster it is, where it stands, or where it was.
                rest = (*settled, *followers)
                result = admitted(rest, report, scene, self._config, self._guards)
                if not isinstance(result, Waiting):
                    settled = list(result[: len(result) - len(followers)])
                    del self._told[entry.train]
                    known.reborn(report, heard_ns)
                    continue
                found = RestartPlace.UNSURE
            if found is RestartPlace.UNSURE:
                settled.append(entry)
                continue
            del self._told[entry.train]
            if found is RestartPlace.GONE:
                del known.records[entry.train]
                gone.append((report, heard_ns))
            else:
                sieved = (recent and entry.sieved) or is_over_border(report, scene)
                sieved = sieved or is_sieved(report, scene, self._config.behind_axle_m)
                settled.append(RosterEntry(entry.train, report.rear_min_m, sieved, report.boot))
                known.reborn(report, heard_ns)
        return tuple(settled), gone

    def _neighbour(self, entry: RosterEntry, known: Conclusions, now_ns: int) -> Neighbour:
        """Trains that began anew one behind the other would wait for each other if only the life
        that arbiters kept counted. No train passes another: where they are is their order.
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
            # It came back elsewhere, and was passed by nobody: that is for its own entry.
            return Neighbour(record.rear_m, heard=True)
        anew_m = report.rear_min_m, known.rear_max_m(report, now_ns)
        return Neighbour(record.rear_m, heard=True, anew_m=anew_m)

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
        ahead_m = scene.area.end_m if ahead == NOBODY else scene.records[ahead].rear_m
        # There at least its foremost axle would be; what is before the area is others' to look at.
        foremost_m = record.rear_m - config.behind_rear_m + SHORTEST_M - config.overhang_m
        from_m = max(foremost_m, scene.area.start_m)
        to_m = max(ahead_m, from_m + config.overhang_m)
        # Of what is there now it matters only whose it is, not who may be forgotten later.
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
        # Over the border, as for any other that comes over it.
        in_line = self._guards.comes_in_line(line_of(report, scene, ahead))
        return found if in_line else RestartPlace.UNSURE
