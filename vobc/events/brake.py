"""Events of a brake that acts later or weaker than operation expects."""

from typing import Final

from can_dbc.vobc import EventKind
from vobc.events.words import place_words
from vobc.vocabulary import BrakeFinding, CycleOutput, Event, Source

MS_PER_S: Final = 1000.0
PERCENT: Final = 100.0
LEAST_PERCENT: Final = 70
"""Effort at which the estimate of the gain ends."""
SOURCES: Final = (Source.TACHO, Source.BRAKE)


def brake_found(finding: BrakeFinding, output: CycleOutput) -> Event:
    """The event, with the dead time in ms or the effort in per cent as its number."""
    if finding.late:
        words = f"the brake is late: it acts {finding.dead_time_s:.2f} s after its command or later"
        number = round(finding.dead_time_s * MS_PER_S)
        return Event(EventKind.BRAKE_LATE, words + place_words(output), SOURCES, number)
    effort_percent = round(PERCENT * (1.0 + finding.gain_ratio))
    or_less = " or less" if effort_percent <= LEAST_PERCENT else ""
    words = f"the brake is weak: it gives {effort_percent} %{or_less} of the demanded deceleration"
    return Event(EventKind.BRAKE_WEAK, words + place_words(output), SOURCES, effort_percent)
