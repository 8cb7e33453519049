"""Trains driven by hand, on sight, up to the section of the next train.

The track ahead is closed first, so that no master lets the train go meanwhile. The controller runs
with or without its position, or is off while the train is towed.
"""

import enum
import math
import random
from typing import Final

from metro_hil.simulation.depot import LOOK_NS
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.removal import CLOSED_NS, PATIENCE_NS
from metro_hil.simulation.true_train import TrueTrain
from zenoh_config.messages import SpeedRestriction

NS_PER_S: Final = 1_000_000_000
LEAST_M: Final = 5.0
MOST_M: Final = 400.0
APART_M: Final = 20.0
"""Least distance to the next train's section, to an object and to the end of the line. Track from
this far behind the next train's reported rear belongs to that train."""
DEAD_S: Final = (0.0, 30.0)
OPENED_S: Final = (0.0, 10.0)


class ManualController(enum.Enum):
    """State of the controller while its train is driven by hand."""

    RUNS = "runs"
    LOST = "is lost"
    """The train is localised again when it stands, or somewhere on the way."""
    OFF = "is off"


class ByHand:
    """Drives one train after the other."""

    def __init__(self, world: LineWorld, rng: random.Random) -> None:
        self.world, self._rng = world, rng
        self.driven = 0
        self.over = False
        """No new drive begins, and trains driven by hand stop."""

    def drives(self) -> bool:
        """Start to drive a train that stands and has room ahead; return False if there is none."""
        choice = [each for each in self.world.trains.values() if self._to_m(each) > each.front_m]
        if not choice or self.over or not self.world.may_close:
            return False
        train = self._rng.choice(choice)
        world, net = self.world, self.world.net
        closed = SpeedRestriction(train.front_m, self._to_m(train) + APART_M, 1.0)
        world.closes(closed)
        how = self._rng.choice(list(ManualController))
        net.say("railway", f"train {train.address} is to be driven; its controller {how.value}")
        if how is ManualController.OFF:
            net.kill(train.address, why="is switched off")
        elif how is ManualController.LOST:
            train.localised = False
        until_ns = net.now_ns + PATIENCE_NS
        net.at(
            net.now_ns + CLOSED_NS, lambda _: self._begin_when_free(train, how, closed, until_ns)
        )
        return True

    def _to_m(self, train: TrueTrain) -> float:
        """Start to drive a train that stands and has room ahead.

        Return False if there is none.
        """
        motion = train.motion
        stands = train.on_line and not train.shunts and not train.rolls and not motion.speed_mps
        if not stands or motion.accel_mps2 > 0.0:
            return train.front_m
        line = self.world.drawn.cast.line
        ahead = [e for e in self.world.trains.values() if e.on_line and e.front_m > train.front_m]
        bounds_m = [self._section_start_m(each) for each in ahead]
        bounds_m += [site.start_m for site in line.objects if site.end_m > train.rear_m]
        room_m = min([line.end_m, *bounds_m]) - APART_M - train.front_m
        return train.front_m + (min(room_m, MOST_M) if room_m >= LEAST_M else 0.0)

    def _section_start_m(self, ahead: TrueTrain) -> float:
        """Return the start of the section that the train ahead is in, may come back to, or reports.

        Axle counters cannot tell the two trains apart in that section, and another train from
        behind may not know of the driven one.
        """
        told_m = ahead.reading().rear_min_m
        hindmost_m = min(self.world.checker.hindmost_m(ahead), told_m - APART_M)
        sections = self.world.drawn.cast.line.sections
        return max([e.start_m for e in sections if e.start_m <= hindmost_m], default=-math.inf)

    def _begin_when_free(
        self, train: TrueTrain, how: ManualController, closed: SpeedRestriction, until_ns: int
    ) -> None:
        """Drive off once neither this train nor an earlier one holds an authority here."""
        net = self.world.net
        to_m = min(self._to_m(train), closed.end_m - APART_M)
        left = self.over or not self.world.is_closed(closed)
        if left or to_m <= train.front_m or net.now_ns > until_ns:
            self._end_drive(train, how, closed)
            return
        if self.world.checker.reach_m(train) > train.reading().front_max_m:
            net.at(
                net.now_ns + LOOK_NS, lambda _: self._begin_when_free(train, how, closed, until_ns)
            )
            return
        self.driven += 1
        train.shunts, train.shunts_to_m = True, self._rng.uniform(train.front_m + LEAST_M, to_m)
        net.say("railway", f"train {train.address} is driven by hand to {train.shunts_to_m:.2f} m")
        if how is ManualController.LOST and self._rng.random() < 0.5:
            found_s = self._rng.uniform(0.0, 30.0)
            net.at(net.now_ns + int(found_s * NS_PER_S), lambda _: _finds_place(train))
        self._continue_drive(train, how, closed)

    def _continue_drive(
        self, train: TrueTrain, how: ManualController, closed: SpeedRestriction
    ) -> None:
        net = self.world.net
        if self.over:
            train.shunts_to_m = min(train.shunts_to_m, train.front_m)
        if train.motion.speed_mps or train.front_m < train.shunts_to_m - LEAST_M:
            net.at(net.now_ns + LOOK_NS, lambda _: self._continue_drive(train, how, closed))
            return
        train.shunts, train.shunts_to_m = False, math.inf
        self.world.stops_next(train)
        net.say("railway", f"train {train.address} stands at {train.front_m:.2f} m")
        self._end_drive(train, how, closed)

    def _end_drive(self, train: TrueTrain, how: ManualController, closed: SpeedRestriction) -> None:
        net = self.world.net
        if how is ManualController.LOST:
            _finds_place(train)
        elif how is ManualController.OFF:
            wait_ns = 0 if self.over else int(self._rng.uniform(*DEAD_S) * NS_PER_S)
            net.at(net.now_ns + wait_ns, net.boot, train.address)
        open_ns = 0 if self.over else int(self._rng.uniform(*OPENED_S) * NS_PER_S)
        net.at(net.now_ns + open_ns, lambda _: self.world.opens(closed))


def _finds_place(train: TrueTrain) -> None:
    train.localised = train.on_line
