"""Measures of one run, from the truth of the plant and the cycle log of the controller."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_py.trackdb import Station
from metro_hil.model.log_columns import Columns, Numbers

CUT_OFF_HZ = 2.0
"""What a standing passenger feels of acceleration and jerk; coupler noise above it is left out."""
RESPONSE_S = 2.5
"""After so long nothing is left of an impulse."""
NEAR_STOP_M = 50.0
"""A standstill farther than this from a stopping point is not a stop at that station."""
ROWS_MIN = 8


@dataclass(frozen=True, slots=True)
class StationStop:
    """How the train stood at one station."""

    station: str
    error_m: float | None
    """Positive beyond the stopping point; None when the train never stood near it."""
    arrived_s: float | None
    run_time_s: float | None
    """From leaving the standstill before to this one."""


@dataclass(frozen=True, slots=True)
class RideComfort:
    """What the passengers felt."""

    max_accel_mps2: float
    max_jerk_mps3: float
    """Change of the low-passed acceleration, the last jolt into the standstill included."""
    duration_s: float
    distance_m: float
    top_speed_mps: float


@dataclass(frozen=True, slots=True)
class Cycles:
    """How the controller kept its rhythm."""

    cycles: int
    slips: int
    work_us_p50: float
    work_us_max: float
    lateness_us_p50: float
    lateness_us_p99: float
    lateness_us_max: float
    least_margin_mps: float
    """Least distance in speed to the emergency curve while moving."""


def measure_stops(truth: Columns, stations: Sequence[Station]) -> list[StationStop]:
    """One entry for each station that the mission should stop at, in running order."""
    time_s, front_m = truth.numbers("t_s"), truth.numbers("front_m")
    still = truth.numbers("speed_mps") == 0.0
    starts, ends = _runs(still)
    stops = []
    for station in stations:
        near = [
            (abs(float(front_m[first]) - station.stop_m), first, index)
            for index, first in enumerate(starts)
            if abs(float(front_m[first]) - station.stop_m) <= NEAR_STOP_M
        ]
        if not near:
            stops.append(StationStop(station.name, None, None, None))
            continue
        # The last standstill near the point is the stop; one before it was a miss that was mended.
        _, first, index = max(near, key=lambda entry: entry[2])
        left_s = float(time_s[ends[index - 1]]) if index > 0 else float(time_s[0])
        arrived_s = float(time_s[first])
        error_m = float(front_m[first]) - station.stop_m
        stops.append(StationStop(station.name, error_m, arrived_s, arrived_s - left_s))
    return stops


def _runs(flags: "np.typing.NDArray[np.bool_]") -> tuple[list[int], list[int]]:
    """First and last index of every stretch of true."""
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    return np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist()


def measure_ride(truth: Columns) -> RideComfort:
    """Acceleration and jerk of the consist's mean motion, low-passed at `CUT_OFF_HZ`."""
    time_s, front_m = truth.numbers("t_s"), truth.numbers("front_m")
    if len(time_s) < ROWS_MIN:
        return RideComfort(0.0, 0.0, 0.0, 0.0, 0.0)
    step_s = float(np.median(np.diff(time_s)))
    grid_s = np.arange(time_s[0], time_s[-1], step_s)
    # From speeds, not from the logged acceleration, so that nothing between two rows is missed.
    speed_mps = np.interp(grid_s, time_s, truth.numbers("speed_mps"))
    accel_mps2 = low_pass(np.diff(speed_mps) / step_s, step_s)
    jerk_mps3 = np.diff(accel_mps2) / step_s
    return RideComfort(
        max_accel_mps2=float(np.max(np.abs(accel_mps2))),
        max_jerk_mps3=float(np.max(np.abs(jerk_mps3))),
        duration_s=float(time_s[-1] - time_s[0]),
        distance_m=float(front_m[-1] - front_m[0]),
        top_speed_mps=float(np.max(speed_mps)),
    )


def low_pass(samples: Numbers, step_s: float) -> Numbers:
    """Second-order Butterworth at `CUT_OFF_HZ` by the bilinear transform, run once forwards.

    Sums the impulse response as far as it is above 1e-8 of the input, in a fixed order, so that
    every processor comes to the same bits.

    Args:
        samples: shape (n,), or (n, k) for k signals at once; before the first it was as there.
    """
    response = _impulse_response(step_s, max(2, math.ceil(RESPONSE_S / step_s)))
    before = np.repeat(samples[:1], len(response) - 1, axis=0)
    padded = np.concatenate((before, samples))
    out = np.zeros_like(samples)
    for index, weight in enumerate(reversed(response)):
        out += weight * padded[index : index + len(samples)]
    return out


def _impulse_response(step_s: float, count: int) -> list[float]:
    warped = math.tan(math.pi * CUT_OFF_HZ * step_s)
    scale = 1.0 / (1.0 + math.sqrt(2.0) * warped + warped**2)
    b0 = warped**2 * scale
    a1 = 2.0 * (warped**2 - 1.0) * scale
    a2 = (1.0 - math.sqrt(2.0) * warped + warped**2) * scale
    out: list[float] = []
    x1 = x2 = y1 = y2 = 0.0
    for index in range(count):
        x0 = 1.0 if index == 0 else 0.0
        y0 = b0 * (x0 + 2.0 * x1 + x2) - a1 * y1 - a2 * y2
        x2, x1, y2, y1 = x1, x0, y1, y0
        out.append(y0)
    return out


def measure_cycles(cycles: Columns) -> Cycles:
    """Rhythm and margin from the controller's own log."""
    work_us, lateness_us = cycles.numbers("work_us"), cycles.numbers("lateness_us")
    speed_mps = cycles.numbers("speed_mps")
    margin_mps = cycles.numbers("emergency_mps") - speed_mps
    moving = speed_mps > 0.1
    slips = cycles.numbers("slips")
    return Cycles(
        cycles=len(cycles),
        slips=int(slips[-1]) if len(slips) else 0,
        work_us_p50=_percentile(work_us, 50.0),
        work_us_max=_percentile(work_us, 100.0),
        lateness_us_p50=_percentile(lateness_us, 50.0),
        lateness_us_p99=_percentile(lateness_us, 99.0),
        lateness_us_max=_percentile(lateness_us, 100.0),
        least_margin_mps=float(np.nanmin(margin_mps[moving])) if np.any(moving) else math.nan,
    )


def _percentile(values: Numbers, percent: float) -> float:
    known = values[~np.isnan(values)]
    return float(np.percentile(known, percent)) if len(known) else math.nan


@dataclass(frozen=True, slots=True)
class SupervisionEvent:
    """The protection changed its state."""

    at_s: float
    state: str
    cause: str


def supervision_events(cycles: Columns) -> list[SupervisionEvent]:
    """Every change of state or cause, the first row included."""
    time_s = cycles.numbers("t_s")
    rows = list(zip(cycles.texts("supervision"), cycles.texts("cause"), strict=True))
    return [
        SupervisionEvent(float(time_s[index]), *row)
        for index, row in enumerate(rows)
        if index == 0 or row != rows[index - 1]
    ]
