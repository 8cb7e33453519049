"""The verdict of a line's run: failures, doubts, and a table of its trains."""

from collections.abc import Mapping
from typing import Final

from rich.table import Table

from can_dbc.vobc import Cause
from metro_hil.line.exercise.event_log import EmergencyBrakeEvent, LineEvents
from metro_hil.line.exercise.results import TrainResult, result_of
from metro_hil.model.terminal import console_for

KMH: Final = 3.6
REMOTE: Final = Cause.REMOTE.name.lower()
"""Cause of an ordered emergency brake, which is no failure."""


def complaints(story: LineEvents, trains: int, *, behind_rear_m: float) -> list[str]:
    """Return the failures as sentences; none if the run passed."""
    said = list(story.collisions)
    for number in range(1, trains + 1):
        train = story.train(number)
        if train.least_gap_m < behind_rear_m:
            said.append(
                f"train {number}: authority ends only {train.least_gap_m:.2f} m behind the next"
            )
        said += [
            f"train {number}: emergency brake {_when(each)}: {each.cause}"
            for each in train.emergencies
            if each.cause != REMOTE and not each.excused
        ]
        if not train.given and not train.drove:
            said.append(f"train {number}: never had an authority")
    return said


def doubts(story: LineEvents, trains: int) -> list[str]:
    """Return why the run proves nothing, from received and missing messages; empty if it does."""
    said = [
        f"train {number}: it drove, but the observer received no authority for it"
        for number in range(1, trains + 1)
        if story.train(number).drove and not story.train(number).given
    ]
    said += [
        f"area {each.area}: train {each.train} was struck in term {each.term}, but no later term "
        "was received; use a longer --for or --down-for"
        for each in story.unseen_takeovers()
    ]
    return [*said, *story.missed_strikes]


def _when(emergency: EmergencyBrakeEvent) -> str:
    if emergency.commanded:
        return "although it was commanded"
    return "while it had no fresh authority"


def show(story: LineEvents, trains: int) -> None:
    """Print the trains as a table, the foremost first."""
    table = Table(box=None)
    for head in ("train", "front m", "km/h", "authority to m", "term"):
        table.add_column(head, justify="right")
    for head in ("oldest ms", "latency ms", "p99", "least gap m", "service", "emergency"):
        table.add_column(head, justify="right")
    table.add_column("stops, m from the stopping point")
    for number in range(1, trains + 1):
        train = result_of(number, story.train(number))
        speed_kmh = None if train.speed_mps is None else train.speed_mps * KMH
        table.add_row(
            str(number),
            _figure(train.front_m, 1),
            _figure(speed_kmh, 1),
            _figure(train.authority_end_m, 1),
            _figure(train.term, 0),
            _figure(train.oldest_ms, 0),
            _figure(train.latency_p50_ms, 0),
            _figure(train.latency_p99_ms, 0),
            _figure(train.least_gap_m, 1),
            str(train.service_brakes),
            emergency_words(train),
            ", ".join([f"{stop.station} {stop.error_m:+.2f}" for stop in train.stops]) or "–",
        )
    console_for(highlight=False).print(table)


def _figure(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:z.{digits}f}"


def emergency_words(train: TrainResult) -> str:
    """Return all causes in order; `struck` if a fault struck the train."""
    causes = [each.cause for each in train.emergencies]
    return ", ".join([*causes, "struck"] if train.struck else causes) or "none"


def areas_words(story: LineEvents) -> list[str]:
    return [
        f"area {number}: train {area.heartbeat.source} commands, term {area.heartbeat.term}, "
        f"{len(area.terms)} {'term' if len(area.terms) == 1 else 'terms'} seen"
        for number, area in sorted(story.areas.items())
    ]


def carried_words(counts: Mapping[str, int]) -> str:
    """Return the packet counts of one direction as text."""
    return f"{counts['lost']} lost, {counts['doubled']} doubled, {counts['cut']} cut off"
