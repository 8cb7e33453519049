"""Results of a line's run, as a table for people and as JSON for scripts."""

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from metro_hil.line.exercise.event_log import (
    AreaEvents,
    EmergencyBrakeEvent,
    LineEvents,
    StopEvent,
    TrainEvents,
)


@dataclass(frozen=True, slots=True)
class TrainResult:
    """Result of one train; unknown values are None."""

    train: int
    front_m: float | None
    speed_mps: float | None
    authority_end_m: float | None
    term: int | None
    oldest_ms: float
    """Greatest age of its authority until a newer one came."""
    latency_p50_ms: float | None
    latency_p99_ms: float | None
    least_gap_m: float | None
    """Least distance from the end of its authority to the true rear of the train ahead."""
    service_brakes: int
    struck: bool
    emergencies: Sequence[EmergencyBrakeEvent]
    stops: Sequence[StopEvent]


def result_of(number: int, train: TrainEvents) -> TrainResult:
    newest = max(train.given.values(), default=None, key=lambda each: each.at_ns)
    latencies_ms = sorted(train.latencies_ms)
    return TrainResult(
        train=number,
        front_m=None if train.place is None else train.place.front_m,
        speed_mps=train.speed_mps,
        authority_end_m=None if newest is None else newest.end_m,
        term=None if newest is None else newest.term,
        oldest_ms=train.oldest_ms,
        latency_p50_ms=_at(latencies_ms, 50),
        latency_p99_ms=_at(latencies_ms, 99),
        least_gap_m=None if math.isinf(train.least_gap_m) else train.least_gap_m,
        service_brakes=train.service_brakes,
        struck=train.struck,
        emergencies=train.emergencies,
        stops=train.stops,
    )


def results_json(
    story: LineEvents,
    trains: int,
    *,
    exit_reason: str,
    complaints: Sequence[str],
    missed: int,
    carried: Mapping[str, Mapping[str, int]],
    second_of: Callable[[int], float],
    doubts: Sequence[str] = (),
) -> str:
    """Return all results as JSON.

    Args:
        doubts: reasons why the run proves nothing.
        missed: number of messages that the recorder lost.
        carried: packet counts, by direction.
        second_of: converts an instant to seconds of the event log.
    """
    results = [result_of(number, story.train(number)) for number in range(1, trains + 1)]
    document = {
        "exit_reason": exit_reason,
        "verdict": "invalid" if doubts else "failed" if complaints else "passed",
        "doubts": doubts,
        "complaints": complaints,
        "trains": [_train(each, second_of) for each in results],
        "areas": [_area(n, area, second_of) for n, area in sorted(story.areas.items())],
        "refused_messages": story.refused,
        "missed_messages": missed,
        "packets": carried,
    }
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def _train(result: TrainResult, second_of: Callable[[int], float]) -> dict[str, Any]:
    emergencies = []
    for each in result.emergencies:
        said = each._asdict()
        emergencies.append({"at_s": round(second_of(said.pop("at_ns")), 3), **said})
    stops = [stop._asdict() for stop in result.stops]
    return {**dataclasses.asdict(result), "emergencies": emergencies, "stops": stops}


def _area(number: int, area: AreaEvents, second_of: Callable[[int], float]) -> dict[str, Any]:
    terms = [
        {"at_s": round(second_of(each.at_ns), 3), "term": each.number, "train": each.train}
        for each in area.terms
    ]
    return {"area": number, "train": area.heartbeat.source, "terms": terms}


def _at(values: Sequence[float], percent: int) -> float | None:
    return values[len(values) * percent // 100] if values else None
