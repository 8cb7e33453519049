"""Power supply: the high-voltage box of one train, and the DC network that feeds all trains.

This package does not import `network`, because that may load a compiler.
"""

from plant_emulator.power.box import HighVoltageBox

__all__ = ["HighVoltageBox"]
