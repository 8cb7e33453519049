"""Shows the event log to a person, or as one JSON object to programs."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from rich.console import Console, OverflowMethod
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from metro_hil.report.explain.answer import ARRIVED, answer, most_telling
from metro_hil.report.explain.event_log import LoggedEvent, LoggedSource, RunEvents, RunHead
from metro_hil.report.explain.known import ControllerKnowledge
from metro_hil.report.explain.meaning import source_words

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
    "BRAKE_LATE": "yellow",
    "BRAKE_WEAK": "yellow",
    "FRAME_REJECTED": "yellow",
    "RADIO_REFUSED": "yellow",
}
RESTARTED: Final = "the controller restarted; its time begins at zero again"
BEFORE_SHOWN: Final = 5
"""Number of events shown before the time of `--at`."""


def show_answer(console: Console, story: RunEvents) -> None:
    """Print the headline, the run, and the events that matter most, one line each."""
    style = STYLES["EMERGENCY_APPLIED"] if _has_emergency(story) else "bold"
    console.print(Text(answer(story), style), soft_wrap=True)
    head = story.head
    way = " → ".join(name for name in head.stations if name)
    run = ", ".join(filter(None, (head.name, f"{head.line}: {way}" if way else "", _ended(story))))
    console.print(Text(f"{run}\n", "dim"), soft_wrap=True)
    shown = most_telling(story.events)
    # A terminal shows as much as fits on its line; a pipe gets the whole line.
    overflow: OverflowMethod = "ellipsis" if console.is_terminal else "ignore"
    controller = 0
    for event in shown:
        if event.controller != controller:
            controller = event.controller
            console.print(Text(f"{'':13}{RESTARTED}", "bold"))
        line = Text(f"{event.t_s:>9.3f} s  ")
        line.append(f"{_kind_words(event.kind):<20}", STYLES.get(event.kind, "cyan"))
        line.append(f"  {event.words}")
        console.print(line, no_wrap=True, overflow=overflow, crop=console.is_terminal)
    words = f"{len(shown)} of {len(story.events)} events; -v shows all of them with their frames"
    console.print(Text(f"\n{words}", "dim"))
    _show_torn_lines(console, story)


def _has_emergency(story: RunEvents) -> bool:
    return any(event.kind == "EMERGENCY_APPLIED" for event in story.events)


def show_story(
    console: Console, story: RunEvents, events: Sequence[LoggedEvent], *, frames: bool
) -> None:
    """Print the head, then the chosen events in order.

    Args:
        frames: whether the frames and messages that led to each event follow it.
    """
    _show_head(console, story)
    if not events:
        console.print("no event is of that kind and time", style="yellow")
        return
    _show_events(console, events, frames=frames)


def _show_head(console: Console, story: RunEvents) -> None:
    head, events = story.head, story.events
    console.print(head.name, style="bold", markup=False, highlight=False, soft_wrap=True)
    way = " → ".join(name for name in head.stations if name)
    if head.line or way:
        console.print(f"{head.line}: {way}", markup=False, highlight=False)
    console.print(_ended(story), markup=False, highlight=False)
    counts = Counter(event.kind for event in events)
    told = ", ".join(f"{count} {_kind_words(kind)}" for kind, count in sorted(counts.items()))
    words = f"{len(events)} events: {told}" if events else "no events"
    console.print(words, style="dim", markup=False, highlight=False)
    _show_torn_lines(console, story)
    console.print()


def _ended(story: RunEvents) -> str:
    last_s = story.events[-1].t_s if story.events else 0.0
    return f"{story.head.ended or 'did not come to its end'}; last event at {last_s:.2f} s"


def _show_torn_lines(console: Console, story: RunEvents) -> None:
    if story.torn_lines:
        words = f"{story.torn_lines} torn lines of {story.folder.events_log} left out"
        console.print(words, style="yellow", markup=False, highlight=False, soft_wrap=True)


def _show_events(console: Console, events: Sequence[LoggedEvent], *, frames: bool = True) -> None:
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    controller = events[0].controller
    for event in events:
        if event.controller != controller:
            controller = event.controller
            table.add_row("", "", Text(RESTARTED, "bold"))
        kind = Text(_kind_words(event.kind), STYLES.get(event.kind, "cyan"))
        table.add_row(f"{event.t_s:.3f} s", kind, Text(event.words))
        for source in event.sources if frames else ():
            if source.number is not None:
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
    heard = Table(title="received last", title_justify="left")
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
        "answer": answer(story),
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
