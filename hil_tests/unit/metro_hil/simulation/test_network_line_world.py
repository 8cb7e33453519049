"""The judge of the line: situations that it permits because of the trains' true positions."""

from dataclasses import replace

import pytest

from metro_hil.simulation.authority_checks import AuthorityChecks
from metro_hil.simulation.checker import ViolationError
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.node import Doom
from metro_hil.simulation.orders import OrderSource, TrainOrder
from metro_hil.simulation.railway_events import RailwayEvents
from metro_hil.simulation.scripted_line import Plot, ScriptedLine
from metro_hil.simulation.true_train import BrakeLoopGrant
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import ObjectClaim, OrderKind, TrainReport
from zenoh_config.t2t_supervision import RemovalState

AGE_MAX_NS = 1_000_000_000
CLOSED = SpeedRestriction(600.0, 700.0, 0.1)


def world(*fronts_m: float) -> LineWorld:
    """Trains of 80 m with axles from 2 m behind the front, on sections of 250 m."""
    return ScriptedLine(Plot(dict(enumerate(fronts_m, start=1)))).world


def joined(of: LineWorld, train: int) -> list[int]:
    return [each.address for each in of.track.joined_to(of.trains[train])]


def test_trains_are_joined_when_no_section_between_them_is_empty() -> None:
    # The second train stands over the joint at 250 m, the third behind the next joint.
    line = world(100.0, 300.0, 560.0, 1100.0)

    assert joined(line, 1) == joined(line, 2) == joined(line, 3) == [1, 2, 3]
    assert joined(line, 4) == [4]


@pytest.mark.parametrize(("front_m", "together"), [(502.1, [1, 2]), (501.9, [1])])
def test_only_axles_join_and_not_the_ends_of_cars(front_m: float, together: list[int]) -> None:
    # The other train stands behind the joint at 750 m, so the section from 500 m on is between
    # them.
    assert joined(world(front_m, 835.0), 1) == together


def test_a_removed_train_is_joined_to_none() -> None:
    line = world(100.0, 400.0, 600.0)
    assert joined(line, 1) == [1, 2, 3]
    line.trains[2].on_line = False

    assert joined(line, 1) == [1]
    assert joined(line, 2) == []


def test_a_train_may_wait_while_a_joined_train_moves() -> None:
    line = world(100.0, 300.0, 900.0)
    assert not line.unsettled([1])

    line.trains[3].motion.speed_mps = 1.0
    assert not line.unsettled([1, 2])
    line.trains[2].motion.speed_mps = 0.1
    assert line.unsettled([1])
    assert not line.unsettled([])


def test_a_train_may_wait_for_one_driven_by_hand_anywhere() -> None:
    line = world(100.0, 900.0)
    line.trains[2].shunts = True

    assert line.unsettled([1])


@pytest.mark.parametrize("state", list(RemovalState))
@pytest.mark.parametrize(
    ("front_m", "on_line", "there"),
    [(900.0, True, True), (900.0, False, False), (2079.0, True, True), (2081.0, True, False)],
)
@pytest.mark.parametrize("moves", [None, 2, 3])
def test_a_train_may_wait_while_one_moves_and_another_must_leave_a_roster(
    state: RemovalState, front_m: float, on_line: bool, there: bool, moves: int | None
) -> None:
    line = ScriptedLine(Plot({1: 100.0, 2: front_m, 3: 1500.0}, areas=2)).world
    line.trains[2].on_line = on_line
    if moves is not None:
        line.trains[moves].motion.speed_mps = 1.0
    line.t2t.removals[1, 2] = state

    heard = state is RemovalState.HEARD and moves == 2
    axles = state is RemovalState.AXLES and moves is not None
    assert line.unsettled([1]) is (not there and (heard or axles))


def apart(room_m: float) -> LineWorld:
    """Two trains 500 m apart, moved together until their certain distance is `room_m`."""
    line = world(400.0, 900.0)
    follower, leader = line.trains[1], line.trains[2]
    for _ in range(20):
        is_m = leader.reading().rear_min_m - follower.reading().front_max_m
        leader.motion.front_m -= is_m - room_m
    return line


