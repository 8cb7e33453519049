"""When trains leave which station, and where each stands when the emulation begins."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py.settings import SettingsError
from firmware_py.trackdb import LineMap, Station
from plant_emulator.traffic.config import TrafficConfig

TERMINAL_S: Final = 25.0
"""About how long a train stands at a terminal before it goes round its loop."""


@dataclass(frozen=True, slots=True)
class Start:
    """Of one train, at the beginning."""

    train: int
    """Its number; 1 is foremost."""
    station: Station
    index: int
    """Of the station on the line."""
    phase_s: float
    """How far its lap has gone by the timetable."""


@dataclass(frozen=True, slots=True)
class LapTimetable:
    """By station of a lap, in s after leaving the first; the lap takes `lap_s`."""

    leaves_s: tuple[float, ...]
    fixed: tuple[bool, ...]
    """Whether the station is left by the clock; else the dwell decides."""
    at_once: tuple[bool, ...]
    lap_s: float


def lap_timetable(config: TrafficConfig, line: LineMap) -> LapTimetable:
    """Raises SettingsError for a lap that takes longer than its trains at their headway."""
    lap = line.stations[: config.stations_a_lap]
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
    if ends_s > lap_s + 1e-6:
        raise SettingsError(
            f"traffic {config.name}: a lap takes {ends_s:g} s, {config.trains} trains every "
            f"{config.headway_s:g} s leave {lap_s:g} s"
        )
    return LapTimetable(tuple(leaves_s), tuple(fixed), tuple(at_once), lap_s)


def starts(config: TrafficConfig, line: LineMap, trains: int) -> tuple[Start, ...]:
    """Each train stands where it leaves next; the foremost first.

    Raises SettingsError for more trains than the timetable has, or two at one platform.
    """
    if not 1 <= trains <= config.trains:
        raise SettingsError(f"--trains {trains}: on {config.line} there are 1 to {config.trains}")
    timetable = lap_timetable(config, line)
    placed = []
    for train in range(1, trains + 1):
        phase_s = (trains - train) * config.headway_s
        later = [n for n, leaves_s in enumerate(timetable.leaves_s) if leaves_s >= phase_s]
        if not later:
            raise SettingsError(f"traffic {config.name}: train {train} has no station to stand at")
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
