"""Comfort of one run: felt acceleration and jerk in each car, and the controller's demand.

The felt acceleration is that of the car's floor along the track, low-passed at 2 Hz. Up to 2 Hz a
standing person feels horizontal motion in full (weighting Wd of ISO 2631-1); faster vibration does
not make a person lose balance. Only service braking counts, because an emergency brake is not meant
to be comfortable. The mean comfort of EN 12299 stands beside it, from the same accelerations.
"""

import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from can_dbc.nodes import Direction
from can_dbc.vobc import AtoPhase, Supervision
from metro_hil.metrics.run import STEPS_MAX, convolved, low_pass
from metro_hil.model.log_columns import Columns, Numbers
from plant_emulator.train_config import TrainConfig
from vobc.vocabulary import CycleOutput

SETTLED_S: Final = 2.0
"""Time after an emergency brake during which its jolt remains in filter and couplers, s."""
JERK_WINDOW_S: Final = 1.0
ROWS_MIN: Final = 8
WINDOW_S: Final = 5.0
"""Length of the windows of EN 12299 over which the weighted acceleration is averaged, s."""
INDEX_FACTOR: Final = 6.0
"""Factor of the mean comfort index of EN 12299 on an acceleration in m/s²."""
WEIGHTING_S: Final = 8.0
"""Time after which the impulse response of the weighting has decayed, s."""
HIGH_PASS_HZ: Final = 0.4
TRANSITION_HZ: Final = 2.0
TRANSITION_Q: Final = 0.63
"""Corner frequencies and resonance of the weighting Wd for horizontal motion (EN 12299, annex C).
Its low-pass at 100 Hz lies far beyond the log."""
DRIVEN: Final = (AtoPhase.RUNNING, AtoPhase.APPROACHING, AtoPhase.STOPPING)
FREE: Final = (Supervision.NOMINAL, Supervision.WARNING)
DRIVEN_WORDS: Final = tuple(phase.name.lower() for phase in DRIVEN)
FREE_WORDS: Final = tuple(state.name.lower() for state in FREE)
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Comfort:
    """Worst values of one run; None where unknown."""

    felt_accel_max_mps2: float | None = None
    """Greatest felt acceleration of any car, in either direction."""
    felt_jerk_1s_mps3: float | None = None
    """Greatest change of a car's felt acceleration over one second."""
    felt_jerk_2hz_mps3: float | None = None
    """Greatest slope of a car's felt acceleration, including the final jolt at standstill."""
    en12299_index_ratio: float | None = None
    """Mean comfort index of EN 12299 by the longitudinal motion of the worst car. Under 1.5 is very
    comfortable, under 2.5 comfortable."""
    commanded_accel_max_mps2: float | None = None
    """Greatest commanded acceleration: tractive effort over the true train's inertia, less the
    service brake demand."""
    commanded_jerk_max_mps3: float | None = None
    """Greatest change of the commanded acceleration between two control cycles."""

    def measures(self) -> dict[str, float | None]:
        """The measures by name."""
        return asdict(self)


class CommandLog:
    """Records the controller's demand, cycle by cycle."""

    def __init__(self, inertia_kg: float) -> None:
        self._inertia_kg = inertia_kg
        self._rows: list[tuple[float, float, bool]] = []

    def output(self, t_s: float, output: CycleOutput) -> None:
        """Record one cycle; call it once for each."""
        force_n = output.force_n
        if output.direction is not Direction.FORWARD:
            force_n = -force_n if output.direction is Direction.REVERSE else 0.0
        driven = (
            output.ato_phase in DRIVEN
            and output.supervision in FREE
            and output.emergency_released
            and output.holding_released
        )
        accel_mps2 = force_n / self._inertia_kg - output.service_decel_mps2
        self._rows.append((t_s, accel_mps2, driven))

    def worst(self) -> tuple[float | None, float | None]:
        """Worst acceleration and jerk of the demand; see `commanded`."""
        if not self._rows:
            return None, None
        time_s, accel_mps2, driven = zip(*self._rows, strict=True)
        return commanded(np.array(time_s), np.array(accel_mps2), np.array(driven))


