"""Shows the event log to a person, or as one JSON object to programs."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from metro_hil.report.explain.event_log import LoggedEvent, LoggedSource, RunEvents, RunHead
from metro_hil.report.explain.known import ControllerKnowledge
from metro_hil.report.explain.meaning import source_words

ARRIVED: Final = "arrived"
STYLES: Final = {
    "EMERGENCY_APPLIED": "bold red",
    "EMERGENCY_RELEASED": "green",
    "SERVICE_BRAKE": "yellow",
    "LOCALISATION_LOST": "red",
    "LOCALISATION_FOUND": "green",
    "INPUT_LOST": "yellow",
    "TAG_REJECTED": "yellow",
    "TAG_MISSED": "yellow",
    "SLIP_BEGAN": "yellow",
    "ALARM_RAISED": "bold red",
    "DOOR_BYPASS": "bold red",
    "REPLICAS_DISAGREE": "bold red",
    "MEMORY_LOST": "bold red",
    "OVERRUN": "yellow",
    "FRAME_REJECTED": "yellow",
    "RADIO_REFUSED": "yellow",
}
BEFORE_SHOWN: Final = 5
"""Number of events shown before the time of `--at`."""


def show_story(console: Console, story: RunEvents, events: Sequence[LoggedEvent]) -> None:
    """Print the head, then the chosen events in order, each with its inputs."""
    _show_head(console, story)
    if not events:
        console.print("no event is of that kind and time", style="yellow")
        return
    _show_events(console, events)


def _show_head(console: Console, story: RunEvents) -> None:
    head, events = story.head, story.events
    console.print(head.name, style="bold", markup=False, highlight=False, soft_wrap=True)
    way = " → ".join(name for name in head.stations if name)
    if head.line or way:
        console.print(f"{head.line}: {way}", markup=False, highlight=False)
    last_s = events[-1].t_s if events else 0.0
    ended = head.ended or "did not come to its end"
    console.print(f"{ended}; last event at {last_s:.2f} s", markup=False, highlight=False)
    counts = Counter(event.kind for event in events)
    told = ", ".join(f"{count} {_kind_words(kind)}" for kind, count in sorted(counts.items()))
    words = f"{len(events)} events: {told}" if events else "no events"
    console.print(words, style="dim", markup=False, highlight=False)
    if story.torn_lines:
        words = f"{story.torn_lines} torn lines of {story.folder.events_log} left out"
        console.print(words, style="yellow", markup=False, highlight=False, soft_wrap=True)
    console.print()


def _show_events(console: Console, events: Sequence[LoggedEvent]) -> None:
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    controller = events[0].controller
    for event in events:
        if event.controller != controller:
            controller = event.controller
            again = "the controller restarted; its time begins at zero again"
            table.add_row("", "", Text(again, "bold"))
        kind = Text(_kind_words(event.kind), STYLES.get(event.kind, "cyan"))
        table.add_row(f"{event.t_s:.3f} s", kind, Text(event.words))
        for source in event.sources:
            if source.number is None:
                continue
            table.add_row("", "", _source_text(event, source))
    console.print(table)


def _source_text(event: LoggedEvent, source: LoggedSource) -> Text:
    name, values = source_words(source)
    age = "" if source.heard_s is None else f", {1000.0 * (event.t_s - source.heard_s):.0f} ms old"
    place = "" if source.frame is None else f", frame {source.frame}"
    return Text(f"from {name}{age}{place}{': ' if values else ''}{values}", "dim")


def _kind_words(kind: str) -> str:
    return kind.replace("_", " ").lower()


def show_known(console: Console, story: RunEvents, known: ControllerKnowledge, at_s: float) -> None:
    """Print one cycle: its decisions, its latest inputs, and the last events."""
    _show_head(console, story)
    row = Table(title=f"cycle at {float(known.cycle['t_s']):.3f} s", title_justify="left")
    row.add_column("column")
    row.add_column("value", overflow="fold")
    for name, value in known.cycle.items():
        if value:
            row.add_row(name, escape(value))
    console.print(row)
    heard = Table(title="heard last", title_justify="left")
    for column in ("what", "at", "values"):
        heard.add_column(column, overflow="fold")
    for each in known.heard:
        heard.add_row(escape(each.name), f"{each.at_s:.3f} s", escape(each.values))
    console.print(heard)
    told = [event for event in story.events if event.t_s <= at_s][-BEFORE_SHOWN:]
    if told:
        console.print("the last events up to then", style="bold")
        _show_events(console, told)


def document(story: RunEvents, events: Sequence[LoggedEvent]) -> dict[str, Any]:
    """The object that --json prints."""
    return {
        "folder": str(story.folder.path),
        **_head_table(story.head),
        "torn_lines": story.torn_lines,
        "events": [_event_table(event) for event in events],
    }


def known_document(story: RunEvents, known: ControllerKnowledge) -> dict[str, Any]:
    heard = [{"what": each.name, "at_s": each.at_s, "values": each.values} for each in known.heard]
    return {
        "folder": str(story.folder.path),
        **_head_table(story.head),
        "cycle": dict(known.cycle),
        "heard": heard,
    }


def _head_table(head: RunHead) -> dict[str, Any]:
    return {
        "name": head.name,
        "line": head.line,
        "stations": [name for name in head.stations if name],
        "ended": head.ended,
        "arrived": head.ended == ARRIVED,
    }


def _event_table(event: LoggedEvent) -> dict[str, Any]:
    return {
        "t_s": event.t_s,
        "controller": event.controller,
        "number": event.number,
        "kind": event.kind,
        "words": event.words,
        "value": event.value,
        "sources": [_source_table(source) for source in event.sources],
    }


def _source_table(source: LoggedSource) -> dict[str, Any]:
    name, values = source_words(source)
    return {
        "source": source.source,
        "name": name,
        "values": values,
        "id": source.number,
        "payload": source.payload.hex(),
        "heard_s": source.heard_s,
        "frame": source.frame,
    }
