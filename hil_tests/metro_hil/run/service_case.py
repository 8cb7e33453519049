"""A case whose train makes the trips of a service: one run for each trip, and one verdict."""

import hashlib
import itertools
from collections.abc import Sequence
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

    began_s: float
    """Time of the service at which the trip began."""
    moved_m: float
    cab_b: bool
    """Whether the train ran with the cab ahead that was behind at first."""
    result: CaseResult


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
    try:
        trips = service_of(setup, files)
        for number, trip in enumerate(trips):
            took_s = sum(each.result.sim_s for each in shown)
            if took_s >= setup.duration_s:
                break
            single = _single(case, trip, setup.duration_s - took_s)
            parts = _parts(single, trip, files, departure)
            run = CaseRun(single, parts, _trip_folder(folder, number))
            leaves = trips[number + 1] if number + 1 < len(trips) else None
            cab_b = departure is not None and departure.cab_b
            departure = _drive(run, trip, leaves, cab_b=cab_b)
            shown.append(TripResult(took_s, run.moved_m, cab_b, run.result()))
            if departure is None:
                break
    except SettingsError as error:
        return blocked(case, error)
    return _together(case, shown, (WallClock().now_ns() - began_ns) / 1e9)


def _single(case: Case, trip: PlannedTrip, left_s: float) -> Case:
    """The case of one trip."""
    setup = msgspec.structs.replace(
        case.setup,
        service=None,
        line=with_route(split_route(case.setup.line)[0], split_route(trip.line)[1]),
        start=trip.start,
        end=trip.end,
        stops=trip.stops,
        dwell_s=dict(trip.dwell_s),
        duration_s=left_s,
    )
    return msgspec.structs.replace(case, setup=setup)


def _parts(case: Case, trip: PlannedTrip, files: Files, departure: Departure | None) -> CaseParts:
    parts = parts_of(case, files)
    scenario = replace(parts.scenario, layover_s=trip.layover_s)
    if departure is None:
        return replace(parts, scenario=scenario)
    return replace(
        parts,
        scenario=departure.scenario(scenario),
        journey=departure.journey(parts.journey),
    )


def _trip_folder(folder: RunFolder | None, number: int) -> RunFolder | None:
    if folder is None:
        return None
    path = folder.path / f"trip-{number + 1}"
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


def _together(case: Case, shown: Sequence[TripResult], wall_s: float) -> CaseResult:
    results = [each.result for each in shown]
    monitors = tuple(
        _worst([(n, trip.began_s, trip.result.monitors[index]) for n, trip in enumerate(shown, 1)])
        for index in range(len(results[0].monitors))
    )
    faults = tuple(_all_of([each.faults[i] for each in results]) for i in range(len(case.faults)))
    died = next((each.died for each in results if each.died), "")
    judgement = judge(
        case,
        RunEvidence(
            monitors=monitors,
            faults=faults,
            died=died,
            moved_m=sum(each.moved_m for each in shown),
            violated=results[-1].exit_reason == VIOLATION,
        ),
    )
    events = [
        msgspec.structs.replace(event, at_s=trip.began_s + event.at_s)
        for trip in shown
        for event in trip.result.events
    ]
    turns = sum(one.cab_b is not other.cab_b for one, other in itertools.pairwise(shown))
    chain = hashlib.sha256("".join(each.chain for each in results).encode()).hexdigest()
    return CaseResult(
        case_id=case.id,
        index=case.index,
        verdict=judgement.verdict,
        reason=judgement.reason,
        lacking=judgement.lacking,
        died=died,
        exit_reason=results[-1].exit_reason,
        sim_s=sum(each.sim_s for each in results),
        frames=sum(each.frames for each in results),
        chain=chain[: len(results[0].chain)],
        monitors=monitors,
        faults=faults,
        measures=_measures(results) | {"ends_changed_count": float(turns)},
        events=tuple(events[:EVENTS_MAX]),
        host=Host(wall_s=wall_s, stepping_s=sum(each.host.stepping_s for each in results)),
    )


def _worst(each_trip: Sequence[tuple[int, float, MonitorResult]]) -> MonitorResult:
    """The result of a monitor that says most about all trips, with its time in the service."""

    def rank(entry: tuple[int, float, MonitorResult]) -> tuple[int, float]:
        _, _, result = entry
        margin = float("inf") if result.margin is None else result.margin
        return WORST.index(result.verdict), margin

    number, began_s, result = min(each_trip, key=rank)
    at_s = None if result.at_s is None else began_s + result.at_s
    detail = f"trip {number}: {result.detail}" if result.detail else ""
    return msgspec.structs.replace(result, at_s=at_s, detail=detail)


def _all_of(each_trip: Sequence[FaultResult]) -> FaultResult:
    counts = [each.touched for each in each_trip if each.touched is not None]
    return FaultResult(
        kind=each_trip[0].kind,
        began=any(each.began for each in each_trip),
        touched=sum(counts) if counts else None,
    )


def _measures(results: Sequence[CaseResult]) -> dict[str, float | None]:
    measures: dict[str, float | None] = {}
    for name in dict.fromkeys(name for each in results for name in each.measures):
        found = [each.measures.get(name) for each in results]
        values = [value for value in found if value is not None]
        adds = name.endswith(ADDED) and not name.startswith("notch_changes")
        measures[name] = sum(values) if adds and values else max(values, key=abs, default=None)
    return measures
