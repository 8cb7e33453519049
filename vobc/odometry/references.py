"""Decides which tags are accepted or missed, and whether the train knows its place."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from can_dbc.odometer import ColdMovement
from firmware_py.trackdb import LineMap, TagSite
from vobc.odometry.config import OdometryConfig
from vobc.odometry.contacts import Contacts, Travelled
from vobc.vocabulary import PlaceProof, RefusedTag, TagRefusal

TURN_PULSES: Final = 4
"""Backward pulses after which the train may pass the same tag again."""
MOVED_PULSES: Final = 10
"""Pulses after which the cold-movement detector no longer shows where the train stood."""


@dataclass(frozen=True, slots=True)
class LocatedTag:
    """A tag of the line as it was read."""

    site: TagSite
    front_m: float
    """Place of the train's front at the tag."""
    claim_m: float
    """Resulting place of the front at the last sample."""
    bound_m: float
    """Hard bound of that place."""
    pulses: int
    """Pulses since the start, at the tag."""
    ground_m: float
    """Best estimate of the distance over ground since the start, at the tag."""
    ground_bound_m: float


@dataclass(frozen=True, slots=True)
class Windows:
    """Where the front may be at the last sample, by each way of measuring."""

    wheels_m: tuple[float, float]
    ground_m: tuple[float, float]

    @property
    def whole_m(self) -> tuple[float, float]:
        """The hull: it holds the front if either way is right."""
        return (
            min(self.wheels_m[0], self.ground_m[0]),
            max(self.wheels_m[1], self.ground_m[1]),
        )


