"""Whole trains, controllers on their buses, that command each other in virtual time."""

import itertools

from can_dbc.vobc import Supervision
from firmware_py.trackdb.areas import Area, AreaMap, TrackSection
from metro_hil.line_bench import LineBench, Run
from vobc.config import load_config

EDGES_M = [-120.0, *range(100, 4700, 100), 4700.0]
SECTIONS = tuple(
    [TrackSection(n, a, b) for n, (a, b) in enumerate(itertools.pairwise(EDGES_M), start=1)]
)
FLORENCE = AreaMap("florence", (Area(1, -120.0, 2500.0), Area(2, 2500.0, 4700.0)), SECTIONS)


class Line:
    """Two trains, the second behind the first; what must hold is looked at all the time."""

    def __init__(self) -> None:
        ways = [Run("III", "IV"), Run("II", "III")]
        self.bench = LineBench(load_config("florence4"), FLORENCE, ways)
        self.smallest_gap_m = 1e9
        self.emergencies = 0

    def run(self, duration_s: float) -> None:
        self.bench.run(duration_s, self.look)

    def look(self) -> None:
        """By the plants' truth: no train may go where another one is."""
        ahead, behind = (self.bench.trains[n] for n in (1, 2))
        held = behind.command.held
        rear_m = ahead.plant.world.front_m - ahead.plant.world.length_m
        if held is not None:
            self.smallest_gap_m = min(self.smallest_gap_m, rear_m - held.end_m)
        in_emergency = behind.vobc.output.supervision is Supervision.EMERGENCY
        self.emergencies += in_emergency and behind.vobc.output.mode.name != "STANDBY"


def test_a_train_follows_another_without_zone_controller_and_goes_on_without_its_master() -> None:
    line = Line()
    line.run(13.0)
    bench, follower = line.bench, line.bench.trains[2]
    assert bench.masters(2) == [1]
    assert follower.plant.world.speed_mps > 4.0
    held = follower.command.held
    assert held is not None
    term = held.term

    bench.kill(1)
    line.run(0.6)
    held = follower.command.held

    assert bench.masters(2) == [2]
    assert held is not None
    assert held.term > term
    line.run(8.0)
    assert bench.trains[1].plant.world.speed_mps == 0.0  # Its own plant braked it.
    assert line.emergencies == 0
    assert line.smallest_gap_m >= 7.0
