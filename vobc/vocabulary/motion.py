"""Place and motion of the train, and its speed limits."""

import enum
import math
from dataclasses import dataclass

from can_dbc.vobc import TargetKind


@dataclass(frozen=True, slots=True)
class Interval:
    """A quantity known only to lie between two bounds."""

    low: float
    best: float
    high: float


class TagRefusal(enum.Enum):
    """Reason why a tag was refused."""

    UNKNOWN = "no such tag on this line"
    OUTSIDE_WINDOW = "outside of its expectation window"
    CONTRADICTED = "contradicted by wheels or ground"
    OUT_OF_ORDER = "out of order"
    REPEATED = "read before"


@dataclass(frozen=True, slots=True)
class RefusedTag:
    tag_id: int
    reason: TagRefusal
    off_m: float
    """Distance from the nearer end of the window to the front's place by this tag, signed."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Result of odometry.

    The intervals contain the true values if the sensors keep their declared errors.
    """

    front_m: Interval
    """Chainage of the front coupler."""
    speed_mps: Interval
    """Speed, positive forwards."""
    accel_mps2: float
    """Smoothed acceleration, positive forwards."""
    travel_m: float
    """Distance by pulses since the start, signed. Tags do not shift it. During slip it follows the
    estimated movement over ground and is no bound."""
    standing: bool
    """Half a second of samples without a pulse. This sign is quick, but no proof of standstill."""
    standstill: bool
    """Zero speed is proven: the upper speed bound was below 1 km/h for 2 s."""
    localised: bool
    slip: bool
    accepted_tag_ids: tuple[int, ...]
    """Tags that corrected the position in this cycle."""
    refused_tags: tuple[RefusedTag, ...] = ()
    """Tags that were read and refused in this cycle."""
    missed_tags: int = 0
    """Number of successive expected tags that were not read."""
    lost_cause: str = ""
    """Why the train does not know its place. Empty while it does."""
    wheel_diameter_m: float = 0.0
    """Last calibrated value."""
    pulses_m: float = 0.0
    """Distance by pulses alone since the start, signed, also during slip."""
    next_tag_m: float = math.inf
    """Chainage of the front when the antenna reaches the next tag that was not read yet. Infinity:
    there is none."""
    adhesion_lost: bool = False
    """Wheels slip or slide in this cycle. Unlike `slip` it ignores axles on two cars whose coupler
    stretches."""


@dataclass(frozen=True, slots=True)
class SupervisedTarget:
    """The place ahead whose braking curve lowers the permitted speed most. Only for display."""

    kind: TargetKind
    speed_mps: float
    """Permitted there."""
    distance_m: float
    """Distance from the farthest place of the front; negative past it."""


@dataclass(frozen=True, slots=True)
class Ceiling:
    """Speed limits that protection permits now, all as speeds of the train."""

    permitted_mps: float
    """The lowest of civil limits under the train, braking curves ahead and end of authority."""
    warning_mps: float
    service_mps: float
    emergency_mps: float
    distance_to_authority_m: float
    """Distance from the farthest place of the front to the end of authority."""
    target: SupervisedTarget | None = None
    """None while the limits under the train are lower than every braking curve."""
