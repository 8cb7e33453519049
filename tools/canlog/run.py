"""Reads the files of a run folder beside its frames: control cycles, events, ground truth."""

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canlog.damage import Damages, LogError
from canlog.database import Bus
from canlog.frames import Frames, Ints
from canlog.run_ports import PORTS_LOG, Ports, match, offset_ns_of, read_ports

BUS_LOG: Final = "bus.log"
CYCLES: Final = "cycles.csv"
EVENTS: Final = "events.jsonl"
TRUTH: Final = "truth.csv"
PLANT: Final = "plant.json"
"""What a plant process leaves at its end."""
CONTROLLER: Final = "VOBC"
NS_PER_S: Final = 1_000_000_000
NO_CYCLE: Final = -1

Columns = dict[str, "npt.NDArray[Any]"]


@dataclass(frozen=True, slots=True)
class RunEvent:
    """One event: a line of events.jsonl."""

    at_ns: int
    """Instant on the time base of the frames' stamps."""
    t_s: float
    """Seconds since the start of the controller."""
    kind: str
    words: str


@dataclass(frozen=True, slots=True)
class RunFiles:
    """Files of a run folder besides its frame log. Missing files leave their part empty."""

    folder: Path
    start_ns: int
    """Stamp of the controller's start in the frame log; the controller's logs count from it."""
    truth_ns: int
    """Stamp of the plant's start in the frame log; the ground truth counts from it."""
    cycle_ns: Ints
    """(c,) stamps at which control cycles began; the index is the number of the cycle."""
    cycle_of: Ints
    """(n,) control cycle that each frame of the log fed or came from, NO_CYCLE for none."""
    sent: "npt.NDArray[np.bool_]"
    """(n,) whether the controller sent the frame; `cycle_of` is then the cycle that sent it."""
    exact: bool
    """Whether frames were matched with the record of the controller's ports, not only by stamps."""
    cycles: Columns = field(default_factory=dict)
    """Columns of cycles.csv: float64 with NaN for empty fields, or text."""
    truth: Columns = field(default_factory=dict)
    """Columns of truth.csv."""
    events: tuple[RunEvent, ...] = ()


def bus_log_of(path: Path) -> Path:
    """Return the frame log of a run folder, or the path itself. Raises LogError."""
    if not path.is_dir():
        return path
    if (path / BUS_LOG).is_file():
        return path / BUS_LOG
    trains = sorted(log.parent.name for log in path.glob(f"*/{BUS_LOG}"))
    if trains:
        raise LogError(
            f"{path}: a run of several trains; name one of its folders, such as {path / trains[0]}"
        )
    raise LogError(f"{path}: no {BUS_LOG} in this folder; name a log or the folder of a run")


def read_run(folder: Path, frames: Frames, bus: Bus, damages: Damages) -> RunFiles:
    """Read all files of a run folder, and relate them to the frames of its log."""
    cycles = _columns(folder / CYCLES, damages)
    sent = _sent(frames, bus)
    ports = read_ports(folder / PORTS_LOG, damages)
    if ports is not None and len(ports.begin_ns):
        offset_ns = offset_ns_of(ports, frames)
        cycle_ns = ports.begin_ns + offset_ns
        cycle_of = match(ports, frames, offset_ns)
        start_ns = ports.start_ns + offset_ns
    else:
        start_ns = _start_ns(cycles, frames, sent)
        began_s = cycles.get("t_s", np.zeros(0))
        cycle_ns = start_ns + np.rint(began_s * NS_PER_S).astype(np.int64)
        cycle_of = _by_stamps(cycle_ns, frames.at_ns, sent)
    return RunFiles(
        folder=folder,
        start_ns=start_ns,
        truth_ns=_truth_ns(folder, frames, start_ns),
        cycle_ns=cycle_ns,
        cycle_of=cycle_of,
        sent=sent,
        exact=ports is not None,
        cycles=cycles,
        truth=_columns(folder / TRUTH, damages),
        events=_events(folder / EVENTS, start_ns, damages),
    )


def _sent(frames: Frames, bus: Bus) -> "npt.NDArray[np.bool_]":
    """(n,) whether a frame belongs to a message that only the controller sends."""
    keys = [spec.key for spec in bus.by_key.values() if spec.senders == (CONTROLLER,)]
    sent: npt.NDArray[np.bool_] = np.isin(frames.key, np.array(keys, np.uint32))
    return sent & frames.is_data


def _start_ns(cycles: Columns, frames: Frames, sent: Any) -> int:
    """Estimate the stamp of the controller's zero: it sends its first frame right after cycle
    one.
    """
    first = np.flatnonzero(sent)
    began_s = cycles.get("t_s")
    if began_s is None or not len(began_s) or not len(first):
        return 0
    guess_ns = int(frames.at_ns[first[0]]) - round(float(began_s[0]) * NS_PER_S)
    # In virtual time the log's stamps already count from the start.
    return 0 if abs(guess_ns) < NS_PER_S else guess_ns


def _truth_ns(folder: Path, frames: Frames, start_ns: int) -> int:
    """Return the stamp of the plant's start.

    A plant process of `vobc run` starts seconds before the controller, and its first frame is the
    first of the log. In virtual time both start at zero.
    """
    if start_ns == 0 or not (folder / PLANT).is_file() or not len(frames):
        return start_ns
    return int(frames.at_ns.min())


def _by_stamps(cycle_ns: Ints, at_ns: Ints, sent: Any) -> Ints:
    """Match by stamps: a received frame feeds the next cycle, a sent one comes from the last
    one.
    """
    if not len(cycle_ns):
        return np.full(len(at_ns), NO_CYCLE, np.int64)
    fed = np.searchsorted(cycle_ns, at_ns, "left")
    came = np.searchsorted(cycle_ns, at_ns, "right") - 1
    found = np.where(sent, came, fed)
    return np.where(found < len(cycle_ns), found, NO_CYCLE)


def _columns(path: Path, damages: Damages) -> Columns:
    """Read the columns of a CSV file; torn rows are left out and counted."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8", errors="replace") as lines:
        rows = list(csv.reader(lines))
    if not rows:
        return {}
    head, whole = rows[0], []
    for number, row in enumerate(rows[1:], 2):
        if len(row) == len(head):
            whole.append(row)
        else:
            damages.add(f"torn line of {path.name}", "line", number, f"{len(row)} fields")
    return {name: _column([row[at] for row in whole]) for at, name in enumerate(head)}


def _column(texts: list[str]) -> "npt.NDArray[Any]":
    try:
        return np.array([float(text) if text else np.nan for text in texts], np.float64)
    except ValueError:
        return np.array(texts, np.str_)


def _events(path: Path, start_ns: int, damages: Damages) -> tuple[RunEvent, ...]:
    if not path.is_file():
        return ()
    found = []
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, 1):
        try:
            told = json.loads(line)
            t_s = float(told["t_s"])
            at_ns = start_ns + round(t_s * NS_PER_S)
            found.append(RunEvent(at_ns, t_s, str(told["kind"]), str(told["words"])))
        except (ValueError, KeyError, TypeError, OverflowError):
            damages.add(f"torn line of {path.name}", "line", number, line[:60])
    return tuple(found)


__all__ = ["NO_CYCLE", "Ports", "RunFiles", "RunEvent", "bus_log_of", "read_run"]
