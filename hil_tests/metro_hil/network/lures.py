"""Scenarios that lead straight to where a guard is needed: random seeds alone miss half of them.

Most hold back one message until it has become dangerous and then let it go.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from metro_hil.network.directed import Make, Scenario, at_speed
from metro_hil.network.scene import NS_PER_MS, NS_PER_S, Plot, Scene
from vobc.t2t.vocabulary import Role
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import (
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    LeaseKind,
    LeaseRequest,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    OrderKind,
    RosterCommit,
    TrackStatus,
    TrainReport,
)
from zenoh_config.timers import LineTimers

SWITCH: Final = 1
SWITCH_M: Final = 700.0
STANDS_M: Final = {1: 560.0, 2: 1000.0, 3: 1250.0, 4: 200.0}
"""Train 1 waits before the switch; all stand at stations of their own. The rearmost, 4, becomes
standby."""


def before_the_switch(make: Make, *, masters: tuple[int, ...] = (3, 2, 1, 4), **more: Any) -> Scene:
    """Four trains that stand; the first of `masters` commands, the switch wants to move."""
    stops_m = tuple(sorted(STANDS_M.values()))
    scene = make(Plot(STANDS_M, objects=True, stops_m=stops_m, dwell_s=1000.0, **more))
    switch = scene.world.track.objects[SWITCH]
    switch.release_wanted = True
    for address in scene.others(*masters):
        scene.net.boot(address)
    scene.run(0.5)
    for address in masters:
        scene.net.boot(address)
        scene.run(1.5)
    scene.until("all trains have authority", scene.all_held, within_s=20.0)
    scene.until("there is a standby", lambda: scene.standby() is not None, within_s=5.0)
    return scene


def _wish(scene: Scene, wanted: bool) -> None:
    scene.world.track.objects[SWITCH].release_wanted = wanted


def _free(scene: Scene) -> bool:
    return not scene.world.track.objects[SWITCH].locked


def _long_one_is_held(scene: Scene) -> bool:
    return any(
        isinstance(each.message, AreaAuthority) and each.message.end_m > SWITCH_M
        for each in scene.held
    )


def _until_granted(scene: Scene) -> None:
    scene.until("it is granted", lambda: _long_one_is_held(scene), within_s=3.0)


def _until_taken_over(scene: Scene) -> None:
    scene.until("a new master", lambda: scene.master() in (1, 2, 4), within_s=3.0)


def late_authority_after_takeover(make: Make) -> None:
    """A long authority is on its way; meanwhile its master ends, and the next one lets the switch
    move."""
    scene = before_the_switch(make)
    scene.expect("the switch is free", _free(scene))
    scene.keep_back_authorities(1)
    _wish(scene, False)
    _until_granted(scene)
    scene.net.kill(3)
    _wish(scene, True)
    _until_taken_over(scene)
    scene.until("the switch is free", lambda: _free(scene), within_s=2.0)
    scene.let_go(3)
    scene.run(0.3)
    scene.no_rules()
    scene.run(1.0)


def unpromised(make: Make) -> None:
    """A train that has not heard the new term still obeys the old one."""
    scene = before_the_switch(make)
    scene.keep_back_authorities(1)
    _wish(scene, False)
    _until_granted(scene)
    scene.net.kill(3)
    scene.lose(Heartbeat, target=1)
    _wish(scene, True)
    _until_taken_over(scene)
    scene.run(0.2)
    scene.let_go(3)
    scene.run(0.3)


def late_authority_of_the_same_master(make: Make) -> None:
    scene = before_the_switch(make)
    scene.keep_back(
        lambda source, target, message: (
            target == 1 and type(message) is AreaAuthority and message.end_m > SWITCH_M
        )
    )
    _wish(scene, False)
    _until_granted(scene)
    _wish(scene, True)
    scene.run(0.6)
    scene.let_go()
    scene.run(0.4)
    scene.no_rules()
    scene.run(1.0)


def late_authority_after_restart(make: Make) -> None:
    scene = before_the_switch(make)
    scene.keep_back_authorities(1)
    _wish(scene, False)
    _until_granted(scene)
    _wish(scene, True)
    scene.net.kill(1)
    scene.net.boot(1)
    scene.run(0.5)
    scene.no_rules()
    scene.let_go()
    scene.run(1.0)


def unacceptable(make: Make) -> None:
    """29: what is old, of another life, of another master or repeated changes nothing."""
    scene = before_the_switch(make)
    came: list[AreaAuthority] = []

    def watch(source: int, target: int, message: Any) -> int:
        if target == 1 and type(message) is AreaAuthority:
            came.append(message)
        return 0

    scene.rule(watch)
    scene.run(1.5)
    genuine, early = came[-1], came[0]
    over = replace(genuine, end_m=SWITCH_M - 30.0, sequence=genuine.sequence + 1000)
    forged = [
        replace(over, term=genuine.term - 1),
        replace(over, source=2),
        replace(over, to_boot=genuine.to_boot - 1),
        replace(over, to_boot=genuine.to_boot + 1),
        replace(over, sequence=early.sequence),
        replace(over, echo_ns=genuine.echo_ns - 1100 * NS_PER_MS),
        replace(over, echo_ns=genuine.echo_ns + 2000 * NS_PER_MS),
        replace(over, destination=2),
        replace(over, area=9),
    ]
    for number, wrong in enumerate(forged):
        message = replace(wrong, sequence=wrong.sequence + number)
        scene.net.deliver(1, message)
        scene.run(0.012)
        scene.expect(f"this is not obeyed: {message}", scene.end_m(1) != over.end_m)
    over = replace(over, sequence=over.sequence + len(forged))
    scene.net.deliver(1, over)
    scene.run(0.012)
    scene.expect("and a sound one is", scene.end_m(1) == over.end_m)


def stale_burst(make: Make) -> None:
    """What a cut kept comes in one burst, seconds old."""
    scene, master = at_speed(make, trains=3)
    train = next(each for each in scene.world.trains if each != master)
    pairs = scene.cut_off(train, keeps=True)
    scene.run(3.0)
    scene.net.heal(pairs)
    scene.run(2.0)


def shortened_at_speed(make: Make) -> None:
    """A train is told to stop at once; until it has, the switch before it must not move."""
    fronts_m = {1: 250.0, 2: 1250.0}
    scene = make(Plot(fronts_m, objects=True, stops_m=(1250.0,), dwell_s=1000.0))
    scene.settle()
    train = scene.world.trains[1]
    scene.until("it is near", lambda: train.front_m > SWITCH_M - 60.0, within_s=80.0)
    scene.expect("and fast", train.motion.speed_mps > 14.0)
    scene.order(OrderKind.STOP, 1)
    _wish(scene, True)
    scene.run(15.0)


def late_release(make: Make) -> None:
    """A release is on its way while the switch is claimed anew and trains are sent over it."""
    scene = before_the_switch(make)
    _wish(scene, False)
    scene.until("it is locked", lambda: not _free(scene), within_s=3.0)
    scene.keep_back(
        lambda source, target, message: (
            isinstance(message, ObjectClaim) and message.kind is ClaimKind.RELEASE
        )
    )
    scene.run(1.0)
    _wish(scene, True)
    scene.until("a release is on its way", lambda: bool(scene.held), within_s=5.0)
    _wish(scene, False)
    scene.until("train 1 may pass", lambda: (scene.end_m(1) or 0.0) > SWITCH_M, within_s=5.0)
    scene.let_go()
    scene.run(1.0)


def stale_status(make: Make) -> None:
    """A status LOCKED from before the release is all that the next master hears."""
    scene = before_the_switch(make)
    _wish(scene, False)
    scene.until("it is locked", lambda: not _free(scene), within_s=3.0)
    scene.run(0.5)
    kept: list[ObjectStatus] = []

    def keep(source: int, target: int, message: Any) -> int | None:
        if isinstance(message, ObjectStatus) and message.number == SWITCH:
            if message.state is ObjectState.LOCKED and not kept:
                kept.append(message)
            return None if target in (2, 3, 4) else 0
        return 0

    scene.rule(keep)
    scene.run(0.2)
    scene.no_rules()
    _wish(scene, True)
    scene.until("it is free", lambda: _free(scene), within_s=8.0)
    scene.lose(ObjectStatus)
    scene.net.kill(3)
    _until_taken_over(scene)
    for _ in range(20):
        for target in (1, 2, 4):
            scene.net.deliver(target, replace(kept[0], sequence=kept[0].sequence + 10_000))
        kept[0] = replace(kept[0], sequence=kept[0].sequence + 1)
        scene.run(0.1)


def closed_unknown(make: Make) -> None:
    """A stretch is closed, and the next master hears nothing of the track."""
    scene = before_the_switch(make)
    _wish(scene, False)
    scene.lose(TrackStatus)
    closed = SpeedRestriction(620.0, 650.0, 1.0)
    scene.world.t2t.closed = (closed,)
    scene.world.closes(closed)
    scene.run(0.2)
    scene.net.kill(3)
    scene.run(6.0)


def reused_term(make: Make) -> None:
    """A candidacy fails; what gives its grants back comes when the next one has succeeded."""
    for seed in range(1, 6):
        scene = make(Plot({1: 560.0, 2: 1000.0}, arbiters=3, seed=seed))
        for address in scene.others(1, 2):
            scene.net.boot(address)
        scene.run(0.5)
        scene.rule(_first_attempt_fails(scene.arbiters[0]))
        scene.net.cut([(1, 2)])
        scene.net.boot(1)
        scene.run(0.15)
        scene.net.boot(2)
        scene.run(2.0)


def _first_attempt_fails(one: int) -> Callable[[int, int, Any], int | None]:
    """Only one arbiter hears of it; releases come late and renewals never."""
    nonces: list[int] = []

    def rule(source: int, target: int, message: Any) -> int | None:
        if source != 1 or not isinstance(message, LeaseRequest):
            return 0
        if message.kind is LeaseKind.RELEASE:
            return 300 * NS_PER_MS
        if message.kind is LeaseKind.RENEW:
            return None
        if message.nonce not in nonces:
            nonces.append(message.nonce)
        return None if nonces.index(message.nonce) == 0 and target != one else 0

    return rule


def term_again(make: Make) -> None:
    """Who has never heard of the terms that there were gets none of them again."""
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


def forgetful_train(make: Make) -> None:
    """The arbiter's clock jumps, so that two leases run; a follower restarts between them."""
    timers = LineTimers(lease_ms=3000, authority_ms=4000)
    scene = before_the_switch(make, timers=timers)
    master = scene.master()
    assert master is not None
    follower = 2 if master != 2 else 3
    scene.net.cut(scene.both_ways([master], scene.others(master)))
    scene.net.step_clock(scene.arbiters[0], 4 * NS_PER_S)
    old = scene.held_term(master)
    scene.until("it obeys the next", lambda: scene.held_term(follower) > old, within_s=2.5)
    scene.net.kill(follower)
    scene.net.cut([(other, follower) for other in scene.others(master, follower)])
    scene.net.heal(scene.both_ways([master], [follower]))
    scene.net.boot(follower)
    scene.run(1.0)
    scene.expect("it obeys no older one", scene.held_term(follower) == 0)


