"""Answers the requests of the page of `canlog open`: trace windows, values, frame rows."""

import json
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from canlog.damage import LogError
from canlog.reader import Log
from canlog.views.extremes import Pyramid
from canlog.views.page_data import PageData, frame_columns
from canlog.views.row_filter import Subject, passing
from canlog.views.traces import trace_of

JSON: Final = "application/json"
BYTES: Final = "application/octet-stream"
COLUMNS_MAX: Final = 20_000
ROWS_MAX: Final = 2_000
FILTERS_KEPT: Final = 8

Query = Mapping[str, str]


class Answers:
    """Answers one request at a time; the caller serialises them."""

    def __init__(self, log: Log, data: PageData) -> None:
        self._log = log
        self._data = data
        self._zero_ns = int(data.head["zero"])
        self._pyramids: dict[str, Pyramid] = {}
        self._selections: dict[str, Any] = {}
        self._columns = {
            name: data.log.taken(column) for name, column in frame_columns(log).items()
        }
        self._subjects = tuple(
            Subject(
                group,
                head["name"],
                log.bus.on(group.channel).spec_at(group.key) if head["known"] else None,
            )
            for group, head in zip(data.log.groups, data.head["messages"], strict=True)
        )
        self._questions: Mapping[str, Callable[[Query], tuple[str, bytes]]] = {
            "/block": lambda query: (BYTES, data.block.deflated()),
            "/trace": self._trace,
            "/values": self._values,
            "/select": self._select,
            "/at": self._at,
            "/rows": self._rows,
        }

    def answer(self, path: str, query: Query) -> tuple[str, bytes] | None:
        """Return media type and content; None for an unknown path.

        Raises:
            LogError: for an invalid request, with a text for the user.
        """
        question = self._questions.get(path)
        if question is None:
            return None
        try:
            return question(query)
        except (KeyError, ValueError, OverflowError) as error:
            raise LogError(f"{path}: {error}") from error

    def _pyramid(self, name: str) -> Pyramid:
        found = self._pyramids.get(name)
        if found is None:
            found = self._pyramids[name] = Pyramid(trace_of(self._log, name), self._zero_ns)
        return found

    def _trace(self, query: Query) -> tuple[str, bytes]:
        columns = min(COLUMNS_MAX, max(1, int(query["columns"])))
        start_ns, end_ns = float(query["from"]), float(query["to"])
        if not start_ns < end_ns:
            raise LogError(f"/trace: no span from {query['from']} to {query['to']}")
        found = self._pyramid(query["name"]).window(start_ns, end_ns, columns)
        head = np.array([float(found.is_raw)])
        return BYTES, np.concatenate([head, found.at_ns, found.values]).astype("<f8").tobytes()

    def _values(self, query: Query) -> tuple[str, bytes]:
        at_ns = int(query["t"])
        found: list[float | None] = []
        for name in query["names"].split(","):
            pyramid = self._pyramid(name)
            row = int(np.searchsorted(pyramid.at_ns, at_ns, "right")) - 1
            value = float(pyramid.values[row]) if row >= 0 else None
            found.append(value if value is not None and np.isfinite(value) else None)
        return JSON, json.dumps(found).encode()

    def _selection(self, text: str) -> Any:
        if text not in self._selections:
            if len(self._selections) >= FILTERS_KEPT:
                self._selections.pop(next(iter(self._selections)))
            self._selections[text] = passing(self._log, self._data.log, self._subjects, text)
        return self._selections[text]

    def _select(self, query: Query) -> tuple[str, bytes]:
        rows = self._selection(query["filter"])
        count = len(self._data.log.frames) if rows is None else len(rows)
        return JSON, json.dumps({"count": count}).encode()

    def _at(self, query: Query) -> tuple[str, bytes]:
        """Return the last row of a filter at or before an instant."""
        rows, at_ns = self._selection(query["filter"]), int(query["t"]) + self._zero_ns
        stamps = self._data.log.frames.at_ns
        here = int(np.searchsorted(stamps, at_ns, "right"))
        row = here - 1 if rows is None else int(np.searchsorted(rows, here, "left")) - 1
        return JSON, json.dumps({"row": max(0, row)}).encode()

    def _rows(self, query: Query) -> tuple[str, bytes]:
        first, count = max(0, int(query["first"])), min(ROWS_MAX, int(query["count"]))
        rows = self._selection(query["filter"])
        total = len(self._data.log.frames) if rows is None else len(rows)
        chosen = range(first, min(total, first + count))
        told = [self._row(at if rows is None else int(rows[at])) for at in chosen]
        return JSON, json.dumps(told, separators=(",", ":")).encode()

    def _row(self, row: int) -> list[Any]:
        ordered = self._data.log
        frames, number = ordered.frames, int(ordered.group[row])
        mine = ordered.groups[number].rows
        rank = int(np.searchsorted(mine, row))
        before = int(mine[rank - 1]) if rank else None
        verdict, cycle = self._columns.get("verdict"), self._columns.get("cycle")
        return [
            row,
            int(frames.at_ns[row]) - self._zero_ns,
            number,
            int(frames.flags[row]),
            int(frames.channel[row]),
            int(frames.length[row]),
            frames.payload(row).hex(),
            None if before is None else frames.payload(before).hex(),
            None if before is None else int(frames.at_ns[row] - frames.at_ns[before]),
            0 if verdict is None else int(verdict[row]),
            0 if cycle is None else int(cycle[row]),
        ]
