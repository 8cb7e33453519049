"""`python -m metro_hil.cli.hil` is `hil`."""

import sys

from firmware_py.program import Program
from metro_hil.cli.hil import main

if __name__ == "__main__":
    sys.exit(Program("hil", lambda: main)())
