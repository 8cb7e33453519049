"""Signals by name as traces for drawing: instants, values, unit, value names, gaps."""

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canlog.damage import LogError
from canlog.database import MessageSpec, SignalSpec
from canlog.frames import Ints
from canlog.reader import Log
from canlog.run import NS_PER_S, RunFiles

Floats = npt.NDArray[np.float64]
NS_PER_MS: Final = 1_000_000
TRUTH: Final = "truth"
CYCLES: Final = "cycles"
TIME_COLUMN: Final = "t_s"
SUFFIX_UNITS: Final = {
    "mps": "m/s",
    "mps2": "m/s²",
    "mps3": "m/s³",
    "m": "m",
    "s": "s",
    "us": "µs",
    "ms": "ms",
    "n": "N",
    "permille": "‰",
    "ratio": "1",
}
"""Unit of a column of a run folder, by the suffix of its name."""
TRAILER: Final = frozenset({"alive_counter", "crc16", "crc8", "crc", "counter", "checksum"})
"""Signals that only protect a frame and carry no information about the train."""


@dataclass(frozen=True, slots=True, eq=False)
class SignalTrace:
    """`n` samples of one signal, in order of time."""

    name: str
    """MESSAGE.signal, or truth.column or cycles.column of a run folder."""
    unit: str
    at_ns: Ints
    """(n,) stamps, rising or equal."""
    values: Floats
    """(n,) NaN only where a float signal itself carries NaN."""
    choices: Mapping[float, str] = field(default_factory=dict)
    """Names by physical value."""
    gap_ns: int = 0
    """Samples further apart than this are not joined; 0 joins all."""
    is_state: bool = False
    """Whether to draw a band of named states instead of a line."""

    def __len__(self) -> int:
        return len(self.at_ns)

    def text_of(self, value: float) -> str:
        """Return a value as text for people, with its unit."""
        named = self.choices.get(value)
        if named is not None:
            return named
        joined = flags_text(self.choices, value)
        return joined or f"{value:.6g}{' ' + self.unit if self.unit not in ('', '1') else ''}"

    def value_at(self, at_ns: int) -> float | None:
        """Return the last value at or before an instant; None before the first sample."""
        index = int(np.searchsorted(self.at_ns, at_ns, "right")) - 1
        return float(self.values[index]) if index >= 0 else None


def flags_text(choices: Mapping[float, str], value: float) -> str:
    """Return `A|B` for a sum of values of a table of powers of two; empty for any other value."""
    bits = [raw for raw in choices if raw > 0]
    if not bits or value <= 0 or not float(value).is_integer() or len(bits) < 2:
        return ""
    if any(int(raw) & (int(raw) - 1) for raw in bits) or int(value) & ~int(sum(bits)):
        return ""
    return "|".join(choices[raw] for raw in sorted(bits) if int(value) & int(raw))


def trace_names(log: Log) -> list[str]:
    """Return all names that can be drawn: signals of messages, then columns of the run folder."""
    names = [f"{name}.{each.name}" for name, spec in log.messages.items() for each in spec.signals]
    return names + list(_run_names(log.run))


def find_names(log: Log, asked: str) -> list[str]:
    """Return the full names for a full name, a pattern, or a signal name alone.

    A signal of the bus has priority over a column of the run folder.

    Raises:
        LogError: if the log has no such name, or several messages have the signal.
    """
    known = trace_names(log)
    if asked in known:
        return [asked]
    if any(sign in asked for sign in "*?["):
        found = [name for name in known if fnmatchcase(name, asked)]
        if found:
            return found
    by_signal = [name for name in known if name.partition(".")[2] == asked]
    on_bus = [name for name in by_signal if name.partition(".")[0] not in (TRUTH, CYCLES)]
    by_signal = on_bus or by_signal
    if len(by_signal) == 1:
        return by_signal
    if by_signal:
        raise LogError(f"{asked}: several messages have it; name one of {', '.join(by_signal)}")
    message, _, signal = asked.partition(".")
    spread = [name for name in known if log.asked_as(message, name.partition(".")[0])]
    spread = [name for name in spread if name.partition(".")[2] == signal]
    if spread:
        words = "several channels or sources have it"
        raise LogError(f"{asked}: {words}; name one of {', '.join(spread)}")
    _complain(log, asked, known)
    return []


def _complain(log: Log, asked: str, known: Sequence[str]) -> None:
    message, dot, signal = asked.partition(".")
    spec = log.bus.messages.get(message)
    if dot and spec is not None and spec.name not in log.messages:
        raise LogError(f"{asked}: {log.path} holds no frame of {message}")
    if dot and spec is not None and "*" not in signal:
        spec.signal(signal)
    tails = {name.partition(".")[2]: name for name in known}
    near = difflib.get_close_matches(asked, [*known, *tails], n=1, cutoff=0.5)
    hint = f"; did you mean {tails.get(near[0], near[0])}?" if near else ""
    raise LogError(f"{asked}: no such signal in {log.path}{hint}")


