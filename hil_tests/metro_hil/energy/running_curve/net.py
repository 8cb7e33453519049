"""All running curves of a hop at once: each way to gain speed joined with each way to lose it.

A curve after [Ninh] is full traction up to the notch-off speed, coasting, and a brake with limited
power. The part before the braking point does not depend on the power limit, and the part behind it
not on the notch-off speed. So each half is integrated once over the way, and all pairs are joined
where they cross. Each pair gives a whole run with its time and energies.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from metro_hil.energy.running_curve.thrift import (
    PRICES,
    Thrift,
    forces_n,
    lowered,
    thrift,
)
from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import CellDrag, Numbers, RunningTrain

STALL_MPS: Final = 0.3
"""Speed below which a coasting train does not reach the next station."""
START_UP_M: Final = 5.0
"""Distance from the start within which every train is slow."""
LEAST: Final = 1e-9
"""Keeps a share finite where nothing changes."""

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Departures:
    """First halves by notch-off speed, `n` of them; arrays (cells + 1, n), up to each node."""

    notch_off_mps: Numbers
    hold_m: Numbers
    """Distance over which the speed is held before the train coasts, (n,)."""
    square_m2_per_s2: Numbers
    time_s: Numbers
    traction_j: Numbers
    """Work at the wheel."""
    regained_j: Numbers
    """Work at the wheel of the electric brake that keeps a limit on the way."""
    drawn_work_j: Numbers
    """Traction work that draws the same energy at the train's single efficiency."""
    returned_work_j: Numbers
    """Work of the electric brake that returns the same energy at the single efficiency."""


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Second halves by power limit, `n` of them; arrays (cells + 1, n), from each node on."""

    power_w: Numbers
    square_m2_per_s2: Numbers
    time_s: Numbers
    regained_j: Numbers
    returned_work_j: Numbers


@dataclass(frozen=True, slots=True)
class Net:
    """Each departure with each arrival; arrays (departures, arrivals).

    If a train stalls before the brake, its time is infinite. A notch-off speed that the train
    cannot reach on this way gives the fastest run.
    """

    notch_off_mps: Numbers
    hold_m: Numbers
    power_w: Numbers
    time_s: Numbers
    acceleration_j: Numbers
    """Energy drawn from the line."""
    regenerated_j: Numbers
    """Energy returned to a line that takes all of it."""
    braking_s: Numbers
    braking_at_m: Numbers
    braking_from_mps: Numbers

    def total_j(self, use_ratio: float) -> Numbers:
        """Return the drawn energy less the returned energy that is used."""
        total: Numbers = self.acceleration_j - use_ratio * self.regenerated_j
        return total


def departures(
    train: RunningTrain, track: HopTrack, notch_off_mps: Numbers, hold_m: Numbers
) -> Departures:
    """Drive with full traction under all limits to the notch-off speed, hold it, then coast.

    On a track with a lower limit ahead the runs are those of `thrift`, which coast before each.
    There notch-off speed and distance of holding only number them, from the slowest on.
    """
    if track.thrift is not None:
        return _thrifty_departures(train, track, track.thrift, notch_off_mps, hold_m)
    cells, n, step_m = track.cells, len(notch_off_mps), track.cell_m
    shape = (cells + 1, n)
    square, time_s = np.zeros(shape), np.zeros(shape)
    traction_j, regained_j = np.zeros(shape), np.zeros(shape)
    run = _Forward(train, notch_off_mps**2, hold_m, step_m)
    ceiling_square = slowed_ceiling(train, track)
    for i in range(cells):
        at = square[i]
        ends, work_j, split_m, middle = run.cell(i, at, track.drag.of(i), ceiling_square[i + 1])
        square[i + 1] = ends
        traction_j[i + 1] = traction_j[i] + np.maximum(work_j, 0.0)
        regained_j[i + 1] = regained_j[i] - np.minimum(work_j, 0.0)
        time_s[i + 1] = time_s[i] + _cell_s(at, middle, ends, split_m, step_m)
    late = np.arange(1, cells + 1)[:, None] * step_m > START_UP_M
    stalled = np.logical_or.accumulate((square[1:] < STALL_MPS**2) & late, axis=0)
    time_s[1:] = np.where(stalled, np.inf, time_s[1:])
    drawn_j = _drawn_work_j(train, step_m, square, traction_j)
    returned_j = _returned_work_j(train, step_m, square, regained_j)
    return Departures(
        notch_off_mps, hold_m, square, time_s, traction_j, regained_j, drawn_j, returned_j
    )


def _thrifty_departures(
    train: RunningTrain, track: HopTrack, best: Thrift, notch_off_mps: Numbers, hold_m: Numbers
) -> Departures:
    cells, n, step_m = track.cells, len(notch_off_mps), track.cell_m
    shape = (cells + 1, n)
    square, time_s = np.zeros(shape), np.zeros(shape)
    traction_j, regained_j = np.zeros(shape), np.zeros(shape)
    gain = 2.0 * step_m / train.mass_kg
    number = track.number_of(notch_off_mps, hold_m) * (PRICES - 1)
    lower = np.minimum(number.astype(np.intp), PRICES - 2)
    change_m = (number - lower) * track.length_m
    ceiling_square = slowed_ceiling(train, track)
    # Beyond the point from which the full brake stops the train, each run coasts.
    stopping, columns = stopping_square(train, track), np.arange(n)
    for i in range(cells):
        at = square[i]
        share = np.clip(change_m / step_m - i, 0.0, 1.0)
        coasting_n, pull_n, keep_n = forces_n(train, at, track.drag.of(i), step_m)
        efforts_n, speed_mps = np.stack([pull_n, keep_n, np.zeros(n)]), np.sqrt(at)
        effort_n = share * efforts_n[best.at(i, lower + 1, speed_mps), columns]
        effort_n += (1.0 - share) * efforts_n[best.at(i, lower, speed_mps), columns]
        effort_n = np.where(at >= stopping[i], np.minimum(effort_n, 0.0), effort_n)
        ends = np.maximum(at + gain * (effort_n - coasting_n), 0.0)
        capped = ends > ceiling_square[i + 1]
        keeping_n = (ceiling_square[i + 1] - at) / gain + coasting_n
        work_j = np.where(capped, keeping_n, effort_n) * step_m
        ends = np.minimum(ends, ceiling_square[i + 1])
        square[i + 1] = ends
        traction_j[i + 1] = traction_j[i] + np.maximum(work_j, 0.0)
        regained_j[i + 1] = regained_j[i] - np.minimum(work_j, 0.0)
        with np.errstate(divide="ignore"):
            time_s[i + 1] = time_s[i] + 2.0 * step_m / (np.sqrt(at) + np.sqrt(ends))
    drawn_j = _drawn_work_j(train, step_m, square, traction_j)
    returned_j = _returned_work_j(train, step_m, square, regained_j)
    return Departures(
        notch_off_mps, hold_m, square, time_s, traction_j, regained_j, drawn_j, returned_j
    )


def _drawn_work_j(
    train: RunningTrain, step_m: float, square: Numbers, traction_j: Numbers
) -> Numbers:
    """Weigh the traction work of each cell by its efficiency; unchanged without a map."""
    if train.traction_map is None:
        return traction_j
    work_j = np.diff(traction_j, axis=0)
    efficiency = train.traction_efficiency(_middle_mps(square), work_j / step_m)
    return _sum_to_nodes(work_j * train.traction_efficiency_ratio / efficiency)


def _returned_work_j(
    train: RunningTrain, step_m: float, square: Numbers, regained_j: Numbers
) -> Numbers:
    """Weigh the work of the electric brake in each cell; unchanged without a map."""
    if train.regeneration_map is None:
        return regained_j
    work_j = np.diff(regained_j, axis=0)
    efficiency = train.regeneration_efficiency(_middle_mps(square), work_j / step_m)
    return _sum_to_nodes(work_j * efficiency / train.regeneration_efficiency_ratio)


def _middle_mps(square: Numbers) -> Numbers:
    found: Numbers = np.sqrt((square[1:] + square[:-1]) / 2.0)
    return found


def _sum_to_nodes(work_j: Numbers) -> Numbers:
    return np.concatenate([np.zeros((1, work_j.shape[1])), np.cumsum(work_j, axis=0)])


class _Forward:
    """Drives all departures through one cell after the other."""

    def __init__(
        self, train: RunningTrain, off_square: Numbers, hold_m: Numbers, step_m: float
    ) -> None:
        self._train = train
        self._off_square = off_square
        self._hold_m = hold_m
        self._step_m = step_m
        self._gain = 2.0 / train.mass_kg
        self._pulls: Flags = np.ones(len(off_square), dtype=np.bool_)
        self._coast_from_m = np.full(len(off_square), np.inf)

    def cell(
        self, i: int, at: Numbers, drag: CellDrag, ceiling_square: float
    ) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        """Return what one cell does to all departures.

        The results are the square of the speed after the cell and the work at the wheel (negative:
        regained). Then follow the place where the two parts of the cell meet and the square of the
        speed there.
        """
        train, step_m, off_square = self._train, self._step_m, self._off_square
        drag_n = drag.at_n(train, np.sqrt(at))
        half = np.maximum(at - 0.5 * step_m * self._gain * drag_n, 0.0)
        drag_n = drag.at_n(train, np.sqrt(half))
        coasted = at - step_m * self._gain * drag_n
        slope = self._gain * (train.traction_at_n(np.sqrt(at)) - drag_n)
        effort_n = train.traction_at_n(np.sqrt(np.maximum(at + 0.5 * step_m * slope, 0.0)))
        pulled = at + step_m * self._gain * (effort_n - drag_n)
        off = self._pulls & (pulled >= off_square)
        holds = ~self._pulls & (i * step_m < self._coast_from_m)
        share = np.clip((off_square - at) / np.maximum(pulled - at, LEAST), 0.0, 1.0)
        after = off_square - np.where(
            self._hold_m > 0.0, 0.0, (1.0 - share) * step_m * self._gain * drag_n
        )
        ends = np.where(off, after, np.where(self._pulls, pulled, np.where(holds, at, coasted)))
        ends = np.maximum(ends, 0.0)
        pulled_m = np.where(off, share, np.where(self._pulls, 1.0, 0.0)) * step_m
        kept_m = np.where(off & (self._hold_m > 0.0), (1.0 - share) * step_m, 0.0)
        work_j = effort_n * pulled_m + drag_n * np.where(holds, step_m, kept_m)
        # Traction or the electric brake keeps a limit, as needed.
        capped = ends > ceiling_square
        keeping_n = (ceiling_square - at) / (self._gain * step_m) + drag_n
        off &= ~capped
        work_j = np.where(capped, keeping_n * step_m, work_j)
        ends = np.where(capped, ceiling_square, ends)
        self._coast_from_m = np.where(off, (i + share) * step_m + self._hold_m, self._coast_from_m)
        self._pulls = self._pulls & ~off
        middle = np.where(off, off_square, (at + ends) / 2.0)
        return ends, work_j, np.where(off, share, 0.5) * step_m, middle


def _cell_s(
    at: Numbers, middle: Numbers, ends: Numbers, split_m: Numbers, step_m: float
) -> Numbers:
    """Return the time of a cell with two parts of constant acceleration that meet at `split_m`."""
    first, between, last = np.sqrt(at), np.sqrt(middle), np.sqrt(ends)
    with np.errstate(divide="ignore", invalid="ignore"):
        one_s = np.where(split_m > 0.0, 2.0 * split_m / (first + between), 0.0)
        two_s = np.where(split_m < step_m, 2.0 * (step_m - split_m) / (between + last), 0.0)
    total: Numbers = one_s + two_s
    return total


def slowed_ceiling(train: RunningTrain, track: HopTrack) -> Numbers:
    """Return the squared ceiling, including the braking distance before each lower limit."""
    square = track.ceiling_mps**2
    gain = 2.0 * track.cell_m / train.mass_kg
    for i in range(track.cells - 1, -1, -1):
        speed = np.sqrt(square[i + 1 : i + 2])
        drag = track.drag.of(i)
        force_n = train.braking_at_n(speed, train.brake_power_w)
        force_n = force_n + train.resistance_at_n(speed, drag.air_ratio)
        square[i] = min(square[i], square[i + 1] + gain * float(force_n[0] + drag.grade_n))
    return square


def arrivals(train: RunningTrain, track: HopTrack, power_w: Numbers) -> Arrivals:
    """Compute the power-limited brake into the stop, backwards from there."""
    cells, n, step_m = track.cells, len(power_w), track.cell_m
    shape = (cells + 1, n)
    square, time_s, regained_j = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    gain = 2.0 / train.mass_kg

    def slowing(at: Numbers, drag: CellDrag) -> Numbers:
        speed = np.sqrt(at)
        force_n = train.braking_at_n(speed, power_w)
        force_n = force_n + train.resistance_at_n(speed, drag.air_ratio) + drag.grade_n
        return gain * np.maximum(force_n, 0.0)

    for i in range(cells - 1, -1, -1):
        drag, at = track.drag.of(i), square[i + 1]
        half = at + 0.5 * step_m * slowing(at, drag)
        square[i] = at + step_m * slowing(half, drag)
        force_n = train.braking_at_n(np.sqrt(half), power_w)
        regained_j[i] = regained_j[i + 1] + force_n * step_m
        with np.errstate(divide="ignore"):
            time_s[i] = time_s[i + 1] + 2.0 * step_m / (np.sqrt(square[i]) + np.sqrt(at))
    # The work counts from each node to the end, so the way is turned round.
    returned_j = _returned_work_j(train, step_m, square[::-1], regained_j[::-1])[::-1]
    return Arrivals(power_w, square, time_s, regained_j, returned_j)


def stopping_square(train: RunningTrain, track: HopTrack) -> Numbers:
    """Return the square of the speed from which the full brake stops the train at the end."""
    full = arrivals(train, track, np.array([train.brake_power_w]))
    found: Numbers = full.square_m2_per_s2[:, 0]
    return found


def with_thrift(train: RunningTrain, track: HopTrack, use_ratio: float) -> HopTrack:
    """Add the best regimes to a track with a lower limit ahead; leave others as they are."""
    if not lowered(track.ceiling_mps):
        return track
    ceiling = np.minimum(slowed_ceiling(train, track), stopping_square(train, track))
    return replace(track, thrift=thrift(train, track.cell_m, track.drag, ceiling, use_ratio))


def join(train: RunningTrain, track: HopTrack, first: Departures, second: Arrivals) -> Net:
    """Join each departure with each arrival where they have the same speed."""
    n, k = len(first.notch_off_mps), len(second.power_w)
    row, column = np.arange(n)[:, None], np.arange(k)[None, :]
    low = np.zeros((n, k), dtype=np.intp)
    high = np.full((n, k), track.cells, dtype=np.intp)
    while int(np.max(high - low)) > 1:
        middle = (low + high) // 2
        over = first.square_m2_per_s2[middle, row] >= second.square_m2_per_s2[middle, column]
        high, low = np.where(over, middle, high), np.where(over, low, middle)
    return _joined(train, track.cell_m, first, second, low)


def _joined(
    train: RunningTrain, step_m: float, first: Departures, second: Arrivals, i: NDArray[np.intp]
) -> Net:
    """Join each pair, which crosses within cell `i`; both halves have constant acceleration."""
    row = np.arange(len(first.notch_off_mps))[:, None]
    column = np.arange(len(second.power_w))[None, :]
    from_square, to_square = first.square_m2_per_s2[i, row], first.square_m2_per_s2[i + 1, row]
    upper, lower = second.square_m2_per_s2[i, column], second.square_m2_per_s2[i + 1, column]
    apart = (upper - from_square) + (to_square - lower)
    share = np.clip((upper - from_square) / np.maximum(apart, LEAST), 0.0, 1.0)
    meet = np.maximum(from_square + share * (to_square - from_square), 0.0)
    at_mps, meet_mps, lower_mps = np.sqrt(from_square), np.sqrt(meet), np.sqrt(lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        before_s = np.where(share > 0.0, 2.0 * share * step_m / (at_mps + meet_mps), 0.0)
        after_s = np.where(share < 1.0, 2.0 * (1.0 - share) * step_m / (meet_mps + lower_mps), 0.0)
    braking_s = after_s + second.time_s[i + 1, column]
    time_s = first.time_s[i, row] + before_s + braking_s
    drawn_j = first.drawn_work_j[i, row] + share * (
        first.drawn_work_j[i + 1, row] - first.drawn_work_j[i, row]
    )
    kept_j = first.returned_work_j[i, row] + share * (
        first.returned_work_j[i + 1, row] - first.returned_work_j[i, row]
    )
    returned_j = (
        kept_j
        + second.returned_work_j[i + 1, column]
        + (1.0 - share)
        * (second.returned_work_j[i, column] - second.returned_work_j[i + 1, column])
    )
    return Net(
        notch_off_mps=first.notch_off_mps,
        hold_m=first.hold_m,
        power_w=second.power_w,
        time_s=time_s,
        acceleration_j=drawn_j / train.traction_efficiency_ratio,
        regenerated_j=returned_j * train.regeneration_efficiency_ratio,
        braking_s=braking_s,
        braking_at_m=(i + share) * step_m,
        braking_from_mps=meet_mps,
    )
