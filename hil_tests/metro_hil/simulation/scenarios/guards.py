"""Scenarios that lead straight to where a guard is needed; random seeds alone miss half of these.

Most hold back one message until it has become dangerous, and then deliver it.
"""

from dataclasses import replace
from typing import Any, Final

from metro_hil.simulation.scenarios.acceptance import DirectedScenario, Make, at_speed
from metro_hil.simulation.scripted_line import NS_PER_MS, NS_PER_S, Plot, ScriptedLine
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import (
    AreaAuthority,
    ClaimKind,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    OrderKind,
    TrackStatus,
)
from zenoh_config.t2t_supervision import RemovalState
from zenoh_config.timers import LineTimers

SWITCH: Final = 1
SWITCH_M: Final = 700.0
STANDS_M: Final = {1: 560.0, 2: 1000.0, 3: 1250.0, 4: 200.0}
"""Fronts at the start. Train 1 waits before the switch, and all stand at stations of their own.
Train 4, the rearmost, becomes standby."""


def before_the_switch(
    make: Make, *, masters: tuple[int, ...] = (3, 2, 1, 4), **more: Any
) -> ScriptedLine:
    """Four trains at rest; the first of `masters` commands, and the switch requests its release."""
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


def _wish(scene: ScriptedLine, wanted: bool) -> None:
    scene.world.track.objects[SWITCH].release_wanted = wanted


def _free(scene: ScriptedLine) -> bool:
    return not scene.world.track.objects[SWITCH].locked


def _long_one_is_held(scene: ScriptedLine) -> bool:
    return any(
        isinstance(each.message, AreaAuthority) and each.message.end_m > SWITCH_M
        for each in scene.held
    )


def _until_granted(scene: ScriptedLine) -> None:
    scene.until("it is granted", lambda: _long_one_is_held(scene), within_s=3.0)


def _until_taken_over(scene: ScriptedLine) -> None:
    scene.until("a new master", lambda: scene.master() in (1, 2, 4), within_s=3.0)


def late_authority_after_takeover(make: Make) -> None:
    """A long authority is late: meanwhile its master dies and the next one frees the switch."""
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
    """A train that has not received the new term still obeys the old one."""
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
    """29: an old, repeated or foreign authority changes nothing.

    Foreign means for another incarnation or from another master.
    """
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
    """Messages held by a cut arrive in one burst, seconds old."""
    scene, master = at_speed(make, trains=3)
    train = next(each for each in scene.world.trains if each != master)
    pairs = scene.cut_off(train, keeps=True)
    scene.run(3.0)
    scene.net.heal(pairs)
    scene.run(2.0)


def shortened_at_speed(make: Make) -> None:
    """A train is ordered to stop; the switch ahead must not move until the train has stopped."""
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
    """A release is late: meanwhile the switch is claimed again and trains are sent over it."""
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
    """The next master receives only a status LOCKED from before the release."""
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
    """A stretch is closed, and the next master receives no track status."""
    scene = before_the_switch(make)
    _wish(scene, False)
    scene.lose(TrackStatus)
    closed = SpeedRestriction(620.0, 650.0, 1.0)
    scene.world.closes(closed)
    scene.run(0.2)
    scene.net.kill(3)
    scene.run(6.0)


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
    """A locked switch is still locked after its interlocking restarts."""
    scene = before_the_switch(make)
    _wish(scene, False)
    scene.until("train 1 may pass", lambda: (scene.end_m(1) or 0.0) > SWITCH_M, within_s=5.0)
    scene.net.kill(WAYSIDE)
    scene.net.boot(WAYSIDE)
    scene.run(1.0)


def late_claim(make: Make) -> None:
    """A claim arrives when the switch is free and requested to move."""
    scene = before_the_switch(make)
    scene.keep_back(lambda source, target, message: isinstance(message, ObjectClaim))
    _wish(scene, False)
    scene.until("a claim is on its way", lambda: bool(scene.held), within_s=3.0)
    _wish(scene, True)
    scene.run(0.2)
    scene.let_go()
    scene.run(0.5)


def removed_in_error(make: Make) -> None:
    """A person reports a train as gone that still stands there.

    It is either a non-communicating train with another close behind it, or one that the master
    receives.
    """
    for silent in (True, False):
        scene = make(Plot({1: 560.0, 2: 680.0}, stops_m=(3000.0,)))
        scene.settle()
        if silent:
            scene.net.kill(2)
        scene.world.trains[2].motion.apply_emergency(scene.net.now_ns)
        scene.stands(2)
        scene.stands(1)
        for _ in range(10):
            scene.world.removes(2)
            scene.run(1.0)
        answer = scene.world.t2t.removals[1, 2]
        wanted = RemovalState.AXLES if silent else RemovalState.HEARD
        scene.expect(f"it is refused: {answer.name}", answer is wanted)
        scene.run(30.0)


def removed_from_the_end(make: Make) -> None:
    """A train leaves the line unnoticed, close before one that stands in the last section.

    The next train waits until a person confirms that the train is gone, and then runs on.
    """
    end_m = 4000.0
    scene = make(Plot({1: end_m - 150.0, 2: end_m - 30.0}, area_m=end_m, stops_m=(end_m - 30.0,)))
    scene.settle()
    gone = scene.world.trains[2]
    scene.net.kill(2)
    scene.run(10.0)
    gone.shunts = True
    scene.until("it is off the line", lambda: gone.rear_m > end_m + 20.0, within_s=120.0)
    gone.on_line = gone.localised = gone.shunts = False
    scene.run(30.0)
    waits_m = scene.world.trains[1].front_m
    scene.expect(f"the other waits: {waits_m:.1f} m", waits_m < end_m - 100.0)
    scene.world.removes(2)
    scene.run(60.0)
    answer = scene.world.t2t.removals[1, 2]
    scene.expect(f"the removal succeeded: {answer.name}", answer is RemovalState.GONE)
    runs_m = scene.world.trains[1].front_m
    scene.expect(f"the other runs on: {runs_m:.1f} m", runs_m > end_m - 35.0)


LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario(
        "late-authority-takeover",
        0,
        "an old authority comes after a takeover",
        late_authority_after_takeover,
    ),
    DirectedScenario(
        "late-authority",
        0,
        "a longer authority comes after a shorter",
        late_authority_of_the_same_master,
    ),
    DirectedScenario(
        "late-authority-restart",
        0,
        "an authority for an earlier incarnation",
        late_authority_after_restart,
    ),
    DirectedScenario("unacceptable", 0, "forged, old and repeated authorities", unacceptable),
    DirectedScenario("stale-burst", 0, "messages that are seconds old come at once", stale_burst),
    DirectedScenario(
        "shortened-at-speed", 0, "a switch before a train that has to stop", shortened_at_speed
    ),
    DirectedScenario("late-release", 0, "a release comes after the next claim", late_release),
    DirectedScenario("stale-status", 0, "an object's old status", stale_status),
    DirectedScenario(
        "closed-unknown", 0, "a closed stretch that the master does not know", closed_unknown
    ),
    DirectedScenario("unpromised", 0, "a train that has not acknowledged the new term", unpromised),
    DirectedScenario(
        "forgetful-train", 0, "a train restarts while two leases run", forgetful_train
    ),
    DirectedScenario("object-restarts", 0, "an interlocking restarts", object_restarts),
    DirectedScenario("late-claim", 0, "a claim comes when the switch is to move", late_claim),
    DirectedScenario(
        "removed-in-error", 0, "a train is removed although it is there", removed_in_error
    ),
    DirectedScenario(
        "removed-from-the-end", 0, "a non-communicating train leaves the line", removed_from_the_end
    ),
)
