"""State of the controller at one time: its cycle, and the latest input of each kind."""

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from firmware_py.ports import CanFrame, RadioMessage
from metro_hil.model.run_folder import RunFolder
from metro_hil.replay.meaning import frame_words, message_words
from metro_hil.replay.recording import CYCLE_TASKS
from metro_hil.report.explain.event_log import PORTS_LOG, RunEventsError

NS_PER_S: Final = 1_000_000_000
HALF_STEP_S: Final = 1e-4
"""Tolerance for the rounding of logged times, s; far less than a cycle."""


@dataclass(frozen=True, slots=True)
class LastReceived:
    """The latest frame or message of one name."""

    name: str
    values: str
    at_s: float


@dataclass(frozen=True, slots=True)
class ControllerKnowledge:
    """What the controller knew at the end of one control cycle."""

    cycle: Mapping[str, str]
    """The row of the cycle log, by column."""
    heard: tuple[LastReceived, ...]
    """Latest inputs, in the order of their names."""


def known_at(folder: RunFolder, at_s: float) -> ControllerKnowledge:
    """State at the last cycle that began by then. Raises RunEventsError for a missing log."""
    row = cycle_at(folder.cycle_log, at_s)
    return ControllerKnowledge(row, heard_until(folder.path / PORTS_LOG, float(row["t_s"])))


def cycle_at(path: Path, at_s: float) -> dict[str, str]:
    """The last row at or before a time, by column. Raises RunEventsError."""
    found: dict[str, str] | None = None
    first_s: float | None = None
    try:
        with path.open(newline="", encoding="utf-8") as lines:
            for row in csv.DictReader(lines):
                if None in row.values() or None in row:
                    continue
                t_s = float(row["t_s"])
                first_s = t_s if first_s is None else first_s
                if t_s <= at_s:
                    found = row
    except (OSError, ValueError, KeyError) as error:
        raise RunEventsError(f"{path}: cannot be read: {error}") from error
    if found is None:
        begin = "it has no cycle" if first_s is None else f"its first cycle is at {first_s:.3f} s"
        raise RunEventsError(f"--at {at_s:g}: {path}: {begin}")
    return found


def heard_until(ports_log: Path, cycle_s: float) -> tuple[LastReceived, ...]:
    """The newest input of each name, up to the cycle that began at `cycle_s` of controller time.

    It reads only the inputs of the recording, so recordings of other versions work as well.
    """
    ear = _LatestInputs()
    try:
        with ports_log.open(encoding="utf-8") as lines:
            for line in lines:
                if ear.over(line.rstrip("\n"), cycle_s):
                    break
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise RunEventsError(f"{ports_log}: cannot be read: {error}") from error
    return ear.heard()


class _LatestInputs:
    """Keeps the newest inputs of a controller; a restart of the controller clears them."""

    def __init__(self) -> None:
        self._start_ns = 0
        self._frames: dict[int, CanFrame] = {}
        self._messages: dict[str, RadioMessage] = {}

    def over(self, line: str, cycle_s: float) -> bool:
        """Take one line of the recording; true if it begins a later cycle."""
        kind, *words = line.split(" ")
        if kind == "start":
            told = json.loads(line.removeprefix("start "))
            self._start_ns = int(told["told"]["start_ns"])
            self._frames, self._messages = {}, {}
        elif kind == "run" and words[0] in CYCLE_TASKS:
            return (int(words[1]) - self._start_ns) / NS_PER_S > cycle_s + HALF_STEP_S
        elif kind == "rx" and words[0] == "can" and ":" not in words[3]:
            frame = CanFrame(int(words[1]), int(words[2], 16), _bytes(words[3]))
            self._frames[frame.can_id] = frame
        elif kind == "rx" and words[0] == "radio":
            self._messages[words[2]] = RadioMessage(int(words[1]), words[2], _bytes(words[3]))
        return False

    def heard(self) -> tuple[LastReceived, ...]:
        found = [self._entry(frame_words(each), each.stamp_ns) for each in self._frames.values()]
        found += [
            self._entry(message_words(each), each.stamp_ns) for each in self._messages.values()
        ]
        return tuple(sorted(found, key=lambda heard: heard.name))

    def _entry(self, words: tuple[str, str], at_ns: int) -> LastReceived:
        return LastReceived(*words, (at_ns - self._start_ns) / NS_PER_S)


def _bytes(text: str) -> bytes:
    return b"" if text == "-" else bytes.fromhex(text)
