"""Trains so near to what is newly restricted or closed that they may brake by emergency."""

from typing import Final

from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import TrainReport

BRAKING_MPS2: Final = 0.6
"""A train that is asked in time slows down by so much without an emergency."""
REACTION_S: Final = 3.0
"""So long it may run on before it does: the decree goes by wayside and master."""


def is_near(report: TrainReport, stretch: SpeedRestriction) -> bool:
    """It is in there faster than the limit, or comes too fast to be slower by then."""
    speed_mps, limit_mps = report.speed_mps, stretch.limit_mps
    if not report.localised or report.standstill or speed_mps <= limit_mps:
        return False
    braking_m = (speed_mps**2 - limit_mps**2) / (2.0 * BRAKING_MPS2) + REACTION_S * speed_mps
    return report.rear_min_m < stretch.end_m and report.front_max_m + braking_m > stretch.start_m
