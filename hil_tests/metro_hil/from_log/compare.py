"""Compares what the controller sent in the record and in the simulation, signal by signal.

Both rides are aligned at the departure. A simulated ride has other noise than the recorded one, so
a signal deviates only where the simulation comes near the recorded value at no time within a
window. Signals with a unit may differ by a share of their recorded range, all others not at all.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

import canlog
from can_dbc.nodes import Node
from metro_hil.from_log.ride import RecordedRide

NS_PER_S: Final = 1e9
CHECKS: Final = frozenset({"alive_counter", "crc16", "work_us", "cycle_slips"})
"""Signals that say nothing of decisions: protection of the frame, and the host's timing."""
TWIN: Final = "_INV"
EVENTS: Final = "VOBC_EVENT"
"""Message without a period, so that it has no value between two frames."""
STEPS_MIN: Final = 2.0
"""Least tolerance of a signal with a unit, in steps of its raw value."""


class SignalDivergence(msgspec.Struct, frozen=True, kw_only=True):
    """The first deviation of one signal."""

    at_s: float
    """Time since the departure, s."""
    message: str
    signal: str
    recorded: str
    simulated: str
    """The value at the same time."""


class RideComparison(msgspec.Struct, frozen=True, kw_only=True):
    signals: int
    """Number of signals compared."""
    compared_s: float
    """Time from the departure to the end of the shorter ride, s."""
    first: tuple[SignalDivergence, ...]
    """The first deviation of each signal that deviates, in order of time."""


def compare_rides(
    log: "canlog.Log",
    ride: RecordedRide,
    again: "canlog.Log",
    simulated: RecordedRide,
    *,
    tolerance_ratio: float,
    window_s: float,
) -> RideComparison:
    """Compare every signal that the controller sends cyclically, from the departure on."""
    begins_ns = (ride.start_ns + ride.left_ns, simulated.start_ns + simulated.left_ns)
    ends_ns = (log.end_ns - begins_ns[0], again.end_ns - begins_ns[1])
    end_ns, window_ns = min(ends_ns), round(window_s * NS_PER_S)
    signals, found = 0, list[SignalDivergence]()
    for spec, signal in _signals(log):
        mine = _course(log.table(spec.name), signal, begins_ns[0])
        theirs = _course(again.table(spec.name), signal, begins_ns[1])
        rows = np.flatnonzero((mine.at_ns >= 0) & (mine.at_ns <= end_ns - window_ns))
        if not len(rows):
            continue
        signals += 1
        row = _first_off(mine, theirs, rows, window_ns, tolerance_ratio)
        if row is not None:
            at_ns = int(mine.at_ns[row])
            now = int(np.searchsorted(theirs.at_ns, at_ns, "right")) - 1
            found.append(
                SignalDivergence(
                    at_s=round(at_ns / NS_PER_S, 3),
                    message=spec.name,
                    signal=signal.name,
                    recorded=mine.text(row),
                    simulated=theirs.text(now) if now >= 0 else "no frame",
                )
            )
    found.sort(key=lambda each: (each.at_s, each.message, each.signal))
    return RideComparison(signals=signals, compared_s=end_ns / NS_PER_S, first=tuple(found))


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """One signal over the time since the departure."""

    table: "canlog.Table"
    signal: "canlog.SignalSpec"
    at_ns: npt.NDArray[np.int64]
    values: npt.NDArray[np.float64]

    def held_ns(self, row: int) -> int:
        """How long the signal keeps the value of a row, from its first frame to the next value."""
        changed = np.flatnonzero(np.diff(self.values)) + 1
        place = int(np.searchsorted(changed, row, "right"))
        first = int(changed[place - 1]) if place else 0
        after = int(changed[place]) if place < len(changed) else len(self.values) - 1
        return int(self.at_ns[after] - self.at_ns[first])

    def text(self, row: int) -> str:
        """Value, unit or name of a row."""
        label = self.signal.choices.get(int(self.table.raw(self.signal.name)[row]))
        unit = "" if self.signal.unit in ("", "1") else f" {self.signal.unit}"
        return label or f"{self.values[row]:.6g}{unit}"


def _course(table: "canlog.Table", signal: "canlog.SignalSpec", begin_ns: int) -> _Course:
    return _Course(table, signal, table.at_ns - begin_ns, table[signal.name].astype(np.float64))


def _first_off(
    mine: _Course,
    theirs: _Course,
    rows: npt.NDArray[np.int64],
    window_ns: int,
    tolerance_ratio: float,
) -> int | None:
    """First recorded row to which the simulation comes near at no time within the window."""
    unit, tolerance = mine.signal.unit, 0.0
    if unit:
        span = float(np.ptp(mine.values[rows]))
        tolerance = max(tolerance_ratio * span, STEPS_MIN * mine.signal.lsb)
    lows = np.searchsorted(theirs.at_ns, mine.at_ns[rows] - window_ns, "left")
    highs = np.searchsorted(theirs.at_ns, mine.at_ns[rows] + window_ns, "right")
    for row, low, high in zip(rows.tolist(), lows.tolist(), highs.tolist(), strict=True):
        near, value = theirs.values[low:high], float(mine.values[row])
        if len(near) and _comes_near(near, value, tolerance, continuous=bool(unit)):
            continue
        if unit or mine.held_ns(row) >= window_ns:
            # A state that lasts shorter is passed through, at instants that the noise decides.
            return int(row)
    return None


def _signals(log: "canlog.Log") -> "Iterator[tuple[canlog.MessageSpec, canlog.SignalSpec]]":
    for spec in log.bus.by_key.values():
        cyclic = Node.VOBC.name in spec.senders and not spec.name.endswith(TWIN)
        if not cyclic or spec.name == EVENTS or not len(log.table(spec.name)):
            continue
        yield from ((spec, each) for each in spec.signals if each.name not in CHECKS)


def _comes_near(
    near: npt.NDArray[np.float64], value: float, tolerance: float, *, continuous: bool
) -> bool:
    if continuous:
        return bool(near.min() - tolerance <= value <= near.max() + tolerance)
    return bool((near == value).any())
