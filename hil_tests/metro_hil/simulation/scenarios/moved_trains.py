"""Scenarios of trains moved by hand or running without radio, and of trains at their old place."""

import math
from collections.abc import Sequence
from typing import Final

from metro_hil.simulation.depot import set_on, take_off
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.scenarios.acceptance import DirectedScenario, Make
from metro_hil.simulation.scripted_line import Plot, ScriptedLine
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import (
    Heartbeat,
    LeaseRequest,
    OrderKind,
    StandbySync,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import RemovalState

FOLLOWS: Final = 1
AHEAD: Final = 2
HIDES: Final = 3


def passed_by_hand(make: Make) -> None:
    """The second of three trains is moved past the first by hand, and the third up to the first.

    The roster still has the second between them. The third must not be let through the first
    because the second is ahead.
    """
    first, second, third, fourth = 1, 2, 3, 4
    fronts_m = {first: 1580.0, second: 1350.0, third: 1100.0, fourth: 3500.0}
    stops_m = (1100.0, 1350.0, 1580.0, 3500.0)
    scene = make(Plot(fronts_m, area_m=4000.0, pieces=10, stops_m=stops_m, dwell_s=200.0))
    scene.world.t2t.closed = (SpeedRestriction(1650.0, 2900.0, 1.0),)
    scene.settle()
    scene.run(3.0)
    for train, front_m in ((second, 2700.0), (third, 1480.0)):
        scene.net.kill(train)
        moved = scene.world.trains[train]
        moved.motion = SimulatedMotion(scene.net.now_ns, front_m, emergency_mps2=1.0)
        scene.world.checker.gave_up(train)
    scene.run(12.0)
    scene.net.boot(second)
    scene.net.boot(third)
    scene.run(5.0)
    rear_m, end_m = scene.world.trains[first].rear_m, scene.end_m(third)
    scene.expect(f"it is not let past: {end_m}", end_m is None or end_m <= rear_m - 7.0)
    scene.world.t2t.closed = ()
    scene.until("all trains have authority", scene.all_held, within_s=60.0)


def came_back_unheard(make: Make) -> None:
    """A train between two others is taken away and set on a bit farther back, without radio.

    The axle counters have moved its assumed position on to the next joint, ahead of where it
    stands.
    """
    away, follows, ahead = 1, 2, 4
    fronts_m = {follows: 500.0, away: 1330.0, ahead: 1590.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=sorted(fronts_m.values()), dwell_s=200.0))
    scene.world.t2t.closed = (SpeedRestriction(900.0, 1100.0, 1.0),)
    scene.settle()
    scene.run(3.0)
    train = scene.world.trains[away]
    _take_off(scene, away)
    scene.run(9.0)
    train.motion = SimulatedMotion(scene.net.now_ns, 1290.0, emergency_mps2=1.0)
    train.on_line = True
    scene.run(1.0)
    scene.world.t2t.closed = ()
    scene.run(3.0)
    end_m = scene.end_m(follows)
    scene.expect(f"it is let no farther than before its section: {end_m}", end_m == 1189.0)
    train.localised = True
    scene.net.boot(away)
    scene.until("all trains have authority", scene.all_held, within_s=60.0)


def _take_off(scene: ScriptedLine, train: int) -> None:
    """Switch the train off, and some time later take it sideways off the line."""
    scene.net.kill(train)
    scene.run(4.0)
    take_off(scene.world, scene.world.trains[train])


def _set_where_it_was(scene: ScriptedLine) -> None:
    """Set the shadow train into the section where the rear of the train ahead was last reported."""
    hides = scene.world.trains[HIDES]
    hides.motion = SimulatedMotion(scene.net.now_ns, 790.0, emergency_mps2=1.0)
    hides.on_line = True
    scene.run(1.0)
    scene.world.t2t.closed = ()


def _stays_before_it(scene: ScriptedLine) -> None:
    scene.run(10.0)
    end_m = scene.end_m(FOLLOWS)
    scene.expect(f"it is let no farther than before that section: {end_m}", end_m == 589.0)
    scene.world.trains[HIDES].localised = True
    for address in (HIDES, AHEAD):
        scene.net.boot(address)
    scene.until("all trains have authority", scene.all_held, within_s=60.0)


def _one_follows(make: Make, stops_m: Sequence[float], *, ahead_m: float = 820.0) -> ScriptedLine:
    fronts_m = {FOLLOWS: 300.0, AHEAD: ahead_m, HIDES: 1900.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=stops_m, dwell_s=200.0))
    hides = scene.world.trains[HIDES]
    hides.on_line = hides.localised = False
    for address in scene.others(HIDES):
        scene.net.boot(address)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    return scene


