"""Messages of a line's radio, read from its log: decoded, selected and counted."""

import csv
import dataclasses
import enum
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from firmware_py.settings import SettingsError
from plant_emulator.wayside.detection import LAYOUT, Place
from zenoh_config.codec import SafetyKey, unpack
from zenoh_config.messages import WAYSIDE, Message, Refused
from zenoh_config.t2t import (
    BROADCAST,
    FIRST_ARBITER,
    LAST_ARBITER,
    SUPERVISION,
    AreaAuthority,
    Heartbeat,
    T2tMessage,
)
from zenoh_config.t2t_codec import HEADER_FIELDS

LINE_LOG: Final = "line.log"
RADIO_LOG: Final = "radio.log"
COLUMNS: Final = ["t_s", "direction", "key", "payload"]
NS_PER_S: Final = 1e9
MS_PER_S: Final = 1000.0
OF_HEAD: Final = (*HEADER_FIELDS, "area", "term", "boot")

Heard = T2tMessage | Message | Place | Refused


class RadioEntry(NamedTuple):
    at_s: float
    """Instant by the clock of the recorder, as logged."""
    key: str
    size: int
    heard: Heard

    @property
    def kind(self) -> str:
        return type(self.heard).__name__

    @property
    def chunks(self) -> list[str]:
        return self.key.split("/")


class Chosen(NamedTuple):
    entry: RadioEntry
    start_s: float
    """Start of the log that holds the entry."""


@dataclass(frozen=True, slots=True)
class RadioLogFilter:
    """Selection of messages; an empty criterion selects all."""

    kinds: frozenset[str] = frozenset()
    """Names of message types, or the key chunks that stand for them, such as `hb`."""
    sources: frozenset[int] = frozenset()
    destinations: frozenset[int] = frozenset()
    areas: frozenset[int] = frozenset()
    since_s: float = float("-inf")
    until_s: float = float("inf")
    """Seconds of the log, from its first message on."""

    def takes(self, entry: RadioEntry, start_s: float) -> bool:
        chunks, heard = entry.chunks, entry.heard
        if not self.since_s <= entry.at_s - start_s <= self.until_s:
            return False
        if self.kinds and not self.kinds & {entry.kind, chunks[4] if len(chunks) > 4 else "x"}:
            return False
        if self.sources and _writer(chunks) not in self.sources:
            return False
        if self.areas and getattr(heard, "area", None) not in self.areas:
            return False
        return not self.destinations or getattr(heard, "destination", None) in self.destinations


def find_log(path: Path) -> Path:
    """Return the log itself, or that of a run folder. Raises SettingsError if there is none."""
    if not path.is_dir():
        return path
    for name in (LINE_LOG, RADIO_LOG):
        if (path / name).exists():
            return path / name
    raise SettingsError(f"{path}: it contains neither {LINE_LOG} nor {RADIO_LOG}")


