"""The optimal control of the same task, by successive linear programmes over the way.

Over the way the motion is linear in the square of the speed, M dz/ds = 2 (F - B - W - R(v) - G).
Energies are sums of force times distance. Running time, power limits and resistance are not linear;
they are linearised around the last solution. A trust region grows where that improved the run and
shrinks where it did not. Each force is free in every cell.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_matrix, csr_matrix

from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import Numbers, RunningTrain, along

ITERATIONS: Final = 60
TRUST_START_RATIO: Final = 0.05
TRUST_END_RATIO: Final = 2.0e-4
TRUST_MAX_RATIO: Final = 10.0
FIRST_PRICE_RATIO: Final = 80.0
"""First price of a second of lateness, relative to the kinetic energy at the mean speed for each
second of the running time. A second later saves a few times this energy per second."""
PRICE_GROWTH_RATIO: Final = 4.0
"""Growth of the price of lateness each time the search still accepts a late run."""
LATE_MAX_S: Final = 0.02
"""Lateness that an answer may have; below what the grid of the way resolves."""
CHECK_RATIO: Final = 0.02
"""Trust region of the programme that gives the costate of the answer."""
FORCE_TOLERANCE_RATIO: Final = 0.01
VALUE_TOLERANCE_RATIO: Final = 0.02
CURVE_STEP_RATIO: Final = 0.001
"""Half width of the difference that gives the slope of an effort curve, as a share of the speed."""
SLOPE_RATIO: Final = 0.02
"""Half width of the difference that gives the slope of an efficiency map."""
AT_LIMIT_RATIO: Final = 0.997
"""Tolerances of the check: of forces, of the costate, and of a speed that follows a limit."""
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
    value_ratio: Numbers
    """Costate by cell, (cells,): energy that one more joule of motion saves later."""
    iterations: int

    @property
    def cost_j(self) -> float:
        """J, the minimised energy."""
        return self.acceleration_j - self.use_ratio * self.regenerated_j


class NotSolvedError(RuntimeError):
    """The search found no run that passes the checks of an optimum."""


def optimise(
    train: RunningTrain,
    track: HopTrack,
    time_s: float,
    use_ratio: float,
    start_square: Numbers,
) -> Optimum:
    """Minimise E_acc - k * E_reg over all runs of at most `time_s`.

    Raises NotSolvedError when the best run found is late or breaks the rules of an optimum.

    Args:
        start_square: (cells + 1,) squared speed of any run, from which the search begins. The
            answer costs no more than this run, unless this run is late.
    """
    square = _repaired(track, start_square)
    trust_ratio = TRUST_START_RATIO
    price_j_per_s = _first_price_j_per_s(train, track, time_s)
    best = _evaluated(train, track, square, use_ratio)
    for done in range(1, ITERATIONS + 1):
        found = _programme(train, track, square, time_s, use_ratio, trust_ratio, price_j_per_s)
        if found is None:
            # No run as near as this to the last one obeys all limits.
            trust_ratio *= 2.0
            if trust_ratio > TRUST_MAX_RATIO:
                break
            continue
        now = _evaluated(train, track, found.square_m2_per_s2, use_ratio)
        if _merit_j(now, time_s, price_j_per_s) < _merit_j(best, time_s, price_j_per_s):
            best = replace(now, iterations=done)
            square = found.square_m2_per_s2
            trust_ratio *= 1.5
        else:
            trust_ratio *= 0.4
        if trust_ratio >= TRUST_END_RATIO:
            continue
        if best.time_s - time_s <= LATE_MAX_S:
            break
        # Lateness was cheaper than energy, so the search goes on at a higher price.
        price_j_per_s *= PRICE_GROWTH_RATIO
        trust_ratio = TRUST_START_RATIO
    near = _programme(train, track, square, time_s, use_ratio, CHECK_RATIO, price_j_per_s)
    if near is None:
        raise NotSolvedError("no run close to the best one obeys all limits")
    best = replace(best, value_ratio=near.value_ratio)
    check(train, track, best, time_s)
    return best


def check(train: RunningTrain, track: HopTrack, run: Optimum, time_s: float) -> None:
    """Hold a run against its task and against Pontryagin's rules. Raises NotSolvedError.

    The costate decides the regime: full traction above 1 / eta_t, coasting below it, electric brake
    below k * eta_r, friction below 0. A force between nothing and its maximum needs the costate at
    its threshold, except where the train follows a speed limit.
    """
    if not run.time_s - time_s <= LATE_MAX_S:
        raise NotSolvedError(f"the best run takes {run.time_s:.2f} s instead of {time_s:g} s")
    middle = np.sqrt((run.speed_mps[1:] ** 2 + run.speed_mps[:-1] ** 2) / 2.0)
    unit_n = FORCE_TOLERANCE_RATIO * train.traction_force_n
    over = run.traction_n > train.traction_at_n(middle) + unit_n
    over |= run.electric_n + run.friction_n > train.service_force_n + unit_n
    low, high, regime = _right_values(train, run, middle, unit_n)
    tolerance = VALUE_TOLERANCE_RATIO / train.traction_efficiency_ratio
    wrong = (run.value_ratio < low - tolerance) | (run.value_ratio > high + tolerance)
    ceiling_mps = np.minimum(track.ceiling_mps[1:], track.ceiling_mps[:-1])
    wrong &= np.maximum(run.speed_mps[1:], run.speed_mps[:-1]) < AT_LIMIT_RATIO * ceiling_mps
    # In a cell in which the regime changes, the force is between those of both regimes.
    changes = int(np.sum(np.diff(regime) != 0))
    if np.any(over) or int(np.sum(wrong)) > changes:
        at_m = float(track.at_m[int(np.argmax(over if np.any(over) else wrong))])
        what = "needs more force than the train has" if np.any(over) else "is not optimal"
        raise NotSolvedError(f"the best run {what} at {at_m:.0f} m of the way")


def _right_values(
    train: RunningTrain, run: Optimum, middle: Numbers, unit_n: float
) -> tuple[Numbers, Numbers, Numbers]:
    """Return the least and the greatest costate that fit each cell's forces, and its regime."""
    pulls, brakes, rubs = run.traction_n > unit_n, run.electric_n > unit_n, run.friction_n > unit_n
    full_pull = run.traction_n > train.traction_at_n(middle) - unit_n
    full_electric = run.electric_n > train.braking_at_n(middle, train.brake_power_w) - unit_n
    full_brake = run.electric_n + run.friction_n > train.service_force_n - unit_n
    pull = _drawn_slopes(train, middle, run.traction_n)[0]
    regain = run.use_ratio * _returned_slopes(train, middle, run.electric_n)[0]
    cases = [pulls, rubs, brakes]
    high = np.select(cases, [np.where(full_pull, np.inf, pull), 0.0, regain], pull)
    low = np.select(cases, [pull, 0.0, np.where(full_electric, 0.0, regain)], regain)
    return np.where(full_brake, -np.inf, low), high, np.select(cases, [1, 2, 3], 0)


