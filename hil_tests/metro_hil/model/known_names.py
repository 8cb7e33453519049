"""Names that the command line offers, as literals: help imports neither train nor controller.

A test compares each with its source.
"""

from typing import Final

LAWS: Final = (
    *("chasing", "chasing_literal", "green", "pid"),
    *("pid_literal", "power_limited", "predictive", "timing"),
)
STAGES: Final = ("continuous", "notches", "current_loop")
DRIVERS: Final = ("obedient", "reckless", "late")
TIMERS: Final = ("A", "B")
LAST_TRAIN: Final = 64_999
LINE_ENDPOINT: Final = "tcp/127.0.0.1:7448"
