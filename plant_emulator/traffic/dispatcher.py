"""Holds one train at its platforms until its departure time, and records arrivals and
departures.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from firmware_py.trackdb import LineMap
from plant_emulator.traffic.config import TrafficConfig
from plant_emulator.traffic.timetable import LapTimetable, Start

AT_STOP_M: Final = 5.0
LEAD_S: Final = 6.0
"""Time before the departure at which the hold ends, because the doors still have to close."""
NS_PER_S: Final = 1_000_000_000


class StationRun(NamedTuple):
    """One completed run from a station to the next."""

    station: str
    """Name of the station where the run ended."""
    planned_s: float
    left_s: float
    arrived_s: float
    error_m: float
    """Stopping error; positive is too far."""

    @property
    def late_s(self) -> float:
        """Positive: the run took longer than planned."""
        return self.arrived_s - self.left_s - self.planned_s


class Dispatcher:
    """Dispatcher of one train.

    It leaves terminals by the clock and other stations when the dwell is over.
    """

    def __init__(
        self,
        config: TrafficConfig,
        timetable: LapTimetable,
        line: LineMap,
        start: Start,
        dwells_s: Iterator[float],
    ) -> None:
        self.runs: list[StationRun] = []
        self._config, self._timetable, self._line = config, timetable, line
        self._dwells_s = dwells_s
        self._phase_s = start.phase_s
        self._index = start.index
        self._stands = True
        self._leaves_s = timetable.leaves_s[start.index] - start.phase_s
        self._left_s = 0.0

    @property
    def at_platform(self) -> bool:
        """Whether the train has arrived at a station and not left it."""
        return self._stands

    def holds(self, now_s: float, front_m: float, speed_mps: float) -> bool:
        """Return whether the train is to stay, and update the record; call it often.

        Args:
            now_s: time since the start of the timetable.
        """
        stations = self._line.stations
        if self._stands and speed_mps != 0.0:
            if front_m > stations[self._index].stop_m + AT_STOP_M:
                self._stands = False
                self._index += 1
        elif self._stands:
            self._left_s = now_s
        elif speed_mps == 0.0 and self._index < len(stations):
            station = stations[self._index]
            if abs(front_m - station.stop_m) <= AT_STOP_M:
                self._arrives(now_s, front_m - station.stop_m)
        return self._stands and now_s < self._leaves_s - LEAD_S

    def _arrives(self, now_s: float, error_m: float) -> None:
        station = self._line.stations[self._index]
        self.runs.append(StationRun(station.name, station.run_s, self._left_s, now_s, error_m))
        self._stands = True
        lap, place = divmod(self._index, len(self._timetable.leaves_s))
        if self._timetable.at_once[place]:
            self._leaves_s = now_s
        elif self._timetable.fixed[place]:
            begins_s = lap * self._timetable.lap_s - self._phase_s
            self._leaves_s = begins_s + self._timetable.leaves_s[place]
        else:
            self._leaves_s = now_s + next(self._dwells_s)
