"""Energy of a service on any line: designed runs of all trains together on the supply.

Each train leaves the first station one headway after the train before, takes the planned time for
each run and dwells by chance. Its power comes from the designed run of that time. The network is
solved step by step with the mean powers. Trains do not hinder one another here.

A timetable is a list of times in s: the running time of each hop, and behind them whatever else a
kind of service may choose.
"""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station
from metro_hil.energy.running_curve.design import TIME_TOLERANCE_S, Hop
from metro_hil.energy.running_curve.net import with_thrift
from metro_hil.energy.running_curve.trace import trace
from metro_hil.energy.running_curve.track import track_between
from metro_hil.energy.running_curve.train import Numbers, RunningTrain
from plant_emulator.power.box import J_PER_KWH
from plant_emulator.power.network import Load
from plant_emulator.power.supplies import Supply
from plant_emulator.traffic.config import TrafficConfig
from plant_emulator.traffic.timetable import TERMINAL_S, LapTimetable, lap_timetable

CIRCUIT_HEADWAYS: Final = 4
"""Number of headways of a circuit that count. Each carries one train round."""
OFF_TIME_S: Final = 0.3
"""Greatest difference of a designed run from its planned time."""
USE_RATIO: Final = 1.0
"""Share of the regenerated energy that the design of single runs takes as used."""
REACH_S: Final = 12.0
"""Greatest change of one running time by a search."""


@dataclass(frozen=True, slots=True)
class PlannedHop:
    """A run from one stop to the next."""

    line: LineMap
    start: Station
    end: Station
    """With the planned running time."""


@dataclass(frozen=True, slots=True)
class RunProfile:
    """One designed run; arrays by node of its track."""

    time_s: Numbers
    """Since the departure."""
    at_m: Numbers
    """Place on the supply."""
    drawn_j: Numbers
    """Electrical energy of traction so far."""
    given_j: Numbers
    """Electrical energy of the motor brake so far."""


@dataclass(frozen=True, slots=True)
class ServiceResults:
    """Energy of the line over some headways, for each train that it carried."""

    actual_kwh: float
    """From the grid, with auxiliaries, less what substations return and storages gained."""
    traction_kwh: float
    regenerated_kwh: float
    burnt_kwh: float
    """Regenerated energy that the trains' resistors took."""
    unserved_kwh: float
    """Traction that low voltage denied. Such trains would be late."""
    lowest_v: float


