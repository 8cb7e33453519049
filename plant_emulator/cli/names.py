"""Names that the command line of `plant` offers, as literals: help imports no train.

A test compares each with its source.
"""

from typing import Final

MODES: Final = ("off", "auto", "manual")
DRIVERS: Final = ("obedient", "reckless", "late")
TIMERS: Final = ("A", "B", "C")
LAST_TRAIN: Final = 64_999
LINE_ENDPOINT: Final = "tcp/127.0.0.1:7448"
WAYSIDE_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Endpoint of the wayside of a single train."""
DESK: Final = "desk"
FAULTS: Final = "faults"
BY_HAND: Final = (DESK, FAULTS)
"""What a person may do while the train runs."""
