"""Scenarios of trains with their front in one area and their rear in another."""

from collections.abc import Callable, Sequence
from typing import Final

from firmware_py.trackdb.areas import Area, AreaMap, ObjectKind, ObjectSite, TrackSection
from metro_hil.simulation.depot import set_on, take_off
from metro_hil.simulation.scenarios.acceptance import DirectedScenario, Make
from metro_hil.simulation.scripted_line import NS_PER_S, Plot, ScriptedLine
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import ObjectClaim, OrderKind

BORDER_M: Final = 2000.0
SWITCH: Final = 1
SECTION_M: Final = 250.0
SWITCH_M: Final = 30.0
BEHIND: Final = 1
OVER: Final = 2
AHEAD: Final = 3
OVER_M: Final = BORDER_M + 30.0
"""Front of the train in both areas. It is 80 m long, so its rear is on the switch, which ends 20 m
before the border."""
ROLLS_M: Final = 2.0


def _line(switch_ends_m: float) -> AreaMap:
    return AreaMap(
        "two areas and a switch in the first",
        (Area(1, 0.0, BORDER_M), Area(2, BORDER_M, 2.0 * BORDER_M)),
        tuple([TrackSection(n, n * SECTION_M, (n + 1) * SECTION_M) for n in range(16)]),
        (ObjectSite(SWITCH, ObjectKind.SWITCH, switch_ends_m - SWITCH_M, switch_ends_m),),
    )


def _on_a_free_switch(
    make: Make, front_m: float, switch_ends_m: float, stops_m: Sequence[float] = ()
) -> ScriptedLine:
    """Start all nodes with the switch unlocked; it stays unlocked because claims of it are lost."""
    fronts_m = {BEHIND: 1000.0, OVER: front_m, AHEAD: 3000.0}
    line = _line(switch_ends_m)
    scene = make(Plot(fronts_m, line=line, stops_m=stops_m, dwell_s=100.0))
    scene.world.track.objects[SWITCH].locked = False
    scene.lose(ObjectClaim)
    scene.world.boot_all()
    return scene


def over_a_free_switch(make: Make) -> None:
    """A train starts on an unlocked switch, of which the area of its front knows nothing."""
    scene = _on_a_free_switch(make, OVER_M, BORDER_M - 20.0)
    scene.run(10.0)
    for area in (1, 2):
        scene.expect(f"a train commands area {area}", scene.master(area) is not None)
    scene.expect("the one ahead goes on", AHEAD not in scene.without())
    scene.expect("it stays where it is", scene.world.trains[OVER].motion.speed_mps == 0.0)
    scene.no_rules()
    scene.until("all trains have authority", scene.all_held, within_s=10.0)


def back_onto_a_free_switch(make: Make) -> None:
    """A train starts just beyond the switch, with or without a border between, and rolls back."""
    for switch_ends_m in (1750.0, BORDER_M):
        front_m = switch_ends_m + 80.0 + 0.95 * ROLLS_M
        scene = _on_a_free_switch(make, front_m, switch_ends_m, stops_m=(front_m,))
        over = scene.world.trains[OVER]
        scene.expect("it is surely beyond", over.reading().rear_min_m > switch_ends_m)
        scene.run(3.0)
        scene.roll_back(OVER, ROLLS_M)
        scene.run(10.0)
        scene.expect("it is beyond no longer", over.rear_m < switch_ends_m)
        scene.no_rules()
        scene.until("all trains have authority", scene.all_held, within_s=10.0)


def master_left_behind(make: Make) -> None:
    """The master of the rear's area is lost during a border crossing: the train runs on."""
    losses: tuple[Callable[[ScriptedLine], object], ...] = (
        lambda scene: scene.net.kill(BEHIND),
        lambda scene: scene.net.stop(BEHIND, 20 * NS_PER_S),
        lambda scene: scene.cut_off(BEHIND),
    )
    for lose in losses:
        _goes_on(make, lose)


def _goes_on(make: Make, lose: Callable[[ScriptedLine], object]) -> None:
    scene = make(Plot({BEHIND: 1450.0, OVER: 1700.0}, line=_line(BORDER_M - 20.0)))
    scene.settle()
    scene.until("there is a standby", lambda: scene.standby() is not None, within_s=5.0)
    if scene.master() == OVER:
        scene.order(OrderKind.SWITCH_MASTER, BEHIND)
    over = scene.world.trains[OVER]
    scene.until("its front is over", lambda: over.front_m > BORDER_M + 10.0, within_s=120.0)
    scene.expect("the one behind commands", scene.master() == BEHIND)
    lose(scene)
    while over.rear_m < BORDER_M + 20.0:
        scene.run(0.1)
        mps = over.motion.speed_mps
        scene.expect(f"it keeps its speed: {mps:.1f} m/s", mps > 16.0)
    scene.expect("no emergency brake", over.emergencies == 0)


