"""`python -m metro_hil.hil_command` is `hil`."""

import sys

from metro_hil.hil_command import main

if __name__ == "__main__":
    sys.exit(main())
