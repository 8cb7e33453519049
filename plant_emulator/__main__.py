"""`python -m plant_emulator`: the same as the command `plant`."""

import sys

from plant_emulator.entry import plant

sys.exit(plant())
