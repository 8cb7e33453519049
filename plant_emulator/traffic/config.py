"""What runs on a line: trains, headway, turnbacks, dwells, and where track and network meet."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from firmware_py import settings
from plant_emulator.power.supplies import SUPPLIES

PACKAGE: Final = "plant_emulator.traffic"


@dataclass(frozen=True, slots=True)
class Bend:
    """One corner of the way on which a lap's chainage becomes a place along the network."""

    at_m: float
    place_m: float


@dataclass(frozen=True, slots=True)
class TrafficConfig:
    """The traffic of one line. Raises ValueError when its parts contradict each other."""

    name: str
    line: str
    consist: str
    """Of all trains."""
    supply: str
    """strong or weak, see `plant_emulator.power.supplies`."""
    stations_a_lap: int
    lap_m: float
    trains: int
    """With as many the headway is even all round."""
    headway_s: float
    turnback_s: float
    """From standing at a terminal to leaving the platform behind its loop."""
    terminals: tuple[str, ...]
    """Stations of the lap that are left as soon as their least dwell is over."""
    dwell_s: float
    dwell_spread_s: float
    """Dwells are drawn evenly between dwell_s less and more this."""
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
        """Along the network, of a train on whatever lap."""
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
    """By path or by the stem of a shipped file; raises SettingsError."""
    return settings.load(TrafficConfig, name, PACKAGE)


def traffic_of(line: str) -> TrafficConfig:
    """Raises SettingsError for a line of which nobody has said what runs on it."""
    names = settings.shipped_names(PACKAGE)
    if line not in names:
        raise settings.SettingsError(
            f"--trains: nothing is known of the traffic on {line}; it is on {', '.join(names)}"
        )
    return load_traffic(line)
