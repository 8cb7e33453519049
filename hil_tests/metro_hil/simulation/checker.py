"""Checks the safety invariants against true positions and true authorities of all trains.

It shares no code with the protocol. It sees true motion, the authority in each brake loop, the
messages, and what arbiters stored. The numbers are those of safety invariants 19 to 29.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from metro_hil.simulation.true_train import ROLL_BACK_MAX_M, BrakeLoopGrant, TrueTrain

NS_PER_MS: Final = 1_000_000
NO_TRAIN: Final = 0
"""Issuer of an authority whose term is no longer the newest one that its train knows."""
CYCLE_M: Final = 4.0
"""Allowance for a train whose authority is shortened: it notices within one control cycle."""
TOUCH_M: Final = 1e-6
"""Tolerance for rounding."""


class ViolationError(Exception):
    """A violated invariant; it ends the run."""

    def __init__(self, invariant: str, what: str) -> None:
        super().__init__(f"{invariant}: {what}")
        self.invariant, self.what = invariant, what


@dataclass(frozen=True, slots=True)
class Rules:
    """What the protocol guarantees, in figures."""

    age_max_ns: int
    """Maximum age of an authority by the train's own clock; after it the train brakes."""
    roll_back_m: float = ROLL_BACK_MAX_M
    jog_m: float = 0.0
    """Maximum distance that a train may jog back where its authority allows it."""
    unjudged: frozenset[str] = frozenset()
    """Invariants that the protocol does not claim to keep; violations are counted but do not end
    the run."""
    hostile: int = NO_TRAIN
    """A train that may hide or lie about itself. Others may come too near to it."""


