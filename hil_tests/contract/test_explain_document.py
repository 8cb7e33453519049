"""The document of events names every kind of event and the keys of a log line."""

import re
from pathlib import Path

from can_dbc.vobc import EventKind, Supervision
from vobc.process.event_log import FRAMES_PER_CYCLE, WAITING_MAX, EventQueue
from vobc.vocabulary import Event, Source
from vobc.wire import Evidence

DOCUMENT = (Path(__file__).parents[2] / "docs" / "guide" / "explain.md").read_text(encoding="utf-8")


class Kept:
    """An event log that keeps its events in memory."""

    def __init__(self) -> None:
        self.entries: list[dict[str, object]] = []

    def event(self, entry: dict[str, object]) -> None:
        self.entries.append(entry)

    def flush(self) -> None:
        """Do nothing."""


def first_column(heading: str) -> list[str]:
    _, below = DOCUMENT.split(f"\n## {heading}\n", 1)
    return re.findall(r"^\| `(\w+)` \|", below.split("\n## ", 1)[0], re.MULTILINE)


def test_the_document_names_every_kind_of_event_once() -> None:
    assert sorted(first_column("Events")) == sorted(kind.name for kind in EventKind)


def test_the_keys_of_a_line_are_those_of_the_log() -> None:
    log = Kept()
    desk = EventQueue(log, lambda source, _: Evidence(source, 391, b"\x01", 2_000_000_000), 0)

    desk.tell(2_500_000_000, [Event(EventKind.MODE, "words", (Source.DESK,), Supervision.NOMINAL)])

    (entry,) = log.entries
    assert first_column("events.jsonl") == list(entry)
    assert entry["sources"] == [{"source": "DESK", "id": 391, "payload": "01", "heard_s": 2.0}]
    for key in ("source", "id", "payload", "heard_s"):
        assert f"`{key}`" in DOCUMENT


def test_the_limits_equal_those_of_the_code() -> None:
    assert FRAMES_PER_CYCLE == 4
    assert "at most four frames a cycle" in " ".join(DOCUMENT.split())
    assert f"at most {WAITING_MAX} wait" in DOCUMENT