def kept_long_ago(make: Make) -> None:
    """The train ahead runs on, and both are switched off.

    The next master knows its rear only from the committed roster, and never saw that section clear.
    """
    scene = _one_follows(make, (300.0, 1100.0))
    scene.run(5.0)
    scene.stands(AHEAD)
    for address in (AHEAD, FOLLOWS):
        scene.net.kill(address)
    scene.run(10.0)
    _set_where_it_was(scene)
    scene.net.boot(FOLLOWS)
    scene.until("it commands", lambda: scene.master() == FOLLOWS, within_s=20.0)
    _stays_before_it(scene)


def lost_and_driven_on(make: Make) -> None:
    """The train ahead loses its position and is driven on by hand.

    It communicates but reports no position, so axle counts behind it do not tell where it is.
    """
    scene = _one_follows(make, (300.0, 820.0))
    scene.world.t2t.closed = (SpeedRestriction(600.0, 800.0, 1.0),)
    ahead = scene.world.trains[AHEAD]
    ahead.localised = False
    scene.run(5.0)
    ahead.shunts, ahead.shunts_to_m = True, 1100.0
    scene.until("it is there", lambda: ahead.front_m > 1095.0, within_s=120.0)
    scene.stands(AHEAD)
    ahead.shunts, ahead.shunts_to_m = False, math.inf
    _set_where_it_was(scene)
    scene.run(1.0)
    scene.expect("it is heard", scene.net.runs(AHEAD))
    ahead.localised = True
    _stays_before_it(scene)


def unseen_since(make: Make) -> None:
    """A train is set on behind the train ahead, and track statuses are lost for a while.

    By then the train ahead could have come from where the axles were counted, had it not stood.
    """
    scene = _one_follows(make, (300.0, 910.0), ahead_m=910.0)
    scene.world.t2t.closed = (SpeedRestriction(600.0, 800.0, 1.0),)
    scene.run(6.0)
    _set_where_it_was(scene)
    scene.run(3.0)
    scene.expect(f"it is seen: {scene.end_m(FOLLOWS)}", scene.end_m(FOLLOWS) == 589.0)
    scene.lose(TrackStatus)
    for _ in range(20):
        scene.run(0.1)
        end_m = scene.end_m(FOLLOWS)
        scene.expect(f"it is not forgotten: {end_m}", end_m in (None, 589.0))
    scene.expect("without a track status no train goes", scene.end_m(FOLLOWS) is None)
    scene.no_rules()
    _stays_before_it(scene)


def stood_and_taken_off(make: Make) -> None:
    """A train is taken away from behind another that stands over a joint before a shadow train.

    As many axles remain as the two trains have that reported their positions.
    """
    away, hemmed_in, commands = 1, 2, 4
    fronts_m = {commands: 300.0, away: 1100.0, hemmed_in: 1250.0, HIDES: 1500.0}
    scene = make(Plot(fronts_m, pieces=5, stops_m=sorted(fronts_m.values()), dwell_s=200.0))
    for address in scene.others(HIDES):
        scene.net.boot(address)
    scene.until_without([away, hemmed_in, HIDES], within_s=20.0)
    _take_off(scene, away)
    scene.run(5.0)
    scene.expect("a shadow train stands there", scene.end_m(hemmed_in) is None)
    scene.net.boot(HIDES)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)


def gone_from_behind(make: Make) -> None:
    """A shadow train stands in the last section, and another waits before it.

    The rearmost train is taken off the line and the roster: the axles in that section are not its
    own.
    """
    away, first = 1, 2
    fronts_m = {away: 300.0, first: 1500.0, HIDES: 1970.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=sorted(fronts_m.values()), dwell_s=200.0))
    for address in scene.others(HIDES):
        scene.net.boot(address)
    scene.until_without([HIDES], within_s=20.0)
    _take_off(scene, away)
    scene.run(1.0)
    scene.world.removes(away)
    told = scene.world.t2t.removals
    scene.until("it is off the roster", lambda: RemovalState.GONE in told.values(), within_s=5.0)
    scene.expect(f"it is let no nearer: {scene.end_m(first)}", scene.end_m(first) == 1789.0)


