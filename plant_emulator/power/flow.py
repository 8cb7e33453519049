"""Currents and voltages of a DC network that is a tree, by Newton's method: the numbers only.

Nodes are numbered so that each one's parent comes before it; a root has parent -1, so several trees
are solved at once. Each node may have a source (a substation's rectifier) and a load (a train).

    sum of branch currents out of the node = source(V) - load(V)

The rectifier I = (d + sqrt(d² + e²)) / 2R, d = V0 - V, has no kink and takes nothing back; what it
still gives far above V0 goes into a small load of the substation's own. A train
takes its power at whatever voltage there is, less of it under a low voltage; what it regenerates
goes into its own resistor the more, the higher the voltage. Newton's matrix has the tree's
structure, so that elimination from the leaves is exact and costs a few operations a node.
"""

import math
from typing import Any, Final

from plant_emulator.power.compiled import kernel

NO_EFFORT, FULL_EFFORT, CHOPS_FROM, CHOPS_ALL, SMOOTH, FLOOR, CEILING = range(7)
"""Places in `limits`, all in V."""
IDLE_S: Final = 0.005
"""Of each substation's own load: 4 A."""
TOLERANCE_A: Final = 1.0e-4
ITERATIONS: Final = 40
HALVINGS: Final = 12
HOMOTOPY_STEPS: Final = 20
LEAST_DIAGONAL_S: Final = 1.0e-9
CLOSE_A: Final = 0.5
"""From here on steps that do not lessen the greatest residual are taken nevertheless."""


@kernel
def effort_share(voltage_v: float, limits: Any) -> tuple[float, float]:
    """Share of the wanted traction power that the voltage leaves, and its slope."""
    at = (voltage_v - limits[NO_EFFORT]) / (limits[FULL_EFFORT] - limits[NO_EFFORT])
    if at <= 0.0:
        return 0.0, 0.0
    if at >= 1.0:
        return 1.0, 0.0
    slope = 6.0 * at * (1.0 - at) / (limits[FULL_EFFORT] - limits[NO_EFFORT])
    return at * at * (3.0 - 2.0 * at), slope


@kernel
def chopped_share(voltage_v: float, limits: Any) -> tuple[float, float]:
    """Share of the regenerated power that goes into the train's resistor, and its slope.

    It goes on beyond 1 for the search's sake: no solution lies there, because a train that took
    more than it gave could not have the highest voltage, and nothing else feeds so high.
    """
    span = limits[CHOPS_ALL] - limits[CHOPS_FROM]
    at = (voltage_v - limits[CHOPS_FROM]) / span
    if at <= 0.0:
        return 0.0, 0.0
    return at * at, 2.0 * at / span


@kernel
def source_current(
    voltage_v: float, no_load_v: float, ohm: float, limits: Any
) -> tuple[float, float]:
    """Of a rectifier less the substation's own load, and its slope over the voltage."""
    if ohm <= 0.0:
        return 0.0, 0.0
    lack = no_load_v - voltage_v
    root = math.sqrt(lack * lack + limits[SMOOTH] * limits[SMOOTH])
    current = (lack + root) / (2.0 * ohm) - IDLE_S * voltage_v
    return current, -(1.0 + lack / root) / (2.0 * ohm) - IDLE_S


@kernel
def load_power(
    voltage_v: float, wants_w: float, gives_w: float, auxiliary_w: float, limits: Any
) -> tuple[float, float]:
    """What a train takes from the line (negative: it feeds), and its slope over the voltage."""
    effort, effort_slope = effort_share(voltage_v, limits)
    chopped, chopped_slope = chopped_share(voltage_v, limits)
    power = wants_w * effort + auxiliary_w - gives_w * (1.0 - chopped)
    return power, wants_w * effort_slope + gives_w * chopped_slope


