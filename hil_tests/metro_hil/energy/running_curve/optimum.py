"""The optimal control of the same task, by successive linear programmes over the way.

Over the way the motion is linear in the square of the speed, M dz/ds = 2 (F - B - W - R(v) - G).
Energies are sums of force times distance. Running time, power limits and resistance are not linear;
they are linearised around the last solution. A trust region grows where that improved the run and
shrinks where it did not. Each force is free in every cell.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_matrix, csr_matrix

from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import Numbers, RunningTrain

ITERATIONS: Final = 60
TRUST_START_RATIO: Final = 0.05
TRUST_END_RATIO: Final = 2.0e-4
TIME_PRICE_RATIO: Final = 0.2
"""Price of a second of lateness, as a share of the first solution's energy; more than a second
saves."""
LEAST_MPS: Final = 0.05


@dataclass(frozen=True, slots=True)
class Optimum:
    """Arrays by node (speed) or by cell (forces)."""

    use_ratio: float
    """k: share of the regenerated energy that is used."""
    time_s: float
    acceleration_j: float
    regenerated_j: float
    friction_j: float
    """Energy of the friction brake, at the wheel."""
    at_m: Numbers
    speed_mps: Numbers
    traction_n: Numbers
    electric_n: Numbers
    friction_n: Numbers
    iterations: int

    @property
    def cost_j(self) -> float:
        """J, the minimised energy."""
        return self.acceleration_j - self.use_ratio * self.regenerated_j


class NotSolvedError(RuntimeError):
    """The linear programmes found no solution; an error of this program, not of the task."""


def optimise(
    train: RunningTrain,
    track: HopTrack,
    time_s: float,
    use_ratio: float,
    start_square: Numbers,
) -> Optimum:
    """Minimise E_acc - k * E_reg over all runs of at most `time_s`.

    Args:
        start_square: (cells + 1,) squared speed of any run, from which the search begins.
    """
    square = _repaired(track, start_square)
    trust_ratio = TRUST_START_RATIO
    price_j_per_s = 0.0
    best: Optimum | None = None
    best_merit_j = np.inf
    done = 0
    for done in range(1, ITERATIONS + 1):
        found, foretold_j = _programme(
            train, track, square, time_s, use_ratio, trust_ratio, price_j_per_s
        )
        if price_j_per_s == 0.0:
            price_j_per_s = TIME_PRICE_RATIO * max(foretold_j, 1.0)
        now = _evaluated(train, track, found, use_ratio, done)
        merit_j = now.cost_j + price_j_per_s * max(0.0, now.time_s - time_s)
        if merit_j < best_merit_j:
            best, best_merit_j, square = now, merit_j, found
            trust_ratio *= 1.5
        else:
            trust_ratio *= 0.4
        if trust_ratio < TRUST_END_RATIO:
            break
    if best is None:
        raise NotSolvedError("no linear programme had a solution")
    return best


def _repaired(track: HopTrack, square: Numbers) -> Numbers:
    inside = np.clip(square, LEAST_MPS**2, track.ceiling_mps**2)
    inside[0] = inside[-1] = 0.0
    return inside


def _evaluated(
    train: RunningTrain, track: HopTrack, square: Numbers, use_ratio: float, iterations: int
) -> Optimum:
    """Compute the forces for these speeds with the whole nonlinear model.

    A cell brakes electrically as far as power and force allow and by friction beyond. A cell that
    needs more traction than available takes extra time as a penalty: see `excess_n`.
    """
    step_m = track.cell_m
    speed = np.sqrt(square)
    middle = np.sqrt((square[1:] + square[:-1]) / 2.0)
    net_n = (
        train.mass_kg * np.diff(square) / (2.0 * step_m)
        + train.resistance_at_n(middle)
        + track.grade_n
    )
    traction_n = np.maximum(net_n, 0.0)
    braking_n = np.maximum(-net_n, 0.0)
    electric_n = np.minimum(braking_n, train.braking_at_n(middle, train.brake_power_w))
    friction_n = braking_n - electric_n
    # Excess traction costs the time without it.
    excess_n = np.maximum(traction_n - train.traction_at_n(middle), 0.0)
    time_s = float(np.sum(2.0 * step_m / (speed[1:] + speed[:-1])))
    time_s += float(np.sum(excess_n / train.traction_force_n)) * step_m / float(np.max(speed))
    return Optimum(
        use_ratio=use_ratio,
        time_s=time_s,
        acceleration_j=float(np.sum(traction_n)) * step_m / train.traction_efficiency_ratio,
        regenerated_j=float(np.sum(electric_n)) * step_m * train.regeneration_efficiency_ratio,
        friction_j=float(np.sum(friction_n)) * step_m,
        at_m=track.at_m,
        speed_mps=speed,
        traction_n=traction_n,
        electric_n=electric_n,
        friction_n=friction_n,
        iterations=iterations,
    )


def _programme(
    train: RunningTrain,
    track: HopTrack,
    square: Numbers,
    time_s: float,
    use_ratio: float,
    trust_ratio: float,
    price_j_per_s: float,
) -> tuple[Numbers, float]:
    """Solve one linear programme: return squared speeds (cells + 1,) and the predicted energy.

    Unknowns are the inner squared speeds, the three forces in units of the greatest traction, and
    the lateness. Lateness is permitted at a price, so that a solution always exists.
    """
    n, step_m, unit_n = track.cells, track.cell_m, train.traction_force_n
    inner = n - 1
    late = inner + 3 * n
    middle_square = (square[1:] + square[:-1]) / 2.0
    middle = np.sqrt(middle_square)
    drag_n, slope = _resistance(train, middle)
    nodes = _Nodes(n)
    # Equation of motion in each cell.
    inertia = train.mass_kg / (2.0 * step_m)
    right_n = -(drag_n - slope * middle_square) - track.grade_n
    motion = nodes.cells(inertia + slope / 2.0, -inertia + slope / 2.0, late + 1) / unit_n
    forces = _forces(n, inner, late + 1)
    # Powers: F <= P / v, as a tangent in the square of the speed.
    powers = []
    limits = []
    for block, power_w, force_n in (
        (0, train.traction_power_w, train.traction_force_n),
        (1, train.brake_power_w, train.brake_force_n),
    ):
        limit_n, tangent = power_w / middle, -0.5 * power_w / middle**3
        rows = nodes.cells(-tangent / 2.0, -tangent / 2.0, late + 1) / unit_n
        powers.append(rows + _block(n, inner + block * n, late + 1))
        limits.append((limit_n - tangent * middle_square) / unit_n)
        assert force_n > 0.0
    # Both brakes together.
    powers.append(_block(n, inner + n, late + 1) + _block(n, inner + 2 * n, late + 1))
    limits.append(np.full(n, train.service_force_n / unit_n))
    # Time.
    run_s, slopes = _time(square, step_m)
    time_row = np.zeros(late + 1)
    time_row[:inner] = slopes[1:-1]
    time_row[late] = -1.0
    limits.append(np.array([time_s - run_s + float(slopes[1:-1] @ square[1:-1])]))
    powers.append(csr_matrix(time_row))
    cost = np.zeros(late + 1)
    joule = unit_n * step_m
    cost[inner : inner + n] = joule / train.traction_efficiency_ratio
    cost[inner + n : inner + 2 * n] = -use_ratio * joule * train.regeneration_efficiency_ratio
    cost[late] = price_j_per_s or 1e9
    return _solved(
        train, track, square, trust_ratio, cost, motion - forces, right_n / unit_n, powers, limits
    )


def _solved(
    train: RunningTrain,
    track: HopTrack,
    square: Numbers,
    trust_ratio: float,
    cost: Numbers,
    motion: csr_matrix,
    right: Numbers,
    powers: list[csr_matrix],
    limits: list[Numbers],
) -> tuple[Numbers, float]:
    from scipy.sparse import vstack

    n, unit_n = track.cells, train.traction_force_n
    reach = trust_ratio * np.maximum(square[1:-1], 4.0)
    low = np.maximum(square[1:-1] - reach, LEAST_MPS**2)
    high = np.minimum(square[1:-1] + reach, track.ceiling_mps[1:-1] ** 2)
    bounds = np.concatenate(
        [
            np.column_stack([np.minimum(low, high), high]),
            np.tile([0.0, 1.0], (n, 1)),
            np.tile([0.0, train.brake_force_n / unit_n], (n, 1)),
            np.tile([0.0, train.service_force_n / unit_n], (n, 1)),
            [[0.0, 1e4]],
        ]
    )
    scale = float(np.max(np.abs(cost[:-1])))
    done = linprog(
        cost / scale,
        A_ub=vstack(powers),
        b_ub=np.concatenate(limits),
        A_eq=motion,
        b_eq=right,
        bounds=bounds,
        method="highs",
    )
    if done.x is None:
        raise NotSolvedError(f"linear programme: {done.message}")
    found = np.zeros(n + 1)
    found[1:-1] = done.x[: n - 1]
    return found, float(done.fun) * scale


def _resistance(train: RunningTrain, middle: Numbers) -> tuple[Numbers, Numbers]:
    """Return the resistance and its slope over the square of the speed."""
    slope = (
        train.resistance_n_per_mps / np.maximum(middle, LEAST_MPS)
        + 2.0 * train.resistance_n_per_mps2
    ) / 2.0
    return train.resistance_at_n(middle), slope


def _time(square: Numbers, step_m: float) -> tuple[float, Numbers]:
    """Return the running time and its slope over each node's square; both ends are ignored."""
    speed = np.sqrt(square)
    pair = speed[1:] + speed[:-1]
    slopes = np.zeros(len(square))
    with np.errstate(divide="ignore"):
        by_speed = -2.0 * step_m / pair**2
        slopes[1:] += by_speed / (2.0 * speed[1:])
        slopes[:-1] += by_speed / (2.0 * speed[:-1])
    return float(np.sum(2.0 * step_m / pair)), slopes


class _Nodes:
    """Matrix rows of one cell each, over the inner nodes on both its sides."""

    def __init__(self, cells: int) -> None:
        self._cells = cells

    def cells(self, after: Numbers | float, before: Numbers | float, width: int) -> csr_matrix:
        n = self._cells
        after = np.broadcast_to(np.asarray(after, dtype=float), (n,))
        before = np.broadcast_to(np.asarray(before, dtype=float), (n,))
        rows = np.concatenate([np.arange(n - 1), np.arange(1, n)])
        columns = np.concatenate([np.arange(n - 1), np.arange(n - 1)])
        values = np.concatenate([after[:-1], before[1:]])
        return coo_matrix((values, (rows, columns)), shape=(n, width)).tocsr()


def _block(n: int, first: int, width: int) -> csr_matrix:
    rows = np.arange(n)
    return coo_matrix((np.ones(n), (rows, first + rows)), shape=(n, width)).tocsr()


def _forces(n: int, first: int, width: int) -> csr_matrix:
    """Return traction less both brakes."""
    traction, electric, friction = (_block(n, first + k * n, width) for k in range(3))
    return traction - electric - friction
