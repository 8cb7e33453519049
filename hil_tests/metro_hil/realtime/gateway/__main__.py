"""Makes `python -m metro_hil.realtime.gateway` start the gateway."""

import sys

from metro_hil.realtime.gateway.command import main

if __name__ == "__main__":
    sys.exit(main())