def heard_and_deaf(make: Make) -> None:
    """A train sends but does not receive, and so does not accept what it is granted.

    Track ahead is closed and a shadow train set on there; then the deaf train receives again. The
    old authority does not prove that the counted axles may be its own.
    """
    commands, deaf = 2, 1
    fronts_m = {commands: 200.0, deaf: 500.0, HIDES: 1900.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=(200.0, 500.0), dwell_s=300.0))
    hides = scene.world.trains[HIDES]
    hides.on_line = hides.localised = False
    for address in scene.others(deaf, HIDES):
        scene.net.boot(address)
    scene.until("it commands", lambda: scene.master() == commands, within_s=10.0)
    scene.net.boot(deaf)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    scene.rule(lambda _, target, __: None if target == deaf else 0)
    scene.run(2.0)
    scene.world.t2t.closed = (SpeedRestriction(1580.0, 1800.0, 1.0),)
    scene.run(7.0)
    set_on(scene.world, hides, 1790.0)
    scene.run(1.0)
    scene.world.t2t.closed = ()
    scene.run(2.0)
    scene.no_rules()
    scene.lose(Heartbeat, target=deaf)
    scene.run(1.0)
    scene.expect(f"it gets no more: {scene.end_m(deaf)}", scene.end_m(deaf) is None)
    scene.no_rules()
    scene.until("it receives an authority", lambda: scene.end_m(deaf) is not None, within_s=10.0)
    scene.run(1.0)
    scene.expect(f"it is let no farther: {scene.end_m(deaf)}", scene.end_m(deaf) == 1589.0)
    scene.net.boot(HIDES)
    scene.until("the one ahead has authority", scene.all_held, within_s=20.0)


def seems_to_overtake(make: Make) -> None:
    """The first of three trains dies and is driven on by hand, and the second runs on after it.

    The next master knows the first only from the committed roster, behind the restarted second. The
    second has passed no train and keeps its place, even when it is not received any more.
    """
    third, second, first = 1, 2, 3
    fronts_m = {third: 300.0, second: 560.0, first: 820.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=(560.0, 780.0, 820.0), dwell_s=130.0))
    for address in scene.others(third, first):
        scene.net.boot(address)
    scene.until("one commands", lambda: scene.master() == second, within_s=10.0)
    scene.lose(StandbySync)
    scene.net.boot(first)
    scene.net.boot(third)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    scene.net.kill(first)
    gone = scene.world.trains[first]
    gone.shunts, gone.shunts_to_m = True, 1300.0
    scene.until("it is away", lambda: gone.front_m > 1295.0, within_s=200.0)
    gone.shunts, gone.shunts_to_m = False, math.inf
    scene.until(
        "the second is there", lambda: scene.world.trains[second].front_m > 778.0, within_s=120.0
    )
    scene.stands(second)
    scene.run(1.0)
    rear_m = scene.world.trains[second].rear_m
    end_m = scene.end_m(third)
    scene.expect(f"the third closes up: {end_m}", end_m is not None and end_m > 600.0)
    scene.lose(LeaseRequest, source=second)
    scene.net.kill(second)
    scene.net.boot(second)
    scene.until("the third commands", lambda: scene.master() == third, within_s=10.0)
    scene.run(1.0)
    scene.net.stop(second, 5_000_000_000)
    scene.run(4.0)
    end_m = scene.end_m(third)
    scene.expect(f"it is let no farther: {end_m}", end_m is not None and end_m < rear_m)
    scene.no_rules()
    scene.net.boot(first)
    scene.until("all trains have authority", scene.all_held, within_s=60.0)


def driven_off(make: Make) -> None:
    """The first of two trains is driven off the line by hand, with a shadow train between them.

    As many of its axles have left the last section as the shadow train has.
    """
    fronts_m = {FOLLOWS: 300.0, HIDES: 700.0, AHEAD: 1900.0}
    scene = make(Plot(fronts_m, pieces=2, stops_m=sorted(fronts_m.values()), dwell_s=200.0))
    hides, ahead = scene.world.trains[HIDES], scene.world.trains[AHEAD]
    hides.axles = 4
    for address in scene.others(HIDES):
        scene.net.boot(address)
    scene.run(3.0)
    ahead.shunts = True
    scene.until("it is off the line", lambda: ahead.rear_m > 2020.0, within_s=120.0)
    ahead.shunts = False
    scene.expect("a shadow train stands there", scene.end_m(FOLLOWS) is None)
    take_off(scene.world, ahead)
    scene.net.kill(AHEAD)
    scene.net.boot(HIDES)
    scene.until("all trains have authority", scene.all_held, within_s=60.0)


