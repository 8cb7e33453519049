"""Whole runs by time steps: slower than the net, of which they use only the braking curves.

One step is the same few lines for one run and for a batch. With numba (the extra `compiled`) they
run compiled, one run after the other. Without it numpy steps a batch of runs at once.
"""

import importlib
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from metro_hil.energy.compiled import COMPILED, kernel
from metro_hil.energy.running_curve.net import Arrivals
from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import Numbers, RunningTrain

STEP_S: Final = 0.1
STEPS_MAX: Final = 6000
_COMPILED_KERNELS: Final[dict[str, Any]] = {}


@dataclass(frozen=True, slots=True)
class RunBatch:
    """Results, (n,) each."""

    time_s: Numbers
    way_m: Numbers
    """Distance to standstill; a run with a braking curve into the stop ends there."""
    traction_j: Numbers
    """Work at the wheel."""
    regained_j: Numbers


def run_all(
    train: RunningTrain,
    track: HopTrack,
    braking: Arrivals,
    notch_off_mps: Numbers,
    column: np.ndarray[tuple[int, ...], np.dtype[np.intp]],
    *,
    step_s: float = STEP_S,
    compiled: bool = COMPILED,
) -> RunBatch:
    """Drive `n` runs: full traction to the notch-off speed, then coasting, then the brake.

    The brake starts where the run meets its braking curve, which is one column of `braking`. Limits
    on the way are ignored.

    Args:
        notch_off_mps, column: (n,) each.
    """
    numbers = np.array(
        [
            *(train.mass_kg, train.traction_force_n, train.traction_power_w, train.brake_force_n),
            *(train.resistance_n, train.resistance_n_per_mps, train.resistance_n_per_mps2),
            *(track.cell_m, step_s),
        ]
    )
    limits_w = np.minimum(braking.power_w, train.brake_power_w)
    drive = _compiled() if compiled else _batch
    time_s, way_m, traction_j, regained_j = drive(
        numbers, *track.drag, braking.square_m2_per_s2, limits_w, notch_off_mps, column
    )
    return RunBatch(time_s, way_m, traction_j, regained_j)


def _batch(
    numbers: Numbers,
    grade_n: Numbers,
    air_ratio: Numbers,
    square: Numbers,
    limits_w: Numbers,
    off_mps: Numbers,
    column: np.ndarray[tuple[int, ...], np.dtype[np.intp]],
) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    mass_kg, force_n, power_w, brake_n, a_n, b_n, c_n, cell_m, step_s = numbers
    n, cells = len(off_mps), len(grade_n)
    v, s, t = np.zeros(n), np.zeros(n), np.zeros(n)
    traction_j, regained_j = np.zeros(n), np.zeros(n)
    pulls, runs = np.ones(n, dtype=np.bool_), np.ones(n, dtype=np.bool_)
    brakes = np.zeros(n, dtype=np.bool_)
    limit_w = limits_w[column]
    for _ in range(STEPS_MAX):
        cell = np.minimum((s / cell_m).astype(np.intp), cells - 1)
        share = np.minimum(s / cell_m - cell, 1.0)
        meets = square[cell, column] * (1.0 - share) + square[cell + 1, column] * share
        brakes |= v * v >= meets
        pulls &= (v < off_mps) & ~brakes
        u = v
        for _half in (0, 1):
            safe = np.maximum(u, 0.1)
            effort_n = np.where(pulls, np.minimum(force_n, power_w / safe), 0.0)
            slow_n = np.where(brakes, np.minimum(brake_n, limit_w / safe), 0.0)
            drag_n = a_n + u * (b_n + u * (c_n * air_ratio[cell])) + grade_n[cell]
            accel = (effort_n - slow_n - drag_n) / mass_kg
            u = np.maximum(v + 0.5 * step_s * accel, 0.0)
        last = v + step_s * accel
        share = np.where(last < 0.0, v / np.maximum(v - last, 1e-12), 1.0)
        last = np.maximum(last, 0.0)
        way = 0.5 * (v + last) * share * step_s * runs
        s, t = s + way, t + share * step_s * runs
        traction_j += effort_n * way
        regained_j += slow_n * way
        v = np.where(runs, last, v)
        runs &= v > 0.0
        if not runs.any():
            break
    return t, s, traction_j, regained_j


def _compiled() -> Any:
    if "kernel" not in _COMPILED_KERNELS:
        numba = importlib.import_module("numba")
        _COMPILED_KERNELS["kernel"] = kernel(_make(numba.prange), parallel=True)
    return _COMPILED_KERNELS["kernel"]


def _make(prange: Any) -> Any:
    """Return a kernel with the same steps for one run after the other."""

    def kernel(
        numbers: Any,
        grade_n: Any,
        air_ratio: Any,
        square: Any,
        limits_w: Any,
        off_mps: Any,
        column: Any,
    ) -> Any:
        mass_kg, force_n, power_w, brake_n = numbers[0], numbers[1], numbers[2], numbers[3]
        a_n, b_n, c_n, cell_m, step_s = numbers[4], numbers[5], numbers[6], numbers[7], numbers[8]
        n, cells, per_m, per_kg = len(off_mps), len(grade_n), 1.0 / cell_m, 1.0 / mass_kg
        t, s = np.zeros(n), np.zeros(n)
        traction_j, regained_j = np.zeros(n), np.zeros(n)
        for i in prange(n):
            v, pulls, brakes, k, off = 0.0, True, False, column[i], off_mps[i]
            way, time, work, gain, limit_w = 0.0, 0.0, 0.0, 0.0, limits_w[column[i]]
            for _ in range(STEPS_MAX):
                at = way * per_m
                cell = min(int(at), cells - 1)
                share = min(at - cell, 1.0)
                meets = square[cell, k] * (1.0 - share) + square[cell + 1, k] * share
                brakes = brakes or v * v >= meets
                pulls = pulls and v < off and not brakes
                u, effort_n, slow_n, accel = v, 0.0, 0.0, 0.0
                for _half in range(2):
                    safe = max(u, 0.1)
                    effort_n = min(force_n, power_w / safe) if pulls else 0.0
                    slow_n = min(brake_n, limit_w / safe) if brakes else 0.0
                    drag_n = a_n + u * (b_n + u * (c_n * air_ratio[cell])) + grade_n[cell]
                    accel = (effort_n - slow_n - drag_n) * per_kg
                    u = max(v + 0.5 * step_s * accel, 0.0)
                last = v + step_s * accel
                share = v / max(v - last, 1e-12) if last < 0.0 else 1.0
                last = max(last, 0.0)
                ran = 0.5 * (v + last) * share * step_s
                way += ran
                time += share * step_s
                work += effort_n * ran
                gain += slow_n * ran
                v = last
                if v <= 0.0:
                    break
            t[i], s[i], traction_j[i], regained_j[i] = time, way, work, gain
        return t, s, traction_j, regained_j

    return kernel