class DesignedService(ABC):
    """A service whose trains take designed runs, on its supply."""

    def __init__(
        self,
        hops: Sequence[PlannedHop],
        train: RunningTrain,
        supply: Supply,
        *,
        headway_s: float,
        source: str,
    ) -> None:
        """Args:
        hops: of a lap, a round trip or an open line.
        source: begin of messages about a running time.
        """
        self.hops, self.headway_s = tuple(hops), headway_s
        self.ends = [hop.end.name for hop in hops]
        """Station at which each hop ends, as a file of running times names it."""
        self._train, self._supply, self._source = train, supply, source
        self._designed: dict[int, Hop] = {}
        self._profiles: dict[tuple[int, float], RunProfile | None] = {}

    @abstractmethod
    def trips(self, times_s: Sequence[float]) -> list[list[int]]:
        """Hops by trip. Within a trip only running times and dwells decide, no clock."""

    @abstractmethod
    def simulate(self, times_s: Sequence[float], *, seed: int, step_s: float) -> ServiceResults:
        """Run the service with the dwells of a seed. Raises SettingsError."""

    @abstractmethod
    def _places_m(self, index: int, front_m: Numbers) -> Numbers:
        """Places on the supply of a train with its front at these chainages of a hop's line."""

    def starts(self, begin_s: Sequence[float]) -> list[list[float]]:
        """Timetables from which a search may begin, besides `begin_s`."""
        return []

    def moves(self, times_s: Sequence[float]) -> list[Mapping[int, float]]:
        """Proposals of a search: factors of the step by the index of the time that it changes.

        They move seconds between the runs before and after one station.
        """
        return [
            {before: sign, before + 1: -sign}
            for hops in self.trips(times_s)
            for before in hops[:-1]
            for sign in (-1.0, 1.0)
        ]

    def permits(
        self, times_s: Sequence[float], begin_s: Sequence[float], changed: Mapping[int, float]
    ) -> bool:
        """Whether a search that began with `begin_s` may choose these times."""
        return all(
            abs(times_s[hop] - begin_s[hop]) <= REACH_S
            and times_s[hop] >= self.least_s(hop)
            and self.profile(hop, times_s[hop]) is not None
            for hop in changed
            if hop < len(self.hops)
        )

    def hop(self, index: int) -> Hop:
        """The hop with the net of its runs."""
        if index not in self._designed:
            hop = self.hops[index]
            track = track_between(hop.line, self._train, hop.start.name, hop.end.name)[2]
            self._designed[index] = Hop(self._train, with_thrift(self._train, track, USE_RATIO))
        return self._designed[index]

    def least_s(self, index: int) -> float:
        """Shortest running time of a hop that a timetable may choose."""
        return float(np.min(self.hop(index).net.time_s))

    def profile(self, index: int, run_s: float) -> RunProfile | None:
        """The designed run of this time; None if this train has none."""
        key = index, round(run_s, 1)
        if key not in self._profiles:
            hop = self.hop(index)
            # Rounding may have made the time shorter than the fastest run.
            curve = hop.slowest(max(key[1], float(np.min(hop.net.time_s)) + TIME_TOLERANCE_S))
            found = None
            if curve is not None and abs(curve.time_s - key[1]) <= OFF_TIME_S:
                run = trace(self._train, hop.track, curve)
                joule = run.power_w[1:] * np.diff(run.time_s)
                middle_mps = (run.speed_mps[1:] + run.speed_mps[:-1]) / 2.0
                force_n = np.abs(joule) / hop.track.cell_m
                drawn_j = np.maximum(joule, 0.0)
                drawn_j /= self._train.traction_efficiency(middle_mps, force_n)
                given_j = np.maximum(-joule, 0.0)
                given_j *= self._train.regeneration_efficiency(middle_mps, force_n)
                found = RunProfile(
                    run.time_s,
                    self._places_m(index, self.hops[index].start.stop_m + run.at_m),
                    np.concatenate([[0.0], np.cumsum(drawn_j)]),
                    np.concatenate([[0.0], np.cumsum(given_j)]),
                )
            self._profiles[key] = found
        return self._profiles[key]

    def profiles(self, times_s: Sequence[float]) -> list[RunProfile]:
        """The runs of all hops. Raises SettingsError for a time without a designed run."""
        found = []
        for index in range(len(self.hops)):
            profile = self.profile(index, times_s[index])
            if profile is None:
                fastest_s = float(np.min(self.hop(index).net.time_s))
                raise SettingsError(
                    f"{self._source}: {self.ends[index]}: {self._train.name} has no run of "
                    f"{times_s[index]:.1f} s; its fastest one takes {fastest_s:.1f} s"
                )
            found.append(profile)
        return found

    def _energy(
        self,
        times_s: Sequence[float],
        leaves_s: Sequence[Sequence[float]],
        *,
        counted: int,
        end_s: float,
        step_s: float,
    ) -> ServiceResults:
        """The energy from 0 s to `end_s`.

        Args:
            leaves_s: departures of each train, and at last the time at which it is gone. The last
                `counted` trains leave one headway after the other, the first of them at 0 s; the
                others before.
        """
        profiles, ahead = self.profiles(times_s), len(leaves_s) - counted
        edges_s = np.arange(math.ceil(end_s / step_s) + 1, dtype=np.float64) * step_s
        rows = [
            self._powers(profiles, leaves, edges_s - (train - ahead) * self.headway_s)
            for train, leaves in enumerate(leaves_s)
        ]
        return self._account(rows, step_s, counted)

    def _powers(
        self, profiles: Sequence[RunProfile], leaves_s: Sequence[float], edges_s: Numbers
    ) -> tuple[Numbers, Numbers, Numbers]:
        """Place in m, wanted and regenerated power in W of one train in each step.

        Off the line the place is NaN.
        """
        middle_s, step_s = (edges_s[1:] + edges_s[:-1]) / 2.0, edges_s[1] - edges_s[0]
        place_m = np.full(len(middle_s), np.nan)
        wants_w, gives_w = np.zeros(len(middle_s)), np.zeros(len(middle_s))
        for run, (leave_s, next_s) in zip(profiles, itertools.pairwise(leaves_s), strict=True):
            on = (middle_s >= leave_s) & (middle_s < next_s)
            place_m[on] = np.interp(middle_s[on] - leave_s, run.time_s, run.at_m)
            wants_w += np.diff(np.interp(edges_s - leave_s, run.time_s, run.drawn_j)) / step_s
            gives_w += np.diff(np.interp(edges_s - leave_s, run.time_s, run.given_j)) / step_s
        return place_m, wants_w, gives_w

    def _account(
        self, rows: Sequence[tuple[Numbers, Numbers, Numbers]], step_s: float, trains: int
    ) -> ServiceResults:
        network = self._supply.network()
        stored_j = sum(network.charges_j)
        sums_w = np.zeros(5)
        lowest_v = self._supply.no_load_v
        for step in range(len(rows[0][0])):
            loads = [
                Load(
                    float(place_m[step]),
                    float(wants_w[step]),
                    float(gives_w[step]),
                    self._train.auxiliary_w,
                )
                for place_m, wants_w, gives_w in rows
                if not math.isnan(place_m[step])
            ]
            fed, balance = network.solve(loads)
            network.advance(step_s)
            served_w = sum([each.traction_w for each in fed])
            wanted_w = sum([each.wants_w for each in loads])
            given_w = sum([each.regenerated_w for each in fed])
            burnt_w = sum([each.resistor_w for each in fed])
            sums_w += (balance.sources_w, served_w, given_w, burnt_w, wanted_w - served_w)
            lowest_v = min([lowest_v, *[each.voltage_v for each in fed]])
        if network.unconverged:
            raise SettingsError(
                f"supply {self._supply.name}: {network.unconverged} of {network.solved} steps "
                "have no solution; it is too weak for this traffic"
            )
        kwh = [float(sum_w) * step_s / J_PER_KWH / trains for sum_w in sums_w]
        gained_kwh = (sum(network.charges_j) - stored_j) / J_PER_KWH / trains
        return ServiceResults(
            actual_kwh=kwh[0] - gained_kwh,
            traction_kwh=kwh[1],
            regenerated_kwh=kwh[2],
            burnt_kwh=kwh[3],
            unserved_kwh=kwh[4],
            lowest_v=lowest_v,
        )