def set_before_one_that_is_lost(make: Make) -> None:
    """The reports of a shortened authority are lost until their train has lost its position.

    Then another train is set on ahead of it, within its old authority, and track ahead of that one
    is closed.
    """
    scene = _one_follows(make, (300.0, 1900.0), ahead_m=1900.0)
    follows, comes = scene.world.trains[FOLLOWS], scene.world.trains[HIDES]
    follows.next_stop = 1
    scene.until("it is on its way", lambda: follows.motion.speed_mps > 10.0, within_s=60.0)

    def shortened(source: int, target: int, message: object) -> int | None:
        if not isinstance(message, TrainReport) or source != FOLLOWS or not message.localised:
            return 0
        return None if message.held_end_m < 1500.0 else 0

    scene.rule(shortened)
    scene.order(OrderKind.STOP, FOLLOWS)
    scene.until("it brakes", lambda: (scene.end_m(FOLLOWS) or 2000.0) < 1500.0, within_s=5.0)
    follows.localised = False
    scene.stands(FOLLOWS)
    scene.world.t2t.closed = (SpeedRestriction(1200.0, 1400.0, 1.0),)
    scene.run(1.0)
    comes.motion = SimulatedMotion(scene.net.now_ns, 1100.0, emergency_mps2=1.0)
    comes.on_line = comes.localised = True
    scene.net.boot(HIDES)
    scene.until("it is let", lambda: scene.end_m(HIDES) is not None, within_s=20.0)
    scene.run(2.0)
    end_m = scene.end_m(HIDES)
    scene.expect(f"into nothing that is closed: {end_m}", end_m == 1200.0)


def kept_farther_on(make: Make) -> None:
    """A train is taken off the line without a master, set on farther back, restarted and driven on.

    Another comes onto the line behind it into the same section. The roster entry is still at the
    old place. When the first is not received any more, that entry does not prove the section clear.
    """
    comes, away, commands = 1, 2, 4
    fronts_m = {comes: 100.0, away: 380.0, commands: 1500.0}
    scene = make(Plot(fronts_m, pieces=5, stops_m=sorted(fronts_m.values()), dwell_s=200.0))
    behind = scene.world.trains[comes]
    behind.on_line = behind.localised = False
    for address in scene.others(comes):
        scene.net.boot(address)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    scene.world.t2t.closed = (SpeedRestriction(310.0, 700.0, 1.0),)
    scene.net.kill(commands)
    _take_off(scene, away)
    train = scene.world.trains[away]
    train.motion = SimulatedMotion(scene.net.now_ns, 300.0, emergency_mps2=1.0)
    train.on_line, train.localised = True, True
    train.shunts, train.shunts_to_m = True, 370.0
    scene.until("it moves", lambda: train.motion.speed_mps > 1.0, within_s=10.0)
    behind.on_line = behind.localised = True
    scene.net.boot(commands)
    scene.until("it commands", lambda: scene.master() == commands, within_s=5.0)
    for address in (away, comes):
        scene.net.boot(address)
    scene.run(1.0)
    scene.lose(TrainReport, source=away)
    scene.until("it is there", lambda: train.front_m > 365.0, within_s=120.0)
    scene.stands(away)
    train.shunts, train.shunts_to_m = False, math.inf
    end_m = scene.end_m(comes)
    scene.expect(f"the other is not let go: {end_m}", end_m is None)
    scene.no_rules()
    scene.world.t2t.closed = ()
    scene.until("all trains have authority", scene.all_held, within_s=20.0)


MOVED_LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario(
        "driven-off", 0, "a train is driven off the line, and a shadow train stays", driven_off
    ),
    DirectedScenario(
        "set-before-one-that-is-lost",
        0,
        "a train is set on within the old authority of a lost one",
        set_before_one_that_is_lost,
    ),
    DirectedScenario("passed-by-hand", 0, "a train is moved past another by hand", passed_by_hand),
    DirectedScenario(
        "came-back-unheard", 0, "a train returns after counters saw it leave", came_back_unheard
    ),
    DirectedScenario(
        "kept-farther-on", 0, "a roster entry lies ahead of its train", kept_farther_on
    ),
    DirectedScenario(
        "kept-long-ago", 0, "a train is set on where the one ahead once was", kept_long_ago
    ),
    DirectedScenario(
        "lost-and-driven-on", 0, "a train is set on where a lost one was", lost_and_driven_on
    ),
    DirectedScenario(
        "unseen-since", 0, "a train is set on, and track statuses are lost", unseen_since
    ),
    DirectedScenario(
        "stood-and-taken-off",
        0,
        "a train that accounted for axles is taken away",
        stood_and_taken_off,
    ),
    DirectedScenario(
        "gone-from-behind", 0, "a train leaves, and a shadow train stays", gone_from_behind
    ),
    DirectedScenario("heard-and-deaf", 0, "a train is set on ahead of a deaf one", heard_and_deaf),
    DirectedScenario(
        "seems-to-overtake", 0, "a train is ahead of another's roster entry", seems_to_overtake
    ),
)
