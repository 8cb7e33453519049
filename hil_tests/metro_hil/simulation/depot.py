"""Trains that leave the line by hand at its end and come back at its start after a while."""

import random
from typing import Final

from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.true_train import TrueTrain
from zenoh_config.t2t_supervision import RemovalState

NS_PER_S: Final = 1_000_000_000
NEAR_M: Final = 60.0
"""Maximum distance from the end of the line at which a train may be driven off it."""
BEYOND_M: Final = 20.0
"""Distance of a train's rear beyond the end of the line where its controller is switched off."""
LOOK_NS: Final = 500_000_000
SEEN_NS: Final = 4_000_000_000
AWAY_S: Final = (5.0, 60.0)
ROOM_M: Final = 40.0
"""Free track that a train needs ahead of it when it is set onto the line."""


class Depot:
    """Drives trains off the line and sets them on again."""

    def __init__(self, world: LineWorld, rng: random.Random) -> None:
        self.world, self._rng = world, rng
        self.entered = 0

    def leaves(self) -> bool:
        """Let the foremost train leave.

        Return False if it is not at rest near the end of the line.
        """
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
        self.world.net.at(self.world.net.now_ns + LOOK_NS, self._leave_when_off, train)
        return True

    def _leave_when_off(self, train: TrueTrain) -> None:
        net = self.world.net
        if train.rear_m < self.world.drawn.cast.line.end_m + BEYOND_M:
            net.at(net.now_ns + LOOK_NS, self._leave_when_off, train)
            return
        train.shunts = False
        take_off(self.world, train)
        net.kill(train.address, why="is switched off in the depot")
        away_ns = int(self._rng.uniform(*AWAY_S) * NS_PER_S)
        net.at(net.now_ns + away_ns, self._enter_when_free, train)
        seen_gone(self.world, train)

    def _enter_when_free(self, train: TrueTrain) -> None:
        """Set the train onto the start of the line when there is room there.

        No train can stand behind it there.
        """
        net, world = self.world.net, self.world
        front_m = train.length_m + self._rng.uniform(10.0, 60.0)
        rears_m = [each.rear_m for each in world.trains.values() if each.on_line]
        if rears_m and min(rears_m) < front_m + ROOM_M:
            net.at(net.now_ns + LOOK_NS, self._enter_when_free, train)
            return
        set_on(world, train, front_m)
        self.entered += 1
        net.boot(train.address)


def take_off(world: LineWorld, train: TrueTrain) -> None:
    """Take a train off the line. No master knows of it yet."""
    train.on_line = train.localised = False
    world.checker.gave_up(train.address)
    for area in world.drawn.cast.line.areas:
        world.t2t.removals.pop((area.number, train.address), None)


def set_on(world: LineWorld, train: TrueTrain, front_m: float) -> None:
    """Set a switched-off train onto the line. Its controller restarts from its stored memory."""
    net = world.net
    net.kill(train.address, why="is switched off before it comes back")
    train.motion = SimulatedMotion(net.now_ns, front_m, emergency_mps2=train.motion.emergency_mps2)
    world.stops_next(train)
    train.on_line = train.localised = True
    net.say("railway", f"train {train.address} comes onto the line, front {front_m:.2f} m")


def seen_gone(world: LineWorld, train: TrueTrain) -> None:
    """Let a person ask every master to take an absent train off its roster, until all have done so.

    Masters may have missed earlier requests. An area that the train has entered again is left out.
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
