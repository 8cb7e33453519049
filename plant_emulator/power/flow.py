"""Currents and voltages of a DC network that is a tree, solved by Newton's method.

Each node has a higher number than its parent. A root has parent -1, so several trees can be solved
at once. Each node may have a source (a substation or a storage) and a load (a train).

    sum of branch currents out of the node = source(V) - load(V)

A source gives I = (d + sqrt(d² + e²)) / 2R, d = V0 - V, as a rectifier does. This has no kink and
accepts no current. An inverter or a storage takes current above a voltage of its own by the same
formula. A bound on either current is approached smoothly. A small load of the source's own takes
the current that remains far above V0. A train takes constant power, and less under a low voltage.
The higher the voltage, the more of the regenerated power goes into the train's own resistor.
Newton's matrix has the tree's structure, so elimination from the leaves is exact and takes a few
operations a node.

Vectors are lists, which is fast enough to solve one line of trains instant by instant. The copy of
this module that numba compiles (`compiled.jitted`) takes arrays instead.
"""

import math
from typing import Final

Numbers = list[float]
Indices = list[int]
Rows = list[list[float]]

NO_EFFORT, FULL_EFFORT, CHOPS_FROM, CHOPS_ALL, SMOOTH, FLOOR, CEILING = range(7)
"""Indices into `limits`; all limits are in V."""
GIVES_BELOW, GIVES_OHM, GIVES_MAX, TAKES_ABOVE, TAKES_OHM, TAKES_MAX = range(6)
"""Rows of `sources`: voltage in V, resistance in ohm and greatest current in A of giving and of
taking. A resistance of 0 is a node that never gives, or never takes. A bound of infinity is none.
"""
SOURCE_ROWS: Final = 6
LEAST_A: Final = 1.0e-3
"""Least bound of a current; it keeps the bounded formula finite."""
IDLE_S: Final = 0.005
"""Conductance of each substation's own load; it takes about 4 A."""
TOLERANCE_A: Final = 1.0e-4
ITERATIONS: Final = 40
HALVINGS: Final = 12
HOMOTOPY_STEPS: Final = 20
LEAST_DIAGONAL_S: Final = 1.0e-9
CLOSE_A: Final = 0.5
"""Residual below which a step is accepted even if it does not reduce the greatest residual, A."""
LEAST_M: Final = 0.1
"""Minimum distance between two nodes of a section. It bounds the conductance between two trains."""


def arrange(
    order: Indices,
    joints_of: list[Indices],
    spans_m: Rows,
    ohms_per_m: Numbers,
    train_section: Indices,
    train_m: Numbers,
    parent: Indices,
    siemens: Numbers,
    node_of_train: Indices,
    node_of_joint: Indices,
    sorted_trains: Indices,
) -> int:
    """Number the nodes for trains at these places, in place, and return the number of nodes.

    Roots come first. Then each section follows from its earlier joint: its trains by place, then
    its far joint.
    """
    n = 0
    for joint in range(len(node_of_joint)):
        if node_of_joint[joint] == -2:
            parent[n], siemens[n] = -1, 0.0
            node_of_joint[joint] = n
            n += 1
    for section in order:
        near, far = joints_of[section][0], joints_of[section][1]
        begin_m, end_m = spans_m[section][0], spans_m[section][1]
        count = 0
        for train in range(len(train_m)):
            if train_section[train] != section:
                continue
            place = count
            while place > 0 and abs(train_m[sorted_trains[place - 1]] - begin_m) > abs(
                train_m[train] - begin_m
            ):
                sorted_trains[place] = sorted_trains[place - 1]
                place -= 1
            sorted_trains[place] = train
            count += 1
        last, at_m = node_of_joint[near], begin_m
        for place in range(count):
            train = sorted_trains[place]
            gap_m = max(LEAST_M, abs(train_m[train] - at_m))
            parent[n], siemens[n] = last, 1.0 / (ohms_per_m[section] * gap_m)
            node_of_train[train] = n
            last, at_m = n, train_m[train]
            n += 1
        gap_m = max(LEAST_M, abs(end_m - at_m))
        parent[n], siemens[n] = last, 1.0 / (ohms_per_m[section] * gap_m)
        node_of_joint[far] = n
        n += 1
    return n