def _merit_j(run: Optimum, time_s: float, price_j_per_s: float) -> float:
    return run.cost_j + price_j_per_s * max(0.0, run.time_s - time_s)


def _first_price_j_per_s(train: RunningTrain, track: HopTrack, time_s: float) -> float:
    """Price of a second of lateness at the beginning of the search.

    It follows from the kinetic energy at the mean speed and not from the energy of the run, which
    may be negative on falling track.
    """
    kinetic_j = train.mass_kg * (track.length_m / time_s) ** 2 / 2.0
    return FIRST_PRICE_RATIO * kinetic_j / time_s


def _repaired(track: HopTrack, square: Numbers) -> Numbers:
    inside = np.clip(square, LEAST_MPS**2, track.ceiling_mps**2)
    inside[0] = inside[-1] = 0.0
    return inside


def _evaluated(train: RunningTrain, track: HopTrack, square: Numbers, use_ratio: float) -> Optimum:
    """Compute the forces for these speeds with the whole nonlinear model.

    A cell brakes electrically as far as power and force allow and by friction beyond. A cell that
    needs more traction than available takes extra time as a penalty: see `excess_n`.
    """
    step_m = track.cell_m
    speed = np.sqrt(square)
    middle = np.sqrt((square[1:] + square[:-1]) / 2.0)
    net_n = (
        train.mass_kg * np.diff(square) / (2.0 * step_m)
        + train.resistance_at_n(middle, track.drag.air_ratio)
        + track.drag.grade_n
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
        acceleration_j=_drawn_j(train, middle, traction_n, step_m),
        regenerated_j=_returned_j(train, middle, electric_n, step_m),
        friction_j=float(np.sum(friction_n)) * step_m,
        at_m=track.at_m,
        speed_mps=speed,
        traction_n=traction_n,
        electric_n=electric_n,
        friction_n=friction_n,
        value_ratio=np.full(track.cells, np.nan),
        iterations=0,
    )


def _drawn_j(train: RunningTrain, middle: Numbers, force_n: Numbers, step_m: float) -> float:
    if train.traction_map is None:
        return float(np.sum(force_n)) * step_m / train.traction_efficiency_ratio
    return float(np.sum(force_n / train.traction_efficiency(middle, force_n))) * step_m


def _returned_j(train: RunningTrain, middle: Numbers, force_n: Numbers, step_m: float) -> float:
    if train.regeneration_map is None:
        return float(np.sum(force_n)) * step_m * train.regeneration_efficiency_ratio
    return float(np.sum(force_n * train.regeneration_efficiency(middle, force_n))) * step_m


def _drawn_slopes(
    train: RunningTrain, middle: Numbers, force_n: Numbers
) -> tuple[Numbers | float, Numbers | float]:
    """Slopes of the drawn energy of each metre, over the force and over the square of the speed."""
    if train.traction_map is None:
        return 1.0 / train.traction_efficiency_ratio, 0.0

    def drawn_n(square: Numbers, at_n: Numbers) -> Numbers:
        return at_n / train.traction_efficiency(np.sqrt(square), at_n)

    return _slopes(drawn_n, middle, force_n, SLOPE_RATIO * train.traction_force_n)


