"""Ways to drive to a braking point past lower limits: coast before each, hold, or pull.

Dynamic programming over the way gives the best regime for each place and speed, at a given price of
time: traction energy, less the used regenerated energy, plus price times time is least. A low price
gives a slow run that coasts long before every lower limit, a high one the fastest run. All prices
are solved at once, because speeds after a cell do not depend on the price. A run between two prices
changes from the one to the other at a place of the way, so that every running time can be met.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from metro_hil.energy.running_curve.train import CellDrag, Numbers, RunningTrain

SPEEDS: Final = 301
PRICES: Final = 26
PRICE_MIN_RATIO, PRICE_MAX_RATIO, PRICE_FASTEST_RATIO = 1.0e-2, 3.0e1, 1.0e3
"""Range of the price, relative to the kinetic energy at top speed for each second of the way."""
SLOWEST_MPS: Final = 0.5
FAR_J: Final = 1.0e15
"""Cost of a speed from which no run reaches the end."""
STEADY_RATIO: Final = 1.0e-9
"""Advantage of holding the speed over equally good regimes, relative to the kinetic energy."""
PULL, HOLD, COAST = range(3)


@dataclass(frozen=True, slots=True)
class Thrift:
    """Best regimes by cell, price and speed."""

    regime: NDArray[np.int8]
    """(cells, prices, SPEEDS), each PULL, HOLD or COAST."""
    grid_mps: Numbers
    """(SPEEDS,)"""

    def at(self, cell: int, price: NDArray[np.intp], speed_mps: Numbers) -> NDArray[np.int8]:
        """Return the regime in this cell for each pair of price and speed."""
        step_mps = self.grid_mps[1] - self.grid_mps[0]
        index = np.rint((speed_mps - self.grid_mps[0]) / step_mps).astype(np.intp)
        found: NDArray[np.int8] = self.regime[cell, price, np.clip(index, 0, SPEEDS - 1)]
        return found


def lowered(ceiling_mps: Numbers) -> bool:
    """Return whether a lower limit follows a higher one on the way."""
    return bool(np.any(np.diff(ceiling_mps) < -1e-6))


def forces_n(
    train: RunningTrain, at: Numbers, drag: CellDrag, cell_m: float
) -> tuple[Numbers, Numbers, Numbers]:
    """Return the drag while coasting, the traction while pulling and the force that keeps the
    speed, for squares of the speed `at`; each from the middle of a cell.
    """
    gain = cell_m / train.mass_kg
    drag_n = drag.at_n(train, np.sqrt(at))
    coasting_n = drag.at_n(train, np.sqrt(np.maximum(at - gain * drag_n, 0.0)))
    pull_n = train.traction_at_n(np.sqrt(at))
    middle = np.sqrt(np.maximum(at + gain * (pull_n - drag_n), 0.0))
    keep_n = np.clip(
        drag_n, -train.braking_at_n(np.sqrt(at), train.brake_power_w), train.traction_at_n(middle)
    )
    return coasting_n, train.traction_at_n(middle), keep_n


def thrift(
    train: RunningTrain,
    cell_m: float,
    drag: CellDrag,
    ceiling_square: Numbers,
    use_ratio: float,
) -> Thrift:
    """Solve all prices.

    Args:
        drag: gradient and air drag by cell.
        ceiling_square: greatest square of the speed by node, with all braking to lower limits and
            to the stop.
        use_ratio: share of the regenerated energy that is used.
    """
    cells, top_mps = len(drag.grade_n), float(np.sqrt(np.max(ceiling_square)))
    grid_mps = np.linspace(SLOWEST_MPS, top_mps, SPEEDS)
    grid = grid_mps**2
    kinetic_j = train.mass_kg * top_mps**2 / 2.0
    ratios = np.geomspace(PRICE_MIN_RATIO, PRICE_MAX_RATIO, PRICES - 1)
    prices = np.append(ratios, PRICE_FASTEST_RATIO) * kinetic_j * top_mps / (cells * cell_m)
    from_square = np.minimum(grid, ceiling_square[:-1, None])
    after, work_j = _moves(
        train, cell_m, from_square, drag.of((slice(None), None)), ceiling_square[1:, None]
    )
    middle_mps, force_n = np.sqrt((from_square[:, None] + after) / 2.0), np.abs(work_j) / cell_m
    cost_j = np.where(
        work_j > 0.0,
        work_j / train.traction_efficiency(middle_mps, force_n),
        use_ratio * train.regeneration_efficiency(middle_mps, force_n) * work_j,
    )
    cost_j[:, HOLD] -= STEADY_RATIO * kinetic_j
    time_s = 2.0 * cell_m / (np.sqrt(from_square)[:, None] + np.sqrt(after) + 1e-9)
    # A train below the slowest speed of the grid does not go on, unless it is at the end.
    stalls = (after < grid[0]) & (ceiling_square[1:, None, None] >= grid[0])
    cost_j = np.where(stalls, FAR_J, cost_j)
    index = np.clip(np.searchsorted(grid, after) - 1, 0, SPEEDS - 2)
    share = np.clip((after - grid[index]) / (grid[index + 1] - grid[index]), 0.0, 1.0)
    regime = np.empty((cells, PRICES, SPEEDS), dtype=np.int8)
    value = np.zeros((PRICES, SPEEDS))
    for cell in range(cells - 1, -1, -1):
        near, far = value[:, index[cell]], value[:, index[cell] + 1]
        total = near + share[cell] * (far - near) + cost_j[cell]
        total += prices[:, None, None] * time_s[cell]
        regime[cell] = np.argmin(total, axis=1)
        value = np.min(total, axis=1)
    return Thrift(regime, grid_mps)


def _moves(
    train: RunningTrain, cell_m: float, at: Numbers, drag: CellDrag, ceiling_square: Numbers
) -> tuple[Numbers, Numbers]:
    """Return the squares of the speed after each cell, and the work at the wheel, negative while
    the electric brake works; both (cells, 3, SPEEDS).
    """
    gain = 2.0 * cell_m / train.mass_kg
    coasting_n, pull_n, keep_n = forces_n(train, at, drag, cell_m)
    effort_n = np.stack([pull_n, keep_n, np.zeros_like(pull_n)], axis=1)
    after = np.maximum(at[:, None] + gain * (effort_n - coasting_n[:, None]), 0.0)
    capped = after > ceiling_square[:, None]
    keeping_n = (ceiling_square - at) / gain + coasting_n
    work_j = np.where(capped, keeping_n[:, None], effort_n) * cell_m
    return np.minimum(after, ceiling_square[:, None]), work_j
