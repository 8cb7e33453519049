"""Finds the frame of the run's bus log that each event was decided from."""

from dataclasses import replace
from typing import Final

import numpy as np

import canlog
from metro_hil.report.explain.event_log import LoggedEvent, LoggedSource, RunEvents

NS_PER_S: Final = 1_000_000_000
HEARD_WITHIN_NS: Final = 5_000_000
"""Greatest difference between the time stamps of one frame at two receivers, ns."""


def located(story: RunEvents) -> RunEvents:
    """The same events with the numbers of their frames; without numbers if there is no bus log.

    A restarted controller counts its time from its restart, so only frames of the first one are
    found.
    """
    try:
        log = canlog.read(story.folder.path)
    except canlog.LogError:
        return story
    return replace(story, events=tuple(_located(event, log) for event in story.events))


def _located(event: LoggedEvent, log: canlog.Log) -> LoggedEvent:
    if event.controller:
        return event
    sources = (replace(each, frame=_number(each, log)) for each in event.sources)
    return replace(event, sources=tuple(sources))


def _number(source: LoggedSource, log: canlog.Log) -> int | None:
    """Number, from 1, of the frame with these bytes that was on the bus when it was received."""
    heard = source.number is not None and source.heard_s is not None
    if not heard or log.run is None or not source.source.isupper():
        return None
    assert source.number is not None
    assert source.heard_s is not None
    rows = log.rows(source.number)
    past_ns = log.frames.at_ns[rows] - log.run.start_ns - round(source.heard_s * NS_PER_S)
    near = rows[np.abs(past_ns) <= HEARD_WITHIN_NS]
    same = [row for row in near.tolist() if log.frames.payload(row) == source.payload]
    return same[-1] + 1 if same else None
