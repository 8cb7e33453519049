"""Which readings of a tag may be second ones, taken anywhere within reach of the tag."""

from dataclasses import dataclass
from typing import Final

from vobc.odometry.config import OdometryConfig

ANY_TAG: Final = 0
"""No tag has this number: telegrams are missing, of whichever tag they were."""


@dataclass(frozen=True, slots=True)
class Way:
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
    other of this passage can have come before it, neither one that was heard nor a lost one.
    """

    __slots__ = ("_leave_m", "_open", "_reach_m")

    def __init__(self, config: OdometryConfig) -> None:
        self._reach_m = config.tag_reach_m
        # Both readings lie within reach, on either side: this far from one, the tag is left.
        self._leave_m = 2.0 * (config.tag_reach_m + config.tag_bound_m)
        # Of what was read before the start nobody told.
        self._open: dict[int, Way] = {ANY_TAG: Way(0, 0.0, 0.0)}

    def touch(self, tag_id: int, way: Way) -> None:
        """A tag was read there, or may have been (ANY_TAG)."""
        self._open[tag_id] = way

    def move(self, way: Way, least_m_per_pulse: float) -> None:
        """Forget what the train has left for certain, by its wheels and over ground."""
        if self._open:
            self._open = {
                tag_id: touched
                for tag_id, touched in self._open.items()
                if not self._left(touched, way, least_m_per_pulse)
            }

    def off_m(self, tag_id: int) -> float:
        """How far from the tag's centre the antenna may have been at a reading of it now."""
        return self._reach_m if tag_id in self._open or ANY_TAG in self._open else 0.0

    def _left(self, touched: Way, way: Way, least_m_per_pulse: float) -> bool:
        # Pulses tell the way between two counts within one.
        rolled_m = (abs(way.pulses - touched.pulses) - 1) * least_m_per_pulse
        blur_m = abs(way.ground_bound_m - touched.ground_bound_m)
        over_m = abs(way.ground_m - touched.ground_m) - blur_m
        return min(rolled_m, over_m) > self._leave_m
