"""Departure times of a lap, and the place of each train at the start."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station
from plant_emulator.traffic.config import TrafficConfig

TERMINAL_S: Final = 25.0
"""Typical stop of a train at a terminal before it goes round its loop, s."""


@dataclass(frozen=True, slots=True)
class Start:
    """Initial state of one train."""

    train: int
    """Number of the train; 1 is the foremost."""
    station: Station
    index: int
    """Index of the station on the line."""
    phase_s: float
    """Time that the train is into its lap by the timetable."""


@dataclass(frozen=True, slots=True)
class LapTimetable:
    """Departure times by station of a lap, in s after leaving the first; the lap takes `lap_s`.

    On an open line the lap is the whole line.
    """

    leaves_s: tuple[float, ...]
    fixed: tuple[bool, ...]
    """Whether trains leave the station by the clock; otherwise the dwell decides."""
    at_once: tuple[bool, ...]
    lap_s: float


def lap_timetable(config: TrafficConfig, line: LineMap) -> LapTimetable:
    """Compute the timetable.

    Raises SettingsError if a lap takes longer than its trains times the headway.
    """
    lap = line.stations[: config.stations_a_lap] if config.circular else line.stations
    for station in lap[1:]:
        if not station.run_s > 0.0:
            raise SettingsError(
                f"traffic {config.name}: runs_s: {station.name} is missing, and the line gives "
                "no run_s for it"
            )
    leaves_s, fixed, at_once = [0.0], [True], [False]
    arrival_s = 0.0
    for station in lap[1:]:
        before_terminal = at_once[-1]
        turned_s = arrival_s + config.turnback_s
        arrival_s = leaves_s[-1] + station.run_s
        terminal = station.name in config.terminals
        stands_s = TERMINAL_S if terminal else config.dwell_s
        leaves_s.append(turned_s if before_terminal else arrival_s + stands_s)
        fixed.append(before_terminal)
        at_once.append(terminal)
    lap_s = config.trains * config.headway_s
    ends_s = arrival_s + config.turnback_s
    if config.circular and ends_s > lap_s + 1e-6:
        raise SettingsError(
            f"traffic {config.name}: a lap takes {ends_s:g} s, {config.trains} trains every "
            f"{config.headway_s:g} s leave {lap_s:g} s"
        )
    return LapTimetable(tuple(leaves_s), tuple(fixed), tuple(at_once), lap_s)


def starts(config: TrafficConfig, line: LineMap, trains: int) -> tuple[Start, ...]:
    """Place each train at the station that it leaves next, the foremost first.

    Raises SettingsError for more trains than the timetable has, or for two at one platform.
    """
    if not 1 <= trains <= config.trains:
        raise SettingsError(f"--trains {trains}: on {line.name} there are 1 to {config.trains}")
    timetable = lap_timetable(config, line)
    # A train that begins at the end of an open line has no way to go.
    leaves_s = timetable.leaves_s if config.circular else timetable.leaves_s[:-1]
    placed = []
    for train in range(1, trains + 1):
        phase_s = (trains - train) * config.headway_s
        later = [n for n, at_s in enumerate(leaves_s) if at_s >= phase_s]
        if not later:
            raise SettingsError(
                f"traffic {config.name}: trains: {trains} every {config.headway_s:g} s do not fit "
                f"on {line.name}, the foremost would be at its end; take fewer or a shorter headway"
            )
        placed.append(Start(train, line.stations[later[0]], later[0], phase_s))
    _check_apart(config, placed)
    return tuple(placed)


def _check_apart(config: TrafficConfig, placed: Sequence[Start]) -> None:
    for ahead, behind in itertools.pairwise(placed):
        if behind.index >= ahead.index:
            raise SettingsError(
                f"traffic {config.name}: trains {ahead.train} and {behind.train} both begin at "
                f"{ahead.station.name}"
            )