def comfort_of(
    truth: Columns | None, cycles: Columns | None, *, inertia_kg: float | None
) -> Comfort:
    """Measure comfort from the logs of a run.

    Args:
        inertia_kg: mass of the true train with rotating parts; None if unknown.
    """
    asked: tuple[float | None, float | None] = None, None
    if cycles is not None and inertia_kg is not None:
        accel_mps2 = cycles.numbers("force_n") / inertia_kg - cycles.numbers("decel_mps2")
        asked = commanded(cycles.numbers("t_s"), accel_mps2, _driven(cycles))
    felt = felt_worst(truth) if truth is not None else {}
    return Comfort(**felt, commanded_accel_max_mps2=asked[0], commanded_jerk_max_mps3=asked[1])


def _driven(cycles: Columns) -> Flags:
    """Cycles in which ATO drives without interference of ATP or a demand for other brakes."""
    states = zip(cycles.texts("phase"), cycles.texts("supervision"), strict=True)
    driven = np.array([p in DRIVEN_WORDS and s in FREE_WORDS for p, s in states], dtype=np.bool_)
    for released in ("emergency_released", "holding_released"):
        driven &= np.array(cycles.flags(released), dtype=np.bool_)
    return driven


def commanded(
    time_s: Numbers, accel_mps2: Numbers, driven: Flags
) -> tuple[float | None, float | None]:
    """Greatest acceleration, and greatest change of it, over the cycles in which ATO drives.

    All arrays have shape (n_cycles,).
    """
    if not np.any(driven):
        return None, None
    both = driven[1:] & driven[:-1] & (np.diff(time_s) > 0.0)
    jerk_mps3 = np.abs(np.diff(accel_mps2)[both] / np.diff(time_s)[both])
    most_mps3 = float(np.max(jerk_mps3)) if len(jerk_mps3) else None
    return float(np.max(np.abs(accel_mps2[driven]))), most_mps3


def felt_worst(truth: Columns) -> dict[str, float | None]:
    """The felt measures by name; None for a log without the cars' speeds."""
    names = (
        "felt_accel_max_mps2",
        "felt_jerk_1s_mps3",
        "felt_jerk_2hz_mps3",
        "en12299_index_ratio",
    )
    motion = _car_accels(truth)
    if motion is None:
        return dict.fromkeys(names)
    time_s, raw_mps2 = motion
    counts = ~_emergency(truth, time_s)
    step_s = float(time_s[1] - time_s[0])
    accel_mps2 = low_pass(raw_mps2, step_s)
    span = max(1, round(JERK_WINDOW_S / step_s))
    # Samples without an emergency in the whole second that they end.
    emergencies = np.concatenate(([0], np.cumsum(~counts)))
    free = emergencies[span + 1 :] == emergencies[: -span - 1]
    over_mps3 = np.abs(accel_mps2[span:] - accel_mps2[:-span]) / (span * step_s)
    slope_mps3 = np.abs(np.diff(accel_mps2, axis=0)) / step_s
    worst = (
        _most(np.abs(accel_mps2), counts),
        _most(over_mps3, free),
        _most(slope_mps3, counts[1:] & counts[:-1]),
        _mean_comfort(raw_mps2, counts, step_s),
    )
    return dict(zip(names, worst, strict=True))


def _mean_comfort(raw_mps2: Numbers, counts: Flags, step_s: float) -> float | None:
    """Index N_MV of EN 12299 with the longitudinal axis alone, of the worst car.

    It is six times the 95th percentile of the weighted root mean square over windows of 5 s.
    Windows in which the train stands, or with an emergency brake, do not count.
    """
    span = round(WINDOW_S / step_s)
    windows = len(raw_mps2) // span
    if windows == 0:
        return None
    weighted = convolved(raw_mps2, _weighting(step_s))[: windows * span]
    shape = (windows, span, raw_mps2.shape[1])
    moves = np.any(raw_mps2[: windows * span].reshape(shape) != 0.0, axis=(1, 2))
    known = moves & np.all(counts[: windows * span].reshape(windows, span), axis=1)
    if not np.any(known):
        return None
    rms_mps2 = np.sqrt(np.mean(weighted.reshape(shape) ** 2, axis=1))[known]
    return INDEX_FACTOR * float(np.max(np.percentile(rms_mps2, 95.0, axis=0)))


