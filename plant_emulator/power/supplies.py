"""Traction supplies, one TOML file each: substations, storages, feeder sections and voltages."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from firmware_py import settings
from plant_emulator.power.network import (
    Network,
    NetworkError,
    Section,
    Storage,
    Substation,
    Voltages,
)

PACKAGE: Final = "plant_emulator.power"


@dataclass(frozen=True, slots=True)
class Supply:
    """The supply of one line. Raises ValueError when its parts form no network."""

    name: str
    substations: tuple[Substation, ...]
    sections: tuple[Section, ...]
    voltages: Voltages = field(default_factory=Voltages)
    storages: tuple[Storage, ...] = ()

    def __post_init__(self) -> None:
        self.network()

    def network(self) -> Network:
        """Return a network without load; raises NetworkError."""
        return Network(self.sections, self.substations, self.voltages, self.storages)

    @property
    def no_load_v(self) -> float:
        """Highest no-load voltage of the substations."""
        return max(station.no_load_v for station in self.substations)


def load_supply(name: str) -> Supply:
    """Load a supply by path or by the name of a shipped file. Raises SettingsError."""
    return settings.load(Supply, name, PACKAGE)


def shipped_supplies() -> dict[str, Supply]:
    """Return the shipped supplies by name, in order of their no-load voltage."""
    found = [load_supply(name) for name in settings.shipped_names(PACKAGE)]
    return {supply.name: supply for supply in sorted(found, key=lambda each: each.no_load_v)}


def check_feeds(supply: Supply, source: str, places: Iterable[tuple[str, float]]) -> None:
    """Check that a section feeds each place. Raises SettingsError.

    Args:
        source: name or path of the supply in messages.
        places: what lies there, and its chainage.
    """
    network = supply.network()
    for what, at_m in places:
        try:
            network.section_of(at_m)
        except NetworkError as error:
            raise settings.SettingsError(
                f"supply {source}: sections: {error}, but {what} lies there; they must reach "
                "along the whole line"
            ) from error
