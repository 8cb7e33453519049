"""Acceptance scenarios of train-to-train control, as scripts for the simulated line.

They run the same state machines and the same checks as random seeds, and add expectations that only
a script can have. They also show that a check fails when a guard is removed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from metro_hil.simulation.links import Weather
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.scripted_line import NS_PER_MS, NS_PER_S, Plot, ScriptedLine
from vobc.train_to_train.vocabulary import Role
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import LeaseAnswer, OrderKind, SwitchKind, SwitchStep

Make = Callable[[Plot], ScriptedLine]
FAILOVER_S: Final = 0.45
"""Maximum time from the end of a master until every follower has an authority of the new term;
timers A."""
AGE_S: Final = 0.4
"""Maximum age of any authority during a planned switch."""
REPORTED_S: Final = 2.0
"""Time after which the master has long known that a train moves."""


@dataclass(frozen=True, slots=True)
class DirectedScenario:
    """A named scenario; `number` is that of the acceptance scenario, 0 for one of our own."""

    name: str
    number: int
    words: str
    play: Callable[[Make], None]


def convoy(trains: int, *, first_m: float = 300.0, gap_m: float = 400.0) -> dict[int, float]:
    """Return the fronts of trains one behind the other; the foremost has the highest number."""
    return {n + 1: first_m + gap_m * n for n in range(trains)}


def two_candidates(make: Make) -> None:
    for late_ms in (0, 1, 2, 5):
        for arbiters in (1, 3):
            scene = make(Plot(convoy(2), arbiters=arbiters, seed=10 + late_ms))
            for address in scene.others(1, 2):
                scene.net.boot(address)
            scene.run(1.0)
            scene.net.boot(1)
            scene.run(late_ms / 1000.0)
            scene.net.boot(2)
            scene.until("both have authority", scene.all_held, within_s=10.0)
            roles = [scene.role(train) for train in (1, 2)]
            scene.expect(f"one master: {roles}", roles.count(Role.MASTER) == 1)


def at_speed(
    make: Make, *, trains: int = 5, from_rest: bool = False, **more: Any
) -> tuple[ScriptedLine, int]:
    """Return a convoy at full speed in one long area, and its master.

    Args:
        from_rest: the trains accelerate themselves; by default they are set in motion at once.
    """
    plot = Plot(convoy(trains), area_m=8000.0, **more)
    scene = make(plot)
    scene.settle()
    if not from_rest:
        scene.until("all move", lambda: _slowest_mps(scene) > 0.0, within_s=5.0)
        for train in scene.world.trains.values():
            train.motion.speed_mps = plot.speed_max_mps
        scene.run(REPORTED_S)
    scene.until("all run at full speed", lambda: _slowest_mps(scene) > 16.0, within_s=120.0)
    scene.until("there is a standby", lambda: scene.standby() is not None, within_s=5.0)
    master = scene.master()
    assert master is not None
    return scene, master


def _slowest_mps(scene: ScriptedLine) -> float:
    return min(train.motion.speed_mps for train in scene.world.trains.values())


def _new_term(scene: ScriptedLine, gone: int, old: int) -> Callable[[], bool]:
    followers = [train for train in scene.world.trains if train != gone]
    return lambda: all(scene.held_term(train) > old for train in followers)


def _no_emergency(scene: ScriptedLine, *but: int) -> None:
    braked = [
        train.address
        for train in scene.world.trains.values()
        if train.emergencies and train.address not in but
    ]
    scene.expect(f"no emergency brake: {braked}", not braked)


def master_killed(make: Make) -> None:
    scene, master = at_speed(make, from_rest=True)
    old = scene.held_term(master)
    scene.net.kill(master)
    took_s = scene.until("the followers obey a new term", _new_term(scene, master, old), within_s=5)
    scene.expect(f"within {FAILOVER_S} s: {took_s:.3f}", took_s <= FAILOVER_S)
    scene.run(10.0)
    _no_emergency(scene, master)
    terms = {scene.held_term(train) for train in scene.world.trains if train != master}
    scene.expect(f"one new term: {old}, {terms}", len(terms) == 1 and min(terms) > old)


def master_isolated(make: Make) -> None:
    for keeps in (False, True):
        scene, master = at_speed(make, trains=4)
        old = scene.held_term(master)
        pairs = scene.cut_off(master, keeps=keeps)
        scene.until("the followers obey a new term", _new_term(scene, master, old), within_s=5.0)
        scene.run(10.0)
        scene.expect("the former master commands no more", scene.role(master) is not Role.MASTER)
        scene.net.heal(pairs)
        scene.run(3.0)
        _no_emergency(scene, master)
        scene.until("all have authority", scene.all_held, within_s=30.0)


def master_stopped(make: Make) -> None:
    scene, master = at_speed(make, trains=4)
    old = scene.held_term(master)
    scene.net.stop(master, 5 * NS_PER_S)
    scene.until("the followers obey a new term", _new_term(scene, master, old), within_s=5.0)
    scene.run(10.0)
    _no_emergency(scene, master)
    scene.until("all have authority", scene.all_held, within_s=30.0)


def master_stopped_before_sending(make: Make) -> None:
    """The master is stopped after it checked its lease and before it sends."""
    for for_ms in (250, 950, 4000):
        scene, master = at_speed(make, trains=3, seed=for_ms)
        scene.net.nodes[master].freeze_ns = for_ms * NS_PER_MS
        scene.run(8.0)
        _no_emergency(scene, master)
        scene.until("all have authority", scene.all_held, within_s=30.0)


def worst_age_s(scene: ScriptedLine, seconds: float) -> float:
    """Return the oldest age of any train's authority during this time."""
    worst_ns, end_ns = 0, scene.net.now_ns + int(seconds * NS_PER_S)
    while scene.net.now_ns < end_ns:
        scene.run(0.01)
        for address, driver in scene.world.drivers.items():
            grants, _ = driver.in_force(scene.net.now_ns)
            local_ns = scene.net.nodes[address].clock.local_ns(scene.net.now_ns)
            scene.expect(f"train {address} has authority", bool(grants))
            worst_ns = max([worst_ns, *[local_ns - grant.stamp_ns for grant in grants]])
    return worst_ns / NS_PER_S