@lru_cache(maxsize=STEPS_MAX)
def _weighting(step_s: float) -> tuple[float, ...]:
    """Impulse response of the weighting Wd of EN 12299, by the bilinear transform."""
    high, turn = (math.tan(math.pi * hz * step_s) for hz in (HIGH_PASS_HZ, TRANSITION_HZ))
    sections = (
        ((1.0, 0.0, 0.0), (1.0, math.sqrt(2.0) * high, high * high)),
        ((0.0, turn, turn * turn), (1.0, turn / TRANSITION_Q, turn * turn)),
    )
    response = [1.0, *[0.0] * (max(2, math.ceil(WEIGHTING_S / step_s)) - 1)]
    for above, below in sections:
        response = _section(response, above, below)
    return tuple(response)


def _section(
    samples: list[float], above: tuple[float, ...], below: tuple[float, ...]
) -> list[float]:
    """Second-order section. Both polynomials are in s over 2 / step, highest power first."""
    b0, b1, b2 = _bilinear(*above)
    a0, a1, a2 = _bilinear(*below)
    out: list[float] = []
    x1 = x2 = y1 = y2 = 0.0
    for x0 in samples:
        y0 = (b0 * x0 + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2) / a0
        out.append(y0)
        x1, x2, y1, y2 = x0, x1, y0, y1
    return out


def _bilinear(square: float, linear: float, constant: float) -> tuple[float, float, float]:
    return (
        square + linear + constant,
        2.0 * (constant - square),
        square - linear + constant,
    )


def felt_signals(truth: Columns) -> tuple[Numbers, Numbers] | None:
    """Times, shape (n,), and felt acceleration of each car, shape (n, n_cars).

    None for a log that is too short or lacks the speeds.
    """
    motion = _car_accels(truth)
    if motion is None:
        return None
    time_s, raw_mps2 = motion
    return time_s, low_pass(raw_mps2, float(time_s[1] - time_s[0]))


def _car_accels(truth: Columns) -> tuple[Numbers, Numbers] | None:
    """Times and acceleration of each car, as for `felt_signals` but without the low-pass.

    It is computed from the cars' speeds, so that no change between two rows is lost. An
    acceleration belongs to the middle of its step.
    """
    if len(truth) < ROWS_MIN or not truth.has("car_speeds_mps"):
        return None
    log_s, speeds_mps = truth.numbers("t_s"), truth.vectors("car_speeds_mps")
    step_s = float(np.median(np.diff(log_s)))
    grid_s = np.arange(log_s[0], log_s[-1], step_s)
    if len(grid_s) * step_s <= JERK_WINDOW_S + 2.0 * step_s:
        return None
    grid_mps = np.stack([np.interp(grid_s, log_s, one) for one in speeds_mps.T], axis=1)
    return grid_s[:-1] + 0.5 * step_s, np.diff(grid_mps, axis=0) / step_s


def _emergency(truth: Columns, time_s: Numbers) -> Flags:
    """Times at which, or shortly before which, the emergency brake was on in motion."""
    log_s, on = truth.numbers("t_s"), np.array(truth.flags("emergency"), dtype=np.bool_)
    moving = truth.numbers("speed_mps") != 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], on.astype(np.int8), [0]))))
    found = np.zeros(len(time_s), dtype=np.bool_)
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        # The brake came on between two rows.
        if np.any(moving[max(0, first - 1) : end]):
            began_s = float(log_s[max(0, first - 1)])
            found |= (time_s >= began_s) & (time_s <= float(log_s[end - 1]) + SETTLED_S)
    return found


def _most(values: Numbers, counts: Flags) -> float | None:
    known = values[counts]
    return float(np.max(known)) if known.size else None


def inertia_of(train: TrainConfig) -> float:
    """Mass of the true train with rotating parts, kg."""
    return train.mass_kg * (1.0 + train.rotating_mass_percent / 100.0)
