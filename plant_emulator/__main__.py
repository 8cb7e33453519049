"""`python -m plant_emulator`: the same as the command `plant`."""

import sys

from plant_emulator.cli import main

sys.exit(main())
