"""A case whose train makes the trips of a service: one run for each trip, and one verdict."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import msgspec

from firmware_py.clock.clock import WallClock
from firmware_py.settings import SettingsError
from firmware_py.storage.errors import RecorderError
from firmware_py.storage.recorder import loss_text
from firmware_py.trackdb.circuit import split_route, with_route
from metro_hil.model.case import (
    Case,
    CaseResult,
    ControllerSpec,
    FaultResult,
    Host,
    MonitorResult,
    PlantSpec,
    Verdict,
)
from metro_hil.model.case_setup import CaseParts, Files, parts_of
from metro_hil.model.end_condition import ARRIVED
from metro_hil.model.run_folder import RunFolder
from metro_hil.model.service import PlannedTrip, service_of
from metro_hil.model.verdict import RunEvidence, judge
from metro_hil.run.case import EVENTS_MAX, VIOLATION, CaseRun, blocked
from metro_hil.run.turnback import Departure, go_on

ADDED: Final = ("_count", "_kwh", "run_time_s", "distance_m")
"""Endings of measures that add up over the trips. Of others, the greatest magnitude counts."""
WORST: Final = (Verdict.FAIL, Verdict.PASS, Verdict.INCONCLUSIVE, Verdict.VACUOUS)
"""Verdicts of a monitor, by how much they say about all trips together."""


@dataclass(frozen=True, slots=True)
class TripResult:
    """What one trip showed."""

    name: str
    """Such as `trip 2`, for texts about the whole service."""
    began_s: float
    """Time of the service at which the trip began."""
    moved_m: float
    result: CaseResult


@dataclass(frozen=True, slots=True)
class ServiceEnd:
    """How a service ended."""

    reason: str
    sim_s: float
    wall_s: float


def runs_service(case: Case) -> bool:
    """Whether the train of a case makes the trips of a service that this bench can run."""
    shipped = (case.controller.kind, case.plant.kind) == (ControllerSpec().kind, PlantSpec().kind)
    return case.setup.service is not None and shipped and case.branch is None


def run_service(case: Case, *, files: Files, folder: RunFolder | None) -> CaseResult:
    """Run the trips until one does not arrive, and judge them together."""
    began_ns = WallClock().now_ns()
    setup = case.setup
    shown: list[TripResult] = []
    departure: Departure | None = None
    turns = 0
    try:
        trips = service_of(setup, files)
        for index, trip in enumerate(trips):
            took_s = sum(each.result.sim_s for each in shown)
            if took_s >= setup.duration_s:
                break
            single = single_trip(case, trip, setup.duration_s - took_s)
            parts = trip_parts(single, files, trip, trips=len(trips))
            if departure is not None:
                scenario, journey = departure.scenario(parts.scenario), parts.journey
                parts = replace(parts, scenario=scenario, journey=departure.journey(journey))
            run = CaseRun(
                single, acting(parts, train=1, trip=index + 1), _trip_folder(folder, index)
            )
            leaves = trips[index + 1] if index + 1 < len(trips) else None
            cab_b = departure is not None and departure.cab_b
            departure = _drive(run, trip, leaves, cab_b=cab_b)
            shown.append(trip_result(run, parts, f"trip {index + 1}", took_s))
            if departure is None:
                break
            turns += departure.cab_b is not cab_b
    except SettingsError as error:
        return blocked(case, error)
    results = [each.result for each in shown]
    end = ServiceEnd(
        results[-1].exit_reason,
        sum(each.sim_s for each in results),
        (WallClock().now_ns() - began_ns) / 1e9,
    )
    return together(case, shown, end, {"ends_changed_count": float(turns)})


def single_trip(case: Case, trip: PlannedTrip, left_s: float) -> Case:
    """The case of one trip."""
    setup = msgspec.structs.replace(
        case.setup,
        service=None,
        trains=None,
        supply=None,
        masters=False,
        cut_master_at_s=None,
        kill_master_at_s=None,
        line=with_route(split_route(case.setup.line)[0], split_route(trip.line)[1]),
        start=trip.start,
        end=trip.end,
        stops=trip.stops,
        dwell_s=dict(trip.dwell_s),
        run_s=dict(trip.run_s),
        duration_s=left_s,
    )
    return msgspec.structs.replace(case, setup=setup)


def trip_parts(
    case: Case, files: Files, trip: PlannedTrip, *, trains: int = 1, trips: int = 1
) -> CaseParts:
    """The parts of one trip, with all faults of its case. Raises SettingsError."""
    parts = parts_of(case, files, trains=trains, trips=trips)
    return replace(parts, scenario=replace(parts.scenario, layover_s=trip.layover_s))


def acting(parts: CaseParts, *, train: int, trip: int) -> CaseParts:
    """The parts with those faults that act in a trip."""
    faults = tuple(plan for plan in parts.faults if plan.acts_in(train=train, trip=trip))
    return replace(parts, faults=faults)


def trip_result(run: CaseRun, parts: CaseParts, name: str, began_s: float) -> TripResult:
    """The result of a trip that has ended, with all faults of the case.

    Args:
        parts: of the trip, with all faults.
    """
    result = run.result()
    acted = {plan.index: each for plan, each in zip(run.parts.faults, result.faults, strict=True)}
    faults = tuple(
        acted.get(plan.index, FaultResult(kind=plan.kind.name, began=False, touched=None))
        for plan in parts.faults
    )
    return TripResult(name, began_s, run.moved_m, msgspec.structs.replace(result, faults=faults))


def _trip_folder(folder: RunFolder | None, index: int) -> RunFolder | None:
    if folder is None:
        return None
    path = folder.path / f"trip-{index + 1}"
    path.mkdir(parents=True, exist_ok=True)
    return RunFolder(path)


def _drive(
    run: CaseRun, trip: PlannedTrip, leaves: PlannedTrip | None, *, cab_b: bool
) -> Departure | None:
    """Drive a trip to its end. Returns how the train leaves; None if it does not go on."""
    departure: Departure | None = None
    try:
        run.to_end()
        if leaves is not None and run.reason == ARRIVED:
            departure = go_on(run.bench, trip, leaves, cab_b=cab_b)
    finally:
        run.close()
    if lost := run.bench.lost_log_lines:
        raise RecorderError(loss_text(lost))
    return departure


def together(
    case: Case,
    shown: Sequence[TripResult],
    end: ServiceEnd,
    measures: Mapping[str, float | None],
    between: Sequence[MonitorResult] = (),
) -> CaseResult:
    """Judge all trips together.

    Args:
        measures: of the whole service, in place of those of the trips.
        between: results of what must hold between trains.
    """
    results = [each.result for each in shown]
    monitors = tuple(
        _worst([(trip, trip.result.monitors[index]) for trip in shown])
        for index in range(len(results[0].monitors))
    )
    monitors += tuple(between)
    faults = tuple(_all_of([each.faults[i] for each in results]) for i in range(len(case.faults)))
    died = next((each.died for each in results if each.died), "")
    judgement = judge(
        case,
        RunEvidence(
            monitors=monitors,
            faults=faults,
            died=died,
            moved_m=sum(each.moved_m for each in shown),
            violated=end.reason == VIOLATION,
        ),
    )
    events = [
        msgspec.structs.replace(event, at_s=trip.began_s + event.at_s)
        for trip in shown
        for event in trip.result.events
    ]
    events.sort(key=lambda event: event.at_s)
    chain = hashlib.sha256("".join(each.chain for each in results).encode()).hexdigest()
    return CaseResult(
        case_id=case.id,
        index=case.index,
        verdict=judgement.verdict,
        reason=judgement.reason,
        lacking=judgement.lacking,
        died=died,
        exit_reason=end.reason,
        sim_s=end.sim_s,
        frames=sum(each.frames for each in results),
        chain=chain[: len(results[0].chain)],
        monitors=monitors,
        faults=faults,
        measures={**measures_of(results), **measures},
        events=tuple(events[:EVENTS_MAX]),
        host=Host(wall_s=end.wall_s, stepping_s=sum(each.host.stepping_s for each in results)),
    )


def _worst(each_trip: Sequence[tuple[TripResult, MonitorResult]]) -> MonitorResult:
    """The result of a monitor that says most about all trips, with its time in the service."""

    def rank(entry: tuple[TripResult, MonitorResult]) -> tuple[int, float]:
        _, result = entry
        margin = float("inf") if result.margin is None else result.margin
        return WORST.index(result.verdict), margin

    trip, result = min(each_trip, key=rank)
    at_s = None if result.at_s is None else trip.began_s + result.at_s
    detail = f"{trip.name}: {result.detail}" if result.detail else ""
    return msgspec.structs.replace(result, at_s=at_s, detail=detail)


def _all_of(each_trip: Sequence[FaultResult]) -> FaultResult:
    counts = [each.touched for each in each_trip if each.touched is not None]
    return FaultResult(
        kind=each_trip[0].kind,
        began=any(each.began for each in each_trip),
        touched=sum(counts) if counts else None,
    )


def measures_of(results: Sequence[CaseResult]) -> dict[str, float | None]:
    """The measures of several trips together."""
    measures: dict[str, float | None] = {}
    for name in dict.fromkeys(name for each in results for name in each.measures):
        found = [each.measures.get(name) for each in results]
        values = [value for value in found if value is not None]
        adds = name.endswith(ADDED) and not name.startswith("notch_changes")
        measures[name] = sum(values) if adds and values else max(values, key=abs, default=None)
    return measures