def object_restarts(make: Make) -> None:
    """A switch that was locked is locked when its interlocking starts anew."""
    scene = before_the_switch(make)
    _wish(scene, False)
    scene.until("train 1 may pass", lambda: (scene.end_m(1) or 0.0) > SWITCH_M, within_s=5.0)
    scene.net.kill(WAYSIDE)
    scene.net.boot(WAYSIDE)
    scene.run(1.0)


def late_claim(make: Make) -> None:
    """A claim comes when the switch is asked to move and free to do so."""
    scene = before_the_switch(make)
    scene.keep_back(lambda source, target, message: isinstance(message, ObjectClaim))
    _wish(scene, False)
    scene.until("a claim is on its way", lambda: bool(scene.held), within_s=3.0)
    _wish(scene, True)
    scene.run(0.2)
    scene.let_go()
    scene.run(0.5)


def out_of_line(make: Make) -> None:
    """The second of two trains before a border is heard first; the first must not be shut out."""
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
    """It forgets no term and grants nothing that it may have granted before."""
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
    """The roster with a newcomer on it is kept nowhere: the newcomer gets nothing."""
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
    """Three arbiters, four trains that start at once, again and again: somebody wins soon."""
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
    """Clocks jump ahead at the master, a follower, the arbiter: nobody gets what is another's."""
    for ahead_ms in (900,):
        for who in range(3):
            scene, master = at_speed(make, trains=3, seed=ahead_ms + who)
            victims = (master, 1 if master != 1 else 2, scene.arbiters[0])
            scene.net.step_clock(victims[who], ahead_ms * NS_PER_MS)
            scene.run(4.0)
            scene.until("all have authority", scene.all_held, within_s=40.0)