@pytest.mark.parametrize(("room_m", "waits"), [(7.1, [1, 2]), (6.9, [])])
def test_a_train_too_close_to_another_is_exempt_from_getting_an_authority(
    room_m: float, waits: list[int]
) -> None:
    """This exempts the train behind, which can get no authority, and the one ahead, which has no
    place."""
    line = apart(room_m)

    assert line.without_authority() == waits
    line.trains[1].motion.speed_mps = 0.1
    assert 1 in line.without_authority()


@pytest.mark.parametrize(
    ("kept", "waits"),
    [
        ({(1, 4): (1, frozenset({2}))}, [2]),
        ({(1, 4): (1, frozenset({1}))}, []),
        ({(1, 4): (1, frozenset({2})), (1, 5): (1, frozenset({1}))}, []),
        ({(2, 6): (1, frozenset({2}))}, []),
    ],
)
def test_a_registered_train_needs_an_authority_however_close_the_train_behind(
    kept: dict[tuple[int, int], tuple[int, frozenset[int]]], waits: list[int]
) -> None:
    line = apart(6.9)
    line.air._kept = kept

    assert line.without_authority() == waits


def test_in_the_final_calm_supervision_detects_trains_that_left_an_area() -> None:
    line = ScriptedLine(Plot({1: 100.0, 2: 2300.0, 3: 900.0}, areas=2)).world
    line.trains[3].on_line = False
    mischief = RailwayEvents(line, seed=1)
    line.t2t.removals[1, 2] = RemovalState.GONE
    mischief.calm()
    line.net.run(4_100_000_000)

    wanted = {(each.area, each.train) for each in line.t2t.orders if each.kind is None}
    assert wanted == {(2, 1), (1, 2)}
    line.t2t.removals.update({(2, 1): RemovalState.GONE, (1, 2): RemovalState.HEARD})
    line.t2t.orders = []
    line.net.run(8_200_000_000)
    assert {(each.area, each.train) for each in line.t2t.orders if each.kind is None} == {(1, 2)}


def test_in_the_final_calm_commands_are_given_train_by_train() -> None:
    """In seed 278683 one command was overtaken 60 times by others of the same instant."""
    line = ScriptedLine(Plot({1: 100.0, 2: 2300.0, 3: 900.0}, areas=2)).world
    RailwayEvents(line, seed=1).calm()
    given = list[set[int]]()
    for _ in range(3):
        line.net.run(line.net.now_ns + 200_000_000)
        given.append({each.train for each in line.t2t.orders})
        line.t2t.orders = []
        line.net.run(line.net.now_ns + 100_000_000)

    assert given == [{1}, {2}, {3}]


def test_no_train_may_enter_a_closed_stretch(monkeypatch: pytest.MonkeyPatch) -> None:
    line = closed_in_front_of(590.0, monkeypatch)

    line.holds(1, grant(CLOSED.start_m))
    with pytest.raises(ViolationError, match=r"^23: .* over what is closed from 600.0 m on"):
        line.holds(1, grant(CLOSED.start_m + 0.01))


def test_a_stretch_closed_again_counts_from_its_second_closing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """If no train held an authority meanwhile, the check once counted from the first closing
    (simulation seed 211900)."""
    line = closed_in_front_of(590.0, monkeypatch)
    (first,) = line.t2t.closed
    again = replace(CLOSED)

    line.opens(first)
    line.closes(again)

    assert (line.is_closed(first), line.is_closed(again)) == (False, True)
    line.holds(1, grant(CLOSED.start_m + 0.01))
    line.net.run(line.net.now_ns + 3 * AGE_MAX_NS)
    with pytest.raises(ViolationError, match=r"^23: .* over what is closed from 600.0 m on"):
        line.holds(1, grant(CLOSED.start_m + 0.01))


def test_a_train_that_rolls_back_out_of_a_closed_stretch_may_keep_its_last_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = closed_in_front_of(605.0, monkeypatch)
    was_m = line.trains[1].reading().front_max_m
    line.holds(1, grant(was_m))
    line.trains[1].motion.front_m = 590.0

    line.holds(1, grant(was_m))
    with pytest.raises(ViolationError, match=r"^23: "):
        line.holds(1, grant(was_m + 0.01))
    line.net.run(line.net.now_ns + AGE_MAX_NS)
    line.holds(1, grant(was_m))
    line.net.run(line.net.now_ns + 1)
    with pytest.raises(ViolationError, match=r"^23: "):
        line.holds(1, grant(was_m))


