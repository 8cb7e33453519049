"""The traction supply of the Changping section, in a variant with a strong and one with a weak
network.
"""

from dataclasses import dataclass
from typing import Final

from plant_emulator.power.network import Network, Section, Substation, Voltages

SUBSTATIONS_M: Final = (0.0, 1900.0, 3799.0, 5824.0, 7788.0)


@dataclass(frozen=True, slots=True)
class Supply:
    name: str
    no_load_v: float
    source_ohm: float
    ohm_per_km: float
    voltages: Voltages

    def network(self) -> Network:
        names = [f"S{at_m:.0f}" for at_m in SUBSTATIONS_M]
        sections = [
            Section(near, far, near_m, far_m, self.ohm_per_km)
            for near, far, near_m, far_m in zip(
                names, names[1:], SUBSTATIONS_M, SUBSTATIONS_M[1:], strict=False
            )
        ]
        stations = [Substation(name, self.no_load_v, self.source_ohm) for name in names]
        return Network(sections, stations, self.voltages)


STRONG: Final = Supply(
    "strong", 836.0, 0.015, 0.020, Voltages(chops_from_v=880.0, chops_all_v=900.0)
)
WEAK: Final = Supply("weak", 850.0, 0.015, 0.030, Voltages(chops_from_v=860.0, chops_all_v=870.0))
SUPPLIES: Final = {supply.name: supply for supply in (STRONG, WEAK)}
