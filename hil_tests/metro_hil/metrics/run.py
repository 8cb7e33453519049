"""Measures of one run, from the plant's truth log and the controller's cycle log."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from metro_hil.model.log_columns import Columns, Numbers

CUT_OFF_HZ = 2.0
"""Upper limit of the acceleration and jerk that a standing passenger feels, Hz; it removes coupler
noise."""
RESPONSE_S = 2.5
"""Time after which an impulse response has decayed, s."""
ROWS_MIN = 8
STEPS_MAX = 16
"""Number of step lengths whose impulse response is cached. Logs differ little in theirs."""


@dataclass(frozen=True, slots=True)
class RideComfort:
    """Motion of the train as passengers feel it."""

    max_accel_mps2: float
    max_jerk_mps3: float
    """Greatest change of the low-passed acceleration, including the final jolt at standstill."""
    duration_s: float
    distance_m: float
    top_speed_mps: float


@dataclass(frozen=True, slots=True)
class Cycles:
    """Timing of the controller's cycles."""

    cycles: int
    slips: int
    work_us_p50: float
    work_us_max: float
    lateness_us_p50: float
    lateness_us_p99: float
    lateness_us_max: float
    least_margin_mps: float
    """Least difference between the emergency curve and the speed while moving."""


def measure_ride(truth: Columns) -> RideComfort:
    """Acceleration and jerk of the train's mean motion, low-passed at `CUT_OFF_HZ`."""
    time_s, front_m = truth.numbers("t_s"), truth.numbers("front_m")
    if len(time_s) < ROWS_MIN:
        return RideComfort(0.0, 0.0, 0.0, 0.0, 0.0)
    step_s = float(np.median(np.diff(time_s)))
    grid_s = np.arange(time_s[0], time_s[-1], step_s)
    # Differences of speeds, unlike the logged acceleration, lose no change between two rows.
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

    It sums the impulse response down to 1e-8 of the input in a fixed order, so that every processor
    gives the same bits.

    Args:
        samples: shape (n,), or (n, k) for k signals; before the first sample its value is assumed.
    """
    return convolved(samples, _impulse_response(step_s, max(2, math.ceil(RESPONSE_S / step_s))))


def convolved(samples: Numbers, response: Sequence[float]) -> Numbers:
    """Output of the filter with this impulse response, summed in a fixed order."""
    before = np.repeat(samples[:1], len(response) - 1, axis=0)
    padded = np.concatenate((before, samples))
    out = np.zeros_like(samples)
    for index, weight in enumerate(reversed(response)):
        out += weight * padded[index : index + len(samples)]
    return out


@lru_cache(maxsize=STEPS_MAX)
def _impulse_response(step_s: float, count: int) -> tuple[float, ...]:
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
    return tuple(out)


def measure_cycles(cycles: Columns) -> Cycles:
    """Timing and margin from the controller's own log."""
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
    """A change of the protection's state."""

    at_s: float
    state: str
    cause: str


def supervision_events(cycles: Columns) -> list[SupervisionEvent]:
    """Every change of state or cause, including the first row."""
    time_s = cycles.numbers("t_s")
    rows = list(zip(cycles.texts("supervision"), cycles.texts("cause"), strict=True))
    return [
        SupervisionEvent(float(time_s[index]), *row)
        for index, row in enumerate(rows)
        if index == 0 or row != rows[index - 1]
    ]
