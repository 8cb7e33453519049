"""Two trains with controllers, one behind the other into a station, when the one ahead brakes
hard."""

import os
from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from can_dbc.vobc import Supervision
from metro_hil.line.headway import LOOK_S, approach
from metro_hil.line.train_group import LineBench

INTERVAL_S = 74.1
RUN_UP_M = 800.0
"""Distance from the first stop, where ATO learns its brake, to the station, m. The trains reach
their speed in 300 m."""
LEFT_S = 45.0
"""Time after which the train behind has certainly finished braking, s."""
KILLED_AT_M = (260.0, 220.0)
"""Distances of the train behind from its stop at which the controller ahead is killed, m."""


class Ending(NamedTuple):
    """What happened after the kill."""

    closest_m: float
    ahead_mps: float
    follower_mps: float
    states: set[Supervision]


def after_the_kill(bench: LineBench) -> Ending:
    """Kill the controller of the train ahead, and watch both trains until they stand."""
    ahead, follower = (bench.trains[number] for number in sorted(bench.trains))
    bench.kill(min(bench.trains))
    closest_m = 1000.0
    states: set[Supervision] = set()
    for _ in range(round(LEFT_S / LOOK_S)):
        bench.run(LOOK_S)
        leader = ahead.plant.world
        room_m = leader.front_m - leader.length_m - follower.plant.world.front_m
        closest_m = min(closest_m, room_m)
        states.add(follower.vobc.output.supervision)
    speeds_mps = ahead.plant.world.speed_mps, follower.plant.world.speed_mps
    return Ending(closest_m, *speeds_mps, states)


def endings() -> Iterator[Ending]:
    """Both trains approach once. At each distance a copy of this process goes on with a kill."""
    with approach(2, INTERVAL_S, RUN_UP_M) as (bench, stop_m):
        follower = bench.trains[max(bench.trains)]
        for at_m in KILLED_AT_M:
            while follower.plant.world.front_m < stop_m - at_m:
                bench.run(LOOK_S)
            yield in_a_copy(bench)


def in_a_copy(bench: LineBench) -> Ending:
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(writer, msgspec.json.encode(after_the_kill(bench)))
        finally:
            # The copy must not end the tests a second time.
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        content = pipe.read()
    os.waitpid(child, 0)
    return msgspec.json.decode(content, type=Ending)


def test_a_hard_braked_leader_causes_no_emergency_brake_of_the_follower() -> None:
    """ATO assumes a stopping distance of the train ahead, which then stops in less."""
    for ending in endings():
        assert ending.follower_mps < 3.0
        assert ending.ahead_mps == 0.0
        assert ending.closest_m > 0.0
        assert Supervision.EMERGENCY not in ending.states