def hangs_over_the_border(make: Make) -> None:
    """A shadow train hangs over a border, which only the next area can know.

    Track is closed from just before the border on, so that the area before lets no train come near.
    """
    hides_m = BORDER_M + 78.0
    scene = make(Plot({BEHIND: 1000.0, OVER: hides_m, AHEAD: 3000.0}, line=_line(1000.0)))
    closed = SpeedRestriction(BORDER_M - 0.5, BORDER_M + 40.0, 1.0)
    scene.world.t2t.closed = (closed,)
    for address in scene.others(OVER):
        scene.net.boot(address)
    runs = scene.world.trains[BEHIND]
    scene.until("it is on its way", lambda: runs.front_m > 1500.0, within_s=60.0)
    scene.expect("the train ahead commands there", scene.master(2) == AHEAD)
    scene.stands(BEHIND)
    scene.expect(f"it comes no nearer: {runs.front_m}", runs.front_m < BORDER_M - 11.0)


def gone_before_the_border(make: Make) -> None:
    """A train that stood before the border is taken off the line and set on again behind another.

    The next area receives no axle counts from places far before its border. It must not wait for
    the old roster entry.
    """
    fronts_m = {BEHIND: 1500.0, OVER: 1780.0, AHEAD: 3000.0}
    scene = make(Plot(fronts_m, line=_line(1000.0), stops_m=(1500.0, 1780.0, 3000.0), dwell_s=90.0))
    scene.settle()
    scene.run(3.0)
    scene.net.kill(OVER)
    scene.run(4.0)
    away = scene.world.trains[OVER]
    take_off(scene.world, away)
    scene.run(12.0)
    set_on(scene.world, away, 1300.0)
    scene.net.boot(OVER)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    scene.until(
        "the other gets over the border",
        lambda: (scene.end_m(BEHIND) or 0.0) > BORDER_M,
        within_s=5.0,
    )


def moved_over_the_border(make: Make) -> None:
    """A train is moved past a shadow train and over the border by hand, and restarts there.

    The restart takes it off the roster of its former area. Its last section there still holds the
    shadow train, which that area must not take for the moved one.
    """
    fronts_m = {BEHIND: 300.0, OVER: 1500.0, AHEAD: 3900.0}
    scene = make(Plot(fronts_m, areas=2, pieces=10, stops_m=(300.0, 1500.0), dwell_s=200.0))
    moved, hides = scene.world.trains[OVER], scene.world.trains[AHEAD]
    hides.on_line = hides.localised = False
    for address in scene.others(AHEAD):
        scene.net.boot(address)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    scene.world.t2t.closed = (SpeedRestriction(1780.0, 2400.0, 1.0),)
    scene.run(6.0)
    set_on(scene.world, hides, 1950.0)
    scene.net.kill(OVER)
    scene.run(4.0)
    take_off(scene.world, moved)
    scene.run(12.0)
    set_on(scene.world, moved, 2150.0)
    scene.world.t2t.closed = ()
    scene.run(2.0)
    scene.expect(
        f"the shadow train's axles are seen: {scene.end_m(BEHIND)}", scene.end_m(BEHIND) == 1789.0
    )
    scene.net.boot(OVER)
    scene.until("the moved train restarts", lambda: scene.end_m(OVER) is not None, within_s=5.0)
    scene.run(1.0)
    scene.expect(
        f"the shadow train is not forgotten: {scene.end_m(BEHIND)}", scene.end_m(BEHIND) == 1789.0
    )
    scene.net.boot(AHEAD)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)


BORDER_LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario(
        "gone-before-the-border",
        0,
        "a train that stood before the border is taken away",
        gone_before_the_border,
    ),
    DirectedScenario("over-a-free-switch", 0, "a train starts in two areas", over_a_free_switch),
    DirectedScenario(
        "back-onto-a-switch", 0, "a train just beyond rolls back", back_onto_a_free_switch
    ),
    DirectedScenario(
        "hangs-over-the-border", 0, "a shadow train stands just beyond", hangs_over_the_border
    ),
    DirectedScenario(
        "moved-over-the-border",
        0,
        "a train is moved over the border by hand",
        moved_over_the_border,
    ),
    DirectedScenario(
        "master-left-behind", 0, "the master of the rear's area is lost", master_left_behind
    ),
)
