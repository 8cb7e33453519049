"""Completes a surveyed line by stated rules: platforms, tags and track beyond both ends."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from firmware_py.settings import SettingsError, build
from firmware_py.trackdb import LineMap
from metro_hil.exchange.survey import SurveyedLine

PLATFORM_SPARE_M: Final = 5.0
"""A platform reaches this far beyond both ends of a train at its stopping point."""
BEFORE_M: Final = 50.0
"""Track behind the first platform, for a train that rolls back."""
BEYOND_M: Final = 200.0
"""Track beyond the last stopping point, for the overlap of the last authority."""
BALISES_M: Final = 250.0
"""Greatest distance between two balises."""
DWELL_S: Final = 30.0
APPROACH: Final = (("t1", 52.0), ("t2", 12.0), ("t3", 3.5))
"""Tags before a stopping point, m; those of [Allotta 2013] as the shipped lines have them."""
HOP_MIN_M: Final = 2.0 * APPROACH[0][1]
"""Least distance between two stopping points, so that the tags of one do not mix with others."""
FIRST_BALISE: Final = 20_001
TAGS_OF_STOP: Final = 100


@dataclass(frozen=True, slots=True)
class FittedTrain:
    """Properties of the train that a line is completed for."""

    name: str
    length_m: float
    antenna_m: float
    """Distance from the front coupler back to the tag antenna."""
    speed_mps_max: float | None = None
    """Greatest speed of the train; None if it is unknown."""


@dataclass(frozen=True, slots=True)
class Completed:
    """The tables of a file, and a sentence for each rule that filled a gap."""

    table: dict[str, Any]
    notes: tuple[str, ...]


def complete_line(line: SurveyedLine, train: FittedTrain) -> Completed:
    """The line as the table of a line file. Raises SettingsError if the line cannot be run."""
    if "tags" not in line.given:
        _check_hops(line, train)
    stations = [
        _station(name, stop_m, train) | line.given.get("stations", {}).get(name, {})
        for name, stop_m in line.stops
    ]
    start_m, end_m = _extent_m(line, stations)
    surveyed_m = "start_m" in line.given
    first_m, last_m = (start_m, end_m) if surveyed_m else (line.stops[0][1], line.stops[-1][1])
    limits, capped = _capped(line.limits, train.speed_mps_max)
    table: dict[str, Any] = {
        "name": line.name,
        "description": f"Imported from {line.source.rsplit('/', maxsplit=1)[-1]}",
        "stations": stations,
        "speed_sections": [
            {"start_m": begin_m, "end_m": finish_m, "limit_mps": limit_mps}
            for begin_m, finish_m, limit_mps in _sections(limits, start_m, end_m)
        ],
        "gradients": [
            {"start_m": begin_m, "end_m": finish_m, "gradient_permille": permille}
            for begin_m, finish_m, permille in _sections(line.gradients, first_m, last_m)
            if permille != 0.0
        ],
        "curves": [
            {"start_m": bend.start_m, "end_m": bend.end_m, "radius_m": bend.radius_m}
            for bend in line.bends
        ],
    }
    table |= {key: value for key, value in line.given.items() if key != "stations"}
    if "tags" not in table:
        table["tags"] = _tags([stop_m for _, stop_m in line.stops], train.antenna_m, line)
    table |= {"start_m": start_m, "end_m": end_m}
    build(LineMap, table, line.source)
    return Completed(table, tuple(_notes(line, train, capped)))


def _extent_m(line: SurveyedLine, stations: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Both ends of the line: those of the file, or further out where the rules need more track."""
    start_m = min(stations[0]["platform_start_m"], stations[0]["stop_m"])
    end_m = max(stations[-1]["platform_end_m"], stations[-1]["stop_m"])
    if "start_m" in line.given:
        return min(line.given["start_m"], start_m), max(line.given["end_m"], end_m)
    return start_m - BEFORE_M, line.stops[-1][1] + BEYOND_M


def _check_hops(line: SurveyedLine, train: FittedTrain) -> None:
    for (before, before_m), (after, after_m) in itertools.pairwise(line.stops):
        if after_m - before_m < HOP_MIN_M:
            raise SettingsError(
                f"{line.source}: stops: {before} and {after} are {after_m - before_m:g} m apart; "
                f"tags need {HOP_MIN_M:g} m; leave one stop out"
            )
    if train.antenna_m >= APPROACH[-1][1]:
        raise SettingsError(
            f"{line.source}: the antenna of {train.name} is {train.antenna_m:g} m behind its "
            f"front, and the tag before `stop` lies {APPROACH[-1][1]:g} m before the stopping "
            "point; the rules cannot place tags for this train"
        )


