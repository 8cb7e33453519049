"""Counts changes of the brake command's level before each stop, from the frames on the bus.

A level counts if the command held it for a while or reversed there; values that a ramp passes
through do not. So one notch is one change, however slowly the command reaches it.
"""

import itertools
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from can_dbc.brake import BrakeCommand
from can_dbc.codec import Decoder
from metro_hil.model.log_columns import Columns

HELD_S: Final = 0.2
RELEASED_S: Final = 1.0
"""Least duration of a released brake before a new braking, s."""
STOPPED_MPS: Final = 0.1
"""Speed below which the holding brake takes over, m/s."""
BAND_MPS: Final = (4.0 / 3.6, 8.0 / 3.6)
"""Speeds between which electro-pneumatic blending takes place [Wu 2022], m/s."""
NS_PER_S: Final = 1e9
SAME_MPS2: Final = 1e-6


class Level(NamedTuple):
    """One deceleration demand, from a given time on."""

    at_s: float
    decel_mps2: float


class NotchLog:
    """Receives every frame of a run and records each change of the service brake demand."""

    __slots__ = ("_changes", "_decode", "_ids")

    def __init__(self) -> None:
        decoder = Decoder([BrakeCommand])
        self._ids = decoder.ids
        self._decode = decoder.decode
        self._changes: list[Level] = []

    def frame(self, stamp_ns: int, can_id: int, data: bytes) -> None:
        if can_id not in self._ids:
            return
        heard = self._decode(can_id, data, stamp_ns)
        if not isinstance(heard, BrakeCommand):
            return
        decel_mps2 = heard.service_decel_mps2
        if not self._changes or abs(decel_mps2 - self._changes[-1].decel_mps2) > SAME_MPS2:
            self._changes.append(Level(stamp_ns / NS_PER_S, decel_mps2))

    def measures(self, truth: Columns) -> dict[str, float | None]:
        """Measures of the recorded changes; see `notch_measures`."""
        return notch_measures(self._changes, truth)


def notch_measures(changes: Sequence[Level], truth: Columns) -> dict[str, float | None]:
    """Measures over all brakings that ended at rest; None without any.

    Args:
        changes: changes of the command, in order of time.
        truth: log with `t_s` and `speed_mps`.
    """
    counts, reversals = [], 0
    for begin_s, end_s, band_s in _brakings(truth):
        levels = held_levels(changes, begin_s, end_s, fast_until_s=band_s[0])
        if len(levels) < 2:
            continue
        counts.append(len(levels) - 1)
        in_band = [level for level in levels[1:] if band_s[0] <= level.at_s < band_s[1]]
        reversals += _reversals(levels, in_band)
    return {
        "notch_changes_max_count": float(max(counts)) if counts else None,
        "notch_changes_mean_count": sum(counts) / len(counts) if counts else None,
        "notch_reversals_count": float(reversals) if counts else None,
    }


def _brakings(truth: Columns) -> list[tuple[float, float, tuple[float, float]]]:
    """Begin and end of each run between two stops, and when it passed the blending band."""
    time_s, speed_mps = truth.numbers("t_s"), truth.numbers("speed_mps")
    moving = np.concatenate(([False], speed_mps > STOPPED_MPS, [False])).astype(np.int8)
    edges = np.diff(moving)
    found = []
    for first, after in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        if after >= len(time_s):
            continue
        times_s, speeds_mps = time_s[first:after], speed_mps[first:after]
        if float(np.max(speeds_mps)) <= BAND_MPS[1]:
            continue
        fast_s = float(times_s[np.flatnonzero(speeds_mps > BAND_MPS[1])[-1]])
        slow_s = float(times_s[np.flatnonzero(speeds_mps > BAND_MPS[0])[-1]])
        found.append((float(times_s[0]), float(time_s[after]), (fast_s, slow_s)))
    return found


def held_levels(
    changes: Sequence[Level], begin_s: float, end_s: float, *, fast_until_s: float
) -> list[Level]:
    """Levels of the last braking in this time, the released brake first; no level repeats.

    Args:
        fast_until_s: a release after this counts as one more change, not as a new braking.
    """
    released = Level(begin_s, 0.0)
    within = [released, *(change for change in changes if begin_s < change.at_s < end_s)]
    ends_s = [*(change.at_s for change in within[1:]), end_s]
    start = 0
    for index, (level, until_s) in enumerate(zip(within, ends_s, strict=True)):
        if level.at_s >= fast_until_s:
            break
        if level.decel_mps2 == 0.0 and until_s - level.at_s >= RELEASED_S:
            start = index
    levels = [within[start]]
    for index in range(start + 1, len(within)):
        level = within[index]
        held = ends_s[index] - level.at_s >= HELD_S or _turns(within, index)
        if held and abs(level.decel_mps2 - levels[-1].decel_mps2) > SAME_MPS2:
            levels.append(level)
    return levels


def _turns(levels: Sequence[Level], index: int) -> bool:
    if index + 1 >= len(levels):
        return False
    before, here, after = (levels[index + step].decel_mps2 for step in (-1, 0, 1))
    return (here - before) * (after - here) < 0.0


def _reversals(levels: Sequence[Level], in_band: Sequence[Level]) -> int:
    """Number of changes in the band whose direction differs from the previous one in the band."""
    risings = [
        here.decel_mps2 > before.decel_mps2
        for before, here in itertools.pairwise(levels)
        if here in in_band
    ]
    return sum(one is not other for one, other in itertools.pairwise(risings))