class References:
    """Sequence of the tags. This class decides and does not move the position.

    A tag is linked to the intersection of both windows: wheels and ground must both expect it. A
    tag that one of them contradicts narrows nothing. The next tag decides: if it agrees with the
    windows, the first one was off its place; if it lies as far from the first one as the train
    ran, the windows were wrong and the pair counts.
    """

    __slots__ = (
        "_backed",
        "_config",
        "_contacts",
        "_doubt_m",
        "_furthest",
        "_last",
        "_next",
        "_tags",
        "_witness",
        "lost_cause",
        "missed",
        "sites",
        "waiting",
    )

    def __init__(self, config: OdometryConfig, line: LineMap, proof: PlaceProof) -> None:
        self._config = config
        self._contacts = Contacts(config)
        self._tags: Sequence[TagSite] = line.tags
        self.sites = {tag.tag_id: tag for tag in line.tags}
        self.lost_cause = ""
        """Why the train does not know its place. Empty while it does."""
        self.waiting = proof is PlaceProof.REMEMBERED
        """Waiting for the proof that the train was not moved while it was off."""
        if self.waiting:
            self.lost_cause = "not proven yet that the train was not moved while it was off"
        elif proof is PlaceProof.UNKNOWN:
            self.lost_cause = "started at an unknown place"
        self.missed = 0
        """Number of successive tags that should have been read."""
        self._next = 0
        self._last: LocatedTag | None = None
        self._furthest = 0
        """Highest pulse count since the last accepted tag was read."""
        self._backed = 0
        """Pulses by which the train moved back from there."""
        self._witness: LocatedTag | None = None
        """Last tag that was refused or read while the place was lost. A second one confirms it."""
        self._doubt_m = 0.0
        """How far the last accepted tag may be off its place without having been noticed."""

    def begin(self, antenna_high_m: float) -> None:
        """Expect only tags beyond this place."""
        self._next = sum(1 for tag in self._tags if tag.position_m <= antenna_high_m)

    @property
    def next_tag_m(self) -> float:
        """Chainage of the next tag that was neither read nor certainly passed. Infinity: none."""
        tags = self._tags
        return tags[self._next].position_m if self._next < len(tags) else math.inf

    def lose(self, cause: str) -> None:
        """Mark the place as lost. Only two references restore it."""
        if not self.lost_cause or self.waiting:
            self.lost_cause = cause
            self._witness = None
        self.waiting = False

    def check_cold(self, cold: ColdMovement, pulses: int) -> float | None:
        """Distance that the train moved while it was off, once it is proven to be small. None: not
        proven.
        """
        if not cold.monitored:
            self.lose("the train may have been moved while it was off: movement was not monitored")
        elif abs(cold.moved_m) > self._config.cold_movement_m:
            self.lose(f"moved by {cold.moved_m:.1f} m while it was off")
        elif abs(pulses) > MOVED_PULSES:
            self.lose("moved before it was proven to stand where it was switched off")
        else:
            self.waiting = False
            self.lost_cause = ""
            return abs(cold.moved_m)
        return None

    def follow(
        self, way: Travelled, least_m_per_pulse: float, now_s: float, *, gap: bool, slip: bool
    ) -> None:
        """Track the train's movement. A gap means that telegrams of the reader may be missing."""
        self._contacts.move(way, least_m_per_pulse, now_s)
        if slip:
            self._contacts.doubt()
        if gap:
            self._contacts.miss(way)

    def off_centre_m(
        self, site: TagSite, pulses: int, most_m_per_pulse: float, read_s: float
    ) -> float:
        """Greatest distance between tag and antenna at the reading with this pulse count.

        Args:
            read_s: earliest time of the reading.
        """
        return self._contacts.off_m(site, pulses, most_m_per_pulse, read_s)

    def read(self, reading: LocatedTag, *, honest: bool) -> None:
        """Note that a tag was read, whether or not it is accepted. `honest`: the wheels did not
        slip.
        """
        way = Travelled(reading.pulses, reading.ground_m, reading.ground_bound_m)
        self._contacts.read(reading.site.tag_id, way, reading.bound_m if honest else math.inf)

    def turned(self, pulses: int) -> None:
        """Track the wheels, in pulses since the start."""
        if pulses > self._furthest:
            self._furthest = pulses
        elif self._furthest - pulses > self._backed:
            self._backed = self._furthest - pulses

    def judge(self, reading: LocatedTag, windows: Windows, *, disputed: bool) -> RefusedTag | None:
        """Why a tag is refused. None: it is in order, and inside its windows.

        Args:
            disputed: wheels and ground contradict each other now, so one window is wrong.
        """
        tag_id, bound_m = reading.site.tag_id, reading.bound_m
        off_m = _off_m(reading.claim_m, windows.whole_m)
        last = self._last
        if last is not None and self._backed <= TURN_PULSES:
            if last.site.tag_id == tag_id:
                return RefusedTag(tag_id, TagRefusal.REPEATED, off_m)
            if reading.site.position_m < last.site.position_m:
                return RefusedTag(tag_id, TagRefusal.OUT_OF_ORDER, off_m)
        if abs(off_m) > bound_m:
            return RefusedTag(tag_id, TagRefusal.OUTSIDE_WINDOW, off_m)
        off_wheels_m = _off_m(reading.claim_m, windows.wheels_m)
        off_ground_m = _off_m(reading.claim_m, windows.ground_m)
        nearer_m, farther_m = sorted((off_wheels_m, off_ground_m), key=abs)
        if abs(nearer_m if disputed else farther_m) > bound_m:
            return RefusedTag(tag_id, TagRefusal.CONTRADICTED, farther_m)
        return None

    def widens(self, refused: RefusedTag, bound_m: float) -> bool:
        """Whether the intervals must hold the place of a refused tag, too.

        They must if this tag may be right and the last accepted one off its place.
        """
        if refused.reason is TagRefusal.OUTSIDE_WINDOW:
            return abs(refused.off_m) <= self._doubt_m + bound_m
        return refused.reason is TagRefusal.CONTRADICTED

    def pairs(self, reading: LocatedTag, least_m_per_pulse: float, most_m_per_pulse: float) -> bool:
        """Whether a refused tag and the one refused before it confirm each other.

        If not, the tag becomes the first of the next pair.
        """
        before, self._witness = self._witness, reading
        if before is None or before.site.tag_id == reading.site.tag_id:
            return False
        return self._apart_m(before, reading, least_m_per_pulse, most_m_per_pulse) == 0.0

    def accept(self, reading: LocatedTag, windows: Windows | None) -> None:
        """Make a tag the last reference.

        Args:
            windows: those that it agrees with. None: another tag confirms it.
        """
        self._doubt_m = 0.0
        if windows is not None:
            low_m, high_m = windows.whole_m
            self._doubt_m = max(reading.claim_m - low_m, high_m - reading.claim_m)
        self._last, self._witness = reading, None
        self._furthest = reading.pulses
        self._backed = 0
        self.missed = 0
        passed_m = reading.site.position_m
        while self._next < len(self._tags) and self._tags[self._next].position_m <= passed_m:
            self._next += 1

    def find_again(
        self, reading: LocatedTag, least_m_per_pulse: float, most_m_per_pulse: float
    ) -> RefusedTag | None:
        """Judge a tag while the place is lost. The place is found once `lost_cause` is empty.

        The distance between two different tags must match the distance that the train ran between
        them, by its wheels or over ground. If two tags contradict each other, the later one is
        kept.
        """
        before = self._witness
        if before is not None and before.site.tag_id == reading.site.tag_id:
            return RefusedTag(reading.site.tag_id, TagRefusal.REPEATED, 0.0)
        self._witness = reading
        if before is None:
            return None
        off_m = self._apart_m(before, reading, least_m_per_pulse, most_m_per_pulse)
        if off_m:
            return RefusedTag(reading.site.tag_id, TagRefusal.OUTSIDE_WINDOW, off_m)
        self.lost_cause = ""
        self.waiting = False
        self.begin(reading.site.position_m)
        return None

    @staticmethod
    def _apart_m(
        before: LocatedTag, reading: LocatedTag, least_m_per_pulse: float, most_m_per_pulse: float
    ) -> float:
        """How much two tags lie too far apart (positive) or too close for what the train ran."""
        apart_m = reading.site.position_m - before.site.position_m
        counted = reading.pulses - before.pulses
        ends_m = (counted * least_m_per_pulse, counted * most_m_per_pulse)
        slack_m = reading.bound_m + before.bound_m
        over_m = reading.ground_m - before.ground_m
        blur_m = slack_m + abs(reading.ground_bound_m - before.ground_bound_m)
        low_m = min(min(ends_m) - slack_m, over_m - blur_m)
        high_m = max(max(ends_m) + slack_m, over_m + blur_m)
        return _off_m(apart_m, (low_m, high_m))

    def watch(self, antenna_low_m: float, speed_mps: float, width_m: float) -> None:
        """Count the tags that the antenna has certainly passed. Too many missed tags lose the
        place.
        """
        config, tags = self._config, self._tags
        self._contacts.look(math.inf if self.lost_cause else antenna_low_m + width_m)
        late_m = max(0.0, speed_mps) * config.tag_silence_s + config.tag_bound_m
        certain_m = antenna_low_m - late_m
        while self._next < len(tags) and tags[self._next].position_m < certain_m:
            self._next += 1
            self.missed += 1
        if self.missed >= config.missed_tags_max:
            self.lose(f"{self.missed} expected tags were not read")
        elif width_m > config.localisation_limit_m:
            self.lose(
                f"the place is known to {width_m:.1f} m only; "
                f"the limit is {config.localisation_limit_m:g} m"
            )


def _off_m(at_m: float, window_m: tuple[float, float]) -> float:
    """Signed distance from the nearer end of a window. 0 inside."""
    return max(0.0, at_m - window_m[1]) or min(0.0, at_m - window_m[0])
