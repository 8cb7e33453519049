"""Reads from a run folder its controller's events, the journey, and how it ended."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from can_dbc.vobc import EventKind
from metro_hil.model.run_folder import RunFolder

PORTS_LOG: Final = "ports.log"
CAMPAIGN: Final = "campaign.json"
START: Final = "start "
KINDS: Final = tuple(kind.name for kind in EventKind)


class RunEventsError(Exception):
    """A folder without events; the text names it and says what to do."""


@dataclass(frozen=True, slots=True)
class LoggedSource:
    """One input that an event was decided from."""

    source: str
    number: int | None
    """Identifier of the frame, id of the tag, or sequence of the message; None if never
    received."""
    payload: bytes
    heard_s: float | None
    frame: int | None = None
    """Number of the frame in the bus log, from 1; None if unknown."""


@dataclass(frozen=True, slots=True)
class LoggedEvent:
    """One line of events.jsonl."""

    t_s: float
    """Time since the start of the controller, s."""
    number: int
    """Number of the event since that start."""
    kind: str
    words: str
    value: int
    sources: tuple[LoggedSource, ...]
    controller: int
    """Number of the controller, from 0; a restart begins another one."""


@dataclass(frozen=True, slots=True)
class RunHead:
    """Summary of the run."""

    name: str
    line: str
    stations: tuple[str, ...]
    """The start, and every stop of the mission."""
    ended: str
    """Why the run ended; empty if the run was killed before it recorded that."""


@dataclass(frozen=True, slots=True)
class RunEvents:
    folder: RunFolder
    head: RunHead
    events: tuple[LoggedEvent, ...]
    torn_lines: int
    """Number of unfinished lines of a killed run, which are not used."""


def read_story(path: Path) -> RunEvents:
    """Read the events of a run. Raises RunEventsError.

    Args:
        path: the run folder, or the file events.jsonl in it.
    """
    folder = _folder_of(path)
    if not folder.path.is_dir():
        raise RunEventsError(f"{path}: no such run folder; `vobc run` makes one below runs/")
    if (folder.path / CAMPAIGN).exists():
        raise RunEventsError(
            f"{path}: the folder of a campaign; name one of its cases below {path / 'cases'}"
        )
    if not folder.events_log.exists():
        raise RunEventsError(_without_events(folder))
    try:
        lines = folder.events_log.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RunEventsError(f"{folder.events_log}: cannot be read: {error}") from error
    events, torn = _events(lines)
    return RunEvents(folder, _head(folder), events, torn)


def _folder_of(path: Path) -> RunFolder:
    """The folder itself, or its only subfolder with events."""
    if path.name == RunFolder(path).events_log.name:
        return RunFolder(path.parent)
    folder = RunFolder(path)
    below = [] if folder.events_log.exists() else sorted(path.glob(f"*/{folder.events_log.name}"))
    return RunFolder(below[0].parent) if len(below) == 1 else folder


def _without_events(folder: RunFolder) -> str:
    path = folder.events_log
    if folder.cycle_log.exists():
        return f"{path}: no events; this run was made by an older version, run it again"
    trains = sorted(log.parent for log in folder.path.glob(f"*/{path.name}"))
    if trains:
        words = f"a run of several trains; name one of its folders, such as {trains[0]}"
        return f"{folder.path}: {words}"
    return f"{path}: no events; {folder.path} is not the folder of a run with a controller of ours"


def _events(lines: Sequence[str]) -> tuple[tuple[LoggedEvent, ...], int]:
    events: list[LoggedEvent] = []
    torn = controller = last = 0
    for line in lines:
        try:
            table = json.loads(line)
            if table["number"] <= last:
                controller += 1
            event = _event(table, controller)
        except (ValueError, KeyError, TypeError, AttributeError):
            torn += 1
            continue
        last = event.number
        events.append(event)
    return tuple(events), torn


def _event(table: Mapping[str, Any], controller: int) -> LoggedEvent:
    return LoggedEvent(
        t_s=float(table["t_s"]),
        number=int(table["number"]),
        kind=str(table["kind"]),
        words=str(table["words"]),
        value=int(table["value"]),
        sources=tuple(_source(source) for source in table["sources"]),
        controller=controller,
    )


def _source(table: Mapping[str, Any]) -> LoggedSource:
    heard_s = table.get("heard_s")
    return LoggedSource(
        source=str(table["source"]),
        number=table.get("id"),
        payload=bytes.fromhex(table.get("payload", "")),
        heard_s=None if heard_s is None else float(heard_s),
    )


def _head(folder: RunFolder) -> RunHead:
    """Read each part from its file; unreadable parts stay empty."""
    told = _told(folder.path / PORTS_LOG)
    mission = told.get("mission", {})
    results = _json(folder.results)
    return RunHead(
        name=str(results.get("case_id", folder.path.name)),
        line=str(told.get("line", {}).get("name", "")),
        stations=(str(mission.get("start", "")), *map(str, mission.get("stops", ()))),
        ended=str(results.get("exit_reason", "")),
    )


def _told(ports_log: Path) -> Mapping[str, Any]:
    """Configuration that the controller received before its first cycle."""
    try:
        with ports_log.open(encoding="utf-8") as lines:
            first = lines.readline()
        told = json.loads(first.removeprefix(START))["told"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return told if isinstance(told, dict) else {}


def _json(path: Path) -> Mapping[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