class ServiceLine(DesignedService):
    """A line with its traffic, train and supply."""

    def __init__(
        self, traffic: TrafficConfig, line: LineMap, train: RunningTrain, supply: Supply
    ) -> None:
        lap = traffic.stations_a_lap
        stations = line.stations[: lap + 1] if traffic.circular else line.stations
        super().__init__(
            [PlannedHop(line, *ends) for ends in itertools.pairwise(stations)],
            train,
            supply,
            headway_s=traffic.headway_s,
            source=f"traffic {traffic.name}: runs_s",
        )
        if traffic.circular:
            self.ends[-1] = stations[0].name
        self.stations = stations
        """The stations of a lap; on a circuit also the first one of the next lap."""
        self._traffic, self._line = traffic, line

    def timetable(self, runs_s: Sequence[float]) -> LapTimetable:
        """The timetable with these running times. Raises SettingsError."""
        timed = [
            replace(station, run_s=run_s)
            for station, run_s in zip(self.stations[1:], runs_s, strict=True)
        ]
        rest = self._line.stations[len(self.stations) :]
        line = replace(self._line, stations=(self.stations[0], *timed, *rest))
        return lap_timetable(self._traffic, line)

    def trips(self, times_s: Sequence[float]) -> list[list[int]]:
        timetable = self.timetable(times_s)
        found: list[list[int]] = [[]]
        for index in range(len(times_s)):
            if index + 1 == len(timetable.leaves_s) or timetable.fixed[index + 1]:
                found.append([])
            else:
                found[-1].append(index)
        return [hops for hops in found if hops]

    def _dwells_s(self, seed: int, trains: int) -> Numbers:
        """Dwells by train and station, (trains, stations); the same for all running times."""
        spread_s = self._traffic.dwell_spread_s
        chance = np.random.default_rng(seed).random((trains, len(self.stations)))
        return self._traffic.dwell_s + spread_s * (2.0 * chance - 1.0)

    def simulate(self, times_s: Sequence[float], *, seed: int, step_s: float) -> ServiceResults:
        """Run the service with the dwells of a seed.

        On an open line all trains run once to the last station. On a circuit `CIRCUIT_HEADWAYS`
        count, after a lap that fills it.
        """
        traffic = self._traffic
        timetable = self.timetable(times_s)
        slack_s = traffic.dwell_spread_s * len(self.stations)
        trip_s = timetable.leaves_s[-1] + slack_s
        ahead, counted, end_s = 0, traffic.trains, (traffic.trains - 1) * traffic.headway_s + trip_s
        if traffic.circular:
            ahead = math.ceil((timetable.lap_s + slack_s) / traffic.headway_s)
            counted, end_s = CIRCUIT_HEADWAYS, CIRCUIT_HEADWAYS * traffic.headway_s
        leaves_s = [
            self._departures_s(timetable, times_s, dwells_s)
            for dwells_s in self._dwells_s(seed, ahead + counted)
        ]
        return self._energy(times_s, leaves_s, counted=counted, end_s=end_s, step_s=step_s)

    def _places_m(self, index: int, front_m: Numbers) -> Numbers:
        return np.array([self._traffic.place_m(at_m) for at_m in front_m.tolist()])

    def _departures_s(
        self, timetable: LapTimetable, runs_s: Sequence[float], dwells_s: Numbers
    ) -> list[float]:
        """Departure from each station, and at last the time at which the train is gone."""
        leaves_s = [0.0]
        for index, run_s in enumerate(runs_s, start=1):
            arrival_s = leaves_s[-1] + run_s
            if index == len(timetable.leaves_s):
                return [*leaves_s, max(arrival_s, timetable.lap_s)]
            if timetable.at_once[index]:
                leaves_s.append(arrival_s + TERMINAL_S)
            elif timetable.fixed[index]:
                leaves_s.append(max(arrival_s, timetable.leaves_s[index]))
            else:
                leaves_s.append(arrival_s + float(dwells_s[index]))
        return leaves_s
