"""Where the train is, how it moves, and how fast it may."""

import enum
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Interval:
    """A quantity that is known only to lie between two ends."""

    low: float
    best: float
    high: float


class TagRefusal(enum.Enum):
    """Why a tag was not believed."""

    UNKNOWN = "no such tag on this line"
    OUTSIDE_WINDOW = "outside of its expectation window"
    OUT_OF_ORDER = "out of order"
    REPEATED = "read before"


@dataclass(frozen=True, slots=True)
class RefusedTag:
    tag_id: int
    reason: TagRefusal
    off_m: float
    """From the nearer end of the window to where the tag claims the front to be; signed."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What odometry makes of pulses and tags; the intervals hold the truth for declared errors."""

    front_m: Interval
    """Chainage of the front coupler."""
    speed_mps: Interval
    """Signed, positive forwards."""
    accel_mps2: float
    """Smoothed, signed."""
    travel_m: float
    """Distance by pulses since start, signed; no tag makes it jump. While wheels slip it follows
    what else is believed of the ground, and is no bound."""
    standing: bool
    """Half a second of samples without a pulse: a quick sign, but no proof of standstill."""
    standstill: bool
    """Zero speed proven: upper speed bound under 1 km/h for 2 s."""
    localised: bool
    slip: bool
    accepted_tag_ids: tuple[int, ...]
    """Tags that corrected the position in this cycle."""
    refused_tags: tuple[RefusedTag, ...] = ()
    """Tags that were read in this cycle and not believed."""
    missed_tags: int = 0
    """Expected tags in a row that were not read."""
    lost_cause: str = ""
    """Why the train does not know where it is; empty while it does."""
    wheel_diameter_m: float = 0.0
    """As last calibrated."""
    pulses_m: float = 0.0
    """Distance by pulses alone since start, signed, also while wheels slip."""


@dataclass(frozen=True, slots=True)
class Ceiling:
    """What protection permits now, all as speeds of the train."""

    permitted_mps: float
    """Least of civil limits under the train, braking curves ahead and end of authority."""
    warning_mps: float
    service_mps: float
    emergency_mps: float
    distance_to_authority_m: float
    """From the worst end of the front interval to the end of authority."""
