"""Power: the high-voltage box of one train, and the DC network between all of them.

The network is in `network` and is not imported here: it may bring a compiler along.
"""

from plant_emulator.power.box import HighVoltageBox

__all__ = ["HighVoltageBox"]
