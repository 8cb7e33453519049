"""More scenarios that lead to a guard: terms, votes, rosters, and the order of admission."""

from collections.abc import Callable
from typing import Any, Final

from metro_hil.simulation.scenarios.acceptance import DirectedScenario, Make, at_speed
from metro_hil.simulation.scenarios.guards import STANDS_M
from metro_hil.simulation.scripted_line import NS_PER_MS, Plot
from vobc.train_to_train.vocabulary import Role
from zenoh_config.t2t import LeaseKind, LeaseRequest, RosterCommit, TrainReport


def reused_term(make: Make) -> None:
    """A candidacy fails; the release of its grants arrives when the next one has succeeded."""
    for seed in range(1, 6):
        scene = make(Plot({1: 560.0, 2: 1240.0}, arbiters=3, seed=seed))
        for address in scene.others(1, 2):
            scene.net.boot(address)
        scene.run(0.5)
        scene.rule(_first_attempt_fails(scene.arbiters[0]))
        scene.net.cut([(1, 2)])
        scene.net.boot(1)
        scene.run(0.34 + 0.02 * seed)
        scene.net.boot(2)
        scene.run(2.0)


def _first_attempt_fails(one: int) -> Callable[[int, int, Any], int | None]:
    """Return a rule: one arbiter gets the first request, releases come late and renewals never."""
    nonces: list[int] = []

    def rule(source: int, target: int, message: Any) -> int | None:
        if source != 1 or not isinstance(message, LeaseRequest):
            return 0
        if message.kind is LeaseKind.RELEASE:
            return 250 * NS_PER_MS
        if message.kind is LeaseKind.RENEW:
            return None
        if message.nonce not in nonces:
            nonces.append(message.nonce)
        return None if nonces.index(message.nonce) == 0 and target != one else 0

    return rule


def term_again(make: Make) -> None:
    """A train that has never received the earlier terms does not get one of them again."""
    for restarts in (False, True):
        fronts_m = {1: 200.0, 2: 700.0, 3: 1200.0, 4: 1700.0}
        scene = make(Plot(fronts_m, stops_m=tuple(fronts_m.values()), dwell_s=1000.0))
        for address in scene.others(2, 4):
            scene.net.boot(address)
        scene.until_without([2, 4], within_s=20.0)
        scene.net.kill(1)
        scene.net.kill(3)
        if restarts:
            scene.net.kill(scene.arbiters[0])
            scene.net.boot(scene.arbiters[0])
        scene.run(1.0)
        scene.net.boot(2)
        scene.net.boot(4)
        scene.run(5.0)


def out_of_line(make: Make) -> None:
    """A restarted arbiter forgets no term and grants nothing that may still be granted."""
    fronts_m = {1: 1300.0, 2: 1700.0, 3: 3000.0}
    scene = make(Plot(fronts_m, areas=2, stops_m=(3000.0,), dwell_s=1000.0))
    scene.rule(
        lambda source, target, message: (
            None if source == 2 and isinstance(message, TrainReport) and message.area == 2 else 0
        )
    )
    scene.world.boot_all()
    scene.run(40.0)
    scene.no_rules()
    scene.until(
        "the first is over the border",
        lambda: scene.world.trains[2].rear_m > 2000.0,
        within_s=40.0,
    )


def arbiter_restarts(make: Make) -> None:
    """A restarted arbiter forgets no term and grants nothing that it may have granted before."""
    for after_s in (0.05, 0.2):
        scene, master = at_speed(make, trains=3)
        arbiter = scene.arbiters[0]
        pairs = scene.both_ways([master], [arbiter])
        scene.net.cut(pairs)
        scene.net.kill(arbiter)
        for train in scene.world.trains:
            if train != master:
                scene.net.cut(scene.both_ways([master], [train]))
        scene.run(after_s)
        scene.net.boot(arbiter)
        scene.run(2.0)


def uncommitted(make: Make) -> None:
    """The roster with a new train is not committed: the train gets no authority."""
    fronts_m = {1: 200.0, 2: 1000.0, 3: 1450.0}
    scene = make(Plot(fronts_m, stops_m=tuple(fronts_m.values()), dwell_s=1000.0))
    for address in scene.others(1):
        scene.net.boot(address)
    scene.until("2 and 3 may go", lambda: scene.world.without_authority() == [1], within_s=20.0)
    scene.lose(RosterCommit)
    scene.net.boot(1)
    scene.run(3.0)
    scene.expect("it has no authority", scene.end_m(1) is None)
    scene.no_rules()
    scene.until("then it has", lambda: scene.end_m(1) is not None, within_s=5.0)


def duelling_candidates(make: Make) -> None:
    """Three arbiters and four trains that start at once, several times: a train soon wins."""
    for seed in range(1, 6):
        scene = make(Plot(STANDS_M, arbiters=3, seed=seed))
        for address in scene.others(*STANDS_M):
            scene.net.boot(address)
        scene.run(0.5)
        for train in STANDS_M:
            scene.net.boot(train)
        scene.commanded(within_s=3.0)
        roles = [scene.role(train) for train in STANDS_M]
        scene.expect(f"one: {roles}", roles.count(Role.MASTER) == 1)


def clock_steps(make: Make) -> None:
    """The clock of the master, a follower or the arbiter jumps ahead: no invariant breaks."""
    for ahead_ms in (900,):
        for who in range(3):
            scene, master = at_speed(make, trains=3, seed=ahead_ms + who)
            victims = (master, 1 if master != 1 else 2, scene.arbiters[0])
            scene.net.step_clock(victims[who], ahead_ms * NS_PER_MS)
            scene.run(4.0)
            scene.until("all have authority", scene.all_held, within_s=40.0)


TERM_LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario("reused-term", 0, "a release of a failed candidacy comes late", reused_term),
    DirectedScenario("term-again", 0, "trains that know of no term", term_again),
    DirectedScenario("out-of-line", 0, "the second in line is received first", out_of_line),
    DirectedScenario("arbiter-restarts", 0, "an arbiter forgets nothing", arbiter_restarts),
    DirectedScenario("uncommitted", 0, "a roster that no arbiter stores", uncommitted),
    DirectedScenario(
        "duelling-candidates", 0, "three candidates, three arbiters", duelling_candidates
    ),
    DirectedScenario("clock-steps", 0, "clocks jump ahead", clock_steps),
)
