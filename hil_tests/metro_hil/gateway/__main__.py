"""Makes `python -m metro_hil.gateway` the gateway."""

import sys

from metro_hil.gateway.command import main

if __name__ == "__main__":
    sys.exit(main())
