"""Two trains with controllers, one behind the other into a station, when the one ahead brakes
hard."""

from collections.abc import Iterator

import pytest

from can_dbc.vobc import Supervision
from metro_hil.line.headway import LOOK_S, approach
from metro_hil.line.train_group import BenchTrain

INTERVAL_S = 74.1
LEFT_S = 45.0
"""Time after which the train behind has certainly finished braking, s."""


def after_the_kill(at_m: float) -> Iterator[tuple[BenchTrain, BenchTrain]]:
    """Yield both trains repeatedly after the controller of the one ahead was killed.

    The kill happens when the train behind is `at_m` before the stop.
    """
    with approach(2, INTERVAL_S) as (bench, stop_m):
        ahead, follower = (bench.trains[number] for number in sorted(bench.trains))
        while follower.plant.world.front_m < stop_m - at_m:
            bench.run(LOOK_S)
        bench.kill(min(bench.trains))
        for _ in range(round(LEFT_S / LOOK_S)):
            bench.run(LOOK_S)
            yield ahead, follower


@pytest.mark.parametrize("at_m", [260.0, 220.0])
def test_a_hard_braked_leader_causes_no_emergency_brake_of_the_follower(
    at_m: float,
) -> None:
    """ATO assumes a stopping distance of the train ahead, which then stops in less."""
    closest_m = 1000.0
    states: set[Supervision] = set()
    for ahead, follower in after_the_kill(at_m):
        leader = ahead.plant.world
        room_m = leader.front_m - leader.length_m - follower.plant.world.front_m
        closest_m = min(closest_m, room_m)
        states.add(follower.vobc.output.supervision)

    assert follower.plant.world.speed_mps < 3.0
    assert ahead.plant.world.speed_mps == 0.0
    assert closest_m > 0.0
    assert Supervision.EMERGENCY not in states
