"""Trains that leave the line and return where no other train can come."""

import math
import random

import pytest

from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.removal import APART_M, AWAY_S, CLOSED_NS, OFF_NS, Sidings
from metro_hil.simulation.scripted_line import Plot, ScriptedLine
from zenoh_config.messages import SpeedRestriction

S = 1_000_000_000


def settled() -> ScriptedLine:
    scene = ScriptedLine(
        Plot({1: 300.0, 2: 900.0, 3: 1500.0}, stops_m=(300.0, 900.0, 1500.0), dwell_s=1e4)
    )
    scene.settle()
    return scene


def off(scene: ScriptedLine) -> list[int]:
    return [each.address for each in scene.world.trains.values() if not each.on_line]


def test_a_train_that_stands_is_switched_off_and_comes_back_among_the_others() -> None:
    scene = settled()
    sidings = Sidings(scene.world, random.Random(3))

    assert sidings.leaves()

    assert off(scene) == []
    scene.run(OFF_NS / S)
    (away,) = off(scene)
    train, was_m = scene.world.trains[away], scene.world.trains[away].front_m
    assert not scene.net.runs(away)
    scene.run(AWAY_S[0])
    assert off(scene) == [away]
    scene.until("it is back", lambda: train.on_line, within_s=120.0)
    assert sidings.entered == 1
    assert train.front_m != was_m
    for other in scene.world.trains.values():
        assert other is train or other.rear_m > train.front_m or other.front_m < train.rear_m
    scene.until("all have authority", scene.all_held, within_s=90.0)
    assert scene.world.t2t.closed == ()


def test_a_train_switched_on_again_meanwhile_stays_where_it_is() -> None:
    scene = settled()

    assert Sidings(scene.world, random.Random(3)).leaves()

    (dead,) = [each for each in scene.world.trains if not scene.net.runs(each)]
    scene.run(OFF_NS / S - 0.5)
    scene.net.boot(dead)
    scene.run(20.0)
    assert off(scene) == []


def test_a_moving_train_is_not_taken_off_the_line() -> None:
    scene = settled()
    for train in scene.world.trains.values():
        train.motion = SimulatedMotion(scene.net.now_ns, train.front_m, emergency_mps2=1.0)
        train.motion.speed_mps = 1.0

    assert not Sidings(scene.world, random.Random(3)).leaves()
    assert off(scene) == []


def test_no_train_is_put_on_the_line_where_another_may_still_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = settled()
    sidings = Sidings(scene.world, random.Random(3))
    judged = list[float]()

    def never_free(_: Sidings, closed: SpeedRestriction) -> bool:
        judged.append(closed.start_m)
        return False

    monkeypatch.setattr(Sidings, "_is_free", never_free)
    sidings.leaves()
    scene.run(OFF_NS / S)
    (away,) = off(scene)
    scene.run(AWAY_S[1] + 2 * CLOSED_NS / S + 40.0)

    assert len(set(judged)) > 1, "elsewhere after a while"
    assert off(scene) == [away]


@pytest.mark.parametrize(("to_m", "taken"), [(979.0, False), (981.0, True), (math.inf, True)])
def test_a_place_to_which_a_train_is_driven_by_hand_is_taken(to_m: float, taken: bool) -> None:
    scene = settled()
    sidings, train = Sidings(scene.world, random.Random(3)), scene.world.trains[1]
    place = SpeedRestriction(1000.0, 1250.0, 1.0)
    for far in (2, 3):
        scene.world.trains[far].on_line = False
    assert not sidings._is_taken(place)

    train.shunts, train.shunts_to_m = True, to_m

    assert sidings._is_taken(place) is taken


@pytest.mark.parametrize(("unsure_m", "taken"), [(0.0, False), (3.0, True)])
def test_a_place_close_to_a_trains_reported_position_is_taken(
    unsure_m: float, *, taken: bool
) -> None:
    """The train's rear is 20.1 m beyond the place. Its report may be lower, and the train may
    roll and jog back."""
    scene = settled()
    sidings, train = Sidings(scene.world, random.Random(3)), scene.world.trains[3]
    for behind in (1, 2):
        scene.world.trains[behind].on_line = False
    train.motion = SimulatedMotion(scene.net.now_ns, 1250.0 + 80.0 + 20.1, emergency_mps2=1.0)
    train.half_width_m = unsure_m

    assert sidings._is_taken(SpeedRestriction(1000.0, 1250.0, 1.0)) is taken


@pytest.mark.parametrize("after_s", [1.0, AWAY_S[1] + 1.0])
def test_in_the_final_calm_no_train_is_put_on_the_line(
    after_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This holds before the search for a place and during the wait at one."""
    scene = settled()
    sidings = Sidings(scene.world, random.Random(3))
    monkeypatch.setattr(Sidings, "_is_free", lambda *_: False)
    sidings.leaves()
    scene.run(OFF_NS / S + after_s)
    (away,) = off(scene)
    monkeypatch.setattr(Sidings, "_is_free", lambda *_: True)
    sidings.over = True

    scene.run(AWAY_S[1] + 2 * CLOSED_NS / S)

    assert off(scene) == [away]
    assert scene.world.t2t.closed == ()


def test_a_place_that_no_train_behind_can_reach_is_free() -> None:
    scene = settled()
    sidings = Sidings(scene.world, random.Random(3))
    end_m = scene.end_m(3)
    assert end_m is not None
    just_free = SpeedRestriction(end_m, end_m + 100.0, 1.0)
    just_not = SpeedRestriction(end_m - 0.1, end_m + 100.0, 1.0)

    assert sidings._is_free(just_free)
    assert not sidings._is_free(just_not)


def test_a_place_that_a_train_may_reach_by_its_own_estimate_is_not_free() -> None:
    """The train brakes before the place but may be over the joint by its position uncertainty
    (seed 135659)."""
    scene = settled()
    sidings, train = Sidings(scene.world, random.Random(3)), scene.world.trains[3]
    scene.world.checker.gave_up(3)
    train.motion.speed_mps = 8.0
    place = SpeedRestriction(train.reading().reach_m - 0.1, 1800.0, 1.0)
    assert scene.world.checker.reach_m(train) < place.start_m

    assert not sidings._is_free(place)
    assert sidings._is_free(SpeedRestriction(place.start_m + 0.2, 1800.0, 1.0))


def test_a_train_waits_off_the_line_while_no_further_stretch_can_be_closed() -> None:
    scene = settled()
    others = (SpeedRestriction(1900.0, 1910.0, 1.0),) * 8
    scene.world.t2t.closed = others

    assert Sidings(scene.world, random.Random(3)).leaves()
    scene.run(OFF_NS / S + AWAY_S[1] + 10.0)
    assert len(off(scene)) == 1
    assert scene.world.t2t.closed == others

    scene.world.t2t.closed = ()
    scene.until("it is back", lambda: not off(scene), within_s=120.0)


def test_the_closed_track_begins_some_distance_before_the_sections_of_the_new_train() -> None:
    """A braking train once took the section for its own, uncertain by a centimetre (seed
    239562)."""
    scene = settled()
    train = scene.world.trains[1]
    scene.net.kill(1)
    train.on_line = train.localised = False
    scene.world.checker.gave_up(1)

    Sidings(scene.world, random.Random(3))._wants_in(train)
    scene.until("it is closed", lambda: bool(scene.world.t2t.closed), within_s=60.0)

    (closed,) = scene.world.t2t.closed
    assert closed.start_m + APART_M in {e.start_m for e in scene.world.track.line.sections}
    assert closed.end_m in {e.end_m for e in scene.world.track.line.sections}
