"""Where trains truly are: what no protocol sees and every check looks at."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from metro_hil.simulation.motion import SimulatedMotion

SERVICE_MPS2: Final = 0.6
SERVICE_REACTION_S: Final = 2.0
HARDEST_MPS2: Final = 10.0
"""What trains believe of the hardest brake that there is."""
ROLL_BACK_MAX_M: Final = 2.0
"""No train ever rolls back farther; the allowance that the protocol is told."""

AXLES: Final = 16


class OdometryReading(NamedTuple):
    """What a train's own odometry tells its controller: intervals that hold the truth."""

    front_min_m: float
    front_max_m: float
    rear_min_m: float
    rests_m: float
    """Its rear comes to rest nowhere behind this."""
    speed_mps: float
    standstill: bool
    reach_m: float
    """As far as it comes with the emergency brake commanded now."""
    easy_m: float
    """As far as it comes with the service brake."""
    localised: bool = True
    out_of_service: bool = False
    axles: int = AXLES


@dataclass(frozen=True, slots=True)
class BrakeLoopGrant:
    """What a train's brake loop goes by."""

    end_m: float
    term: int
    sequence: int
    issuer: int
    area: int
    stamp_ns: int
    """The train's own clock at sending the report that this answers."""
    rear_m: float = math.inf
    """Its minimum safe rear may move back to here; by default not at all."""


class Build(NamedTuple):
    """How a train is made."""

    length_m: float
    axles: int


class TrueTrain:
    """One train on the track, or away from the line."""

    __slots__ = (
        *("address", "axles", "dwell_until_ns", "emergencies", "half_width_m", "heard_ns", "lane"),
        *("length_m", "localised", "motion", "next_stop", "on_line", "out_of_service"),
        *("shunts", "shunts_to_m"),
    )

    def __init__(
        self,
        address: int,
        motion: SimulatedMotion,
        *,
        length_m: float,
        half_width_m: float,
        lane: int = 0,
        axles: int = AXLES,
    ) -> None:
        self.address, self.motion, self.length_m = address, motion, length_m
        self.half_width_m = half_width_m
        self.lane, self.axles = lane, axles
        self.on_line = True
        self.next_stop = 0
        self.dwell_until_ns = 0
        self.heard_ns = 0
        """When its controller last showed a sign of life to its brake."""
        self.emergencies = 0
        self.localised = True
        self.out_of_service = False
        self.shunts = False
        """Driven by hand, whatever its authority is."""
        self.shunts_to_m = math.inf
        """Where it is driven by hand; by default off the line."""

    @property
    def rolls(self) -> bool:
        """It is still to roll or set back."""
        return self.motion.back_m > 0.0

    @property
    def front_m(self) -> float:
        return self.motion.front_m

    @property
    def driven_to_m(self) -> float:
        """By hand; else where its front is."""
        return max(self.front_m, self.shunts_to_m) if self.shunts else self.front_m

    @property
    def rear_m(self) -> float:
        return self.motion.front_m - self.length_m

    def _error_m(self, front_m: float) -> float:
        return 0.9 * self.half_width_m * math.sin(front_m * 0.01 + self.address)

    @property
    def foremost_rear_min_m(self) -> float:
        """Its minimum safe rear when it was farthest."""
        most_m = self.motion.most_m
        return most_m + self._error_m(most_m) - self.half_width_m - self.length_m

    @property
    def foremost_front_max_m(self) -> float:
        """Where its front may have been at most when it was farthest."""
        most_m = self.motion.most_m
        return most_m + self._error_m(most_m) + self.half_width_m

    def reading(self) -> OdometryReading:
        """As of the instant to which the motion was brought forward.

        The error depends on the place alone and so slightly that the reading of a train which
        does not roll back never goes back.
        """
        motion = self.motion
        front_m, half_m = motion.front_m, self.half_width_m
        error_m = self._error_m(front_m)
        middle_m = front_m + error_m
        return OdometryReading(
            middle_m - half_m,
            middle_m + half_m,
            middle_m - half_m - self.length_m,
            middle_m - half_m - self.length_m + motion.speed_mps**2 / (2.0 * HARDEST_MPS2),
            motion.speed_mps,
            motion.speed_mps == 0.0,
            motion.farthest_m + error_m + half_m,
            motion.stop_m(SERVICE_MPS2, SERVICE_REACTION_S) + error_m + half_m,
            self.localised,
            self.out_of_service,
            self.axles,
        )
