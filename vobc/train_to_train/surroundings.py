"""Surroundings of a train as its master sees them: counted axles and the trains that account for
them.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from firmware_py.trackdb.areas import AreaMap
from vobc.train_to_train.admission import AdmissionGuardInputs, may_explain, standing_of
from vobc.train_to_train.authority import StandingTrain
from vobc.train_to_train.axle_counting import TrackView, way_m
from vobc.train_to_train.inference import Conclusions
from vobc.train_to_train.removals import TrackObservation
from vobc.train_to_train.roster import Order
from zenoh_config.t2t import TrainReport

Heard = tuple[TrainReport, int]
"""A report and its time of arrival."""


class Halt(NamedTuple):
    since_ns: int
    """When the first report arrived that shows the train at standstill."""
    report: TrainReport
    """The newest report that shows it."""


class AreaObservation(NamedTuple):
    """Everything observed in the area at one instant, for any train."""

    told: Mapping[int, StandingTrain]
    """Trains that report their place."""
    at_rest: Mapping[int, StandingTrain]
    """Those trains that already stood in the same place when the axles were counted."""
    strangers: Sequence[Heard]
    reserved_m: dict[int, float]
    track: TrackView | None
    now_ns: int


class Surroundings:
    """Surroundings of the trains of one area, as its master knows them."""

    def __init__(self, known: Conclusions, line: AreaMap, area: int) -> None:
        self._known, self._counts = known, bool(line.sections)
        self._line_m, self._apply_m = (line.start_m, line.end_m), line.apply_m
        self._area, self._before = line.area(area), line.preceding(area)
        self._passed: dict[int, Heard] = {}
        self._halts: dict[int, Halt] = {}
        """Trains at standstill."""

    def on_message(self, report: TrainReport, now_ns: int) -> None:
        """Record since when a train stands. Older axle counts say nothing of its surroundings."""
        known = self._halts.pop(report.source, None)
        if report.standstill and report.localised:
            since_ns = now_ns
            if known is not None and known.report.boot == report.boot:
                since_ns = known.since_ns
            self._halts[report.source] = Halt(since_ns, report)

    def is_far(self, report: TrainReport) -> bool:
        """The train does not approach the area yet."""
        return report.front_max_m < self._area.start_m - self._apply_m

    def passes(self, report: TrainReport, now_ns: int) -> None:
        """Record a train that has left the area. It may account for axles beyond the borders."""
        self._passed[report.source] = report, now_ns

    def look(
        self, order: Order, strangers: Iterable[Heard], track: TrackView | None, now_ns: int
    ) -> AreaObservation:
        """Observe the area at one instant.

        Args:
            strangers: trains that are not on the roster in this incarnation.
        """
        records, others = self._known.records, list(strangers)
        told = self._witnesses(others, track, now_ns)
        at_rest = self._at_rest(told, track, now_ns)
        reserved_m = self._known.reserved_m([each for each in order if each.train in records])
        return AreaObservation(told, at_rest, others, reserved_m, track, now_ns)

    def scene(
        self, but: int, look: AreaObservation, *, inside: bool = False
    ) -> AdmissionGuardInputs:
        """Inputs that decide on the admission of a train.

        Args:
            but: the train itself.
            inside: include other trains that stand in the area, as for a restarted train.
        """
        track = look.track
        there = self._standing_there(look.strangers, track, look.now_ns) if inside else {}
        return AdmissionGuardInputs(
            area=self._area,
            before=self._before,
            records=self._known.records,
            reserved_m=look.reserved_m,
            counted=(track.counted if track else ()) if self._counts else None,
            stood=self._stood(but, track, look.now_ns),
            standing=_of_others(look.told, but),
            at_rest=_of_others(look.at_rest, but),
            there=_of_others(there, but),
            line_m=self._line_m,
        )

    def sight(
        self, strangers: Iterable[Heard], track: TrackView | None, now_ns: int
    ) -> TrackObservation:
        """Inputs that decide on the removal of a train."""
        others = list(strangers)
        # A report that was long under way still shows that the train exists.
        present = {
            e.source for e, received_at_ns in others if self._known.is_alive(received_at_ns, now_ns)
        }
        return TrackObservation(
            self._counts,
            track,
            tuple(self._standing_there(others, track, now_ns).values()),
            present,
            self._area.end_m,
        )

    def _standing_there(
        self, others: Sequence[Heard], track: TrackView | None, now_ns: int
    ) -> dict[int, StandingTrain]:
        """Trains at rest in the area now, including those that the master may forget later."""
        return self._at_rest(self._witnesses(others, track, now_ns, inside=True), track, now_ns)

    def _at_rest(
        self, told: Mapping[int, StandingTrain], track: TrackView | None, now_ns: int
    ) -> dict[int, StandingTrain]:
        return {
            train: StandingTrain(each.rear_m, each.front_m, each.axles)
            for train, each in told.items()
            if self._stood(train, track, now_ns)
        }

    def _stood(self, train: int, track: TrackView | None, now_ns: int) -> bool:
        """The train already stood in its place when axles were counted, and still reports it."""
        halt = self._halts.get(train)
        if halt is None or track is None or not self._known.is_recent(halt.report, now_ns):
            return False
        return halt.since_ns <= track.seen_ns

    def _witnesses(
        self,
        strangers: Iterable[Heard],
        track: TrackView | None,
        now_ns: int,
        *,
        inside: bool = False,
    ) -> dict[int, StandingTrain]:
        """Trains that may account for axles: all of the roster, and others outside the area.

        Args:
            inside: include others that stand in the area.
        """
        known = self._known
        behind_m = 0.0 if track is None else way_m(now_ns - track.seen_ns)
        reports = [each.report for each in known.records.values() if each.report is not None]
        self._passed = {t: e for t, e in self._passed.items() if known.is_alive(e[1], now_ns)}
        for report, _ in [*strangers, *self._passed.values()]:
            # A train that was registered a moment ago is still among the applicants.
            if may_explain(report, known.records, self._area) or (inside and report.localised):
                reports.append(report)
        # A silent train may have run on, or been taken away while it stood. Only recent reports
        # count.
        return {
            report.source: standing_of(report)._replace(
                farther_m=way_m(now_ns - report.echo_ns), behind_m=behind_m
            )
            for report in reports
            if known.is_recent(report, now_ns)
        }


def _of_others(standing: Mapping[int, StandingTrain], but: int) -> tuple[StandingTrain, ...]:
    return tuple([each for train, each in standing.items() if train != but])