def read_log(path: Path, key: SafetyKey) -> Iterator[RadioEntry]:
    """Yield every message, also damaged ones. Raises SettingsError naming file and line."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.reader(file)
            if next(rows, None) != COLUMNS:
                expected = ",".join(COLUMNS)
                raise SettingsError(f"{path}: not a radio log: its first line is not {expected}")
            for number, row in enumerate(rows, start=2):
                try:
                    at, _, topic, payload = row
                    yield entry_of(float(at), topic, bytes.fromhex(payload), key)
                except ValueError as error:
                    raise SettingsError(f"{path}: line {number}: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise SettingsError(f"{path}: cannot be read: {reason}") from error


def entry_of(at_s: float, topic: str, payload: bytes, key: SafetyKey) -> RadioEntry:
    chunks = topic.split("/")
    heard: Heard
    if len(chunks) == 4 and chunks[2] == "x" and len(payload) == LAYOUT.size:
        heard = Place(*LAYOUT.unpack(payload))
    else:
        heard = unpack(payload, key)
    return RadioEntry(at_s, topic, len(payload), heard)


# Messages as text.


def words_of(entry: RadioEntry, start_s: float) -> str:
    """Return one line: instant, sender, receiver, area, term and contents."""
    heard, at_s = entry.heard, entry.at_s - start_s
    if isinstance(heard, Refused):
        return f"{at_s:12.6f}  {entry.key}: refused: {heard.reason.value}: {heard.detail}"
    if isinstance(heard, Place):
        what = f"front {heard.front_m:.2f} m, rear {heard.rear_m:.2f} m, {heard.axles} axles"
        return f"{at_s:12.6f}  rails of T{entry.chunks[3]}: {what}"
    if isinstance(heard, T2tMessage):
        who = f"{address_words(heard.source)} > {address_words(heard.destination)}"
        head = f"{who}  area {heard.area} term {heard.term} #{heard.boot}.{heard.sequence}"
    else:
        head = f"{address_words(_writer(entry.chunks) or WAYSIDE)}"
    fields = [f for f in dataclasses.fields(heard) if f.name not in OF_HEAD]
    said = ", ".join([f"{f.name} {_value(getattr(heard, f.name))}" for f in fields])
    return f"{at_s:12.6f}  {head}  {entry.kind}: {said}"


def address_words(address: int) -> str:
    if address == WAYSIDE:
        return "wayside"
    if address == BROADCAST:
        return "all"
    if address == SUPERVISION:
        return "supervision"
    return f"arbiter {address}" if FIRST_ARBITER <= address <= LAST_ARBITER else f"T{address}"


def _value(value: Any) -> str:
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, float):
        return f"{value:.2f}"
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return "(" + " ".join([_value(each) for each in value]) + ")"
    if isinstance(value, tuple):
        return "[" + ", ".join([_value(each) for each in value]) + "]"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return "(" + " ".join([_value(v) for v in dataclasses.astuple(value)]) + ")"
    return str(value)


# Figures.


@dataclass(slots=True)
class TrainFigures:
    """Figures of the authorities for one train, in seconds of the log."""

    at_s: list[float] = field(default_factory=list)
    latency_ms: list[float] = field(default_factory=list)
    """Time from the report until the receipt of the authority that answers it."""
    age_ms: list[float] = field(default_factory=list)
    """Age of the previous authority at that time."""


@dataclass(slots=True)
class RadioFigures:
    trains: dict[int, TrainFigures] = field(default_factory=dict)
    terms: dict[int, list[tuple[float, int, int]]] = field(default_factory=dict)
    """Second, term and train of each new term, by area."""
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of messages, by sender and kind."""
    sizes: Counter[tuple[str, str]] = field(default_factory=Counter)
    refused: int = 0
    start_s: float = 0.0
    end_s: float = 0.0
    """End of the selection; all instants are in seconds of the log."""


def figures_of(chosen: Iterable[Chosen]) -> RadioFigures:
    found = RadioFigures(start_s=float("inf"))
    echoes: dict[tuple[int, int], tuple[int, int]] = {}
    for entry, start_s in chosen:
        at_s, heard = entry.at_s - start_s, entry.heard
        found.start_s, found.end_s = min(found.start_s, at_s), max(found.end_s, at_s)
        if isinstance(heard, Refused):
            found.refused += 1
            continue
        writer = _writer(entry.chunks)
        who = "rails" if writer is None else address_words(writer)
        found.counts[who, entry.kind] += 1
        found.sizes[who, entry.kind] += entry.size
        if isinstance(heard, Heartbeat):
            terms = found.terms.setdefault(heard.area, [])
            if not terms or heard.term > terms[-1][1]:
                terms.append((at_s, heard.term, heard.source))
        elif isinstance(heard, AreaAuthority):
            _add_authority(found, heard, entry.at_s, at_s, echoes)
    return found


def _add_authority(
    found: RadioFigures,
    heard: AreaAuthority,
    logged_s: float,
    at_s: float,
    echoes: dict[tuple[int, int], tuple[int, int]],
) -> None:
    train = found.trains.setdefault(heard.destination, TrainFigures())
    key = heard.destination, heard.area
    term, echo_ns = echoes.get(key, (heard.term, heard.echo_ns))
    if heard.term < term:
        return
    train.at_s.append(at_s)
    train.latency_ms.append(MS_PER_S * (logged_s - heard.echo_ns / NS_PER_S))
    train.age_ms.append(MS_PER_S * (logged_s - echo_ns / NS_PER_S))
    echoes[key] = heard.term, heard.echo_ns


def _writer(chunks: list[str]) -> int | None:
    """Return the sender with this key; None for the rails."""
    if len(chunks) > 3 and chunks[2] == "w" and chunks[3].isdecimal():
        return int(chunks[3])
    return None