def panels_of(log: Log, words: Iterable[str]) -> list[list[SignalTrace]]:
    """Return one panel per word; names joined by commas share one. Raises LogError."""
    panels = []
    for word in words:
        names = [name for part in word.split(",") for name in find_names(log, part.strip())]
        panels.append([trace_of(log, name) for name in dict.fromkeys(names)])
    return panels


def trace_of(log: Log, name: str) -> SignalTrace:
    """Return the trace of a full name. Raises LogError."""
    group, _, column = name.partition(".")
    if log.run is not None and group in (TRUTH, CYCLES):
        return _run_trace(log.run, group, column)
    spec = log.spec(group)
    signal = spec.signal(column)
    table = log.table(group)
    values = np.asarray(table[column], np.float64)
    at_ns, valid = table.at_ns, table.valid(column)
    if not valid.all():
        at_ns, values = at_ns[valid], values[valid]
    at_ns, values = in_order(at_ns, values)
    return SignalTrace(
        name,
        signal.unit,
        at_ns,
        values,
        physical_choices(signal),
        gap_of(spec, at_ns),
        signal.is_state,
    )


def in_order(at_ns: Ints, values: Any) -> tuple[Ints, Any]:
    """Return both columns sorted by time; frames of equal stamp keep the order of the log."""
    if len(at_ns) < 2 or bool((at_ns[1:] >= at_ns[:-1]).all()):
        return at_ns, values
    order = np.argsort(at_ns, kind="stable")
    return at_ns[order], values[order]


def physical_choices(signal: SignalSpec) -> dict[float, str]:
    """Return the value table by physical value."""
    return {raw * signal.scale + signal.offset: name for raw, name in signal.choices.items()}


def gap_of(spec: MessageSpec, at_ns: Ints) -> int:
    """Return how long a signal of the message holds: its timeout, or 0 if it has none."""
    del at_ns
    return spec.timeout_ms * NS_PER_MS


def _run_names(run: RunFiles | None) -> Iterator[str]:
    if run is None:
        return
    for group, columns in ((TRUTH, run.truth), (CYCLES, run.cycles)):
        for name, column in columns.items():
            if name != TIME_COLUMN and TIME_COLUMN in columns and column.dtype.kind == "f":
                yield f"{group}.{name}"


def _run_trace(run: RunFiles, group: str, name: str) -> SignalTrace:
    columns = run.truth if group == TRUTH else run.cycles
    if name not in columns or TIME_COLUMN not in columns or columns[name].dtype.kind != "f":
        raise LogError(f"{group}.{name}: {run.folder} has no such column of numbers")
    values = columns[name]
    there = ~np.isnan(values)
    zero_ns = run.truth_ns if group == TRUTH else run.start_ns
    at_ns = zero_ns + np.rint(columns[TIME_COLUMN][there] * NS_PER_S).astype(np.int64)
    at_ns, values = in_order(at_ns, values[there])
    return SignalTrace(f"{group}.{name}", unit_of_column(name), at_ns, values)


def unit_of_column(name: str) -> str:
    """Return the unit from the suffix of a column's name; empty for a name without one."""
    return SUFFIX_UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""


PREFERRED: Final = (
    ("VOBC_MOTION.speed_mps", "VOBC_MOTION.ceiling_mps", "VOBC_MOTION.emergency_mps"),
    ("TRACTION_CMD.force_n", "TRACTION_STATUS.force_n"),
    ("BRAKE_CMD.service_decel_mps2", "BRAKE_STATUS.applied_decel_mps2"),
    ("VOBC_STATUS.supervision", "VOBC_STATUS.ato_phase", "VOBC_MODE.mode"),
)
"""Panels for a train of this project if the user names no signals."""
PANELS_MAX: Final = 4


def default_words(log: Log) -> list[str]:
    """Return the default panels: PREFERRED for a train, otherwise the signals that vary the most.

    Raises:
        LogError: if the log has nothing to draw.
    """
    names = trace_names(log)
    if not names:
        hint = "; --dbc takes the file that defines its messages" if log.unknown else ""
        raise LogError(f"{log.path}: no message of {log.bus.name} is in it{hint}")
    there = [[name for name in panel if name in names] for panel in PREFERRED]
    chosen = [",".join(panel) for panel in there if panel]
    if len(chosen) >= 2:
        return chosen
    return [name for _, name in sorted(_liveliest(log))[:PANELS_MAX]] or names[:PANELS_MAX]


def _liveliest(log: Log) -> Iterator[tuple[int, str]]:
    """Yield rank and name of varying signals, by the number of distinct values in a small
    sample.
    """
    for message, spec in log.messages.items():
        for signal in spec.signals:
            if signal.name.lower() in TRAILER:
                continue
            values = log.table(message)[signal.name]
            glance = values[:: max(1, len(values) // 500)]
            distinct = len(np.unique(glance[: 1 << 12]))
            if distinct > 1:
                yield -distinct, f"{message}.{signal.name}"
