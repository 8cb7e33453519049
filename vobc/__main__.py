"""Makes `python -m vobc` the bare controller."""

import sys

from vobc.cli import main

sys.exit(main())
