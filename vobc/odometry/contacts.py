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


@dataclass(slots=True)
class _Contact:
    """A place within reach of a tag."""

    way: Travelled
    bound_m: float = inf
    """Bound of the distance from the tag to the antenna's centre."""
    left_s: float = inf
    """When the train had certainly left the tag."""


class Contacts:
    """Remembers the tags whose reach the antenna may not have left since they were read.

    The first telegram of a passage is sent at the tag's centre. While the antenna stays within
    reach, the tag may be read again at any place there. A reading therefore marks the centre only
    if no earlier reading of this passage is possible, received or lost. After a received one, the
    wheels bound the distance to the next one if they have not slipped.

    A telegram may arrive after the train has left the tag. What counts is the place at its reading.
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
        "_silence_s",
    )

    def __init__(self, config: OdometryConfig) -> None:
        self._reach_m = config.tag_reach_m
        self._bound_m = config.tag_bound_m
        # Both readings lie within reach, on either side. Beyond this distance from one, the tag is
        # left.
        self._leave_m = 2.0 * (config.tag_reach_m + config.tag_bound_m)
        self._silence_s = config.tag_silence_s
        self._read: dict[int, _Contact] = {}
        """Last reading of each tag that may still be in reach, or was a moment ago."""
        self._furthest_m = inf
        """Farthest place that the antenna may have reached. Infinity while the place is lost."""
        # Telegrams before the start are unknown, so a gap begins there.
        self._gap: _Contact | None = _Contact(Travelled(0, 0.0, 0.0))
        """Place where missing telegrams were detected. None: the train has left it long ago."""
        self._gap_furthest_m = inf
        """Tags beyond this place had not been reached when the gap was detected."""
        self._gap_is_new = True

    def read(self, tag_id: int, way: Travelled, bound_m: float) -> None:
        """Note that a tag was read and its telegram received.

        Args:
            bound_m: bound of the distance from the tag to the antenna's centre. Infinity if the
                wheels slip.
        """
        self._read[tag_id] = _Contact(way, bound_m)

    def doubt(self) -> None:
        """Discard the bounds of all readings, because slipping wheels do not measure the
        distance.
        """
        for contact in self._read.values():
            contact.bound_m = inf

    def miss(self, way: Travelled) -> None:
        """Note that telegrams of unknown tags are missing up to this place."""
        self._gap, self._gap_furthest_m, self._gap_is_new = _Contact(way), inf, True

    def move(self, way: Travelled, least_m_per_pulse: float, now_s: float) -> None:
        """Note which tags and gaps the train has certainly left, by its wheels and over ground.

        They are forgotten when no telegram that was read before can still arrive.
        """
        if self._gap is not None and self._is_over(self._gap, way, least_m_per_pulse, now_s):
            self._gap = None
        if self._read:
            self._read = {
                tag_id: contact
                for tag_id, contact in self._read.items()
                if not self._is_over(contact, way, least_m_per_pulse, now_s)
            }

    def look(self, ahead_m: float) -> None:
        """Update the farthest place of the antenna. Infinity while the place is lost."""
        if self._furthest_m < inf:
            ahead_m = max(ahead_m, self._furthest_m)
        self._furthest_m = ahead_m
        if self._gap_is_new:
            self._gap_furthest_m, self._gap_is_new = ahead_m, False

    def off_m(self, site: TagSite, pulses: int, most_m_per_pulse: float, read_s: float) -> float:
        """Greatest distance between tag and antenna centre at a reading.

        Args:
            pulses: pulses of the wheels at the reading.
            read_s: earliest time of the reading.
        """
        missing = self._gap is not None and read_s <= self._gap.left_s
        if missing and site.position_m - self._bound_m <= self._gap_furthest_m:
            return self._reach_m
        before = self._read.get(site.tag_id)
        if before is None or read_s > before.left_s:
            return 0.0
        rolled_m = (abs(pulses - before.way.pulses) + 1) * most_m_per_pulse
        return min(self._reach_m, before.bound_m + rolled_m)

    def _is_over(
        self, contact: _Contact, way: Travelled, least_m_per_pulse: float, now_s: float
    ) -> bool:
        """Note when the train leaves a tag. True: no telegram from before can still arrive."""
        if contact.left_s == inf and self._left(contact.way, way, least_m_per_pulse):
            contact.left_s = now_s
        return now_s - contact.left_s > self._silence_s

    def _left(self, there: Travelled, way: Travelled, least_m_per_pulse: float) -> bool:
        # The distance by pulses is exact to one pulse.
        rolled_m = (abs(way.pulses - there.pulses) - 1) * least_m_per_pulse
        blur_m = abs(way.ground_bound_m - there.ground_bound_m)
        over_m = abs(way.ground_m - there.ground_m) - blur_m
        return min(rolled_m, over_m) > self._leave_m