LURES: Final[tuple[Scenario, ...]] = (
    Scenario(
        "late-authority-takeover",
        0,
        "an old authority comes after a takeover",
        late_authority_after_takeover,
    ),
    Scenario(
        "late-authority",
        0,
        "a longer authority comes after a shorter",
        late_authority_of_the_same_master,
    ),
    Scenario(
        "late-authority-restart",
        0,
        "an authority for an earlier life",
        late_authority_after_restart,
    ),
    Scenario("unacceptable", 0, "forged, old and repeated authorities", unacceptable),
    Scenario("stale-burst", 0, "messages that are seconds old come at once", stale_burst),
    Scenario(
        "shortened-at-speed", 0, "a switch before a train that has to stop", shortened_at_speed
    ),
    Scenario("late-release", 0, "a release comes after the next claim", late_release),
    Scenario("stale-status", 0, "an object's old status", stale_status),
    Scenario(
        "closed-unknown", 0, "a closed stretch of which the master has not heard", closed_unknown
    ),
    Scenario("reused-term", 0, "a release of a failed candidacy comes late", reused_term),
    Scenario("unpromised", 0, "a train that has not promised", unpromised),
    Scenario("term-again", 0, "trains that know of no term", term_again),
    Scenario("forgetful-train", 0, "a train restarts while two leases run", forgetful_train),
    Scenario("object-restarts", 0, "an interlocking restarts", object_restarts),
    Scenario("late-claim", 0, "a claim comes when the switch is to move", late_claim),
    Scenario("out-of-line", 0, "the second in line is heard first", out_of_line),
    Scenario("arbiter-restarts", 0, "an arbiter forgets nothing", arbiter_restarts),
    Scenario("uncommitted", 0, "a roster that nobody keeps", uncommitted),
    Scenario("duelling-candidates", 0, "three candidates, three arbiters", duelling_candidates),
    Scenario("clock-steps", 0, "clocks jump ahead", clock_steps),
)
