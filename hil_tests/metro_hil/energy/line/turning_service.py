"""Energy of trains that turn round: designed runs on all tracks of a network.

Each round trip begins by the clock, one headway after that of the train before. Within it running
times, dwells and layovers decide. The times of a timetable are the running times of all hops of a
round trip, and behind them the layovers before each trip but the first.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.circuit import load_network, split_route
from metro_hil.energy.line.service import (
    CIRCUIT_HEADWAYS,
    DesignedService,
    PlannedHop,
    RunProfile,
    ServiceResults,
)
from metro_hil.energy.running_curve.train import Numbers, RunningTrain
from metro_hil.model.network_places import NetworkAxis
from metro_hil.model.network_supply import supply_of
from metro_hil.model.service import LAYOVER_MAX_S, PlannedTrip, load_service, read_service

DWELL_SPREAD_S: Final = 2.0
"""Dwells are uniform within this distance of the planned ones. No timetable may depend on seconds
that trains do not keep."""
DOORS_S: Final = 7.8
"""Time at a platform besides the dwell: until doors open, and until the train moves behind them.
Whole trains of the Changping line on two tracks took 7.7 to 8.1 s."""
TURN_S: Final = 5.0
"""Time from standing at the end of a trip to the begin of the next one. Whole trains took 5.0 s."""
START_S: Final = 2.05
"""Time from the begin of a trip until protection permits movement; a layover includes it."""
DEPARTS_S: Final = 3.3
"""Time from there to the first movement. Whole trains took 5.35 s after the begin of a trip."""
WHOLE_S: Final = 7.0
"""Time by which whole trains are slower than the fastest designed run: they keep below each limit
and stop gently. A planned time may be shorter."""
ROUTE_S: Final = 60.0
"""Longest time before the stop at a turnback, and behind it, for which a train keeps the route."""
SWITCH_S: Final = 6.0
"""Time in which the route to a turnback is set for the next train."""
START_STEP_S: Final = 5.0
"""Step of the layovers from which a search may begin."""


class TurningService(DesignedService):
    """A service of several trains on a network, with its train and supply."""

    def __init__(self, name: str, supply: str, train: RunningTrain) -> None:
        """Raises SettingsError.

        Args:
            name: path of the service file.
            supply: name or path of the supply.
        """
        self.service = read_service(name)
        if not self.service.headway_s > 0.0:
            raise SettingsError(f"{name}: headway_s: is 0; trains that meet need a timetable")
        self.planned = load_service(name)[: len(self.service.trips)]
        network = load_network(split_route(self.planned[0].line)[0])
        self.network = network.name
        self._axis = NetworkAxis(network)
        self._trips = [_hops_of(trip) for trip in self.planned]
        super().__init__(
            [hop for hops in self._trips for hop in hops],
            train,
            supply_of(supply, network, self.planned),
            headway_s=self.service.headway_s,
            source=f"{name}: run_s",
        )
        self._path_of = [
            trip.path for trip, hops in zip(self.planned, self._trips, strict=True) for _ in hops
        ]
        self.layovers_s = tuple(trip.layover_s for trip in self.planned[1:])
        """Planned layovers before each trip but the first."""
        self._name, self._round_s = name, self.service.trains * self.headway_s

    def trips(self, times_s: Sequence[float]) -> list[list[int]]:
        numbers = iter(range(len(self.hops)))
        return [[next(numbers) for _ in hops] for hops in self._trips]

    @staticmethod
    def _turn_s(layover_s: float) -> float:
        """Time from standing at the end of a trip to the first movement of the next one."""
        return TURN_S + max(START_S, layover_s) + DEPARTS_S

    def layover_max_s(self, times_s: Sequence[float], trip: int) -> float:
        """Longest layover before a trip that leaves the track free for the next train in time."""
        trips = self.trips(times_s)
        into_s, out_s = times_s[trips[trip - 1][-1]], times_s[trips[trip][0]]
        kept_s = min(into_s, ROUTE_S) + min(out_s, ROUTE_S) + TURN_S + DEPARTS_S + SWITCH_S
        planned_s = self.layovers_s[trip - 1]
        return min(LAYOVER_MAX_S, max(planned_s, self.headway_s - DWELL_SPREAD_S - kept_s))

    def least_s(self, index: int) -> float:
        planned_s, whole_s = self.hops[index].end.run_s, super().least_s(index) + WHOLE_S
        return min(planned_s, whole_s) if planned_s else whole_s

    def starts(self, begin_s: Sequence[float]) -> list[list[float]]:
        """Each layover alone in steps, with the others as planned."""
        found = []
        for trip in range(1, len(self._trips)):
            index = len(self.hops) + trip - 1
            for layover_s in np.arange(0.0, self.layover_max_s(begin_s, trip), START_STEP_S):
                times_s = [*begin_s]
                times_s[index] = float(layover_s)
                if self.permits(times_s, begin_s, {index: 1.0}):
                    found.append(times_s)
        return found

    def moves(self, times_s: Sequence[float]) -> list[Mapping[int, float]]:
        layovers = range(len(self.hops), len(times_s))
        return super().moves(times_s) + [{n: sign} for n in layovers for sign in (-1.0, 1.0)]

    def permits(
        self, times_s: Sequence[float], begin_s: Sequence[float], changed: Mapping[int, float]
    ) -> bool:
        layovers_s = times_s[len(self.hops) :]
        return (
            all(
                0.0 <= layover_s <= self.layover_max_s(times_s, trip)
                for trip, layover_s in enumerate(layovers_s, start=1)
            )
            and self._longest_s(times_s) <= self._round_s
            and super().permits(times_s, begin_s, changed)
        )

    def profiles(self, times_s: Sequence[float]) -> list[RunProfile]:
        took_s = self._longest_s(times_s)
        if took_s > self._round_s:
            raise SettingsError(
                f"{self._name}: headway_s: a round trip takes up to {took_s:.0f} s, and "
                f"{self.service.trains} trains every {self.headway_s:g} s leave {self._round_s:g} s"
            )
        return super().profiles(times_s)

    def simulate(self, times_s: Sequence[float], *, seed: int, step_s: float) -> ServiceResults:
        """Run the service with the dwells of a seed; `CIRCUIT_HEADWAYS` count, all trains run."""
        ahead, counted = self.service.trains + 1, CIRCUIT_HEADWAYS
        chance = np.random.default_rng(seed).random((ahead + counted, len(self.hops)))
        leaves_s = [self._departures_s(times_s, row) for row in chance]
        end_s = counted * self.headway_s
        return self._energy(times_s, leaves_s, counted=counted, end_s=end_s, step_s=step_s)

    def _departures_s(self, times_s: Sequence[float], chance: Numbers) -> list[float]:
        """Departure to each hop, and at last the begin of the next round trip."""
        leaves_s = [0.0]
        for trip, hops in enumerate(self.trips(times_s)):
            for index in hops:
                arrival_s = leaves_s[-1] + times_s[index]
                if index != hops[-1]:
                    spread_s = DWELL_SPREAD_S * (2.0 * float(chance[index]) - 1.0)
                    dwell_s = max(0.0, self.hops[index].end.dwell_s + spread_s)
                    leaves_s.append(arrival_s + dwell_s + DOORS_S)
                elif trip + 1 < len(self._trips):
                    leaves_s.append(arrival_s + self._turn_s(times_s[len(self.hops) + trip]))
                else:
                    leaves_s.append(max(arrival_s, self._round_s))
        return leaves_s

    def _longest_s(self, times_s: Sequence[float]) -> float:
        """Time of a round trip with the longest dwells, until the train may begin the next."""
        *_, last_s, _ = self._departures_s(times_s, np.ones(len(self.hops)))
        return last_s + times_s[len(self.hops) - 1] + self._turn_s(0.0)

    def _places_m(self, index: int, front_m: Numbers) -> Numbers:
        path, half_m = self._path_of[index], self._train.length_m / 2.0
        return np.array(
            [self._axis.place_m(path.to_track(at_m - half_m)) for at_m in front_m.tolist()]
        )

    def trips_with(self, times_s: Sequence[float]) -> Iterator[tuple[dict[str, float], float]]:
        """Running times by station, and layover, of each trip of a round trip."""
        layovers_s = [self.planned[0].layover_s, *times_s[len(self.hops) :]]
        for hops, layover_s in zip(self.trips(times_s), layovers_s, strict=True):
            yield {self.hops[index].end.name: times_s[index] for index in hops}, layover_s


def _hops_of(trip: PlannedTrip) -> list[PlannedHop]:
    """The hops between the stops of a trip."""
    line: LineMap = trip.timed(trip.path.line)
    mission = trip.mission(line)
    return [PlannedHop(line, *ends) for ends in pairwise([mission.start, *mission.stops])]
