"""Runs all trains of a service together in virtual time, and watches what must hold between them.

Trains meet only in the interlocking and in the authorities of the wayside. So each train runs alone
for a slice of time, one after the other in the order of their numbers, and then all are at the same
instant.
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from firmware_py.interrupts import never
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import TrackPlace
from metro_hil.line.turning.invariants import Between
from metro_hil.line.turning.plan import FleetPlan
from metro_hil.line.turning.train import TurningTrain
from metro_hil.model.end_condition import ARRIVED, INTERRUPTED
from metro_hil.run.lockstep import LIMIT_S, STANDS_S, STUCK, TIME_UP
from plant_emulator.wayside.interlocking import SignalBox

SLICE_NS: Final = 50_000_000
"""Time for which a train runs alone: a control cycle, and the interval of the wayside."""
POINT_NS: Final = 1_000_000_000
"""Time between two points of the train graph."""
NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class GraphPoint:
    """Where the middle of a train was at an instant."""

    at_s: float
    train: int
    trip: int
    place: TrackPlace


@dataclass(slots=True)
class FleetRecord:
    """What a run of all trains showed."""

    network: TrackNetwork
    exit_reason: str = ""
    duration_s: float = 0.0
    points: list[GraphPoint] = field(default_factory=list)


class Conductor:
    """All trains of a service on their network."""

    def __init__(self, plan: FleetPlan, folders: Callable[[int], Path | None]) -> None:
        """Args:
        folders: gives the folder for the logs of a train by its number, or None.
        """
        self.box = SignalBox(plan.network)
        self.trains = [
            TurningTrain(plan, number, self.box, folders(number))
            for number in range(1, plan.trains + 1)
        ]
        self.record = FleetRecord(plan.network)
        self.between = Between()
        self._patience_s = STANDS_S + max(plan.round_s, plan.service.headway_s)

    def run(
        self,
        told: Callable[[float], None] = lambda now_s: None,
        interrupted: Callable[[], bool] = never,
    ) -> FleetRecord:
        """Run until every train has left the network, or no train moves any more.

        Args:
            told: receives the time of the network each second.
        """
        with ExitStack() as stack:
            for train in self.trains:
                stack.callback(train.close)
            self._run(told, interrupted)
        return self.record

    def _run(self, told: Callable[[float], None], interrupted: Callable[[], bool]) -> None:
        now_ns = moved_ns = 0
        record = self.record
        while not record.exit_reason:
            if now_ns % POINT_NS == 0:
                told(now_ns / NS_PER_S)
                self._draw(now_ns)
            for train in self.trains:
                if train.bench is None and not train.gone:
                    train.enter(now_ns)
            now_ns += SLICE_NS
            for train in self.trains:
                train.advance(now_ns)
            self._watch(now_ns)
            if any(train.moving for train in self.trains):
                moved_ns = now_ns
            if all(train.gone for train in self.trains):
                record.exit_reason = ARRIVED
            elif interrupted():
                record.exit_reason = INTERRUPTED
            elif now_ns - moved_ns > self._patience_s * NS_PER_S:
                record.exit_reason = STUCK
            elif now_ns > LIMIT_S * NS_PER_S:
                record.exit_reason = TIME_UP
        record.duration_s = now_ns / NS_PER_S

    def _watch(self, now_ns: int) -> None:
        present = {
            train.name: (train.interlocking, train.authority_end_m)
            for train in self.trains
            if train.bench is not None
        }
        self.between.look(now_ns / NS_PER_S, present)

    def _draw(self, now_ns: int) -> None:
        for train in self.trains:
            if train.bench is not None:
                body = train.interlocking.body
                place = body.path.to_track((body.rear_m + body.end_m) / 2.0)
                self.record.points.append(
                    GraphPoint(now_ns / NS_PER_S, train.number, train.trips[-1].index, place)
                )
