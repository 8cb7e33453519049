"""Names that the command line offers, as literals: help imports neither train nor controller.

A test compares each with its source.
"""

from typing import Final


class LawNames(tuple[str, ...]):
    """Names of control laws. One that is not among them is looked up in the controller's table."""

    __slots__ = ()

    def __contains__(self, name: object) -> bool:
        if super().__contains__(name):
            return True
        from vobc.ato.laws import STRATEGIES

        return name in STRATEGIES


LAWS: Final = LawNames(
    (
        *("chasing", "chasing_literal", "green", "pid"),
        *("pid_literal", "power_limited", "predictive", "timing"),
    )
)
STAGES: Final = ("continuous", "notches", "current_loop")
DRIVERS: Final = ("obedient", "reckless", "late")
TIMERS: Final = ("A", "B", "C")
DESK: Final = "desk"
FAULTS: Final = "faults"
"""What a viewer of the page of a run may act on."""
LAST_TRAIN: Final = 64_999
LINE_ENDPOINT: Final = "tcp/127.0.0.1:7448"