def planned_switch(make: Make) -> None:
    scene, master = at_speed(make, trains=4)
    successor = next(train for train in scene.world.trains if train != master)
    scene.order(OrderKind.SWITCH_MASTER, successor)
    oldest_s = worst_age_s(scene, 4.0)
    scene.expect(f"{successor} commands", scene.master() == successor)
    scene.expect(f"no authority got old: {oldest_s:.3f} s", oldest_s <= AGE_S)
    _no_emergency(scene)


def planned_switch_disturbed(make: Make) -> None:
    """One step or a fifth of all messages is lost: the switch completes or has no effect."""
    for lost in (SwitchKind.READY, SwitchKind.COMMIT, SwitchKind.PREPARE, None):
        scene, master = at_speed(make, trains=4, seed=3)
        successor = next(train for train in scene.world.trains if train != master)
        if lost is None:
            scene.net.weather(scene.net.links(), Weather(loss_share=0.2))
        else:
            scene.rule(_loses(lost))
        scene.order(OrderKind.SWITCH_MASTER, successor)
        scene.run(4.0)
        scene.commanded(within_s=2.0)
        scene.no_rules()
        scene.run(4.0)
        _no_emergency(scene)


def _loses(kind: SwitchKind) -> Callable[[int, int, Any], int | None]:
    return lambda a, b, m: None if isinstance(m, SwitchStep) and m.kind is kind else 0


BORDER: Final = {1: 1500.0, 2: 2700.0}
BORDER_M: Final = 2000.0


def hand_over(make: Make) -> None:
    scene = make(Plot(BORDER, areas=2, area_m=BORDER_M, stops_m=(3900.0,)))
    scene.settle()
    front = scene.world.trains[1]
    slowest_mps = 100.0
    scene.until("it nears the border", lambda: front.front_m > BORDER_M - 150.0, within_s=120.0)
    while front.rear_m < BORDER_M + 20.0:
        scene.run(0.1)
        slowest_mps = min(slowest_mps, front.motion.speed_mps)
        scene.expect("it gets over the border", scene.now_s < 200.0)
    scene.expect(f"it keeps its speed: {slowest_mps:.1f} m/s", slowest_mps > 16.0)
    _no_emergency(scene)


def _stands_before_the_border(scene: ScriptedLine) -> None:
    """Let train 1 run up to the border, and wait whether it stays there."""
    train = scene.world.trains[1]
    scene.until("it moves", lambda: train.motion.speed_mps > 0.0, within_s=20.0)
    scene.stands(1)
    scene.run(10.0)
    scene.expect(
        f"it stands before the border: {train.front_m:.1f} m",
        BORDER_M - 30.0 < train.front_m <= BORDER_M and train.motion.speed_mps == 0.0,
    )


def _beyond(motion: SimulatedMotion, place_m: float) -> Callable[[], bool]:
    return lambda: motion.front_m > place_m


def hand_over_silent(make: Make) -> None:
    """No train commands the area behind the border: the train stops before it."""
    scene = make(Plot(BORDER, areas=2, area_m=BORDER_M))
    for address in scene.others(2):
        scene.net.boot(address)
    scene.rule(lambda a, b, m: None if isinstance(m, LeaseAnswer) and m.area == 2 else 0)
    scene.until("train 1 has authority", lambda: scene.end_m(1) is not None, within_s=20.0)
    _stands_before_the_border(scene)
    _no_emergency(scene)


