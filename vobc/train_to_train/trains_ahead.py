"""The nearest train that reports itself ahead. No authority lets this train past its rear.

Masters obey the same rule. Each train applies it again to what it receives itself, so that a false
or mistaken master cannot send it into a train that it receives.
"""

import math
from typing import Final, NamedTuple

from vobc.train_to_train.occupancy import protected_rear_m
from vobc.train_to_train.vocabulary import OwnTrain
from zenoh_config.t2t import TrainReport
from zenoh_config.timers import NS_PER_MS

HEARD_NS: Final = 10_000 * NS_PER_MS
"""Time after a report for which its rear still bounds the train behind.

A train that is silent for longer may have been taken off the line. Its master protects it until
axle counters or a person show that it has gone.
"""
TRAINS_MAX: Final = 256
"""Number of trains that are remembered. The areas around one train hold fewer."""


class HeardTrain(NamedTuple):
    """Newest place that a train has reported in any area."""

    received_at_ns: int
    boot: int
    sequence: int
    front_max_m: float
    rear_m: float
    """Protected rear. It never goes back within one incarnation."""


class TrainsAhead:
    def __init__(self, jog_m: float) -> None:
        self._jog_m = jog_m
        self._heard: dict[int, HeardTrain] = {}

    def on_message(self, report: TrainReport, now_ns: int) -> None:
        """Note the reported place. A train that has lost its place reports none."""
        if not report.localised:
            return
        before, rear_m = self._heard.get(report.source), protected_rear_m(report, self._jog_m)
        if before is not None:
            # Reports to different areas may arrive in any order.
            if (report.boot, report.sequence) <= (before.boot, before.sequence):
                return
            if report.boot == before.boot:
                rear_m = max(before.rear_m, rear_m)
            del self._heard[report.source]
        self._heard[report.source] = HeardTrain(
            now_ns, report.boot, report.sequence, report.front_max_m, rear_m
        )
        if len(self._heard) > TRAINS_MAX:
            del self._heard[next(iter(self._heard))]

    def rear_m(self, now_ns: int, own: OwnTrain) -> float:
        """Protected rear of the nearest train ahead. Infinite if this train receives none."""
        return min(
            [
                each.rear_m
                for each in self._heard.values()
                if each.front_max_m > own.front_max_m and now_ns - each.received_at_ns <= HEARD_NS
            ],
            default=math.inf,
        )
