"""What the ATP and ATO of a train do with its authority.

It replaces the whole on-board controller: supervision of the braking curve to the end of authority,
automatic driving below it, and stops at stations.
"""

import math
from dataclasses import dataclass
from typing import Final

GUARANTEED_MPS2: Final = 1.0
"""Guaranteed emergency brake rate (GEBR) that supervision assumes; no emergency brake is weaker."""
REACTION_S: Final = 1.3
"""Time from the overspeed to the full brake: a control cycle and the build-up, with a margin."""
SERVICE_MPS2: Final = 0.8
TRACTION_MPS2: Final = 0.9
DRIVE_REACTION_S: Final = 1.6
CREEP_M: Final = 0.5


@dataclass(frozen=True, slots=True)
class DrivingTarget:
    """Where automatic driving plans to stop, and its maximum speed."""

    speed_max_mps: float
    stop_m: float
    """Position of the station stop or of the end of authority less a margin, whichever is
    nearer."""


def braking_curve_mps(distance_m: float, *, decel_mps2: float, reaction_s: float) -> float:
    """Return the speed v from which reaction distance plus v²/2b equals `distance_m`."""
    if distance_m <= 0.0:
        return 0.0
    lost_mps = decel_mps2 * reaction_s
    return math.sqrt(lost_mps * lost_mps + 2.0 * decel_mps2 * distance_m) - lost_mps


def must_trip(front_m_max: float, speed_mps: float, end_m: float, *, accel_mps2: float) -> bool:
    """Tell whether supervision must apply the emergency brake now.

    Traction may still act during the reaction time, so the test adds the speed that it gains.
    """
    distance_m = end_m - front_m_max
    fastest_mps = speed_mps + max(0.0, accel_mps2) * 0.3
    limit_mps = braking_curve_mps(distance_m, decel_mps2=GUARANTEED_MPS2, reaction_s=REACTION_S)
    return fastest_mps > limit_mps and speed_mps > 0.0


def demand_mps2(front_m: float, speed_mps: float, aim: DrivingTarget) -> float:
    """Return the acceleration that ATO demands; it stays well below the supervision curve."""
    distance_m = aim.stop_m - front_m
    if distance_m <= CREEP_M:
        return -SERVICE_MPS2
    wanted_mps = min(
        aim.speed_max_mps,
        braking_curve_mps(distance_m, decel_mps2=SERVICE_MPS2 * 0.85, reaction_s=DRIVE_REACTION_S),
    )
    if speed_mps > wanted_mps:
        return max(-SERVICE_MPS2, (wanted_mps - speed_mps) * 1.0 - 0.3)
    return min(TRACTION_MPS2, (wanted_mps - speed_mps) * 0.7)
