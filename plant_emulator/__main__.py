"""Run the command `plant` as `python -m plant_emulator`."""

import sys

from plant_emulator.entry import plant

sys.exit(plant())
