"""Design after [Ninh]: the notch-off speed from the weight, the power limit from the running time.

The notch-off speed follows from the running time x of the train with its full brake. Within T0 <= x
<= T, x minimises f(x) = E_acc(x) / E_acc(T0) + weight * x / T0. The rest of the time, T - x, goes
to the brake: with the chosen power limit the run lasts T. The limit is found on the runs
themselves; equation (1)'s rule for the braking time is in `literal`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_py.settings import SettingsError
from metro_hil.energy.running_curve.net import Arrivals, Departures, Net, arrivals, departures, join
from metro_hil.energy.running_curve.track import HopTrack
from metro_hil.energy.running_curve.train import Numbers, RunningTrain

SPEEDS: Final = 161
HOLDS: Final = 40
FINE: Final = 41
POWERS: Final = 96
POWER_MIN_RATIO: Final = 0.05
"""Least power limit that the search considers, as a share of the greatest one."""
SPEED_MIN_RATIO: Final = 0.35
ROUNDS: Final = 3
SECTIONS: Final = 65
"""Number of sections of an interval; a whole batch costs little more than one curve."""
TIME_TOLERANCE_S: Final = 0.005
EARLY_S: Final = 0.3


class InfeasibleError(SettingsError):
    """No curve of this train takes exactly that time."""


@dataclass(frozen=True, slots=True)
class RunningCurve:
    """One whole run."""

    notch_off_mps: float
    hold_m: float
    """Distance over which the notch-off speed is held before the train coasts."""
    power_w: float
    """Power limit of the electric brake at the wheel, all motors together."""
    time_s: float
    acceleration_j: float
    regenerated_j: float
    braking_s: float
    braking_at_m: float
    braking_from_mps: float

    def total_j(self, use_ratio: float) -> float:
        return self.acceleration_j - use_ratio * self.regenerated_j


@dataclass(frozen=True, slots=True)
class WeightedChoice:
    """The choice by the weight among the runs with the full brake."""

    weight_factor: float
    x_s: float
    fastest_s: float
    """T0, the shortest running time."""
    times_s: Numbers
    """x of each notch-off speed, in falling order."""
    accelerations_j: Numbers
    scores_ratio: Numbers
    """f(x)."""
    cubic_j: Numbers
    """Coefficients A, B, C, D of E_acc over x - T0, highest order first."""
    cubic_x_s: float
    """x that minimises f on the fitted cubic. The choice itself compares the runs."""
    notch_off_mps: float
    hold_m: float


@dataclass(frozen=True, slots=True)
class Design:
    time_s: float
    choice: WeightedChoice
    curve: RunningCurve
    late_s: float
    """Lateness of the run; 0 unless even the full brake makes it too slow."""


class Hop:
    """One train on one hop, with the runs under the full brake, which all designs share."""

    def __init__(self, train: RunningTrain, track: HopTrack) -> None:
        self.train = train
        self.track = track
        self.full = arrivals(train, track, np.array([train.brake_power_w]))
        self.net = join(train, track, _all_departures(train, track), self.full)
        self._slowest: dict[float, RunningCurve | None] = {}

    def slowest(self, time_s: float) -> RunningCurve | None:
        """Return the run of exactly this time with the full brake; None without one."""
        if time_s not in self._slowest:
            self._slowest[time_s] = _by_time(self.train, self.track, self.full, time_s)
        return self._slowest[time_s]


def whole_net(train: RunningTrain, track: HopTrack) -> Net:
    """Return the net of all curves: ways to gain speed by power limits."""
    powers_w = np.linspace(POWER_MIN_RATIO, 1.0, POWERS) * train.brake_power_w
    return join(train, track, _all_departures(train, track), arrivals(train, track, powers_w))


def _all_departures(train: RunningTrain, track: HopTrack) -> Departures:
    eagerness = np.append(
        np.linspace(SPEED_MIN_RATIO, 1.0, SPEEDS), 1.0 + np.linspace(0.0, 1.0, HOLDS + 1)[1:]
    )
    return _eager(train, track, eagerness)


def _eager(train: RunningTrain, track: HopTrack, eagerness: Numbers) -> Departures:
    """Return the departures for eagerness values, each of which is one way to gain speed.

    Up to 1 it is the notch-off speed as a share of the limit. Above 1 the excess is the share of
    the way over which the limit is held.
    """
    top_mps = float(np.max(track.ceiling_mps))
    speeds_mps = np.minimum(eagerness, 1.0) * top_mps
    holds_m = np.maximum(eagerness - 1.0, 0.0) * track.length_m
    return departures(train, track, speeds_mps, holds_m)


def curve_of(
    train: RunningTrain, track: HopTrack, notch_off_mps: float, hold_m: float, power_w: float
) -> RunningCurve:
    """Return a single run."""
    first = departures(train, track, np.array([notch_off_mps]), np.array([hold_m]))
    return pick(join(train, track, first, arrivals(train, track, np.array([power_w]))), 0, 0)


def pick(net: Net, row: int, column: int) -> RunningCurve:
    return RunningCurve(
        notch_off_mps=float(net.notch_off_mps[row]),
        hold_m=float(net.hold_m[row]),
        power_w=float(net.power_w[column]),
        time_s=float(net.time_s[row, column]),
        acceleration_j=float(net.acceleration_j[row, column]),
        regenerated_j=float(net.regenerated_j[row, column]),
        braking_s=float(net.braking_s[row, column]),
        braking_at_m=float(net.braking_at_m[row, column]),
        braking_from_mps=float(net.braking_from_mps[row, column]),
    )


def choose(hop: Hop, time_s: float, weight_factor: float) -> WeightedChoice:
    """Choose x by the weight. Raises InfeasibleError."""
    train, track, full, net = hop.train, hop.track, hop.full, hop.net
    fastest_s = float(np.min(net.time_s))
    if time_s < fastest_s - TIME_TOLERANCE_S:
        raise InfeasibleError(
            f"--time {time_s:g}: the fastest run of {train.name} takes {fastest_s:.2f} s"
        )
    curves = _shorter(net, time_s)
    slowest = hop.slowest(time_s)
    if slowest is not None:
        curves.append(slowest)
    best = min(curves, key=lambda curve: _score(curve, curves[0], weight_factor))
    # Refine between the neighbours of the best run, so that the result is not bound to the grid.
    at, step = _eagerness(track, best), 1.0 / HOLDS
    fine = np.linspace(max(SPEED_MIN_RATIO, at - step), min(2.0, at + step), FINE)
    curves += _shorter(join(train, track, _eager(train, track, fine), full), time_s)
    curves.sort(key=lambda curve: -curve.time_s)
    fastest = curves[-1]
    best = min(curves, key=lambda curve: _score(curve, fastest, weight_factor))
    times_s = np.array([curve.time_s for curve in curves])
    energies_j = np.array([curve.acceleration_j for curve in curves])
    scores = np.array([_score(curve, fastest, weight_factor) for curve in curves])
    cubic_j, cubic_x_s = _cubic(times_s, energies_j, fastest.time_s, weight_factor)
    return WeightedChoice(
        weight_factor=weight_factor,
        x_s=best.time_s,
        fastest_s=fastest.time_s,
        times_s=times_s,
        accelerations_j=energies_j,
        scores_ratio=scores,
        cubic_j=cubic_j,
        cubic_x_s=cubic_x_s,
        notch_off_mps=best.notch_off_mps,
        hold_m=best.hold_m,
    )


def _shorter(net: Net, time_s: float) -> list[RunningCurve]:
    """Return the runs in time with the net's first brake, the fastest first.

    A run that costs more than another and takes no less time is left out.
    """
    kept: list[RunningCurve] = []
    for row in range(len(net.notch_off_mps)):
        if net.time_s[row, 0] <= time_s and (not kept or net.time_s[row, 0] < kept[-1].time_s):
            kept.append(pick(net, row, 0))
    return kept[::-1]


def _eagerness(track: HopTrack, curve: RunningCurve) -> float:
    top_mps = float(np.max(track.ceiling_mps))
    return curve.notch_off_mps / top_mps + curve.hold_m / track.length_m


def _score(curve: RunningCurve, fastest: RunningCurve, weight_factor: float) -> float:
    """Return f(x) of equation (1)."""
    energy_ratio = curve.acceleration_j / fastest.acceleration_j
    return energy_ratio + weight_factor * curve.time_s / fastest.time_s


def _cubic(
    times_s: Numbers, energies_j: Numbers, fastest_s: float, weight_factor: float
) -> tuple[Numbers, float]:
    """Return the third-order E_acc of equation (1), and the x that minimises its f."""
    if len(times_s) < 4:
        return np.array([0.0, 0.0, 0.0, float(energies_j[-1])]), float(times_s[-1])
    cubic_j = np.polyfit(times_s - fastest_s, energies_j, 3)
    fine_s = np.linspace(float(times_s[-1]), float(times_s[0]), 2001)
    scores = np.polyval(cubic_j, fine_s - fastest_s) / energies_j[-1]
    scores += weight_factor * fine_s / fastest_s
    return cubic_j, float(fine_s[int(np.argmin(scores))])


def _by_time(
    train: RunningTrain, track: HopTrack, second: Arrivals, time_s: float
) -> RunningCurve | None:
    """Return the run of exactly this time with one power limit; None without one."""
    low, high = SPEED_MIN_RATIO / 4.0, 2.0
    net = None
    for _ in range(ROUNDS):
        eagerness = np.linspace(low, high, SECTIONS)
        net = join(train, track, _eager(train, track, eagerness), second)
        late = net.time_s[:, 0] > time_s
        if bool(np.all(late)):
            return None
        first = int(np.argmin(late))
        if first == 0:
            break
        low, high = float(eagerness[first - 1]), float(eagerness[first])
    assert net is not None
    return pick(net, int(np.argmin(net.time_s[:, 0] > time_s)), 0)


def with_time(
    train: RunningTrain, track: HopTrack, power_w: float, time_s: float
) -> RunningCurve | None:
    """Return the run of exactly this time whose brake has this power limit; None without one."""
    return _by_time(train, track, arrivals(train, track, np.array([power_w])), time_s)


def limit_for_time(
    train: RunningTrain, track: HopTrack, notch_off_mps: float, hold_m: float, time_s: float
) -> RunningCurve:
    """Return the run with the least power limit that is not late, by bisection in wide sections.

    If even the least power limit is too strong, the run is early. If the full brake is too weak,
    the function returns the run with it, which is late.
    """
    first = departures(train, track, np.array([notch_off_mps]), np.array([hold_m]))
    low_w, high_w = POWER_MIN_RATIO * train.brake_power_w, train.brake_power_w
    net = None
    for _ in range(ROUNDS):
        powers_w = np.linspace(low_w, high_w, SECTIONS)
        net = join(train, track, first, arrivals(train, track, powers_w))
        late = net.time_s[0] > time_s
        if bool(np.all(late)):
            return pick(net, 0, SECTIONS - 1)
        found = int(np.argmin(late))
        if found == 0:
            break
        low_w, high_w = float(powers_w[found - 1]), float(powers_w[found])
    assert net is not None
    return pick(net, 0, int(np.argmin(net.time_s[0] > time_s)))


def design(hop: Hop, time_s: float, weight_factor: float) -> Design:
    """Design a curve. Raises InfeasibleError if no run of this train takes exactly `time_s`."""
    if not 0.0 <= weight_factor < np.inf:
        raise SettingsError(f"--eta {weight_factor:g}: is not zero or more")
    choice = choose(hop, time_s, weight_factor)
    curve = limit_for_time(hop.train, hop.track, choice.notch_off_mps, choice.hold_m, time_s)
    if time_s - curve.time_s > EARLY_S:
        early_s = time_s - curve.time_s
        raise InfeasibleError(
            f"--time {time_s:g}: with the least power limit it is still {early_s:.1f} s early"
        )
    return Design(time_s, choice, curve, max(0.0, curve.time_s - time_s))