def hand_over_refused(make: Make) -> None:
    """The first metres behind the border are closed; the train goes on when they are opened."""
    scene = make(Plot(BORDER, areas=2, area_m=BORDER_M))
    scene.world.t2t.closed = (SpeedRestriction(BORDER_M, BORDER_M + 100.0, 1.0),)
    scene.settle()
    _stands_before_the_border(scene)
    scene.world.t2t.closed = ()
    motion = scene.world.trains[1].motion
    scene.until("it went on", _beyond(motion, BORDER_M + 100.0), within_s=60.0)
    _no_emergency(scene)


def leader_rolls_back(make: Make) -> None:
    for way_m in (2.0,):
        scene, _ = at_speed(make, trains=2)
        scene.world.trains[2].motion.apply_emergency(scene.net.now_ns)
        scene.stands(2)
        scene.roll_back(2, way_m)
        scene.run(60.0)


def radio_lost(make: Make) -> None:
    for train in (1, 2):
        scene, _ = at_speed(make, trains=3, seed=train)
        pairs = scene.cut_off(train)
        scene.run(25.0)
        scene.expect("it stands", scene.world.trains[train].motion.speed_mps == 0.0)
        scene.net.heal(pairs)
        scene.until("all have authority again", scene.all_held, within_s=20.0)
        motion = scene.world.trains[train].motion
        goal_m = motion.front_m + 50.0
        scene.until("it runs again", _beyond(motion, goal_m), within_s=30.0)


def hidden_train(make: Make) -> None:
    """A train whose process never starts stands among the others: no train may be sent into it."""
    fronts_m = {1: 172.6, 2: 579.3, 3: 803.6, 4: 1137.9, 5: 1330.5, 6: 1619.1}
    for hidden in (2, 4):
        scene = make(Plot(fronts_m, seed=hidden))
        for address in reversed(scene.others(hidden)):
            scene.net.boot(address)
            scene.run(0.4)
        scene.run(15.0)
        scene.expect("a train commands", scene.master() is not None)


def hidden_beyond_a_border(make: Make) -> None:
    """A shadow train hangs over a border and rolls back; all its axles are counted behind it."""
    for commanded in (True, False):
        _draw_up_to_a_border(make, commanded=commanded)


def _draw_up_to_a_border(make: Make, *, commanded: bool) -> None:
    """`commanded`: a train holds the lease of the area behind the border."""
    scene = make(Plot({1: 1400.0, 2: BORDER_M + 79.0}, areas=2, area_m=BORDER_M))
    if not commanded:
        scene.rule(lambda a, b, m: None if isinstance(m, LeaseAnswer) and m.area == 2 else 0)
    for address in scene.others(2):
        scene.net.boot(address)
    scene.until("train 1 has authority", lambda: scene.end_m(1) is not None, within_s=20.0)
    _stands_before_the_border(scene)
    scene.roll_back(2, 2.0)
    scene.run(10.0)


def close_at_a_border(make: Make) -> None:
    """Two trains start on either side of a border, with no clear section between them."""
    scene = make(Plot({1: 1782.0, 2: 2318.0}, areas=2, area_m=BORDER_M))
    scene.settle(within_s=10.0)


SCENARIOS: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario(
        "two-candidates", 17, "two candidates within 5 ms in an empty area", two_candidates
    ),
    DirectedScenario("master-killed", 18, "the master dies at full speed", master_killed),
    DirectedScenario("master-isolated", 19, "the master is cut off for 10 s", master_isolated),
    DirectedScenario("master-stopped", 20, "the master is stopped for 5 s", master_stopped),
    DirectedScenario(
        "stopped-before-sending",
        20,
        "the master is stopped between deciding and sending",
        master_stopped_before_sending,
    ),
    DirectedScenario("planned-switch", 21, "supervision moves the command", planned_switch),
    DirectedScenario("switch-disturbed", 21, "steps of it are lost", planned_switch_disturbed),
    DirectedScenario("hand-over", 22, "from one area to the next at speed", hand_over),
    DirectedScenario(
        "hand-over-silent", 22, "no train commands behind the border", hand_over_silent
    ),
    DirectedScenario(
        "hand-over-refused", 22, "the stretch behind the border is closed", hand_over_refused
    ),
    DirectedScenario(
        "leader-rolls-back", 23, "the train ahead stops and rolls back", leader_rolls_back
    ),
    DirectedScenario(
        "close-at-a-border", 0, "trains stand on either side of a border", close_at_a_border
    ),
    DirectedScenario("hidden-train", 0, "a shadow train stands among others", hidden_train),
    DirectedScenario(
        "hidden-beyond-a-border",
        0,
        "a shadow train hangs over a border",
        hidden_beyond_a_border,
    ),
    DirectedScenario("radio-lost", 25, "a train is cut off and comes back", radio_lost),
)
