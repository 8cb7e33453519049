"""Events to mark in pictures: those of a run folder with their sources, or those on the bus."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from canlog.reader import Log
from canlog.run import EVENTS, NS_PER_S, RunFiles

EVENT_MESSAGE: Final = "VOBC_EVENT"
EVENT_SIGNAL: Final = "event"
GRAVE: Final = frozenset(
    {"EMERGENCY_APPLIED", "SERVICE_BRAKE", "LOCALISATION_LOST", "REPLICAS_DISAGREE", "MEMORY_LOST"}
)
UNUSUAL: Final = frozenset(
    {
        "TAG_REJECTED",
        "TAG_MISSED",
        "INPUT_LOST",
        "FRAME_REJECTED",
        "RADIO_REFUSED",
        "SLIP_BEGAN",
        "ALARM_RAISED",
        "DOOR_BYPASS",
        "OVERRUN",
        "BRAKE_LATE",
        "BRAKE_WEAK",
        "EMERGENCY_RELEASED",
    }
)


@dataclass(frozen=True, slots=True)
class Basis:
    """One frame, telegram or message on which an event is based."""

    source: str
    identifier: int | None
    payload: str
    """Payload in hexadecimal."""
    heard_ns: int | None


@dataclass(frozen=True, slots=True)
class Happening:
    """One event at one instant."""

    at_ns: int
    kind: str
    words: str
    basis: tuple[Basis, ...] = ()

    @property
    def weight(self) -> int:
        """2 for an event that brakes the train, 1 for an unusual one, 0 for others."""
        return 2 if self.kind in GRAVE else int(self.kind in UNUSUAL)


def happenings(log: Log) -> tuple[Happening, ...]:
    """Return the events in order of time; without events.jsonl, those sent on the bus."""
    told = tuple(_told(log.run)) if log.run is not None else ()
    found = told or tuple(_heard(log))
    return tuple(sorted(found, key=lambda each: each.at_ns))


def event_head(each: Happening, zero_ns: int) -> dict[str, Any]:
    """Return one event as the page reads it."""
    return {
        "t": each.at_ns - zero_ns,
        "kind": each.kind,
        "words": each.words,
        "weight": each.weight,
        "basis": [
            {
                "source": basis.source,
                "id": basis.identifier,
                "payload": basis.payload,
                "t": None if basis.heard_ns is None else basis.heard_ns - zero_ns,
            }
            for basis in each.basis
        ],
    }


def _told(run: RunFiles) -> Iterator[Happening]:
    path = run.folder / EVENTS
    if not path.is_file():
        return
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            table = json.loads(line)
        except ValueError:
            # The last line of a killed run may be torn.
            continue
        found = happening_of(table, run.start_ns)
        if found is not None:
            yield found


def happening_of(table: Any, start_ns: int) -> Happening | None:
    """Return the event of one line of events.jsonl; None for a line that is no event.

    Args:
        start_ns: stamp of the start of the controller.
    """
    try:
        return Happening(
            start_ns + round(float(table["t_s"]) * NS_PER_S),
            str(table["kind"]),
            str(table["words"]),
            tuple(_basis(start_ns, each) for each in table.get("sources", ())),
        )
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
        return None


def _basis(start_ns: int, table: Mapping[str, Any]) -> Basis:
    heard_s = table.get("heard_s")
    return Basis(
        str(table["source"]),
        table.get("id"),
        str(table.get("payload", "")),
        None if heard_s is None else start_ns + round(float(heard_s) * NS_PER_S),
    )


def _heard(log: Log) -> Iterator[Happening]:
    spec = log.messages.get(EVENT_MESSAGE)
    if spec is None or not any(each.name == EVENT_SIGNAL for each in spec.signals):
        return
    table = log.table(EVENT_MESSAGE)
    labels = table.labels(EVENT_SIGNAL)
    others = [each.name for each in spec.signals if each.name != EVENT_SIGNAL]
    columns = {name: table[name].tolist() for name in others}
    for row, (at_ns, label) in enumerate(zip(table.at_ns.tolist(), labels, strict=True)):
        words = ", ".join(f"{name} {columns[name][row]}" for name in others)
        yield Happening(at_ns, label or "EVENT", words)