def effort_share(voltage_v: float, limits: Numbers) -> tuple[float, float]:
    """Return the share of the wanted traction power that the voltage permits, and its slope."""
    at = (voltage_v - limits[NO_EFFORT]) / (limits[FULL_EFFORT] - limits[NO_EFFORT])
    if at <= 0.0:
        return 0.0, 0.0
    if at >= 1.0:
        return 1.0, 0.0
    slope = 6.0 * at * (1.0 - at) / (limits[FULL_EFFORT] - limits[NO_EFFORT])
    return at * at * (3.0 - 2.0 * at), slope


def chopped_share(voltage_v: float, limits: Numbers) -> tuple[float, float]:
    """Return the share of the regenerated power that goes into the train's resistor, and its slope.

    The share exceeds 1 at high voltage only to guide the search. No solution lies there: such a
    train would be a load at the highest voltage of the network, and no source feeds that high.
    """
    span = limits[CHOPS_ALL] - limits[CHOPS_FROM]
    at = (voltage_v - limits[CHOPS_FROM]) / span
    if at <= 0.0:
        return 0.0, 0.0
    return at * at, 2.0 * at / span


def smooth_a(excess_v: float, ohm: float, most_a: float, limits: Numbers) -> tuple[float, float]:
    """Return the current that a positive excess of voltage drives, and its slope."""
    root = math.sqrt(excess_v * excess_v + limits[SMOOTH] * limits[SMOOTH])
    current = (excess_v + root) / (2.0 * ohm)
    slope = (1.0 + excess_v / root) / (2.0 * ohm)
    if most_a == math.inf:
        return current, slope
    part = current / max(LEAST_A, most_a)
    square = 1.0 + part * part
    return current / math.sqrt(square), slope / (square * math.sqrt(square))


def given_a(voltage_v: float, node: int, sources: Rows, limits: Numbers) -> float:
    """Return the current that the node's rectifier or storage gives."""
    ohm = sources[GIVES_OHM][node]
    if ohm <= 0.0:
        return 0.0
    lack_v = sources[GIVES_BELOW][node] - voltage_v
    current, _ = smooth_a(lack_v, ohm, sources[GIVES_MAX][node], limits)
    return current


def taken_a(voltage_v: float, node: int, sources: Rows, limits: Numbers) -> float:
    """Return the current that the node's inverter or storage takes."""
    ohm = sources[TAKES_OHM][node]
    if ohm <= 0.0:
        return 0.0
    excess_v = voltage_v - sources[TAKES_ABOVE][node]
    current, _ = smooth_a(excess_v, ohm, sources[TAKES_MAX][node], limits)
    return current


def source_current(
    voltage_v: float, node: int, sources: Rows, limits: Numbers
) -> tuple[float, float]:
    """Return the current of a source, minus what it takes and its own load, and its slope over the
    voltage.
    """
    ohm = sources[GIVES_OHM][node]
    if ohm <= 0.0:
        return 0.0, 0.0
    lack_v = sources[GIVES_BELOW][node] - voltage_v
    current, slope = smooth_a(lack_v, ohm, sources[GIVES_MAX][node], limits)
    current, slope = current - IDLE_S * voltage_v, -slope - IDLE_S
    if sources[TAKES_OHM][node] > 0.0:
        excess_v = voltage_v - sources[TAKES_ABOVE][node]
        taken, taken_slope = smooth_a(
            excess_v, sources[TAKES_OHM][node], sources[TAKES_MAX][node], limits
        )
        current, slope = current - taken, slope - taken_slope
    return current, slope


def load_power(
    voltage_v: float, wants_w: float, gives_w: float, auxiliary_w: float, limits: Numbers
) -> tuple[float, float]:
    """Return the power that a train takes from the line (negative: it feeds), and its slope over
    the voltage.
    """
    effort, effort_slope = effort_share(voltage_v, limits)
    chopped, chopped_slope = chopped_share(voltage_v, limits)
    power = wants_w * effort + auxiliary_w - gives_w * (1.0 - chopped)
    return power, wants_w * effort_slope + gives_w * chopped_slope


def residuals(
    parent: Indices,
    siemens: Numbers,
    sources: Rows,
    loads: Rows,
    share: float,
    limits: Numbers,
    volts: Numbers,
    out: Numbers,
    n: int,
) -> float:
    """Write the missing current at each node into `out` (n,) and return the greatest, in A."""
    wants_w, gives_w, auxiliary_w = loads[0], loads[1], loads[2]
    for i in range(n):
        v = volts[i]
        gained, _ = source_current(v, i, sources, limits)
        power, _ = load_power(
            v, share * wants_w[i], share * gives_w[i], share * auxiliary_w[i], limits
        )
        out[i] = gained - power / v
    for i in range(n):
        if parent[i] >= 0:
            current = siemens[i] * (volts[i] - volts[parent[i]])
            out[i] -= current
            out[parent[i]] += current
    worst = 0.0
    for i in range(n):
        worst = max(worst, abs(out[i]))
    return worst


