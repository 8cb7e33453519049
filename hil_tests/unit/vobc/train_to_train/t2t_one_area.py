"""A master's area in which trains of its roster restart."""

import dataclasses

from firmware_py.trackdb.areas import Area
from vobc.train_to_train.admission import AdmissionGuardInputs
from vobc.train_to_train.authority import Counted, StandingTrain
from vobc.train_to_train.guards import MasterGuards
from vobc.train_to_train.inference import Conclusions
from vobc.train_to_train.occupancy import TrainTable
from vobc.train_to_train.restart import RestartedTrains
from vobc.train_to_train.roster import Order
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config.t2t import RosterEntry, TrainReport

NOW_NS = 60_000_000_000


def report_at(rear_m: float, *, train: int = 1, unsure_m: float = 4.0) -> TrainReport:
    front_m = rear_m + 80.0
    return TrainReport(
        *(train, 65_535, 1, 5, 2, 1, 0, True, front_m, front_m + unsure_m, rear_m, rear_m, 0.0),
        True,
        *(front_m + unsure_m, front_m + unsure_m, front_m + unsure_m, 0, 0, False, 0, 0, 16),
        *(False, 0, 0),
    )


class OneArea:
    """A master's area from 0 to 3000 m; `before` is the area behind it, if any."""

    def __init__(
        self,
        *trains: tuple[int, float],
        counted: tuple[Counted, ...] | None = None,
        before: Area | None = None,
        start_m: float = 0.0,
        sieved: bool = False,
    ) -> None:
        self.order: Order = tuple([RosterEntry(train, at, sieved, 1) for train, at in trains])
        self.known = Conclusions(5, TrainTable(), T2tConfig(), MasterGuards())
        self.known.begin_with(self.order, 0)
        self.newborns = RestartedTrains(T2tConfig(), MasterGuards())
        self._area, self._before, self.counted = Area(1, start_m, 3000.0), before, counted
        self.reserved_m: dict[int, float] = {}
        self.at_rest: tuple[StandingTrain, ...] = ()
        self.unregistered: tuple[StandingTrain, ...] = ()
        """Unregistered trains that stand in the area; the master may forget them."""

    def receives_former_report(
        self, train: int, *, age_ns: int, echo_ns: int | None = None, localised: bool = True
    ) -> None:
        """Receive a report of the former incarnation.

        By default the train had received the master's heartbeat at that instant.
        """
        echo_ns = NOW_NS - age_ns if echo_ns is None else echo_ns
        record = self.known.records[train]
        former = report_at(record.rear_m, train=train)
        former = dataclasses.replace(former, echo_ns=echo_ns, localised=localised)
        record.on_message(former, NOW_NS - age_ns, term=5, jog_m=5.0)

    def on_message(self, report: TrainReport, *, age_ns: int = 0) -> None:
        self.newborns.on_message(report, NOW_NS - age_ns)

    def settles(self) -> tuple[Order, list[tuple[TrainReport, int]]]:
        return self.newborns.settle(self.order, self._scene_of, self.known, NOW_NS)

    def _scene_of(self, _: TrainReport) -> AdmissionGuardInputs:
        records, there = self.known.records, (*self.at_rest, *self.unregistered)
        scene = AdmissionGuardInputs(
            self._area, self._before, records, self.reserved_m, self.counted, True, ()
        )
        return scene._replace(at_rest=self.at_rest, there=there, line_m=(0.0, 4000.0))


def restarted(
    rear_m: float,
    *,
    train: int = 1,
    localised: bool = True,
    standstill: bool = True,
    comes_from: int = 0,
    behind: int = 0,
) -> TrainReport:
    """A report of the second incarnation; its front is known within 4 m."""
    return dataclasses.replace(
        report_at(rear_m, train=train),
        boot=2,
        localised=localised,
        standstill=standstill,
        comes_from=comes_from,
        behind=behind,
        ready_nonce=40 + train,
        echo_ns=NOW_NS,
    )


BEYOND = restarted(820.0)
"""The restarted train reports a place before the one that was ahead of it, from 700 m to 780 m."""
