"""Trains that leave the line sideways, switched off, and are set on again at any other place.

They may pass other trains in this way. The track there is closed first, because a master cannot
take back at once an authority that it has sent.
"""

import random
from collections.abc import Callable
from typing import Final

from metro_hil.simulation.depot import LOOK_NS, SEEN_NS, seen_gone, set_on, take_off
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.true_train import TrueTrain
from zenoh_config.messages import SpeedRestriction

NS_PER_S: Final = 1_000_000_000
AWAY_S: Final = (12.0, 60.0)
"""Range of the time away from the line; no shorter than what the protocol assumes."""
OFF_NS: Final = 4 * NS_PER_S
"""Time for which a train is switched off before it is moved; receivers notice its silence by
then."""
DEAD_S: Final = (2.0, 40.0)
OPENED_S: Final = (1.0, 20.0)
CLOSED_NS: Final = 6 * NS_PER_S
"""Time from a closure until every authority in force was issued with knowledge of it."""
PATIENCE_NS: Final = 30 * NS_PER_S
ROOM_M: Final = 40.0
"""Minimum length of closed track on either side of the train."""
APART_M: Final = 20.0
"""Least distance of other trains to the closed track, by their true and by their reported
position."""


class Sidings:
    """Takes trains off the line and sets them on again."""

    def __init__(self, world: LineWorld, rng: random.Random) -> None:
        self.world, self._rng = world, rng
        self.entered = 0
        self.over = False
        """No train is set onto the line any more."""

    def leaves(self) -> bool:
        """Let a train at rest leave the line; return False if there is none."""
        standing = [
            each
            for each in self.world.trains.values()
            if each.on_line and not each.shunts and not each.rolls
            if not each.motion.speed_mps and each.motion.accel_mps2 <= 0.0
        ]
        if not standing:
            return False
        self._switch_off(self._rng.choice(standing))
        return True

    def _switch_off(self, train: TrueTrain) -> None:
        """Switch the train off some time before it is moved."""
        net = self.world.net
        net.kill(train.address, why="is switched off")
        lives = net.nodes[train.address].boots
        net.at(net.now_ns + OFF_NS, lambda _: self._take_off_line(train, lives))

    def _take_off_line(self, train: TrueTrain, lives: int) -> None:
        """Take the train off the line, unless it was switched on again."""
        net = self.world.net
        if train.shunts or not train.on_line or net.nodes[train.address].boots != lives:
            return
        net.say("railway", f"train {train.address} is taken off the line")
        take_off(self.world, train)
        self._after(AWAY_S, self._wants_in, train)
        net.at(net.now_ns + SEEN_NS, lambda _: seen_gone(self.world, train))

    def _after(
        self, span_s: tuple[float, float], call: Callable[[TrueTrain], None], train: TrueTrain
    ) -> None:
        wait_ns = int(self._rng.uniform(*span_s) * NS_PER_S)
        self.world.net.at(self.world.net.now_ns + wait_ns, call, train)

    def _wants_in(self, train: TrueTrain) -> None:
        """Close whole sections without trains and objects, and set the train on there later.

        Axle counters could not distinguish it from another train in the same section, or from one
        that may roll back into it. The closure begins some way before, so that a train that stops
        there is sure not to be in these sections.
        """
        world, net = self.world, self.world.net
        if self.over:
            return
        line = world.drawn.cast.line
        front_m = self._rng.uniform(train.length_m + ROOM_M, line.end_m - ROOM_M)
        rear_m = front_m - train.length_m
        sections = [e for e in line.sections if e.end_m > rear_m - ROOM_M]
        sections = [e for e in sections if e.start_m < front_m + ROOM_M]
        closed = SpeedRestriction(sections[0].start_m - APART_M, sections[-1].end_m, 1.0)
        if (
            not world.may_close
            or self._is_taken(closed)
            or any(
                site.start_m < closed.end_m and closed.start_m < site.end_m for site in line.objects
            )
        ):
            net.at(net.now_ns + LOOK_NS, self._wants_in, train)
            return
        world.closes(closed)
        until_ns = net.now_ns + PATIENCE_NS
        net.at(
            net.now_ns + CLOSED_NS,
            lambda _: self._enter_when_free(train, front_m, closed, until_ns),
        )

    def _enter_when_free(
        self, train: TrueTrain, front_m: float, closed: SpeedRestriction, until_ns: int
    ) -> None:
        """Set the train on once no other train may come there, or else choose another place.

        Another place is needed if that takes long or if a train was set on there. The counters must
        have shown free track for a while.
        """
        world, net = self.world, self.world.net
        if self.over:
            world.opens(closed)
            return
        if not world.is_closed(closed) or net.now_ns > until_ns or self._is_taken(closed):
            world.opens(closed)
            net.at(net.now_ns + LOOK_NS, self._wants_in, train)
            return
        if not self._is_free(closed):
            net.at(
                net.now_ns + LOOK_NS,
                lambda _: self._enter_when_free(train, front_m, closed, until_ns),
            )
            return
        set_on(world, train, front_m)
        self.entered += 1
        if self._rng.random() < 0.7:
            net.boot(train.address)
        else:
            self._after(DEAD_S, lambda _: net.boot(train.address), train)
        self._after(OPENED_S, lambda _: world.opens(closed), train)

    def _is_taken(self, closed: SpeedRestriction) -> bool:
        trains = [each for each in self.world.trains.values() if each.on_line]
        return any(
            each.reading().rear_min_m - APART_M < closed.end_m
            and closed.start_m < each.driven_to_m + APART_M
            for each in trains
        )

    def _is_free(self, closed: SpeedRestriction) -> bool:
        judge = self.world.checker
        for train in self.world.trains.values():
            if not train.on_line or train.rear_m >= closed.end_m:
                continue
            # A train may also be in a section by its own position interval.
            comes_to_m = max(train.reading().reach_m, judge.reach_m(train))
            if comes_to_m > closed.start_m:
                return False
        return True
