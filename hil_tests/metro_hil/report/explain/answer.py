"""The answer that `vobc explain` opens with: one sentence, and the events that matter most."""

from collections.abc import Mapping, Sequence
from typing import Final

from metro_hil.report.explain.event_log import LoggedEvent, RunEvents

ARRIVED: Final = "arrived"
LINES_MAX: Final = 10
"""Number of events below the headline, so that the answer fits on one screen."""
WEIGHTS: Final[Mapping[str, int]] = {
    "EMERGENCY_APPLIED": 9,
    "EMERGENCY_RELEASED": 8,
    "REPLICAS_DISAGREE": 7,
    "MEMORY_LOST": 7,
    "LOCALISATION_LOST": 7,
    "ALARM_RAISED": 7,
    "DOOR_BYPASS": 7,
    "SERVICE_BRAKE": 6,
    "INPUT_LOST": 6,
    "BRAKE_LATE": 6,
    "BRAKE_WEAK": 6,
    "OVERRUN": 5,
    "DEPARTURE_INHIBITED": 5,
    "DOORS_WITHHELD": 4,
    "SLIP_BEGAN": 4,
    "TAG_REJECTED": 4,
    "TAG_MISSED": 4,
    "FRAME_REJECTED": 4,
    "RADIO_REFUSED": 4,
    "LOCALISATION_FOUND": 3,
    "SUPERVISION": 3,
    "JOG_BEGAN": 3,
    "MODE": 2,
    "INPUT_BACK": 0,
    "WHEEL_CALIBRATED": 0,
}
"""How much an event explains, by kind; every other kind has weight 1."""
OUTCOMES: Final = (
    ("EMERGENCY_APPLIED", "the emergency brake came"),
    ("LOCALISATION_LOST", "the train lost its position"),
    ("SERVICE_BRAKE", "ATP applied the service brake"),
)
"""Kinds that answer why a train braked, the gravest first, with the words of the headline."""


def answer(story: RunEvents) -> str:
    """The headline: what happened to the train and when, in one sentence."""
    for kind, words in OUTCOMES:
        found = [event for event in story.events if event.kind == kind]
        # A service brake before an arrival answers no question.
        if not found or (kind == "SERVICE_BRAKE" and story.head.ended == ARRIVED):
            continue
        first = found[0]
        when = "" if len(found) == 1 else f" {len(found)} times, first"
        # The events' own texts begin with the name of what came; the headline has it already.
        why = first.words.partition(": ")[2] or first.words
        return f"{words[0].upper()}{words[1:]}{when} at {first.t_s:.3f} s: {why}"
    if story.head.ended == ARRIVED:
        return "The train arrived. Neither the emergency brake nor a loss of position occurred."
    held = _held(story.events)
    if held is not None:
        return f"The train may not depart since {held.t_s:.3f} s: {held.words}"
    return "Neither the emergency brake nor a loss of position occurred."


def _held(events: Sequence[LoggedEvent]) -> LoggedEvent | None:
    """The event that inhibits departure when the log ends; None if departure is permitted."""
    held = None
    for event in events:
        if event.kind == "DEPARTURE_INHIBITED":
            held = event
        elif event.kind == "DEPARTURE_PERMITTED":
            held = None
    return held


def most_telling(events: Sequence[LoggedEvent], count: int = LINES_MAX) -> list[LoggedEvent]:
    """The events with the greatest weights in their order; of equal ones those near the gravest."""
    if not events:
        return []
    gravest = max(events, key=_weight)
    place = events.index(gravest)
    ranked = sorted(
        range(len(events)), key=lambda index: (-_weight(events[index]), abs(index - place))
    )
    return [events[index] for index in sorted(ranked[:count])]


def _weight(event: LoggedEvent) -> int:
    return WEIGHTS.get(event.kind, 1)
