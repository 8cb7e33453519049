"""Scenarios with a hostile train: it has valid keys and forges messages under its own address."""

from dataclasses import replace
from typing import Final

from metro_hil.simulation.scenarios.acceptance import DirectedScenario, Make, convoy
from metro_hil.simulation.scripted_line import Plot, ScriptedLine
from zenoh_config.t2t import (
    BROADCAST,
    TERM_MAX,
    AreaAuthority,
    Heartbeat,
    LeaseKind,
    LeaseRequest,
    Phase,
)

INSIDER: Final = 3
"""The foremost of three trains."""
TERMS_SAME_DAY: Final = 1_000_000
"""More terms than a line uses in a day."""


def _line(make: Make) -> ScriptedLine:
    fronts_m = convoy(3)
    scene = make(Plot(fronts_m, stops_m=tuple(fronts_m.values()), dwell_s=1000.0))
    scene.settle()
    # A false master uses the terms of true ones until an arbiter's answer shows it.
    checker = scene.world.checker
    checker.rules = replace(checker.rules, unjudged=frozenset({"19"}))
    scene.net.kill(INSIDER, why="is replaced by a hostile controller")
    return scene


def _head(
    scene: ScriptedLine, to: int, term: int, number: int
) -> tuple[int, int, int, int, int, int, int]:
    return INSIDER, to, 1, term, 9, number, number


def false_master(make: Make) -> None:
    """A train that no arbiter granted anything sends train 1 through train 2 ahead of it."""
    scene = _line(make)
    for number in range(1, 40):
        scene.run(0.1)
        term = scene.term(1) + (number == 1)
        scene.net.deliver(1, Heartbeat(*_head(scene, BROADCAST, term, number), Phase.ISSUING, 0, 1))
        node = scene.net.nodes[1]
        stamp_ns = node.clock.local_ns(scene.net.now_ns)
        head = _head(scene, 1, term, 1000 + number)
        scene.net.deliver(1, AreaAuthority(*head, node.disk.boot, stamp_ns, 1900.0, 0.0, 0, 1, ()))


def false_term(make: Make) -> None:
    """On a secured line it claims a new term, and shows the grants of the true master or none.

    The trains keep their term, and the true master commands on without a gap.
    """
    fronts_m = convoy(3)
    plot = Plot(fronts_m, stops_m=tuple(fronts_m.values()), dwell_s=1000.0, arbiters=3, signed=True)
    scene = make(plot)
    scene.settle()
    before = [scene.term(train) for train in (1, 2)]
    scene.net.kill(INSIDER, why="is replaced by a hostile controller")
    protocol = scene.protocol(scene.master() or INSIDER)
    desk = None if protocol is None else protocol.core.desk(1)
    assert desk is not None
    shown = desk.lease.proof()
    scene.expect(f"the true master shows a majority: {len(shown)}", len(shown) == 2)
    for number in range(1, 40):
        scene.run(0.1)
        for train in (1, 2):
            head = _head(scene, BROADCAST, before[0] + 1, number)
            grants = shown[: number % 3]
            scene.net.deliver(train, Heartbeat(*head, Phase.ISSUING, 0, 1, grants))
    scene.run(0.1)
    now = [scene.term(train) for train in (1, 2)]
    scene.expect(f"terms were {before} and are {now}", now == before)
    for train in (1, 2):
        protocol = scene.protocol(train)
        count = 0 if protocol is None else protocol.core.refusals["term not proven"]
        scene.expect(f"train {train} refused {count} terms", count == 39)
    scene.commanded(within_s=0.5)


def last_term(make: Make) -> None:
    """It claims the last term of all, to trains and to the arbiter. Then the others go on."""
    scene = _line(make)
    for train in (1, 2):
        head = _head(scene, BROADCAST, TERM_MAX, 1)
        scene.net.deliver(train, Heartbeat(*head, Phase.ISSUING, 0, 1))
    scene.run(1.0)
    for train in (1, 2):
        scene.net.kill(train)
    scene.run(1.0)
    request = LeaseRequest(*_head(scene, scene.arbiters[0], TERM_MAX, 2), LeaseKind.ACQUIRE, 1, 0)
    scene.net.deliver(scene.arbiters[0], request)
    scene.run(1.0)
    for train in (1, 2):
        scene.net.boot(train)
    scene.commanded(within_s=5.0)
    terms = [scene.term(train) for train in (1, 2)]
    scene.expect(f"terms are left: {terms}", max(terms) < TERMS_SAME_DAY)


INSIDER_LURES: Final[tuple[DirectedScenario, ...]] = (
    DirectedScenario("false-master", 0, "a hostile train grants what is not free", false_master),
    DirectedScenario("false-term", 0, "a hostile train shows an unproven term", false_term),
    DirectedScenario("last-term", 0, "a hostile train claims the last term", last_term),
)
