"""What a run folder of this project tells beside its frames: control cycles, events, truth."""

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from metro_tools.canlog.damage import LogError

BUS_LOG: Final = "bus.log"
CYCLES: Final = "cycles.csv"
EVENTS: Final = "events.jsonl"
TRUTH: Final = "truth.csv"
NS_PER_S: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class RunEvent:
    """One line of events.jsonl."""

    t_s: float
    """Since the start of the run's controller."""
    kind: str
    words: str


@dataclass(frozen=True, slots=True)
class Run:
    """Beside the frames. Instants are seconds since the start of the controller."""

    folder: Path
    start_ns: int
    """Stamp in the frame log of the controller's zero."""
    cycles: "npt.NDArray[Any] | None" = None
    """(n,) float64 seconds at which control cycles began; None where the folder does not tell."""
    cycle_columns: dict[str, "npt.NDArray[Any]"] = field(default_factory=dict)
    """Columns of cycles.csv: float64 with NaN for empty fields, or str."""
    truth_columns: dict[str, "npt.NDArray[Any]"] = field(default_factory=dict)
    """Columns of truth.csv."""
    events: tuple[RunEvent, ...] = ()


def bus_log_of(path: Path) -> Path:
    """The frame log of a run folder, or the path itself. Raises LogError."""
    if not path.is_dir():
        return path
    if (path / BUS_LOG).is_file():
        return path / BUS_LOG
    raise LogError(f"{path}: no {BUS_LOG} in this folder; name a log or the folder of a run")


def read_run(folder: Path) -> Run:
    """What there is; a file that is missing leaves its part empty."""
    cycle_columns = _columns(folder / CYCLES)
    return Run(
        folder=folder,
        start_ns=0,
        cycles=cycle_columns.get("t_s"),
        cycle_columns=cycle_columns,
        truth_columns=_columns(folder / TRUTH),
        events=_events(folder / EVENTS),
    )


def _columns(path: Path) -> dict[str, "npt.NDArray[Any]"]:
    """Of a CSV file; rows that are torn are left out."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8", errors="replace") as lines:
        rows = list(csv.reader(lines))
    if not rows:
        return {}
    head = rows[0]
    whole = [row for row in rows[1:] if len(row) == len(head)]
    return {name: _column([row[at] for row in whole]) for at, name in enumerate(head)}


def _column(texts: list[str]) -> "npt.NDArray[Any]":
    try:
        return np.array([float(text) if text else np.nan for text in texts], np.float64)
    except ValueError:
        return np.array(texts, np.str_)


def _events(path: Path) -> tuple[RunEvent, ...]:
    if not path.is_file():
        return ()
    found = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            told = json.loads(line)
            found.append(RunEvent(float(told["t_s"]), str(told["kind"]), str(told["words"])))
        except (ValueError, KeyError, TypeError):
            continue
    return tuple(found)
