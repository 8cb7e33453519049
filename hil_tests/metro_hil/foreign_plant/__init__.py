"""A train in another program, driven in lockstep: a command, or an FMU by way of its host.

`docs/reference/plant_interface.md` describes the messages between bench and program.
"""

from metro_hil.foreign_plant.choice import read_plant, start_plant
from metro_hil.foreign_plant.plant import ForeignPlant, PlantDiedError, PlantStartError

__all__ = ["ForeignPlant", "PlantDiedError", "PlantStartError", "read_plant", "start_plant"]