def _returned_slopes(
    train: RunningTrain, middle: Numbers, force_n: Numbers
) -> tuple[Numbers | float, Numbers | float]:
    """The same of the returned energy."""
    if train.regeneration_map is None:
        return train.regeneration_efficiency_ratio, 0.0

    def returned_n(square: Numbers, at_n: Numbers) -> Numbers:
        return at_n * train.regeneration_efficiency(np.sqrt(square), at_n)

    return _slopes(returned_n, middle, force_n, SLOPE_RATIO * train.brake_force_n)


def _slopes(
    of: Callable[[Numbers, Numbers], Numbers], middle: Numbers, force_n: Numbers, step_n: float
) -> tuple[Numbers, Numbers]:
    square = middle**2
    low_n, high_n = np.maximum(force_n - step_n, 0.0), force_n + step_n
    by_force = (of(square, high_n) - of(square, low_n)) / (high_n - low_n)
    low, high = square * (1.0 - SLOPE_RATIO), square * (1.0 + SLOPE_RATIO) + LEAST_MPS**2
    return by_force, (of(high, force_n) - of(low, force_n)) / (high - low)


def _programme(
    train: RunningTrain,
    track: HopTrack,
    square: Numbers,
    time_s: float,
    use_ratio: float,
    trust_ratio: float,
    price_j_per_s: float,
) -> "_Solution | None":
    """Solve one linear programme.

    Unknowns are the inner squared speeds, the three forces in units of the greatest traction, and
    the lateness. Lateness is permitted at a price, so that a solution always exists.
    """
    n, step_m, unit_n = track.cells, track.cell_m, train.traction_force_n
    inner = n - 1
    late = inner + 3 * n
    middle_square = (square[1:] + square[:-1]) / 2.0
    middle = np.sqrt(middle_square)
    drag_n, slope = _resistance(train, middle, track.drag.air_ratio)
    nodes = _Nodes(n)
    # Equation of motion in each cell.
    inertia = train.mass_kg / (2.0 * step_m)
    right_n = -(drag_n - slope * middle_square) - track.drag.grade_n
    motion = nodes.cells(inertia + slope / 2.0, -inertia + slope / 2.0, late + 1) / unit_n
    forces = _forces(n, inner, late + 1)
    # Powers: F <= P / v, or F <= the curve, as a tangent in the square of the speed.
    powers = []
    limits = []
    for block, (limit_n, tangent) in enumerate(_most_forces(train, middle)):
        rows = nodes.cells(-tangent / 2.0, -tangent / 2.0, late + 1) / unit_n
        powers.append(rows + _block(n, inner + block * n, late + 1))
        limits.append((limit_n - tangent * middle_square) / unit_n)
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
    now = _evaluated(train, track, square, use_ratio)
    drawn, drawn_by_square = _drawn_slopes(train, middle, now.traction_n)
    returned, returned_by_square = _returned_slopes(train, middle, now.electric_n)
    cost[inner : inner + n] = joule * drawn
    cost[inner + n : inner + 2 * n] = -use_ratio * joule * returned
    by_square = np.zeros(n) + step_m * (drawn_by_square - use_ratio * returned_by_square)
    cost[:inner] = (by_square[1:] + by_square[:-1]) / 2.0
    cost[late] = price_j_per_s
    return _solved(
        train, track, square, trust_ratio, cost, motion - forces, right_n / unit_n, powers, limits
    )


def _most_forces(train: RunningTrain, middle: Numbers) -> list[tuple[Numbers, Numbers]]:
    """Bounds of traction and electric brake by speed, each with its slope over squared speed."""
    bounds: list[tuple[Numbers, Numbers]] = []
    for points, power_w in (
        (train.traction_effort, train.traction_power_w),
        (train.brake_effort, train.brake_power_w),
    ):
        if points:
            low, high = middle * (1.0 - CURVE_STEP_RATIO), middle * (1.0 + CURVE_STEP_RATIO)
            slope = (along(points, high) - along(points, low)) / (high**2 - low**2)
            bounds.append((along(points, middle), slope))
        else:
            bounds.append((power_w / middle, -0.5 * power_w / middle**3))
    return bounds


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
) -> "_Solution | None":
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
        return None
    found = np.zeros(n + 1)
    found[1:-1] = done.x[: n - 1]
    joule = unit_n * track.cell_m
    return _Solution(found, -np.asarray(done.eqlin.marginals) * scale / joule)


@dataclass(frozen=True, slots=True)
class _Solution:
    """Solution of one linear programme."""

    square_m2_per_s2: Numbers
    """(cells + 1,)"""
    value_ratio: Numbers
    """Dual of the motion: value of a joule at the wheel, (cells,)."""


def _resistance(
    train: RunningTrain, middle: Numbers, air_ratio: Numbers
) -> tuple[Numbers, Numbers]:
    """Return the resistance and its slope over the square of the speed."""
    slope = (
        train.resistance_n_per_mps / np.maximum(middle, LEAST_MPS)
        + 2.0 * train.resistance_n_per_mps2 * air_ratio
    ) / 2.0
    return train.resistance_at_n(middle, air_ratio), slope


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
