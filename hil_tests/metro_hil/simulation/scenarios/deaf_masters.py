"""Scenarios of a master that sends but receives nothing, or not from all that it needs."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from metro_hil.simulation.scenarios.acceptance import FAILOVER_S, DirectedScenario, Make, at_speed
from metro_hil.simulation.scripted_line import NS_PER_MS, ScriptedLine
from vobc.train_to_train.vocabulary import Role
from zenoh_config.t2t import (
    LeaseAnswer,
    LeaseKind,
    LeaseRequest,
    OrderKind,
    SwitchKind,
    SwitchStep,
)


def _deafen(
    scene: ScriptedLine, master: int, to: Sequence[int] | None = None
) -> list[tuple[int, int]]:
    """Cut the links to the master (from these nodes); what it sends still arrives."""
    pairs = [(each, master) for each in (to or scene.others(master))]
    scene.net.cut(pairs)
    return pairs


def _taken_over(
    scene: ScriptedLine, master: int, old: int, *, within_s: float = FAILOVER_S
) -> None:
    followers = [train for train in scene.world.trains if train != master]
    took_s = scene.until(
        "the followers obey a new term",
        lambda: all(scene.held_term(train) > old for train in followers),
        within_s=5.0,
    )
    scene.expect(f"within {within_s} s: {took_s:.3f}", took_s <= within_s)
    scene.run(5.0)
    braked = [each.address for each in scene.world.trains.values() if each.emergencies]
    scene.expect(f"no other brakes: {braked}", set(braked) <= {master})


def deaf_master(make: Make) -> None:
    """The master receives nothing from all others, or from its arbiters: it resigns by itself."""
    for arbiters in (1, 3):
        for to_all in (True, False):
            scene, master = at_speed(make, trains=4, arbiters=arbiters, seed=arbiters)
            old = scene.held_term(master)
            pairs = _deafen(scene, master, None if to_all else scene.arbiters)
            _taken_over(scene, master, old)
            scene.net.heal(pairs)
            scene.until("all have authority", scene.all_held, within_s=30.0)


def deaf_to_trains(make: Make) -> None:
    """The master keeps its lease and sends heartbeats, but receives no train and so serves none."""
    scene, master = at_speed(make, trains=4)
    old = scene.held_term(master)
    pairs = _deafen(scene, master, [each for each in scene.world.trains if each != master])
    _taken_over(scene, master, old, within_s=2 * FAILOVER_S)
    scene.expect("it commands no more", scene.role(master) is not Role.MASTER)
    scene.net.heal(pairs)
    scene.until("all have authority", scene.all_held, within_s=30.0)


def deaf_then_mute(make: Make) -> None:
    """The deaf master cannot resign any more: its lease ends at the arbiters at the same time."""
    for heard_s in (0.05, 0.1, 0.15):
        scene, master = at_speed(make, trains=4, seed=int(heard_s * 1000.0))
        old = scene.held_term(master)
        scene.lose(SwitchStep, source=master)
        scene.rule(_keeps_its_lease(master))
        pairs = _deafen(scene, master)
        scene.run(heard_s)
        muted = [(master, each) for each in scene.others(master, *scene.arbiters)]
        scene.net.cut(muted)
        _taken_over(scene, master, old, within_s=FAILOVER_S - heard_s)
        scene.no_rules()
        scene.net.heal(muted + pairs)
        scene.until("all have authority", scene.all_held, within_s=30.0)


def _keeps_its_lease(master: int) -> Callable[[int, int, Any], int | None]:
    """Return a rule that loses the requests with which the master gives its lease back."""

    def rule(source: int, target: int, message: Any) -> int | None:
        gives_back = isinstance(message, LeaseRequest) and message.kind is LeaseKind.RELEASE
        return None if source == master and gives_back else 0

    return rule


def shortened_lease(make: Make) -> None:
    """Answers are lost for a while; then one arrives for a request of less than a whole lease."""
    scene, master = at_speed(make, trains=3)
    arbiter = scene.arbiters[0]
    asked: dict[int, int] = {}

    def rule(source: int, target: int, message: Any) -> int | None:
        if source == master and isinstance(message, LeaseRequest):
            asked[message.nonce] = message.less_ns
        answers = target == master and isinstance(message, LeaseAnswer)
        return None if answers and asked.get(message.nonce, 0) < 100 * NS_PER_MS else 0

    scene.rule(rule)
    scene.until(
        "it asks for less", lambda: any(v >= 100 * NS_PER_MS for v in asked.values()), within_s=1.0
    )
    scene.run(0.01)
    standby = scene.standby()
    assert standby is not None
    scene.net.cut(scene.both_ways([master], [arbiter, standby]))
    old = scene.held_term(master)
    # The third train is received; the new term is not.
    scene.rule(
        lambda source, target, message: None if target == master and message.term > old else 0
    )
    scene.run(3.0)


def resignation_late(make: Make) -> None:
    """The resignation of a former master arrives at a standby after the next takeover."""
    scene, master = at_speed(make, trains=4)
    scene.keep_back(
        lambda source, target, message: (
            isinstance(message, SwitchStep) and message.kind is SwitchKind.RESIGN
        )
    )
    pairs = _deafen(scene, master)
    scene.run(3.0)
    scene.net.heal(pairs)
    scene.run(2.0)
    now = scene.master()
    scene.expect(
        "it was said, and another commands", bool(scene.held) and now not in (None, master)
    )
    term = scene.held_term(master)
    scene.let_go()
    scene.run(3.0)
    scene.expect("the present master goes on", scene.master() == now)
    scene.expect("under the same term", scene.held_term(master) == term)


def _newer(scene: ScriptedLine, train: int) -> Callable[[], bool]:
    """Return a condition: the train obeys a later term than now."""
    old = scene.held_term(train)
    return lambda: scene.held_term(train) > old


def stop_outlives_master(make: Make) -> None:
    """A train stopped by supervision stays stopped under the next master and the one after it."""
    scene, first = at_speed(make, trains=4)
    stopped = next(train for train in scene.world.trains if train not in (first, scene.standby()))
    scene.order(OrderKind.STOP, stopped)
    scene.stands(stopped)
    where_m = scene.world.trains[stopped].front_m
    for _ in range(2):
        master = scene.master()
        assert master is not None
        newer = _newer(scene, stopped)
        scene.net.kill(master)
        scene.until("there is a new term", newer, within_s=5.0)
        scene.net.boot(master)
        scene.run(20.0)
        scene.expect("it stands", scene.world.trains[stopped].front_m <= where_m)
    scene.order(OrderKind.GO, stopped)
    scene.run(10.0)
    scene.expect("it goes on", scene.world.trains[stopped].front_m > where_m + 5.0)


DEAF_LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario("deaf-master", 0, "the master sends and receives nothing", deaf_master),
    DirectedScenario(
        "deaf-to-trains", 0, "the master receives arbiters and no train", deaf_to_trains
    ),
    DirectedScenario("deaf-then-mute", 0, "a deaf master cannot resign", deaf_then_mute),
    DirectedScenario("shortened-lease", 0, "a grant for less than a whole lease", shortened_lease),
    DirectedScenario(
        "stop-outlives-master",
        0,
        "a stop command is committed with the roster",
        stop_outlives_master,
    ),
    DirectedScenario(
        "resignation-late", 0, "a resignation comes after the next takeover", resignation_late
    ),
)
