"""True positions of trains, which the checks use and the protocol never sees."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from metro_hil.simulation.motion import SimulatedMotion

SERVICE_MPS2: Final = 0.6
SERVICE_REACTION_S: Final = 2.0
HARDEST_MPS2: Final = 10.0
"""Deceleration of the hardest brake that trains assume."""
ROLL_BACK_MAX_M: Final = 2.0
"""Maximum distance that any train rolls back; the allowance in the protocol's configuration."""

AXLES: Final = 16


class OdometryReading(NamedTuple):
    """Reading of a train's odometry: intervals that contain the true position."""

    front_min_m: float
    front_max_m: float
    rear_min_m: float
    rests_m: float
    """Position behind which the train's rear cannot come to rest."""
    speed_mps: float
    standstill: bool
    reach_m: float
    """Where the front may come to rest if the emergency brake is commanded now."""
    easy_m: float
    """Where the front may come to rest with the service brake."""
    localised: bool = True
    out_of_service: bool = False
    axles: int = AXLES


@dataclass(frozen=True, slots=True)
class BrakeLoopGrant:
    """An authority in a train's brake loop."""

    end_m: float
    term: int
    sequence: int
    issuer: int
    area: int
    stamp_ns: int
    """Reading of the train's own clock when it sent the report that this authority answers."""
    rear_m: float = math.inf
    """Position to which the minimum safe rear may move back; by default not at all."""


class Build(NamedTuple):
    """Length and number of axles of a train."""

    length_m: float
    axles: int


class TrueTrain:
    """One train, on the track or away from the line."""

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
        """Time of the controller's last sign of life to the brake unit."""
        self.emergencies = 0
        self.localised = True
        self.out_of_service = False
        self.shunts = False
        """Whether the train is driven by hand, whatever its authority."""
        self.shunts_to_m = math.inf
        """Where a train driven by hand stops; by default beyond the line."""

    @property
    def rolls(self) -> bool:
        """Whether the train has still to roll or jog back."""
        return self.motion.back_m > 0.0

    @property
    def front_m(self) -> float:
        return self.motion.front_m

    @property
    def driven_to_m(self) -> float:
        """Where a train driven by hand stops; for others the position of the front."""
        return max(self.front_m, self.shunts_to_m) if self.shunts else self.front_m

    @property
    def rear_m(self) -> float:
        return self.motion.front_m - self.length_m

    def _error_m(self, front_m: float) -> float:
        return 0.9 * self.half_width_m * math.sin(front_m * 0.01 + self.address)

    @property
    def foremost_rear_min_m(self) -> float:
        """Minimum safe rear when the train was farthest on."""
        most_m = self.motion.most_m
        return most_m + self._error_m(most_m) - self.half_width_m - self.length_m

    @property
    def foremost_front_max_m(self) -> float:
        """Maximum safe front when the train was farthest on."""
        most_m = self.motion.most_m
        return most_m + self._error_m(most_m) + self.half_width_m

    def reading(self) -> OdometryReading:
        """Return the reading at the instant to which the motion was brought forward.

        The error depends on the position alone, and so slightly that the reading never goes back
        while the train does not roll back.
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
