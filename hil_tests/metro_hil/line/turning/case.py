"""A case with several trains of a service: one run for each trip, and one verdict over all."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Final

import msgspec

from firmware_py.clock.clock import WallClock
from firmware_py.settings import SettingsError
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.recorder import loss_text
from firmware_py.trackdb.network import TrackNetwork
from metro_hil.line.turning.conductor import Conductor
from metro_hil.line.turning.invariants import Between
from metro_hil.line.turning.masters import Masters, StruckMaster
from metro_hil.line.turning.plan import FleetPlan, TripPlan, entry_of, strike_of
from metro_hil.line.turning.train import TurningTrain
from metro_hil.model.case import Case, CaseEvent, CaseResult, MonitorResult, Verdict
from metro_hil.model.case_setup import CaseParts, Files, file_name
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.mission import Journey
from metro_hil.model.network_supply import supply_of
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.service import (
    PlannedTrip,
    needs_switches,
    read_service,
    service_of,
    trains_of,
)
from metro_hil.run.case import DIED, DURATION, STUCK, STUCK_S, VIOLATION, CaseRun, blocked
from metro_hil.run.lockstep import Lockstep
from metro_hil.run.service_case import (
    ServiceEnd,
    TripResult,
    acting,
    measures_of,
    single_trip,
    together,
    trip_parts,
    trip_result,
)
from plant_emulator.faults.declared_process import ControllerKilled
from plant_emulator.faults.fitting import check_commanded
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.power.box import J_PER_KWH
from plant_emulator.power.network import Network
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.coupling import Books
from plant_emulator.wayside.interlocking import SharedNetwork, SignalBox
from plant_emulator.wayside.route_objects import check_masters
from plant_emulator.world import TrainScenario, World
from vobc.train_to_train.vocabulary import HeldAuthority, T2tConfig
from zenoh_config.messages import MovementAuthority

MS_PER_S: Final = 1e3
APART: Final = "trains-apart"
"""Name of the monitor of what must hold between trains."""
FOLLOWED: Final = "master-followed"
"""Name of the monitor of what must hold after a master was struck."""
SOLVED: Final = "supply-solved"
"""Name of the monitor of the supply network."""
WITH_OTHERS: Final = "ended with the other trains"
OF_EACH: Final = ("arrived_count", "stop_error_worst_m", "emergency_count", "energy_drawn_kwh")
"""Measures that each train has of its own, as `train_1_arrived_count`."""


def run_several(case: Case, *, files: Files, folder: RunFolder | None) -> CaseResult:
    """Run all trains of a case until they have made their trips, and judge them together."""
    began_ns = WallClock().now_ns()
    try:
        fleet = Fleet(case, files, folder)
    except SettingsError as error:
        return blocked(case, error)
    fleet.run()
    return fleet.result((WallClock().now_ns() - began_ns) / 1e9)


class CaseTrain(TurningTrain):
    """A train whose trips are judged as a case."""

    def __init__(
        self,
        fleet: "Fleet",
        number: int,
        box: SignalBox,
        folder: Path | None = None,
        masters: Masters | None = None,
    ) -> None:
        super().__init__(fleet.plan, number, box, folder, masters)
        self.shown: list[TripResult] = []
        """The trips that have ended."""
        self.turns = 0
        self.run: CaseRun | None = None
        """The present trip."""
        self.reason = ""
        """How the case ended, if that ends the present trip."""
        self._fleet = fleet
        self._obeyed: HeldAuthority | None = None
        """The newest authority that the monitors have."""

    def advance(self, until_ns: int) -> None:
        try:
            super().advance(until_ns)
        except Exception as error:
            if self.run is None:
                raise
            self.run.bury(error)
            self._fall_silent()

    def _look(self, bench: Lockstep) -> None:
        super()._look(bench)
        held = None if self._command is None else self._command.held
        if held is None or held == self._obeyed:
            return
        self._obeyed = held
        bench.plant.railway.obey(end_m=held.end_m, rear_m=held.rear_m)
        assert self.run is not None
        # It was issued after the report that it answers.
        head = (self.number, 0, held.term, held.sequence, held.echo_ns, held.end_m)
        self.run.obeys(MovementAuthority(*head, stamp_ns=held.echo_ns, rear_m=held.rear_m))

    def _on_fault(self, plan: FaultPlan, active: bool, now_ns: int) -> None:
        if active and isinstance(plan.parameters, ControllerKilled):
            self._fall_silent()

    def _open(
        self, index: int, scenario: TrainScenario, journey: Journey, shared: SharedNetwork
    ) -> Lockstep:
        parts = replace(
            self._fleet.parts[index], scenario=scenario, journey=journey, config=self._config
        )
        self.run = CaseRun(
            self._fleet.cases[index],
            acting(parts, train=self.number, trip=index + 1),
            self._trip_folder(index),
            shared=shared,
            command=self._command,
        )
        self.run.bench.plant.schedule.listen(self._on_fault)
        self._rows = self.run.rows
        return self.run.bench

    def _connect(self, world: World) -> None:
        super()._connect(world)
        assert self.run is not None
        self.run.metered_before_j = (world.power.drawn_j, world.power.returned_j)

    def _end(self, bench: Lockstep) -> None:
        run, record = self.run, self.trips[-1]
        assert run is not None
        bench.plant.schedule.finish(bench.clock.now_ns())
        run.end(ARRIVED if bench.arrived else self.reason)
        run.close()
        self.turns += record.turned
        name = f"train {self.number}, trip {record.index + 1}"
        parts = self._fleet.parts[record.index]
        shown = trip_result(run, parts, name, record.began_s)
        events = tuple(
            CaseEvent(event.at_s, f"{name}: {event.what}") for event in shown.result.events
        )
        self.shown.append(
            replace(shown, result=msgspec.structs.replace(shown.result, events=events))
        )


class Fleet:
    """All trains of a case."""

    def __init__(self, case: Case, files: Files, folder: RunFolder | None) -> None:
        """Raises SettingsError."""
        assert case.setup.service is not None
        trips, trains = service_of(case.setup, files), trains_of(case.setup, files)
        self._case = case
        self.cases = [single_trip(case, trip, case.setup.duration_s) for trip in trips]
        """The case of each trip, the same for all trains."""
        self.parts: list[CaseParts] = [
            trip_parts(each, files, trip, trains=trains, trips=len(trips))
            for each, trip in zip(self.cases, trips, strict=True)
        ]
        if case.setup.masters:
            check_commanded(self.parts[0].faults, case.id)
        first = self.parts[0]
        if first.scenario.tracks is None:
            raise SettingsError(f"{case.id}: {needs_switches(trains, case.setup.line)}")
        if case.setup.masters:
            departures = [(trip.path, trip.start) for trip in trips]
            check_masters(first.scenario.tracks[0], departures, case.id)
        self.plan = FleetPlan(
            first.scenario.tracks[0],
            first.config,
            read_service(file_name(case.setup.service, files)),
            trains,
            tuple(
                TripPlan(
                    trip,
                    each.journey,
                    each.scenario,
                    entry_of(each.scenario, each.journey, each.config),
                )
                for trip, each in zip(trips, self.parts, strict=True)
            ),
            case.seed,
            case.setup.masters,
            strike_of(case.setup),
            supply=_supply_of(case, files, first.scenario.tracks[0], trips),
        )
        self._trains: list[CaseTrain] = []
        self._reason = ""
        self._moved_s = 0.0
        dwells_s = [stop.dwell_s for each in self.parts for stop in each.journey.stops]
        layover_s = max(trip.layover_s for trip in trips)
        self._patience_s = STUCK_S + max(layover_s, self.plan.service.headway_s, *dwells_s)
        self._conductor = Conductor(
            self.plan,
            lambda number: None if folder is None else folder.path / f"train{number}",
            self._train,
        )

    def _train(
        self,
        plan: FleetPlan,
        number: int,
        box: SignalBox,
        folder: Path | None,
        masters: Masters | None,
    ) -> CaseTrain:
        self._trains.append(CaseTrain(self, number, box, folder, masters))
        return self._trains[-1]

    def run(self) -> None:
        """Run until all trains have left the network, or the case is over."""
        record = self._conductor.run(self._look, lambda: bool(self._reason))
        self._reason = self._reason or record.exit_reason
        if lost := sum(train.lost_log_lines for train in self._trains):
            raise RecorderError(loss_text(lost))

    def _look(self, now_s: float) -> None:
        """End the case if it is over; called each second."""
        open_runs = [(each, each.run) for each in self._trains if each.bench is not None]
        running = [(train, run) for train, run in open_runs if run is not None]
        if any(run.bench.plant.pending or train.moving for train, run in running):
            self._moved_s = now_s
        violated = any(run.violated for _, run in running)
        if violated or (self._case.stop_at_violation and self._conductor.between.violations):
            self._reason = VIOLATION
        elif any(run.died for _, run in running):
            self._reason = DIED
        elif now_s >= self._case.setup.duration_s:
            self._reason = DURATION
        elif now_s - self._moved_s > self._patience_s:
            self._reason = STUCK
        for train, run in running:
            with_others = self._reason == VIOLATION and not run.violated
            train.reason = WITH_OTHERS if with_others else self._reason

    def result(self, wall_s: float) -> CaseResult:
        """Judge the run. Call it after `run`."""
        shown = [trip for train in self._trains for trip in train.shown]
        between, box = self._conductor.between, self._conductor.box
        measures: dict[str, float | None] = {
            "switches_moved_count": float(sum(each.moves for each in box.machines.values())),
            "ends_changed_count": float(sum(train.turns for train in self._trains)),
            "least_gap_m": between.least_gap_m if isfinite(between.least_gap_m) else None,
        }
        for train in self._trains:
            own = measures_of([trip.result for trip in train.shown])
            measures |= {f"train_{train.number}_{name}": own.get(name) for name in OF_EACH}
        monitors = [_apart(between)]
        if self._conductor.masters is not None:
            measures |= _measures_of(self._conductor.masters)
            if self.plan.strike is not None:
                monitors.append(_followed(self._conductor.masters.struck))
        if self._conductor.supply is not None:
            coupling = self._conductor.supply.coupling
            measures |= _of_supply(coupling.books)
            monitors.append(_solved(coupling.network))
        end = ServiceEnd(self._reason, self._conductor.record.duration_s, wall_s)
        return together(self._case, shown, end, measures, monitors)


def _measures_of(masters: Masters) -> dict[str, float | None]:
    struck = masters.struck
    return {
        "command_changes_count": float(len(masters.changes)),
        "takeover_worst_s": None
        if struck is None
        else max(struck.takeovers_s.values(), default=None),
        "authority_oldest_s": None if struck is None else struck.oldest_s,
    }


def _followed(struck: StruckMaster | None) -> MonitorResult:
    """Whether others commanded after a master was struck, while their authorities were fresh."""
    if struck is None:
        detail = "no train commanded an area with another train in it"
        return MonitorResult(
            name=FOLLOWED,
            verdict=Verdict.INCONCLUSIVE,
            margin=None,
            unit="s",
            detail=detail,
            own=False,
        )
    lost = [
        f"area {area} of {path}"
        for path, area in struck.areas
        if (path, area) not in struck.takeovers_s
    ]
    margin_s = T2tConfig().timers.authority_ms / MS_PER_S - struck.oldest_s
    return MonitorResult(
        name=FOLLOWED,
        verdict=Verdict.FAIL if lost or margin_s <= 0.0 else Verdict.PASS,
        margin=None if lost else margin_s,
        unit="s",
        at_s=struck.at_s,
        detail=f"no other train commanded {', '.join(lost)}" if lost else f"train {struck.train}",
        own=False,
    )


def _supply_of(
    case: Case, files: Files, network: TrackNetwork, trips: Sequence[PlannedTrip]
) -> Supply | None:
    if case.setup.supply is None:
        return None
    return supply_of(file_name(case.setup.supply, files), network, trips)


def _apart(between: Between) -> MonitorResult:
    """The result of what must hold between trains."""
    found: Sequence[str] = [
        f"at {each.at_s:.2f} s, {' and '.join(each.trains)}: {each.kind}"
        for each in between.violations
    ]
    judged = Verdict.PASS if between.checked_count else Verdict.VACUOUS
    gap_m = between.least_gap_m
    return MonitorResult(
        name=APART,
        verdict=Verdict.FAIL if found else judged,
        margin=gap_m if isfinite(gap_m) and not found else None,
        unit="m",
        at_s=between.violations[0].at_s if found else None,
        detail="; ".join(found) if found else "" if between.checked_count else "no two trains met",
        own=False,
    )


def _of_supply(books: Books) -> dict[str, float | None]:
    """The measures of the whole supply network."""
    return {
        "grid_energy_kwh": books.sources_j / J_PER_KWH,
        "resistor_energy_kwh": books.resistor_j / J_PER_KWH,
        "lowest_voltage_v": books.lowest_v,
    }


def _solved(network: Network) -> MonitorResult:
    """Whether each instant of the supply network had a solution."""
    judged = Verdict.PASS if network.solved else Verdict.VACUOUS
    text = f"{network.unconverged} of {network.solved} instants without a solution"
    return MonitorResult(
        name=SOLVED,
        verdict=Verdict.FAIL if network.unconverged else judged,
        margin=None,
        unit="",
        at_s=None,
        detail=text,
        own=False,
    )
