"""The traffic of a line: trains, headway, turnbacks, dwells, and the mapping of track to
network.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py import settings
from plant_emulator.power.supplies import SUPPLIES

PACKAGE: Final = "plant_emulator.traffic"


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
    consist: str
    """Consist of all trains."""
    supply: str
    """strong or weak, see `plant_emulator.power.supplies`."""
    stations_a_lap: int
    lap_m: float
    trains: int
    """Number of trains at which the headway is even all round."""
    headway_s: float
    turnback_s: float
    """Time from stopping at a terminal to leaving the platform behind its loop."""
    terminals: tuple[str, ...]
    """Stations of the lap that trains leave as soon as the minimum dwell is over."""
    dwell_s: float
    dwell_spread_s: float
    """Dwells are distributed uniformly over dwell_s ± this value."""
    way: tuple[Bend, ...]

    def __post_init__(self) -> None:
        for name in ("lap_m", "headway_s", "turnback_s", "dwell_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} {getattr(self, name)} is not positive")
        if not 0.0 <= self.dwell_spread_s <= self.dwell_s:
            raise ValueError(f"dwell_spread_s {self.dwell_spread_s} is not in 0..dwell_s")
        if self.supply not in SUPPLIES:
            raise ValueError(f"supply {self.supply!r}: there is {', '.join(sorted(SUPPLIES))}")
        if not 1 <= self.trains <= self.stations_a_lap:
            raise ValueError(f"trains {self.trains} is not in 1..stations_a_lap")
        ats_m = [bend.at_m for bend in self.way]
        if len(ats_m) < 2 or ats_m != sorted(ats_m) or ats_m[0] != 0.0 or ats_m[-1] != self.lap_m:
            raise ValueError("way does not lead from 0 to lap_m")

    def place_m(self, front_m: float) -> float:
        """Return the place along the network of a train on any lap."""
        at_m = front_m % self.lap_m
        return _between(self.way, at_m)


def _between(way: Sequence[Bend], at_m: float) -> float:
    index = 0
    while index < len(way) - 2 and at_m > way[index + 1].at_m:
        index += 1
    near, far = way[index], way[index + 1]
    share = (at_m - near.at_m) / max(1e-9, far.at_m - near.at_m)
    return near.place_m + share * (far.place_m - near.place_m)


def load_traffic(name: str) -> TrafficConfig:
    """Load traffic by path or by the name of a shipped file; raises SettingsError."""
    return settings.load(TrafficConfig, name, PACKAGE)


def traffic_of(line: str) -> TrafficConfig:
    """Return the traffic of a line. Raises SettingsError for a line without a traffic file."""
    names = settings.shipped_names(PACKAGE)
    if line not in names:
        raise settings.SettingsError(
            f"--trains: {line} has no traffic file; lines with one: {', '.join(names)}"
        )
    return load_traffic(line)