class Checker:
    """Invariants that the protocol does not claim to keep.

    Violations are counted, and the run goes on.
    """

    def __init__(self, trains: Iterable[TrueTrain], rules: Rules) -> None:
        self.trains = {train.address: train for train in trains}
        self.rules = rules
        self.looked = Counter[str]()
        """Number of checks of each invariant."""
        self.held: dict[int, dict[int, BrakeLoopGrant]] = {}
        """Authorities that a train may still act on, by train and area."""
        self._issuers: dict[tuple[int, int], int] = {}
        """Train whose authorities were accepted, by area and term."""
        self._terms: dict[tuple[int, int], int] = {}
        """Highest accepted term over all incarnations, by train and area."""
        self._overrun_limit_m: dict[int, float] = {}
        """Position up to which a train may run although its authority was shortened, by train."""
        self._newest: dict[tuple[int, int], tuple[int, int]] = {}

    # -- notifications
    # ------------------------------------------------------------------------------

    def accepted(
        self, address: int, grant: BrakeLoopGrant, now_ns: int, *, whole: bool = True
    ) -> None:
        """A train begins to act on an authority; `now_ns` is its own clock.

        An authority that is not `whole` combines several and is as old as the oldest of them.
        """
        self._check_issuer(address, grant)
        if self._is_new(address, grant) and whole:
            self._check_age(address, grant, now_ns)
        self._allow_overrun(self.trains[address], grant)
        self.held.setdefault(address, {})[grant.area] = grant
        self.train_apart(self.trains[address])

    def gave_up(self, address: int, area: int | None = None) -> None:
        """A train stops acting on its authorities, of one area or of all, and brakes to a stop."""
        if area is None:
            self.held.pop(address, None)
        else:
            self.held.get(address, {}).pop(area, None)

    def moved(self, train: TrueTrain) -> None:
        """Check a train whose motion was brought forward."""
        self.train_apart(train)
        self._within_reach(train)

    # -- invariants --------------------------------------------------------------------------------

    def _violate(self, invariant: str, what: str) -> None:
        if invariant not in self.rules.unjudged:
            raise ViolationError(invariant, what)
        self.looked[f"{invariant} broken"] += 1

    def _check_issuer(self, address: int, grant: BrakeLoopGrant) -> None:
        if grant.issuer == NO_TRAIN:
            return
        self.looked["19"] += 1
        issuer = self._issuers.setdefault((grant.area, grant.term), grant.issuer)
        if issuer != grant.issuer:
            self._violate(
                "19",
                f"train {address} accepts from {grant.issuer} in area {grant.area}, term "
                f"{grant.term}, in which {issuer} issued before",
            )

    def _is_new(self, address: int, grant: BrakeLoopGrant) -> bool:
        """Tell whether the authority is new; check that neither term nor sequence falls."""
        self.looked["20"] += 1
        key = address, grant.area
        before = self._terms.get(key, 0)
        if grant.term < before:
            self._violate(
                "20",
                f"train {address} accepts term {grant.term} in area {grant.area} after {before}",
            )
        self._terms[key] = grant.term
        newest = self._newest.get(key, (-1, -1))
        # The same authority comes again after another area's was the lower one meanwhile.
        if (grant.term, grant.sequence) < newest:
            self._violate(
                "29",
                f"train {address} accepts {(grant.term, grant.sequence)} in area {grant.area} "
                f"after {newest}",
            )
        self._newest[key] = grant.term, grant.sequence
        return (grant.term, grant.sequence) > newest

    def _check_age(self, address: int, grant: BrakeLoopGrant, now_ns: int) -> None:
        self.looked["24"] += 1
        age_ns = now_ns - grant.stamp_ns
        if age_ns > self.rules.age_max_ns:
            self._violate(
                "24",
                f"train {address} accepts an authority that is {age_ns / NS_PER_MS:.0f} ms old",
            )

    def reach_m(self, train: TrueTrain) -> float:
        """Return how far the train's front may come before a new authority can reach it."""
        farthest_m = train.motion.farthest_m if train.motion.speed_mps > 0.0 else train.front_m
        return max(farthest_m, self.granted_m(train))

    def granted_m(self, train: TrueTrain) -> float:
        """Return the end of the authorities that the train holds."""
        grants = self.held.get(train.address)
        if not grants:
            return -math.inf
        end_m = math.inf
        for grant in grants.values():
            end_m = min(end_m, grant.end_m)
        return end_m

    def hindmost_m(self, train: TrueTrain) -> float:
        """Return how far back the rear may come: by an allowed jog and then a full rollback.

        A train stops before it jogs back. A moving train stops farther on, by its braking distance.
        """
        allowed_m = [each.rear_m for each in self.held.get(train.address, {}).values()]
        jog_m = 0.0
        if allowed_m:
            jog_m = min(self.rules.jog_m, train.foremost_rear_min_m - min(allowed_m))
        motion = train.motion
        most_m = motion.most_m
        if motion.speed_mps > 0.0:
            rests_m = motion.front_m + motion.speed_mps**2 / (2.0 * motion.emergency_mps2)
            most_m = max(most_m, min(rests_m, motion.most_m + max(jog_m, 0.0)))
        return most_m - train.length_m - max(jog_m, 0.0) - self.rules.roll_back_m

    def train_apart(self, train: TrueTrain) -> None:
        """Check invariants 21 and 22: no two trains may reach the same metre of track.

        An authority ends before the rear of the train ahead.
        """
        if not train.on_line or train.address == self.rules.hostile:
            return
        self.looked["21"] += 1
        reach_m, front_m = self.reach_m(train), train.front_m
        for other in self.trains.values():
            if other is train or not other.on_line or other.address == self.rules.hostile:
                continue
            if other.front_m >= front_m:
                rear, ahead_m, name, who = train, reach_m, "21", other
            else:
                rear, ahead_m, name, who = other, self.reach_m(other), "21", train
            limit_m = who.rear_m
            if ahead_m > limit_m + TOUCH_M:
                self._violate(
                    name,
                    f"train {rear.address} may go to {ahead_m:.2f} m, and train {who.address} "
                    f"ahead of it has its rear at {limit_m:.2f} m",
                )
            if rear.front_m > who.rear_m:
                self._violate(
                    "collision",
                    f"train {rear.address}, front {rear.front_m:.2f} m, stands in train "
                    f"{who.address}, rear {who.rear_m:.2f} m",
                )
        self._leaves_room(train)

    def _leaves_room(self, train: TrueTrain) -> None:
        """Check invariant 22: an authority leaves room for a leader that may still roll back."""
        grants = self.held.get(train.address)
        if not grants:
            return
        self.looked["22"] += 1
        end_m = min(each.end_m for each in grants.values())
        for other in self.trains.values():
            if other is train or not other.on_line or other.front_m < train.front_m:
                continue
            if other.address == self.rules.hostile:
                continue
            hindmost_m = self.hindmost_m(other)
            if end_m > hindmost_m + TOUCH_M:
                self._violate(
                    "22",
                    f"the authority of train {train.address} ends at {end_m:.2f} m, and train "
                    f"{other.address} with its rear at {other.rear_m:.2f} m may come back to "
                    f"{hindmost_m:.2f} m",
                )

    def _allow_overrun(self, train: TrueTrain, grant: BrakeLoopGrant) -> None:
        """Allow a moving train to overrun an authority shortened within its braking distance."""
        if train.motion.speed_mps > 0.0 and train.motion.farthest_m > grant.end_m:
            excused_m = max(train.motion.farthest_m, self._overrun_limit_m.get(train.address, 0.0))
            self._overrun_limit_m[train.address] = excused_m + CYCLE_M

    def _within_reach(self, train: TrueTrain) -> None:
        """Check invariant 24 in motion: no train passes its last authority, even without radio."""
        grants = self.held.get(train.address)
        if not grants or train.shunts:
            return
        if train.motion.speed_mps == 0.0:
            self._overrun_limit_m.pop(train.address, None)
            return
        end_m = min(each.end_m for each in grants.values())
        end_m = max(end_m, self._overrun_limit_m.get(train.address, end_m))
        if train.front_m > end_m + TOUCH_M:
            self._violate(
                "24",
                f"train {train.address}, front {train.front_m:.2f} m, has passed its authority's "
                f"end {end_m:.2f} m",
            )
