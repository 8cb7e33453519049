"""Finds trains so close to a new restriction or closure that they may apply the emergency brake."""

from typing import Final

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import TrainReport

BRAKING_MPS2: Final = 0.6
"""Deceleration of a train that brakes in time, without an emergency."""
REACTION_S: Final = 3.0
"""Time for which a train may run on; the command passes wayside and master first."""


def is_near(report: TrainReport, stretch: SpeedRestriction) -> bool:
    """Tell whether the train is inside faster than the limit, or cannot slow down before it."""
    speed_mps, limit_mps = report.speed_mps, stretch.limit_mps
    if not report.localised or report.standstill or speed_mps <= limit_mps:
        return False
    braking_m = (speed_mps**2 - limit_mps**2) / (2.0 * BRAKING_MPS2) + REACTION_S * speed_mps
    return report.rear_min_m < stretch.end_m and report.front_max_m + braking_m > stretch.start_m