def _station(name: str, stop_m: float, train: FittedTrain) -> dict[str, Any]:
    return {
        "name": name,
        "stop_m": stop_m,
        "platform_start_m": stop_m - train.length_m - PLATFORM_SPARE_M,
        "platform_end_m": stop_m + PLATFORM_SPARE_M,
        "side": "right",
        "dwell_s": DWELL_S,
    }


def _capped(
    limits: Sequence[tuple[float, float]], most_mps: float | None
) -> tuple[list[tuple[float, float]], bool]:
    """The limits, none above the train's greatest speed, and whether one was lowered."""
    if most_mps is None:
        return list(limits), False
    capped = [(at_m, min(limit_mps, most_mps)) for at_m, limit_mps in limits]
    return capped, capped != list(limits)


def _sections(
    changes: Sequence[tuple[float, float]], start_m: float, end_m: float
) -> list[tuple[float, float, float]]:
    """Sections from start to end; the first and last value hold to the ends."""
    inner = [(at_m, value) for at_m, value in changes if at_m < end_m]
    starts_m = [start_m, *(at_m for at_m, _ in inner[1:])]
    return [
        (begin_m, finish_m, value)
        for begin_m, finish_m, (_, value) in zip(
            starts_m, [*starts_m[1:], end_m], inner, strict=True
        )
    ]


def _tags(stops_m: Sequence[float], antenna_m: float, line: SurveyedLine) -> list[dict[str, Any]]:
    tags: list[dict[str, Any]] = []
    balise = FIRST_BALISE
    before_m = stops_m[0]
    for index, ((name, _), stop_m) in enumerate(zip(line.stops, stops_m, strict=True)):
        approach = APPROACH if index else ()
        if approach:
            gap_m = stop_m - approach[0][1] - before_m
            parts = math.ceil(gap_m / BALISES_M)
            for part in range(1, parts):
                at_m = round(before_m + part * gap_m / parts, 2)
                tags.append({"tag_id": balise, "position_m": at_m, "kind": "balise"})
                balise += 1
        number = TAGS_OF_STOP * (index + 1)
        for offset, (kind, ahead_m) in enumerate((*approach, ("stop", antenna_m)), start=1):
            tags.append(
                {
                    "tag_id": number + offset,
                    "position_m": stop_m - ahead_m,
                    "kind": kind,
                    "station": name,
                }
            )
        before_m = stop_m
    return tags


def _notes(line: SurveyedLine, train: FittedTrain, capped: bool) -> list[str]:
    stations = line.given.get("stations", {})
    laid_out = [name for name, _ in line.stops if "platform_end_m" not in stations.get(name, {})]
    notes = [
        f"stations: in running order, {line.stops[0][0]} to {line.stops[-1][0]}; where the file "
        f"does not say, doors open for {DWELL_S:g} s on the right, and there are no platform doors",
    ]
    if laid_out:
        names = "each" if len(laid_out) == len(line.stops) else ", ".join(laid_out)
        notes.append(
            f"platforms: {names} reaches {PLATFORM_SPARE_M:g} m beyond both ends of a standing "
            f"train of {train.length_m:g} m ({train.name})"
        )
    if "tags" not in line.given:
        notes.append(
            f"tags: a balise at least every {BALISES_M:g} m; t1, t2 and t3 52, 12 and 3.5 m before "
            f"each stopping point, and `stop` under the antenna, {train.antenna_m:g} m before it"
        )
    if "start_m" not in line.given:
        notes.append(
            f"track: {BEFORE_M:g} m behind the first platform and {BEYOND_M:g} m beyond the last "
            "stopping point, level, with the nearest limit"
        )
    if capped and train.speed_mps_max is not None:
        notes.append(
            f"speed_sections: limits above {3.6 * train.speed_mps_max:g} km/h lowered to it, the "
            f"greatest speed of {train.name}"
        )
    if line.bends:
        notes.append("curves: a transition has its mean curvature as radius")
    notes += [*line.filled, *(f"left out: {text}" for text in line.ignored)]
    return notes
