"""Reads a log of `PortLog`: the controllers of one process, each with its steps."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.settings import SettingsError
from firmware_py.storage.port_log import PORTS_LOG, VERSION
from vobc.process import Commission, read_commission

STANDARD_DIGITS: Final = 3
ERROR: Final = "E:"
REMOTE: Final = "R:"
STOP: Final = "stop"
CYCLE_TASKS: Final = frozenset({"control", "grant"})
"""Tasks that read inputs; the second belongs to a controller in another process."""


class RecordingError(SettingsError):
    """A recording that cannot be replayed; the text names file and line."""


@dataclass(frozen=True, slots=True)
class Output:
    """One output of a controller."""

    wire: str
    """Wire: can, tags or radio."""
    key: str
    """Identifier in hexadecimal, or key on the radio."""
    data: bytes


@dataclass(slots=True)
class RecordedStep:
    """One run of one task, or the end of the controller."""

    task: str
    begin_ns: int
    execution_ns: int = 0
    """Execution time of the previous run of the same task."""
    frames: list[CanFrame] = field(default_factory=list)
    """Frames that the controller received in this step; likewise chunks and messages."""
    chunks: list[SerialChunk] = field(default_factory=list)
    messages: list[RadioMessage] = field(default_factory=list)
    outputs: list[Output] = field(default_factory=list)


@dataclass(slots=True)
class Segment:
    """One controller from its start to its end, or to the end of the recording."""

    commission: Commission
    virtual: bool
    """Whether it was recorded in virtual time, in which execution takes no time."""
    steps: list[RecordedStep] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Recording:
    path: Path
    segments: tuple[Segment, ...]
    complete: bool
    """False if the recorder was killed; its last step, which may be torn, is left out."""


def read_recording(folder: Path) -> Recording:
    """Read the recording of a run folder, or the file itself. Raises RecordingError."""
    path = _recording_of(folder) if folder.is_dir() else folder
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise RecordingError(
            f"{path}: no such file; a run keeps it when its controller's ports are recorded"
        ) from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_recording(path, data)


def _recording_of(folder: Path) -> Path:
    """Path of the recording in the folder itself, or in its only subfolder with one."""
    below = sorted(folder.glob(f"*/{PORTS_LOG}"))
    if (folder / PORTS_LOG).exists() or not below:
        return folder / PORTS_LOG
    if len(below) > 1:
        found = ", ".join(str(path.parent) for path in below)
        raise RecordingError(f"{folder}: more than one controller was recorded: {found}")
    return below[0]


def parse_recording(path: Path, data: bytes) -> Recording:
    """Parse a recording. Raises RecordingError for a damaged or missing line."""
    *whole, torn = data.split(b"\n")
    reader = _Reader(path)
    for line in whole:
        reader.take(line.decode("utf-8", "replace"))
    if torn and reader.ended:
        raise RecordingError(f"{path}: line {len(whole) + 1}: follows the end of the recording")
    segments = reader.segments
    if not segments:
        raise RecordingError(f"{path}: holds no start of a controller")
    if not reader.ended and segments[-1].steps:
        segments[-1].steps.pop()
    return Recording(path, tuple(segments), reader.ended)


class _Reader:
    def __init__(self, path: Path) -> None:
        self.segments: list[Segment] = []
        self.ended = False
        self._path = path
        self._number = 0

    def take(self, line: str) -> None:
        self._number += 1
        words = line.split(" ")
        try:
            self._record(words, line)
        except RecordingError:
            raise
        except (ValueError, IndexError):
            shown = line if len(line) <= 60 else f"{line[:57]}..."
            raise self._error(f"damaged: {shown!a}") from None

    def _record(self, words: list[str], line: str) -> None:
        if self.ended:
            raise self._error("follows the end of the recording")
        if words[0] == "start":
            self.segments.append(self._segment(line.removeprefix("start ")))
        elif words[0] == "end":
            (lines,) = words[1:]
            if int(lines) != self._number - 1:
                raise self._error(f"must follow {lines} lines, but follows {self._number - 1}")
            self.ended = True
        elif words[0] == "run":
            task, begin, execution = words[1:]
            self._segment_now().steps.append(RecordedStep(task, int(begin), int(execution)))
        elif words[0] == STOP:
            (begin,) = words[1:]
            self._segment_now().steps.append(RecordedStep(STOP, int(begin)))
        elif words[0] == "rx":
            _heard(self._step_now(), words)
        elif words[0] == "tx":
            self._step_now().outputs.append(_output(words))
        else:
            raise ValueError

    def _segment(self, text: str) -> Segment:
        told: Any = json.loads(text)
        if not isinstance(told, dict) or not isinstance(told.get("told"), dict):
            raise ValueError
        if told.get("version") != VERSION:
            raise self._error(f"version {told.get('version')!r}; this program reads {VERSION}")
        commission = read_commission(told["told"], f"{self._path}: line {self._number}")
        return Segment(commission, bool(told.get("virtual")))

    def _segment_now(self) -> Segment:
        if not self.segments:
            raise self._error("no start of a controller before it")
        return self.segments[-1]

    def _step_now(self) -> RecordedStep:
        steps = self._segment_now().steps
        if not steps:
            raise self._error("no run of a task before it")
        return steps[-1]

    def _error(self, words: str) -> RecordingError:
        return RecordingError(f"{self._path}: line {self._number}: {words}")


def _heard(step: RecordedStep, words: list[str]) -> None:
    wire, stamp = words[1], int(words[2])
    if wire == "can":
        (_, _, _, digits, data) = words
        kind = data[:2] if data[1:2] == ":" else ""
        step.frames.append(
            CanFrame(
                stamp_ns=stamp,
                can_id=int(digits, 16),
                data=_bytes(data.removeprefix(kind)),
                extended=len(digits) > STANDARD_DIGITS and kind != ERROR,
                remote=kind == REMOTE,
                error=kind == ERROR,
            )
        )
    elif wire == "tags":
        (_, _, _, data) = words
        step.chunks.append(SerialChunk(stamp, _bytes(data)))
    elif wire == "radio":
        (_, _, _, key, data) = words
        step.messages.append(RadioMessage(stamp, key, _bytes(data)))
    else:
        raise ValueError


def _output(words: list[str]) -> Output:
    if words[1] == "tags":
        (_, _, data) = words
        return Output("tags", "", _bytes(data))
    (_, wire, key, data) = words
    if wire not in ("can", "radio"):
        raise ValueError
    return Output(wire, f"{int(key, 16):03X}" if wire == "can" else key, _bytes(data))


def _bytes(text: str) -> bytes:
    return b"" if text == "-" else bytes.fromhex(text)


def cycles(segment: Segment) -> Iterator[tuple[int, RecordedStep]]:
    """Index and step of each control cycle."""
    return ((at, step) for at, step in enumerate(segment.steps) if step.task in CYCLE_TASKS)
