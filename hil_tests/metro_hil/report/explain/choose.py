"""Selects the events to show."""

import difflib
from collections.abc import Sequence

from metro_hil.report.explain.event_log import KINDS, LoggedEvent, RunEventsError


def kinds_of(text: str) -> frozenset[str]:
    """Kinds of event from a comma-separated list in any case. Raises RunEventsError with the
    nearest."""
    found = set()
    for word in filter(None, (part.strip() for part in text.split(","))):
        name = word.upper().replace("-", "_")
        if name not in KINDS:
            near = difflib.get_close_matches(name, KINDS, n=1, cutoff=0.0)
            raise RunEventsError(f"--only {word}: no kind of event; nearest is {near[0]}")
        found.add(name)
    return frozenset(found)


def chosen(
    events: Sequence[LoggedEvent],
    *,
    from_s: float | None,
    to_s: float | None,
    only: frozenset[str],
) -> list[LoggedEvent]:
    """Events in the time range, both ends included; an empty `only` accepts every kind."""
    return [
        event
        for event in events
        if (from_s is None or event.t_s >= from_s)
        and (to_s is None or event.t_s <= to_s)
        and (not only or event.kind in only)
    ]
