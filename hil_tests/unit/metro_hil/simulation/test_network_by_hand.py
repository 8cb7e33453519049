"""Trains that a person drives up to the next train, whatever their authority."""

import random

import pytest

from metro_hil.simulation.manual_driving import APART_M, ByHand, ManualController
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.removal import CLOSED_NS, PATIENCE_NS
from metro_hil.simulation.scripted_line import Plot, ScriptedLine
from zenoh_config.messages import SpeedRestriction

S = 1_000_000_000
FRONTS_M = {1: 300.0, 2: 900.0, 3: 1500.0}


def settled() -> ScriptedLine:
    scene = ScriptedLine(Plot(FRONTS_M, stops_m=tuple(FRONTS_M.values()), dwell_s=1e4))
    scene.settle()
    return scene


def drivers(scene: ScriptedLine) -> int:
    scene.until(
        "one drives", lambda: any(t.shunts for t in scene.world.trains.values()), within_s=40.0
    )
    return next(each.address for each in scene.world.trains.values() if each.shunts)


class Always(random.Random):
    """Always chooses the same kind of controller and otherwise samples as usual."""

    def __init__(self, how: ManualController) -> None:
        super().__init__(5)
        self.how = how

    def choice(self, seq):  # type: ignore[no-untyped-def]
        return self.how if self.how in seq else super().choice(seq)


@pytest.mark.parametrize("how", list(ManualController))
def test_a_train_is_driven_farther_than_it_may_go_and_has_authority_again(
    how: ManualController,
) -> None:
    scene = settled()
    by_hand = ByHand(scene.world, Always(how))

    assert by_hand.drives()

    scene.run(CLOSED_NS / S - 0.5)
    assert not any(each.shunts for each in scene.world.trains.values())
    train = scene.world.trains[drivers(scene)]
    was_m, to_m = train.front_m, train.shunts_to_m
    assert scene.net.runs(train.address) is (how is not ManualController.OFF)
    assert train.localised or how is ManualController.LOST
    held = scene.world.checker.held.get(train.address, {})
    assert all(each.end_m < to_m for each in held.values()), "by no authority"
    scene.until("it stands", lambda: not train.shunts, within_s=120.0)
    assert train.motion.speed_mps == 0.0
    assert was_m < train.front_m == pytest.approx(to_m, abs=5.0)
    assert by_hand.driven == 1
    scene.until("all have authority", scene.all_held, within_s=90.0)
    scene.run(10.0)
    assert scene.world.t2t.closed == ()


@pytest.mark.parametrize("commanded", [True, False])
def test_a_train_driven_by_hand_stays_out_of_the_next_trains_section(*, commanded: bool) -> None:
    """A train unknown to the masters was driven up to a commanded one. Only axles in that
    train's section then showed it (simulation seed 230866)."""
    scene = settled()
    by_hand, trains = ByHand(scene.world, random.Random(1)), scene.world.trains
    (section,) = [e for e in scene.world.track.line.sections if e.start_m == 1250.0]
    if not commanded:
        scene.net.kill(3)
        scene.run(5.0)

    assert section.start_m < trains[3].rear_m < section.end_m
    assert by_hand._to_m(trains[2]) == section.start_m - APART_M


@pytest.mark.parametrize(
    ("beyond_m", "unsure_m", "before_m"),
    [(1.9, 0.0, 1000.0), (19.9, 0.0, 1000.0), (20.1, 0.0, 1250.0), (20.1, 3.0, 1000.0)],
)
def test_a_train_driven_by_hand_stays_out_of_sections_that_the_next_train_may_occupy(
    beyond_m: float, unsure_m: float, before_m: float
) -> None:
    """A train was driven to 100 m behind another, into a section that the other was not sure to
    have left.

    The other was 4 m beyond it, so the axles counted as its own (simulation seed 282326).
    """
    scene = settled()
    by_hand, trains = ByHand(scene.world, random.Random(1)), scene.world.trains
    trains[3].motion = SimulatedMotion(
        scene.net.now_ns, 1250.0 + 80.0 + beyond_m, emergency_mps2=1.0
    )
    trains[3].half_width_m = unsure_m

    assert by_hand._to_m(trains[2]) == pytest.approx(before_m - APART_M)


def test_a_moving_train_or_one_without_room_is_not_driven_by_hand() -> None:
    scene = settled()
    for train in scene.world.trains.values():
        train.motion = SimulatedMotion(scene.net.now_ns, train.front_m, emergency_mps2=1.0)
        train.motion.speed_mps = 1.0

    assert not ByHand(scene.world, random.Random(3)).drives()
    assert scene.world.t2t.closed == ()


def test_no_train_is_driven_by_hand_while_it_may_still_move_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The attempt is given up a while later, and all track is opened again."""
    scene = settled()
    by_hand = ByHand(scene.world, Always(ManualController.RUNS))
    monkeypatch.setattr(scene.world.checker, "reach_m", lambda train: train.front_m + 100.0)
    by_hand.drives()

    scene.run((CLOSED_NS + PATIENCE_NS) / S)

    assert by_hand.driven == 0
    scene.run(12.0)
    assert scene.world.t2t.closed == ()


@pytest.mark.parametrize("how", list(ManualController))
def test_driving_by_hand_stops_in_the_final_calm(how: ManualController) -> None:
    scene = settled()
    by_hand = ByHand(scene.world, Always(how))
    by_hand.drives()
    train = scene.world.trains[drivers(scene)]
    scene.until("it is fast", lambda: train.motion.speed_mps > 3.0, within_s=60.0)
    train.shunts_to_m += 100.0

    by_hand.over = True

    scene.until("it stands", lambda: not train.shunts, within_s=15.0)
    scene.run(0.2)
    assert scene.world.t2t.closed == ()
    assert train.localised
    assert scene.net.runs(train.address)
    assert not by_hand.drives()


@pytest.mark.parametrize("closed", [7, 8])
def test_the_number_of_closed_stretches_is_bounded(closed: int) -> None:
    scene = settled()
    scene.world.t2t.closed = (SpeedRestriction(1900.0, 1910.0, 1.0),) * closed

    assert ByHand(scene.world, random.Random(1)).drives() is (closed < 8)
    assert len(scene.world.t2t.closed) == 8
