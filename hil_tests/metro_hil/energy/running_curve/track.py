"""The track between two stations in cells, with the gradient and speed limit of each."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap
from metro_hil.energy.running_curve.thrift import Thrift
from metro_hil.energy.running_curve.train import GRAVITY_MPS2, CellDrag, Numbers, RunningTrain

CELL_M: Final = 1.0
CELLS_MIN: Final = 20
CELLS_MAX: Final = 2000
"""Number of cells that a hop has at most; long hops have longer cells."""
LOWERED_CELL_M: Final = 2.5
"""Length of a cell on a hop with a lower limit ahead, where more runs are compared."""
LENGTH_MAX_M: Final = 100000.0


@dataclass(frozen=True, slots=True)
class HopTrack:
    """One hop of `cells` cells of equal length; arrays by cell or by the nodes between them."""

    length_m: float
    cells: int
    drag: CellDrag
    """Gradient and air drag by cell, (cells,)."""
    ceiling_mps: Numbers
    """Limit for the whole train by node, including the train's own maximum speed, (cells + 1,)."""
    thrift: Thrift | None = None
    """Best regimes of a track with a lower limit ahead."""

    @property
    def cell_m(self) -> float:
        return self.length_m / self.cells

    def number_of(self, notch_off_mps: Numbers, hold_m: Numbers) -> Numbers:
        """Return the number of a run between 0, the slowest, and 1; see `net.departures`."""
        top_mps = float(np.max(self.ceiling_mps))
        number: Numbers = (notch_off_mps / top_mps + hold_m / self.length_m) / 2.0
        return np.minimum(number, 1.0)

    @property
    def at_m(self) -> Numbers:
        """Distance of each node, (cells + 1,)."""
        return np.linspace(0.0, self.length_m, self.cells + 1)


def level_track(train: RunningTrain, length_m: float, *, cell_m: float = CELL_M) -> HopTrack:
    """Return a level, straight track with the train's own maximum speed as limit."""
    cells = max(CELLS_MIN, math.ceil(length_m / cell_m))
    ceiling_mps = np.full(cells + 1, train.speed_max_mps)
    return HopTrack(length_m, cells, CellDrag(np.zeros(cells), np.ones(cells)), ceiling_mps)


def track_between(
    line: LineMap,
    train: RunningTrain,
    start: str | None,
    end: str | None,
    *,
    cell_m: float | None = None,
) -> tuple[str, str, HopTrack]:
    """Return the track from one station to another, whatever lies between.

    Raises SettingsError.

    The default is the longest hop of the line, as in [Ninh], or the hop after `start`.
    """
    names = [station.name for station in line.stations]
    for option, name in (("--from", start), ("--to", end)):
        if name is not None and name not in names:
            known = ", ".join(names)
            raise SettingsError(f"{option} {name}: no such station; {line.name} has {known}")
    first, last = _ends(line, start, end)
    if last <= first:
        raise SettingsError(
            f"--to {names[last]}: not beyond {names[first]}; trains run towards growing chainage"
        )
    begin_m, end_m = line.stations[first].stop_m, line.stations[last].stop_m
    length_m = end_m - begin_m
    if length_m > LENGTH_MAX_M:
        raise SettingsError(
            f"{names[first]}-{names[last]}: {length_m:g} m is over {LENGTH_MAX_M:g} m"
        )
    limits_mps = [
        section.limit_mps
        for section in line.speed_sections
        if section.start_m < end_m and section.end_m > begin_m - train.length_m
    ]
    if cell_m is None:
        several = len({min(train.speed_max_mps, limit_mps) for limit_mps in limits_mps}) > 1
        cell_m = LOWERED_CELL_M if several else CELL_M
    cells = min(CELLS_MAX, max(CELLS_MIN, math.ceil(length_m / cell_m)))
    at_m = np.linspace(begin_m, end_m, cells + 1)
    middles_m = (at_m[1:] + at_m[:-1]) / 2.0
    grade_n = np.array(
        [
            train.weight_kg
            * GRAVITY_MPS2
            * line.mean_gradient_permille(front_m - train.length_m, front_m)
            / 1000.0
            for front_m in middles_m
        ]
    )
    air_ratio = np.array(
        [line.mean_drag_ratio(front_m - train.length_m, front_m) for front_m in middles_m]
    )
    ceiling_mps = np.array(
        [
            min(train.speed_max_mps, line.least_limit_mps(front_m - train.length_m, front_m))
            for front_m in at_m
        ]
    )
    track = HopTrack(length_m, cells, CellDrag(grade_n, air_ratio), ceiling_mps)
    return names[first], names[last], track


def _ends(line: LineMap, start: str | None, end: str | None) -> tuple[int, int]:
    names = [station.name for station in line.stations]
    if len(names) < 2:
        raise SettingsError(f"{line.name}: needs two stations")
    if start is not None:
        first = names.index(start)
        if end is None and first == len(names) - 1:
            raise SettingsError(f"--from {start}: is the last station")
        return first, first + 1 if end is None else names.index(end)
    if end is not None:
        last = names.index(end)
        if last == 0:
            raise SettingsError(f"--to {end}: is the first station")
        return last - 1, last
    hops_m = [
        (later.stop_m - earlier.stop_m, -index)
        for index, (earlier, later) in enumerate(
            zip(line.stations, line.stations[1:], strict=False)
        )
    ]
    first = -max(hops_m)[1]
    return first, first + 1
