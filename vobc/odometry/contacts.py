"""Which readings of a tag may be second ones, taken anywhere within reach of the tag."""

from dataclasses import dataclass
from math import inf

from firmware_py.trackdb import TagSite
from vobc.odometry.config import OdometryConfig


@dataclass(frozen=True, slots=True)
class Travelled:
    """How far the train has come since start."""

    pulses: int
    """By the wheels."""
    ground_m: float
    """Over ground, as likely."""
    ground_bound_m: float


class Contacts:
    """Keeps in mind which tags the antenna may not have left since they were read.

    The first telegram of a passage is of the tag's centre. While the antenna stays within reach of
    the tag, it may be read again, at any place there. So a reading tells the centre only if no
    other of this passage can have come before it, neither one that was heard nor a lost one. Of one
    that was heard, wheels that have not slipped since tell how far away the next one is.
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
        # Both readings lie within reach, on either side: this far from one, the tag is left.
        self._leave_m = 2.0 * (config.tag_reach_m + config.tag_bound_m)
        self._read: dict[int, tuple[Travelled, float]] = {}
        """Tags that may not have been left yet; where they were read last, and within what."""
        self._furthest_m = inf
        """So far ahead the antenna may have been; nobody knows while the place is lost."""
        # Of what was read before the start nobody told.
        self._gap: Travelled | None = Travelled(0, 0.0, 0.0)
        """Where it was found out that telegrams are missing, until that is left."""
        self._gap_furthest_m = inf
        """Tags further on had not been reached by then."""
        self._gap_is_new = True

    def read(self, tag_id: int, way: Travelled, bound_m: float) -> None:
        """A tag was read there, and that was told.

        Args:
            bound_m: of the way from the tag to the antenna's centre; infinity for bad wheels.
        """
        self._read[tag_id] = (way, bound_m)

    def doubt(self) -> None:
        """The wheels slip: they do not tell any more how far it is from where a tag was read."""
        self._read = {tag_id: (way, inf) for tag_id, (way, _) in self._read.items()}

    def miss(self, way: Travelled) -> None:
        """Telegrams are missing up to here, of whichever tags they were."""
        self._gap, self._gap_furthest_m, self._gap_is_new = way, inf, True

    def move(self, way: Travelled, least_m_per_pulse: float) -> None:
        """Forget what the train has left for certain, by its wheels and over ground."""
        if self._gap is not None and self._left(self._gap, way, least_m_per_pulse):
            self._gap = None
        if self._read:
            self._read = {
                tag_id: (there, bound_m)
                for tag_id, (there, bound_m) in self._read.items()
                if not self._left(there, way, least_m_per_pulse)
            }

    def look(self, ahead_m: float) -> None:
        """The antenna is no further on than that, now; infinity while its place is lost."""
        if self._furthest_m < inf:
            ahead_m = max(ahead_m, self._furthest_m)
        self._furthest_m = ahead_m
        if self._gap_is_new:
            self._gap_furthest_m, self._gap_is_new = ahead_m, False

    def off_m(self, site: TagSite, pulses: int, most_m_per_pulse: float) -> float:
        """How far from the tag the antenna's centre may have been when it was read just now."""
        if self._gap is not None and site.position_m - self._bound_m <= self._gap_furthest_m:
            return self._reach_m
        before = self._read.get(site.tag_id)
        if before is None:
            return 0.0
        way, bound_m = before
        return min(self._reach_m, bound_m + (abs(pulses - way.pulses) + 1) * most_m_per_pulse)

    def _left(self, there: Travelled, way: Travelled, least_m_per_pulse: float) -> bool:
        # Pulses tell the way between two counts within one.
        rolled_m = (abs(way.pulses - there.pulses) - 1) * least_m_per_pulse
        blur_m = abs(way.ground_bound_m - there.ground_bound_m)
        over_m = abs(way.ground_m - there.ground_m) - blur_m
        return min(rolled_m, over_m) > self._leave_m