@kernel
def residuals(
    parent: Any,
    siemens: Any,
    sources: Any,
    loads: Any,
    limits: Any,
    volts: Any,
    out: Any,
    n: int,
) -> float:
    """Into `out` (n,): current that is missing at each node; answers with the greatest, in A."""
    for i in range(n):
        v = volts[i]
        gained, _ = source_current(v, sources[i, 0], sources[i, 1], limits)
        power, _ = load_power(v, loads[i, 0], loads[i, 1], loads[i, 2], limits)
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


@kernel
def newton_step(
    parent: Any,
    siemens: Any,
    sources: Any,
    loads: Any,
    limits: Any,
    volts: Any,
    out: Any,
    work: Any,
    n: int,
) -> None:
    """Replaces the residuals in `out` by the change of voltages that would remove them."""
    for i in range(n):
        v = volts[i]
        _, gain = source_current(v, sources[i, 0], sources[i, 1], limits)
        power, slope = load_power(v, loads[i, 0], loads[i, 1], loads[i, 2], limits)
        work[i] = -gain + slope / v - power / (v * v) + siemens[i]
    for i in range(n):
        if parent[i] >= 0:
            work[parent[i]] += siemens[i]
        else:
            work[i] -= siemens[i]
    # From the leaves to the root, and back.
    for i in range(n - 1, -1, -1):
        if abs(work[i]) < LEAST_DIAGONAL_S:
            work[i] = LEAST_DIAGONAL_S
        if parent[i] >= 0:
            share = siemens[i] / work[i]
            work[parent[i]] -= share * siemens[i]
            out[parent[i]] += share * out[i]
    for i in range(n):
        if parent[i] >= 0:
            out[i] += siemens[i] * out[parent[i]]
        out[i] /= work[i]


@kernel
def newton(
    parent: Any, siemens: Any, sources: Any, loads: Any, limits: Any, volts: Any, work: Any, n: int
) -> int:
    """Solves for `volts` (n,) in place, from what is in it. `work` is (4, n).

    Answers with the iterations taken, or -1 where it did not converge.
    """
    worst = residuals(parent, siemens, sources, loads, limits, volts, work[0], n)
    for iteration in range(ITERATIONS):
        if worst < TOLERANCE_A:
            return iteration
        newton_step(parent, siemens, sources, loads, limits, volts, work[0], work[1], n)
        factor = 1.0
        better = worst
        for _halving in range(HALVINGS):
            for i in range(n):
                changed = volts[i] + factor * work[0, i]
                work[2, i] = min(max(changed, limits[FLOOR]), limits[CEILING])
            better = residuals(parent, siemens, sources, loads, limits, work[2], work[3], n)
            if better < worst or (worst < CLOSE_A and better < CLOSE_A):
                break
            factor *= 0.5
        for i in range(n):
            volts[i] = work[2, i]
            work[0, i] = work[3, i]
        worst = better
    return ITERATIONS if worst < TOLERANCE_A else -1


@kernel
def solve(
    parent: Any, siemens: Any, sources: Any, loads: Any, limits: Any, volts: Any, work: Any, n: int
) -> int:
    """As `newton`, which is tried from the last voltages, then from no load, then along loads that
    grow from nothing. `work` is (4, n), `volts` holds the solution."""
    done = newton(parent, siemens, sources, loads, limits, volts, work, n)
    if done >= 0:
        return done
    spent = ITERATIONS
    highest = 0.0
    for i in range(n):
        highest = max(highest, sources[i, 0])
    for i in range(n):
        volts[i] = highest
    done = newton(parent, siemens, sources, loads, limits, volts, work, n)
    if done >= 0:
        return spent + done
    spent += ITERATIONS
    for i in range(n):
        volts[i] = highest
    for step in range(1, HOMOTOPY_STEPS + 1):
        part = loads * (step / HOMOTOPY_STEPS)
        done = newton(parent, siemens, sources, part, limits, volts, work, n)
        spent += ITERATIONS
    return spent if done >= 0 else -1
