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
from metro_hil.line.turning.invariants import KNOWN_S, Between, Observed
from metro_hil.line.turning.masters import CUT_NS, Masters
from metro_hil.line.turning.plan import FleetPlan
from metro_hil.line.turning.supply import FleetSupply
from metro_hil.line.turning.train import TurningTrain
from metro_hil.model.end_condition import ARRIVED, INTERRUPTED
from metro_hil.run.lockstep import LIMIT_S, STANDS_S, STUCK, TIME_UP
from plant_emulator.traffic.coupling import INTERVAL_NS
from plant_emulator.wayside.interlocking import SignalBox

SLICE_NS: Final = 50_000_000
"""Time for which a train runs alone: a control cycle, and the interval of the wayside."""
MESSAGE_NS: Final = 10_000_000
"""The same between trains that command themselves: their messages arrive within two of them."""
POINT_NS: Final = 1_000_000_000
"""Time between two points of the train graph."""
NS_PER_S: Final = 1_000_000_000
AFTER_KILL_NS: Final = 60_000_000_000
AFTER_KILL: Final = "a minute after the master was killed"
"""The train of a killed controller stands for good, and others wait behind it."""


TrainMaker = Callable[
    [FleetPlan, int, SignalBox, Path | None, Masters | None],
    TurningTrain,
]


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

    def __init__(
        self,
        plan: FleetPlan,
        folders: Callable[[int], Path | None],
        make: TrainMaker = TurningTrain,
    ) -> None:
        """Args:
        folders: gives the folder for the logs of a train by its number, or None.
        make: makes a train by its number.
        """
        self.box = SignalBox(plan.network)
        self.masters = _masters_of(plan, self.box)
        """The masters of all paths; None: the wayside issues all authorities."""
        self.trains = [
            make(plan, number, self.box, folders(number), self.masters)
            for number in range(1, plan.trains + 1)
        ]
        self.record = FleetRecord(plan.network)
        self._plan = plan
        self._killed_ns: int | None = None
        self._heals_ns: int | None = None
        """When a cut of a master's radio ends."""
        self.between = Between(0.0 if self.masters is None else KNOWN_S)
        self.supply = _supply_of(plan)
        """None: each train has a source of its own."""
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
            self._strike(now_ns)
            self._advance(now_ns)
            now_ns += SLICE_NS
            self._watch(now_ns)
            if self.supply is not None and now_ns % INTERVAL_NS == 0:
                self.supply.step(now_ns, self.trains)
            if any(train.moving for train in self.trains):
                moved_ns = now_ns
            if all(train.gone for train in self.trains):
                record.exit_reason = ARRIVED
            elif interrupted():
                record.exit_reason = INTERRUPTED
            elif self._killed_ns is not None and now_ns - self._killed_ns >= AFTER_KILL_NS:
                record.exit_reason = AFTER_KILL
            elif now_ns - moved_ns > self._patience_s * NS_PER_S:
                record.exit_reason = STUCK
            elif now_ns > LIMIT_S * NS_PER_S:
                record.exit_reason = TIME_UP
        if self.supply is not None and now_ns % INTERVAL_NS:
            # The last interval is shorter; its energy counts too.
            self.supply.step(now_ns, self.trains)
        record.duration_s = now_ns / NS_PER_S

    def _strike(self, now_ns: int) -> None:
        """Strike a master when that is due, and end a cut."""
        masters, strike = self.masters, self._plan.strike
        if masters is None or strike is None:
            return
        struck = masters.struck
        if struck is None and now_ns >= strike.at_s * NS_PER_S:
            struck = masters.choose(now_ns)
            if struck is not None and strike.kills:
                self.trains[struck.train - 1].kill()
                self._killed_ns = now_ns
            elif struck is not None:
                masters.cut(struck.train)
                self._heals_ns = now_ns + CUT_NS
        if self._heals_ns is not None and now_ns >= self._heals_ns:
            masters.heal()
            self._heals_ns = None

    def _advance(self, now_ns: int) -> None:
        """Run all trains for a slice. Trains under masters answer each other within it."""
        step_ns = SLICE_NS if self.masters is None else MESSAGE_NS
        for until_ns in range(now_ns + step_ns, now_ns + SLICE_NS + 1, step_ns):
            for train in self.trains:
                train.advance(until_ns)
            if self.masters is not None:
                self.masters.step(until_ns)

    def _watch(self, now_ns: int) -> None:
        present = {
            train.name: Observed(train.interlocking, train.authority_end_m, train.authority_number)
            for train in self.trains
            if train.bench is not None
        }
        self.between.look(now_ns / NS_PER_S, present)

    def _draw(self, now_ns: int) -> None:
        for train in self.trains:
            if train.bench is not None:
                at_s, trip = now_ns / NS_PER_S, train.trips[-1].index
                self.record.points.append(GraphPoint(at_s, train.number, trip, train.middle))


def _masters_of(plan: FleetPlan, box: SignalBox) -> Masters | None:
    if not plan.masters:
        return None
    paths = {each.trip.path.line.name: each.trip.path for each in plan.trips}
    return Masters(plan.network, paths.values(), box)


def _supply_of(plan: FleetPlan) -> FleetSupply | None:
    if plan.supply is None:
        return None
    return FleetSupply(plan.supply, plan.network, headway_s=plan.service.headway_s)
