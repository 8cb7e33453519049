"""Traction supplies, one TOML file each: substations, storages, feeder sections and voltages."""

from dataclasses import dataclass, field
from typing import Final

from firmware_py import settings
from plant_emulator.power.network import Network, Section, Storage, Substation, Voltages

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
