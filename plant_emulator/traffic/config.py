"""The traffic of a line: trains, headway, turnbacks, dwells, and the mapping of track to
network.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from firmware_py import settings
from firmware_py.trackdb import LineMap, load_line
from plant_emulator.power.supplies import Supply, check_feeds, load_supply

PACKAGE: Final = "plant_emulator.traffic"
PLACE_STEP_M: Final = 25.0
"""Step in which a line is checked for sections that feed it."""


@dataclass(frozen=True, slots=True)
class Bend:
    """One point of the mapping from a lap's chainage to a place along the network."""

    at_m: float
    place_m: float


@dataclass(frozen=True, slots=True)
class TrafficConfig:
    """The traffic of one line. Raises ValueError when its parts contradict each other."""

    name: str
    line: str
    """Line, by name or by path; a path is relative to the traffic file."""
    consist: str
    """Consist of all trains, likewise."""
    supply: str
    """Supply, likewise; see `plant_emulator.power.supplies`."""
    trains: int
    """Greatest number of trains; on a circuit the number at which the headway is even all round."""
    headway_s: float
    dwell_s: float
    dwell_spread_s: float
    """Dwells are distributed uniformly over dwell_s ± this value."""
    params: str | None = None
    """Parameters of all controllers, likewise; None: those with the name of the consist."""
    stations_a_lap: int = 0
    lap_m: float = 0.0
    """Length of a lap of a circuit. 0: an open line, which each train runs through once."""
    turnback_s: float = 0.0
    """Time from stopping at a terminal to leaving the platform behind its loop."""
    terminals: tuple[str, ...] = ()
    """Stations of the lap that trains leave as soon as the minimum dwell is over."""
    runs_s: Mapping[str, float] = field(default_factory=dict)
    """Planned running times by the station where the run ends. A station that is not here has the
    time of the line file."""
    way: tuple[Bend, ...] = ()
    """Places along the network. Empty on an open line: the place is the chainage."""

    def __post_init__(self) -> None:
        for name in ("headway_s", "dwell_s"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if not 0.0 <= self.dwell_spread_s <= self.dwell_s:
            raise ValueError(f"dwell_spread_s {self.dwell_spread_s} is not in 0..dwell_s")
        for station, run_s in self.runs_s.items():
            if not 0.0 < run_s < math.inf:
                raise ValueError(f"runs_s: {station} {run_s} is not positive")
        if self.trains < 1:
            raise ValueError(f"trains {self.trains} is not 1 or more")
        if not 0.0 <= self.lap_m < math.inf:
            raise ValueError(f"lap_m {self.lap_m} is negative; an open line has 0")
        if self.circular:
            self._check_circuit()
        elif self.stations_a_lap or self.terminals or self.turnback_s:
            raise ValueError(
                "stations_a_lap, terminals and turnback_s are for a circuit with lap_m"
            )
        ats_m = [bend.at_m for bend in self.way]
        if self.way and (len(ats_m) < 2 or any(b <= a for a, b in itertools.pairwise(ats_m))):
            raise ValueError("way: needs two points or more, with rising at_m")

    def _check_circuit(self) -> None:
        if not 0.0 < self.turnback_s < math.inf:
            raise ValueError(f"turnback_s {self.turnback_s} is not positive")
        if not 1 <= self.trains <= self.stations_a_lap:
            raise ValueError(f"trains {self.trains} is not in 1..stations_a_lap")
        if not self.way or self.way[0].at_m != 0.0 or self.way[-1].at_m != self.lap_m:
            raise ValueError("way does not lead from 0 to lap_m")

    @property
    def circular(self) -> bool:
        """Trains go round, and the foremost follows the last."""
        return self.lap_m > 0.0

    def place_m(self, front_m: float) -> float:
        """Return the place along the network of a train on any lap."""
        at_m = front_m % self.lap_m if self.circular else front_m
        return _between(self.way, at_m) if self.way else at_m

    def load_line(self) -> LineMap:
        """Load the line, with the running times of `runs_s`. Raises SettingsError."""
        line = load_line(self.line)
        stations = line.stations
        lap = stations[: self.stations_a_lap] if self.circular else stations
        names = [station.name for station in lap]
        for key, asked in (("runs_s", self.runs_s), ("terminals", self.terminals)):
            for name in asked:
                if name not in names:
                    hint = settings.nearest(name, names, "station")
                    raise settings.SettingsError(f"traffic {self.name}: {key}: {name}: {hint}")
        if not self.runs_s:
            return line
        timed = [
            replace(station, run_s=self.runs_s.get(names[n % len(lap)], station.run_s))
            for n, station in enumerate(stations)
        ]
        return replace(line, stations=tuple(timed))


def _between(way: Sequence[Bend], at_m: float) -> float:
    index = 0
    while index < len(way) - 2 and at_m > way[index + 1].at_m:
        index += 1
    near, far = way[index], way[index + 1]
    share = (at_m - near.at_m) / max(1e-9, far.at_m - near.at_m)
    return near.place_m + share * (far.place_m - near.place_m)


def load_traffic(name: str) -> TrafficConfig:
    """Load traffic by path or by the name of a shipped file; raises SettingsError."""
    traffic = settings.load(TrafficConfig, name, PACKAGE)
    if not settings.is_path(name):
        return traffic
    folder = Path(name).parent

    def beside(value: str) -> str:
        return str(folder / value) if settings.is_path(value) else value

    return replace(
        traffic,
        line=beside(traffic.line),
        consist=beside(traffic.consist),
        supply=beside(traffic.supply),
        params=None if traffic.params is None else beside(traffic.params),
    )


def traffic_of(line: str) -> TrafficConfig:
    """Return the traffic of a line. Raises SettingsError for a line without a traffic file."""
    names = settings.shipped_names(PACKAGE)
    if line not in names:
        raise settings.SettingsError(
            f"--trains: {line} has no traffic file; give one with --traffic FILE.toml, or take a "
            f"line with one: {', '.join(names)}"
        )
    return load_traffic(line)


def plan_traffic(
    line: str | None, traffic: str | None, supply: str | None
) -> tuple[TrafficConfig, LineMap, Supply]:
    """Return traffic, line and supply that fit each other. Raises SettingsError.

    Args:
        line: of the option --line. With `traffic` it replaces that file's line, if given.
        traffic: name or path of the traffic file; None: that of the line.
        supply: name or path of the supply; None: that of the traffic.
    """
    config = traffic_of(line or "") if traffic is None else load_traffic(traffic)
    if traffic is not None and line:
        config = replace(config, line=line)
    track = config.load_line()
    source = supply or config.supply
    network = load_supply(source)
    highest_m = config.lap_m if config.circular else track.stations[-1].stop_m
    lowest_m = 0.0 if config.circular else track.stations[0].stop_m
    steps = max(1, math.ceil((highest_m - lowest_m) / PLACE_STEP_M))
    spaced_m = (lowest_m + (highest_m - lowest_m) * step / steps for step in range(steps + 1))
    check_feeds(network, source, ((track.name, config.place_m(at_m)) for at_m in spaced_m))
    return config, track, network
