"""Which readings of a tag may be repeated ones, taken anywhere within reach of the tag."""

from dataclasses import dataclass
from math import inf

from firmware_py.trackdb import TagSite
from vobc.odometry.config import OdometryConfig


@dataclass(frozen=True, slots=True)
class Travelled:
    """Distance that the train has covered since the start."""

    pulses: int
    """Pulses of the wheels."""
    ground_m: float
    """Best estimate over ground."""
    ground_bound_m: float


class Contacts:
    """Remembers the tags whose reach the antenna may not have left since they were read.

    The first telegram of a passage is sent at the tag's centre. While the antenna stays within
    reach, the tag may be read again at any place there. A reading therefore marks the centre only
    if no earlier reading of this passage is possible, received or lost. After a received one, the
    wheels bound the distance to the next one if they have not slipped.
    """

    __slots__ = (
        "_bound_m",
        "_furthest_m",
        "_gap",
        "_gap_furthest_m",
        "_gap_is_new",
        "_leave_m",
        "_reach_m",
        "_read",
    )

    def __init__(self, config: OdometryConfig) -> None:
        self._reach_m = config.tag_reach_m
        self._bound_m = config.tag_bound_m
        # Both readings lie within reach, on either side. Beyond this distance from one, the tag is
        # left.
        self._leave_m = 2.0 * (config.tag_reach_m + config.tag_bound_m)
        self._read: dict[int, tuple[Travelled, float]] = {}
        """Tags that may still be in reach, with the place of the last reading and its bound."""
        self._furthest_m = inf
        """Farthest place that the antenna may have reached. Infinity while the place is lost."""
        # Telegrams before the start are unknown, so a gap begins there.
        self._gap: Travelled | None = Travelled(0, 0.0, 0.0)
        """Place where missing telegrams were detected. None: the train has left it."""
        self._gap_furthest_m = inf
        """Tags beyond this place had not been reached when the gap was detected."""
        self._gap_is_new = True

    def read(self, tag_id: int, way: Travelled, bound_m: float) -> None:
        """Note that a tag was read and its telegram received.

        Args:
            bound_m: bound of the distance from the tag to the antenna's centre. Infinity if the
                wheels slip.
        """
        self._read[tag_id] = (way, bound_m)

    def doubt(self) -> None:
        """Discard the bounds of all readings, because slipping wheels do not measure the
        distance.
        """
        self._read = {tag_id: (way, inf) for tag_id, (way, _) in self._read.items()}

    def miss(self, way: Travelled) -> None:
        """Note that telegrams of unknown tags are missing up to this place."""
        self._gap, self._gap_furthest_m, self._gap_is_new = way, inf, True

    def move(self, way: Travelled, least_m_per_pulse: float) -> None:
        """Forget tags and gaps that the train has certainly left, by its wheels and over ground."""
        if self._gap is not None and self._left(self._gap, way, least_m_per_pulse):
            self._gap = None
        if self._read:
            self._read = {
                tag_id: (there, bound_m)
                for tag_id, (there, bound_m) in self._read.items()
                if not self._left(there, way, least_m_per_pulse)
            }

    def look(self, ahead_m: float) -> None:
        """Update the farthest place of the antenna. Infinity while the place is lost."""
        if self._furthest_m < inf:
            ahead_m = max(ahead_m, self._furthest_m)
        self._furthest_m = ahead_m
        if self._gap_is_new:
            self._gap_furthest_m, self._gap_is_new = ahead_m, False

    def off_m(self, site: TagSite, pulses: int, most_m_per_pulse: float) -> float:
        """Greatest distance between tag and antenna centre at the present reading."""
        if self._gap is not None and site.position_m - self._bound_m <= self._gap_furthest_m:
            return self._reach_m
        before = self._read.get(site.tag_id)
        if before is None:
            return 0.0
        way, bound_m = before
        return min(self._reach_m, bound_m + (abs(pulses - way.pulses) + 1) * most_m_per_pulse)

    def _left(self, there: Travelled, way: Travelled, least_m_per_pulse: float) -> bool:
        # The distance by pulses is exact to one pulse.
        rolled_m = (abs(way.pulses - there.pulses) - 1) * least_m_per_pulse
        blur_m = abs(way.ground_bound_m - there.ground_bound_m)
        over_m = abs(way.ground_m - there.ground_m) - blur_m
        return min(rolled_m, over_m) > self._leave_m
