"""`python -m metro_hil.cli.hil` is `hil`."""

import sys

from metro_hil.cli.hil import main

if __name__ == "__main__":
    sys.exit(main())
