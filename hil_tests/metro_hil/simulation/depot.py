"""Trains that leave the line at its end, by hand, and come back at its beginning after a while."""

import random
from typing import Final

from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.true_train import TrueTrain
from zenoh_config.t2t_supervision import RemovalState

NS_PER_S: Final = 1_000_000_000
NEAR_M: Final = 60.0
"""So near the end of the line a train may be driven off it."""
BEYOND_M: Final = 20.0
"""So far behind the end its rear is in the depot, and its controller is switched off."""
LOOK_NS: Final = 500_000_000
SEEN_NS: Final = 4_000_000_000
AWAY_S: Final = (5.0, 60.0)
ROOM_M: Final = 40.0
"""Free track ahead of a train that is set onto the line."""


class Depot:
    """Drives trains off and sets them on again."""

    def __init__(self, world: LineWorld, rng: random.Random) -> None:
        self.world, self._rng = world, rng
        self.entered = 0

    def leaves(self) -> bool:
        """Let the foremost train leave; whether it is there to do so."""
        trains = [each for each in self.world.trains.values() if each.on_line]
        if not trains:
            return False
        train = max(trains, key=lambda each: each.front_m)
        motion = train.motion
        if train.shunts or motion.speed_mps or motion.accel_mps2 > 0.0 or train.rolls:
            return False
        if train.front_m < self.world.drawn.cast.line.end_m - NEAR_M:
            return False
        self.world.net.say("railway", f"train {train.address} is driven off the line")
        train.shunts = True
        self.world.net.at(self.world.net.now_ns + LOOK_NS, self._gone, train)
        return True

    def _gone(self, train: TrueTrain) -> None:
        net = self.world.net
        if train.rear_m < self.world.drawn.cast.line.end_m + BEYOND_M:
            net.at(net.now_ns + LOOK_NS, self._gone, train)
            return
        train.shunts = False
        take_off(self.world, train)
        net.kill(train.address, why="is switched off in the depot")
        away_ns = int(self._rng.uniform(*AWAY_S) * NS_PER_S)
        net.at(net.now_ns + away_ns, self._enters, train)
        seen_gone(self.world, train)

    def _enters(self, train: TrueTrain) -> None:
        """When there is room: its place is nobody's, as none is behind it."""
        net, world = self.world.net, self.world
        front_m = train.length_m + self._rng.uniform(10.0, 60.0)
        rears_m = [each.rear_m for each in world.trains.values() if each.on_line]
        if rears_m and min(rears_m) < front_m + ROOM_M:
            net.at(net.now_ns + LOOK_NS, self._enters, train)
            return
        set_on(world, train, front_m)
        self.entered += 1
        net.boot(train.address)


def take_off(world: LineWorld, train: TrueTrain) -> None:
    """It is not on the line any more, and nobody has been told so yet."""
    train.on_line = train.localised = False
    world.checker.gave_up(train.address)
    for area in world.drawn.cast.line.areas:
        world.t2t.removals.pop((area.number, train.address), None)


def set_on(world: LineWorld, train: TrueTrain, front_m: float) -> None:
    """Switched off, whatever ran while it was away: it begins anew with what it stored."""
    net = world.net
    net.kill(train.address, why="is switched off before it comes back")
    train.motion = SimulatedMotion(net.now_ns, front_m, emergency_mps2=train.motion.emergency_mps2)
    world.stops_next(train)
    train.on_line = train.localised = True
    net.say("railway", f"train {train.address} comes onto the line, front {front_m:.2f} m")


def seen_gone(world: LineWorld, train: TrueTrain) -> None:
    """By a person, who asks every master to take it off its roster until all have: theirs may not
    have heard of it. Where it is again by then it is seen, too.
    """
    told = world.t2t.removals
    left = [
        area.number
        for area in world.drawn.cast.line.areas
        if told.get((area.number, train.address)) is not RemovalState.GONE
        and not world.is_in(train, area)
    ]
    if left:
        world.removes(train.address, left)
        world.net.at(world.net.now_ns + SEEN_NS, lambda _: seen_gone(world, train))