def newton_step(
    parent: Indices,
    siemens: Numbers,
    sources: Rows,
    loads: Rows,
    share: float,
    limits: Numbers,
    volts: Numbers,
    out: Numbers,
    work: Numbers,
    n: int,
) -> None:
    """Replace the residuals in `out` by the voltage changes that would remove them."""
    wants_w, gives_w, auxiliary_w = loads[0], loads[1], loads[2]
    for i in range(n):
        v = volts[i]
        _, gain = source_current(v, i, sources, limits)
        power, slope = load_power(
            v, share * wants_w[i], share * gives_w[i], share * auxiliary_w[i], limits
        )
        work[i] = -gain + slope / v - power / (v * v) + siemens[i]
    for i in range(n):
        if parent[i] >= 0:
            work[parent[i]] += siemens[i]
        else:
            work[i] -= siemens[i]
    # Eliminate from the leaves to the root, then substitute back.
    for i in range(n - 1, -1, -1):
        if abs(work[i]) < LEAST_DIAGONAL_S:
            work[i] = LEAST_DIAGONAL_S
        if parent[i] >= 0:
            part = siemens[i] / work[i]
            work[parent[i]] -= part * siemens[i]
            out[parent[i]] += part * out[i]
    for i in range(n):
        if parent[i] >= 0:
            out[i] += siemens[i] * out[parent[i]]
        out[i] /= work[i]


def newton(
    parent: Indices,
    siemens: Numbers,
    sources: Rows,
    loads: Rows,
    share: float,
    limits: Numbers,
    volts: Numbers,
    work: Rows,
    n: int,
) -> int:
    """Solve for `volts` (n,) in place, from its present values, with this share of the loads.

    Returns the number of iterations, or -1 without convergence. `work` is (4, n).
    """
    missing_a, diagonal, tried_v, then_a = work[0], work[1], work[2], work[3]
    worst = residuals(parent, siemens, sources, loads, share, limits, volts, missing_a, n)
    for iteration in range(ITERATIONS):
        if worst < TOLERANCE_A:
            return iteration
        newton_step(parent, siemens, sources, loads, share, limits, volts, missing_a, diagonal, n)
        factor = 1.0
        better = worst
        for _halving in range(HALVINGS):
            for i in range(n):
                changed = volts[i] + factor * missing_a[i]
                tried_v[i] = min(max(changed, limits[FLOOR]), limits[CEILING])
            better = residuals(parent, siemens, sources, loads, share, limits, tried_v, then_a, n)
            if better < worst or (worst < CLOSE_A and better < CLOSE_A):
                break
            factor *= 0.5
        for i in range(n):
            volts[i] = tried_v[i]
            missing_a[i] = then_a[i]
        worst = better
    return ITERATIONS if worst < TOLERANCE_A else -1


def solve(
    parent: Indices,
    siemens: Numbers,
    sources: Rows,
    loads: Rows,
    limits: Numbers,
    volts: Numbers,
    work: Rows,
    n: int,
) -> int:
    """Solve for `volts` by `newton`: from the last voltages, then from no load, then along growing
    loads.

    Args:
        sources: (SOURCE_ROWS, n), see above.
        loads: (3, n): traction wanted, regeneration offered, auxiliaries.
        work: (4, n), scratch space.
    """
    done = newton(parent, siemens, sources, loads, 1.0, limits, volts, work, n)
    if done >= 0:
        return done
    spent = ITERATIONS
    highest = 0.0
    for i in range(n):
        highest = max(highest, sources[0][i])
    for i in range(n):
        volts[i] = highest
    done = newton(parent, siemens, sources, loads, 1.0, limits, volts, work, n)
    if done >= 0:
        return spent + done
    spent += ITERATIONS
    for i in range(n):
        volts[i] = highest
    for step in range(1, HOMOTOPY_STEPS + 1):
        share = step / HOMOTOPY_STEPS
        done = newton(parent, siemens, sources, loads, share, limits, volts, work, n)
        spent += ITERATIONS
    return spent if done >= 0 else -1