def test_a_train_without_authority_that_rolls_back_may_keep_its_last_place_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    line = closed_in_front_of(605.0, monkeypatch)
    train = line.trains[1]
    was_m = train.reading().front_max_m
    dict(RailwayEvents(line, seed=1)._things)["rolls back"]()
    assert train.rolls
    train.motion.front_m = 590.0

    line.holds(1, grant(was_m))
    with pytest.raises(ViolationError, match=r"^23: "):
        line.holds(1, grant(was_m + 0.01))


def test_the_place_of_a_rolling_train_is_recorded_at_each_step() -> None:
    scene = ScriptedLine(Plot({1: 300.0, 2: 900.0}))
    scene.settle()
    scene.world.t2t.closed = (SpeedRestriction(301.0, 400.0, 0.1),)
    scene.run(60.0)
    scene.stands(1)
    scene.world._places[1].clear()

    scene.roll_back(1, 1.0)
    scene.run(0.5)

    noted_m = [front_m for _, front_m in scene.world._places[1]]
    assert len(noted_m) > 3
    assert noted_m == sorted(noted_m, reverse=True)


@pytest.mark.parametrize("rolls_m", [0.5, 3.0])
def test_the_last_authority_of_a_train_inside_an_object_does_not_count_as_an_entry(
    rolls_m: float,
) -> None:
    """The object is unlocked; the front of the train is 2 m inside it and rolls back, out of it
    or not."""
    line = ScriptedLine(Plot({1: 702.0}, objects=True)).world
    train = line.trains[1]

    def holds(end_m: float) -> None:
        line.checker.accepted(1, grant(end_m), 0)
        line.check_objects()

    was_m = train.reading().front_max_m
    holds(was_m)
    train.motion.front_m -= rolls_m
    line.net.run(AGE_MAX_NS)
    holds(was_m)
    line.net.run(AGE_MAX_NS + 1)
    stays_in_it = rolls_m < 2.0
    if stays_in_it:
        # The train keeps the object from moving.
        holds(was_m)

    with pytest.raises(ViolationError, match=r"^23: object 1 at 700.0 m is not locked, and train"):
        holds(was_m + 0.01 if stays_in_it else was_m)


@pytest.mark.parametrize("doom", list(Doom))
def test_an_object_locks_before_it_stores_the_lock(doom: Doom) -> None:
    """Otherwise the object would count as locked after a restart while it is open (seed 210690)."""
    scene = ScriptedLine(Plot({1: 500.0}, objects=True, stops_m=(500.0,), dwell_s=60.0))
    scene.keep_back(lambda source, target, message: isinstance(message, ObjectClaim))
    scene.world.boot_all()
    scene.run(3.0)
    thing = scene.world.track.objects[1]
    assert not thing.locked
    assert scene.held

    scene.no_rules()
    scene.let_go()
    scene.net.nodes[WAYSIDE].doom = doom
    scene.run(0.05)

    assert not scene.net.runs(WAYSIDE)
    assert thing.locked
    thing.release_wanted = True
    scene.net.boot(WAYSIDE)
    scene.run(1.0)


def test_an_acknowledged_authority_already_binds_the_brake() -> None:
    """The brake once followed up to 0.2 s later, although the report already included it (seed
    220394)."""
    scene = ScriptedLine(Plot({1: 200.0, 2: 1800.0}))
    scene.settle()
    train = scene.world.trains[1]
    scene.until("it is fast", lambda: train.motion.speed_mps > 10.0, within_s=60.0)
    brakes: list[bool] = []

    def seen(source: int, target: int, message: object) -> int:
        if isinstance(message, TrainReport) and source == 1 and message.held_end_m < 1000.0:
            brakes.append(train.motion.emergency)
        return 0

    scene.rule(seen)
    scene.order(OrderKind.STOP, 1)
    scene.run(1.0)

    assert brakes
    assert all(brakes)


