"""Divides the time of a trip among its hops so that all runs together take the least energy.

Each hop has a net of designed runs: the lower convex hull of energy over running time. Every second
of the trip goes where it saves most. Trains do not meet here: nothing is shifted against another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap
from metro_hil.energy.running_curve.design import Hop
from metro_hil.energy.running_curve.net import with_thrift
from metro_hil.energy.running_curve.track import track_between
from metro_hil.energy.running_curve.train import Numbers, RunningTrain


@dataclass(frozen=True, slots=True)
class HopCosts:
    """Energy of one hop over its running time, as a convex curve; both arrays (points,)."""

    start: str
    end: str
    times_s: Numbers
    """Rising, from the fastest run to the cheapest one."""
    energies_j: Numbers
    """Drawn energy less the used regenerated energy, falling."""

    @property
    def fastest_s(self) -> float:
        return float(self.times_s[0])

    def from_s(self, least_s: float) -> "HopCosts":
        """The costs of the running times of at least this."""
        later = self.times_s > least_s
        times_s = np.concatenate([[max(least_s, self.fastest_s)], self.times_s[later]])
        energies_j = np.concatenate([[self.energy_j(times_s[0])], self.energies_j[later]])
        return HopCosts(self.start, self.end, times_s, energies_j)

    def energy_j(self, time_s: float) -> float:
        """Interpolate. More time than that of the cheapest run saves nothing."""
        return float(np.interp(time_s, self.times_s, self.energies_j))


def hop_costs(line: LineMap, train: RunningTrain, index: int, use_ratio: float) -> HopCosts:
    """Compute the hop behind the station with this index. Raises SettingsError."""
    names = line.stations[index].name, line.stations[index + 1].name
    track = track_between(line, train, *names)[2]
    return costs_of(*names, Hop(train, with_thrift(train, track, use_ratio)), use_ratio)


def costs_of(start: str, end: str, hop: Hop, use_ratio: float) -> HopCosts:
    """Return the costs of a hop whose net of runs is known."""
    net = hop.net
    times_s, energies_j = net.time_s[:, 0], net.total_j(use_ratio)[:, 0]
    ends = np.isfinite(times_s)
    return HopCosts(start, end, *lower_hull(times_s[ends], energies_j[ends]))


def lower_hull(times_s: Numbers, energies_j: Numbers) -> tuple[Numbers, Numbers]:
    """Return the lower convex hull from the shortest time to the least energy."""
    order = np.lexsort((energies_j, times_s))
    kept: list[int] = []
    for point in order:
        if kept and energies_j[point] >= energies_j[kept[-1]]:
            continue
        while len(kept) > 1:
            a, b = kept[-2], kept[-1]
            run_s, more_s = times_s[b] - times_s[a], times_s[point] - times_s[a]
            chord_j = (energies_j[point] - energies_j[a]) * run_s
            if (energies_j[b] - energies_j[a]) * more_s < chord_j:
                break
            kept.pop()
        kept.append(int(point))
    return times_s[kept], energies_j[kept]


def divide(hops: Sequence[HopCosts], trip_s: float) -> list[float]:
    """Return the running time of each hop; together they take `trip_s`.

    Raises SettingsError if the fastest runs take longer. Time that saves nothing goes to all hops
    in proportion.
    """
    runs_s = [hop.fastest_s for hop in hops]
    left_s = trip_s - sum(runs_s)
    if left_s < 0.0:
        raise SettingsError(f"a trip of {trip_s:.1f} s: the fastest runs take {sum(runs_s):.1f} s")
    pieces = [
        (float(np.diff(hop.energies_j)[n] / np.diff(hop.times_s)[n]), number, n)
        for number, hop in enumerate(hops)
        for n in range(len(hop.times_s) - 1)
    ]
    for _, number, n in sorted(pieces):
        more_s = min(left_s, float(np.diff(hops[number].times_s)[n]))
        runs_s[number] += more_s
        left_s -= more_s
    total_s = sum(runs_s)
    return [run_s * (1.0 + left_s / total_s) for run_s in runs_s]
