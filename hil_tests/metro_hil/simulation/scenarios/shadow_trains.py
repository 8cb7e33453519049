"""Scenarios of shadow trains, and of full lines without any.

A shadow train stands beside a new train, where a third train with as many axles reported itself and
has long run on. That report is old: it was delayed, or its train has lost its position or died
since.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from firmware_py.trackdb.areas import Division
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.scenarios.acceptance import DirectedScenario, Make
from metro_hil.simulation.scripted_line import HeldMessage, Plot, ScriptedLine
from zenoh_config.t2t import RosterCommit, TrainReport

RUNS_ON: Final = 1
NEWCOMER: Final = 2
HIDES: Final = 3
COMMANDS: Final = 4
SAID_M: Final = 830.0
"""Front of the train when it reported, with its middle in the section from 600 m to 800 m."""
AWAY_M: Final = 1000.0
"""Position of its rear after which it has also left the section that follows."""
NEWCOMER_M: Final = 690.0
HIDES_M: Final = 780.0
TOLD_S: Final = 0.5
"""Time within which trains receive axle counts through their master."""


def _on_its_way(make: Make, stops_m: Sequence[float] = (1980.0,)) -> ScriptedLine:
    """Two trains run; two others are not yet on the line and have never communicated."""
    fronts_m = {RUNS_ON: 100.0, NEWCOMER: 300.0, HIDES: 400.0, COMMANDS: 1980.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=stops_m, dwell_s=100.0, speed_max_mps=25.0))
    for address in (NEWCOMER, HIDES):
        train = scene.world.trains[address]
        train.on_line = train.localised = False
    for address in scene.others(RUNS_ON, NEWCOMER, HIDES):
        scene.net.boot(address)
    scene.run(2.0)
    scene.net.boot(RUNS_ON)
    train = scene.world.trains[RUNS_ON]
    scene.until("it is there", lambda: train.front_m > SAID_M - 1.0, within_s=120.0)
    scene.expect("the one ahead commands", scene.master() == COMMANDS)
    return scene


def _set_on(scene: ScriptedLine) -> None:
    """Set both trains on by hand once the running one is away; the shadow train is switched off."""
    train = scene.world.trains[RUNS_ON]
    scene.until("it is away", lambda: train.rear_m > AWAY_M, within_s=60.0)
    for address, front_m in ((NEWCOMER, NEWCOMER_M), (HIDES, HIDES_M)):
        each = scene.world.trains[address]
        each.motion = SimulatedMotion(scene.net.now_ns, front_m, emergency_mps2=1.0)
        each.on_line = each.localised = True
    scene.net.boot(NEWCOMER)
    scene.run(3.0)


def _stays(scene: ScriptedLine) -> None:
    scene.run(20.0)
    scene.expect("the newcomer gets nothing", scene.end_m(NEWCOMER) is None)


def late_report(make: Make) -> None:
    """One report is delayed for long, and those that follow are lost."""
    scene = _on_its_way(make)

    def hold_the_first(source: int, target: int, message: object) -> int | None:
        if source == RUNS_ON and isinstance(message, TrainReport):
            if target == COMMANDS and not scene.held:
                scene.held.append(HeldMessage(source, target, message))
            return None
        return 0

    scene.rule(hold_the_first)
    _set_on(scene)
    scene.let_go()
    _stays(scene)


def lost_on_its_way(make: Make) -> None:
    """The running train has lost its position and reports that ever since."""
    scene = _on_its_way(make)
    scene.world.trains[RUNS_ON].localised = False
    _set_on(scene)
    _stays(scene)


def towed_away(make: Make) -> None:
    """The running train stood there when it died, and was driven on by hand."""
    scene = _on_its_way(make, stops_m=(SAID_M, 1980.0))
    train = scene.world.trains[RUNS_ON]
    scene.stands(RUNS_ON)
    scene.run(1.0)
    scene.net.kill(RUNS_ON)
    train.shunts = True
    scene.until("it is away", lambda: train.rear_m > AWAY_M, within_s=120.0)
    train.shunts = False
    _set_on(scene)
    _stays(scene)


def full_line(make: Make) -> None:
    """All trains start on two areas that are occupied without a gap, and there is no shadow train.

    The area ahead never receives the rearmost train.
    """
    fronts_m = {train: 220.0 * train for train in range(1, 11)}
    scene = make(Plot(fronts_m, areas=2, area_m=1400.0, pieces=4, length_m=160.0))
    scene.settle(within_s=30.0)


def packed_line(make: Make) -> None:
    """A train stands on every joint, so that no clear section separates any two trains.

    The rearmost and the foremost train are received in each other's area only because trains also
    report to neighbouring areas.
    """
    fronts_m = dict(enumerate((205.0, 408.0, 658.0, 859.0, 1076.0, 1310.0, 1556.0), start=1))
    line = Division("packed", (0.0, 760.0, 1660.0), 400.0, 400.0, ()).area_map()
    scene = make(Plot(fronts_m, line=line, length_m=160.0))
    scene.settle(within_s=40.0)


def hangs_over(make: Make) -> None:
    """A train that never communicated leaves the line by hand, and its overhang remains.

    The last section is clear although the train stands over it, and no counter lies beyond.
    """
    line_m = 2000.0
    scene = make(Plot({RUNS_ON: 600.0, HIDES: 1700.0}, area_m=line_m, pieces=10))
    hides = scene.world.trains[HIDES]
    for address in scene.others(HIDES):
        scene.net.boot(address)
    scene.run(10.0)
    first_m = scene.end_m(RUNS_ON)
    scene.expect("its axles keep the other away", first_m is not None and first_m < hides.rear_m)
    hides.shunts = True
    scene.until("its last axle is off", lambda: hides.rear_m > line_m - 1.99, within_s=120.0)
    hides.shunts = False
    hides.motion = SimulatedMotion(scene.net.now_ns, hides.front_m, emergency_mps2=1.0)
    scene.run(20.0)
    scene.expect("it still hangs over the line", hides.rear_m < line_m)
    scene.expect("the other comes no nearer", scene.end_m(RUNS_ON) == line_m - 11.0)


def came_back_behind(make: Make) -> None:
    """The first of three trains leaves the line without radio and restarts behind the third.

    The second is dead. The restarted train stands near a shadow train. That it comes no farther
    proves nothing about others, and so no object may be released that the third may run over.
    """
    line_m, platform_m, platform = 4000.0, 2800.0, 2
    fronts_m = {1: 2400.0, 2: line_m - 120.0, 3: line_m - 30.0, 4: 290.0}
    stops_m = sorted(fronts_m.values())
    scene = make(Plot(fronts_m, area_m=line_m, objects=True, stops_m=stops_m, dwell_s=200.0))
    for address in scene.others(4):
        scene.net.boot(address)
    scene.until_without([4], within_s=20.0)
    third, first = scene.world.trains[1], scene.world.trains[3]
    for address in (2, 3):
        scene.net.kill(address)
    first.shunts = True
    scene.until("it is off the line", lambda: first.rear_m > line_m + 20.0, within_s=120.0)
    first.shunts = False
    first.motion = SimulatedMotion(scene.net.now_ns, 390.0, emergency_mps2=1.0)
    scene.net.boot(3)
    scene.run(3.0)
    end_m = scene.end_m(1)
    scene.expect(f"the third may pass: {end_m}", end_m is not None and end_m > platform_m + 300.0)
    thing = scene.world.track.objects[platform]
    thing.release_wanted = True
    scene.until("it is let go", lambda: not thing.locked, within_s=10.0)
    end_m = scene.end_m(1)
    scene.expect(f"the third stops: {end_m}", end_m is not None and end_m <= platform_m)
    scene.expect("no emergency brake", third.emergencies == 0)


def forgotten_newcomer(make: Make) -> None:
    """A reporting train hangs over into the section behind its own, and is on no committed roster.

    The next master has not received it. The former master let no train into that section, so the
    next one still sees that a train must be there.
    """
    section_m, rear_m = 200.0, 1560.0
    scene = make(Plot({1: 500.0, 2: rear_m + 80.0}, area_m=4000.0, pieces=20, stops_m=(500.0,)))
    for address in scene.others(2):
        scene.net.boot(address)
    scene.until_without([2], within_s=20.0)
    scene.lose(RosterCommit)
    scene.net.boot(2)
    scene.until(
        "it receives its admission",
        lambda: scene.world.t2t.said["Admission COMMITTING"] > 0,
        within_s=5.0,
    )
    scene.run(1.0)
    term, end_m = scene.term(1), scene.end_m(1)
    scene.expect(f"the other comes no nearer: {end_m}", end_m == 7 * section_m - 11.0)
    scene.no_rules()
    scene.lose(TrainReport, source=2)
    pairs = scene.both_ways([1], list(scene.arbiters))
    scene.net.cut(pairs)
    scene.run(0.5)
    scene.net.heal(pairs)
    scene.until("it commands again", lambda: scene.term(1) > term, within_s=5.0)
    scene.run(3.0)
    scene.no_rules()
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    end_m = scene.end_m(1)
    scene.expect(f"the other follows: {end_m}", end_m is not None and end_m > 7 * section_m)


def _set_before(scene: ScriptedLine, front_m: float, ends_m: float) -> None:
    """Set the shadow train by hand into sections that the running train was granted long ago."""
    runs, hides = scene.world.trains[RUNS_ON], scene.world.trains[HIDES]
    end_m = scene.end_m(RUNS_ON)
    scene.expect(f"it was let past there: {end_m}", end_m is not None and end_m > front_m)
    hides.motion = SimulatedMotion(scene.net.now_ns, front_m, emergency_mps2=1.0)
    hides.on_line = True
    # Invariants 21 and 22 cannot hold until the master has received the axle counts.
    judge = scene.world.checker
    rules, judge.rules = judge.rules, replace(judge.rules, unjudged=frozenset({"21", "22"}))
    scene.run(TOLD_S)
    judge.rules = rules
    scene.expect(f"it is let no nearer: {scene.end_m(RUNS_ON)}", scene.end_m(RUNS_ON) == ends_m)
    scene.stands(RUNS_ON)
    scene.expect(f"it stops in time: {runs.front_m}", ends_m - 60.0 < runs.front_m < ends_m)
    scene.expect("the service brake is enough", runs.emergencies == 0)


def set_between(make: Make) -> None:
    """Set the shadow train between two running trains that are commanded all the time."""
    scene = _on_its_way(make)
    _set_before(scene, 1590.0, 1389.0)


def set_before_all(make: Make) -> None:
    """Set the shadow train ahead of the foremost train."""
    fronts_m = {COMMANDS: 100.0, RUNS_ON: 300.0, HIDES: 400.0}
    scene = make(Plot(fronts_m, pieces=10, stops_m=(100.0,), dwell_s=200.0, speed_max_mps=25.0))
    train = scene.world.trains[HIDES]
    train.on_line = train.localised = False
    for address in scene.others(RUNS_ON, HIDES):
        scene.net.boot(address)
    scene.run(2.0)
    scene.net.boot(RUNS_ON)
    running = scene.world.trains[RUNS_ON]
    scene.until("it is on its way", lambda: running.front_m > SAID_M, within_s=120.0)
    _set_before(scene, 1590.0, 1389.0)


HIDDEN_LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario("late-report", 0, "a report arrives when its train is elsewhere", late_report),
    DirectedScenario(
        "lost-on-its-way", 0, "a train runs on after it lost its position", lost_on_its_way
    ),
    DirectedScenario("towed-away", 0, "a train that stood is driven on by hand", towed_away),
    DirectedScenario("hangs-over", 0, "a shadow train leaves the line at its end", hangs_over),
    DirectedScenario(
        "came-back-behind", 0, "a train left and came back behind others", came_back_behind
    ),
    DirectedScenario(
        "forgotten-newcomer", 0, "a train ahead is on no committed roster", forgotten_newcomer
    ),
    DirectedScenario("set-between", 0, "a train is set on between two running ones", set_between),
    DirectedScenario(
        "set-before-all", 0, "a train is set on ahead of the first one", set_before_all
    ),
    DirectedScenario("packed-line", 0, "trains stand on every joint, and all start", packed_line),
    DirectedScenario("full-line", 0, "trains stand everywhere, and all start", full_line),
)