def test_a_new_jog_replaces_an_unfinished_one() -> None:
    """Jogs once added up, and a train rolled back 14 m (seed 22784)."""
    scene = ScriptedLine(Plot({1: 700.0}))
    scene.settle()
    motion = scene.world.trains[1].motion
    motion.advance(scene.net.now_ns)
    mischief = RailwayEvents(scene.world, seed=1)
    jog = dict(mischief._things)["jog"]

    for _ in range(3):
        jog()
        assert 0.0 < motion.jogged_m == motion.back_m <= scene.world.checker.rules.jog_m


def test_no_train_enters_a_section_with_a_disturbed_counter_until_it_is_checked() -> None:
    scene = ScriptedLine(Plot({1: 300.0}))
    scene.settle()
    track = scene.world.track
    (section,) = [each for each in track.line.sections if each.start_m == 1000.0]
    track.disturbed = frozenset({section.number})

    scene.run(30.0)

    assert (scene.end_m(1) or 0.0) < section.start_m
    assert scene.emergencies() == 0
    track.disturbed = frozenset()
    scene.until("all is clear", lambda: (scene.end_m(1) or 0.0) > section.end_m, within_s=2.0)


@pytest.mark.parametrize("over", [False, True])
def test_a_counter_is_disturbed_for_a_while_or_until_the_final_calm(over: bool) -> None:
    line = world(200.0, 900.0)
    line.drawn = replace(line.drawn, disturbed=True)
    mischief = RailwayEvents(line, seed=1)

    dict(mischief._things)["counter disturbed"]()

    (number,) = line.track.disturbed
    assert number in {each.number for each in line.track.line.sections}
    if over:
        mischief.calm()
    else:
        line.net.run(60_000_000_000)
    assert not line.track.disturbed


def test_a_disturbed_section_joins_the_trains_on_either_side() -> None:
    line = world(200.0, 600.0)
    assert joined(line, 1) == [1]

    line.track.disturbed = frozenset({2})

    assert joined(line, 1) == [1, 2]


@pytest.mark.parametrize("shunts", [False, True])
def test_a_restarted_train_brakes_from_its_first_output_and_ignores_its_former_authority(
    shunts: bool,
) -> None:
    """The brake once waited up to a control cycle, although the report already included its effect.

    An object was released 190 m ahead, within the authority of the former incarnation (seed 60368).
    """
    scene = ScriptedLine(Plot({1: 200.0, 2: 1500.0}))
    scene.settle()
    scene.run(5.0)
    train, checker = scene.world.trains[1], scene.world.checker
    train.shunts = shunts
    assert train.motion.speed_mps > 1.0
    assert checker.held[1]

    scene.net.kill(1)
    assert checker.held[1]
    scene.net.boot(1)

    assert not checker.held.get(1)
    assert train.motion.emergency is not shunts
    assert checker.reach_m(train) == train.motion.farthest_m


@pytest.mark.parametrize("kind", [*OrderKind, None])
def test_without_a_master_only_the_command_back_into_service_is_sent(
    kind: OrderKind | None,
) -> None:
    """The command goes to its train in any area; all other trains would receive it from their
    master."""
    desk, wanted = OrderSource(boot=3), TrainOrder(kind, 2, 7, left=1)
    said = desk.says([wanted], 50)

    goes_out = kind is OrderKind.IN_SERVICE
    assert [(each.destination, each.area, each.term) for each in said] == [(7, 2, 0)] * goes_out
    assert (wanted.left, desk.says([wanted], 60)) == (1 - goes_out, [])


def closed_in_front_of(front_m: float, monkeypatch: pytest.MonkeyPatch) -> LineWorld:
    """A line with the stretch from 600 m to 700 m closed long ago."""
    monkeypatch.setattr(AuthorityChecks, "made_of", lambda *_: None)
    line = world(front_m)
    line.closes(CLOSED)
    line.net.run(10 * AGE_MAX_NS)
    return line


def grant(end_m: float) -> BrakeLoopGrant:
    return BrakeLoopGrant(end_m, term=1, sequence=1, issuer=1, area=1, stamp_ns=0)
