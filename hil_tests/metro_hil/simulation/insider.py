"""A hostile train: it has valid keys and sends forged messages of every kind under its own address.

It does not lie about its own place. Against that lie only axle counters help.
"""

import dataclasses
import enum
import random
import typing
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from metro_hil.simulation.depot import SEEN_NS, seen_gone, take_off
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.node import SimulatedNode
from metro_hil.simulation.protocol_nodes import TrainNode
from metro_hil.simulation.train_node import TrainNodeController
from vobc.train_to_train.vocabulary import TrainMemory
from zenoh_config.messages import SpeedRestriction
from zenoh_config.t2t import (
    BROADCAST,
    TERM_MAX,
    TERM_STEP_MAX,
    SignedGrant,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_codec import SIGNATURE_BYTES, problem_of_t2t
from zenoh_config.t2t_types import T2T_TYPES

NS_PER_S: Final = 1_000_000_000
BETWEEN_NS: Final = (1_000_000, 100_000_000)
"""Range of the time between two forged messages."""
RESTARTS_NS: Final = 25 * NS_PER_S
"""Time between two restarts of other nodes. It is longer than trains remember each other."""
DEAD_NS: Final = 1 * NS_PER_S
YOUNG_NS: Final = 1 * NS_PER_S
"""Time for which a restarted train is spared. It has not received the train ahead yet."""
HEAD: Final = frozenset({"source", "destination", "area", "boot", "sequence", "stamp_ns"})
NUMBERS: Final = (0, 1, 2, 3, 128, 255, 2**16, 2**32 - 1)
STAMPS_NS: Final = (0, 1, NS_PER_S, 2**63 - 1)
PLACES_M: Final = (-1.0e6, 0.0, 1.0, 1.0e6)
LENGTHS: Final = (0, 1, 3, 64)


class Knowledge(NamedTuple):
    """What the hostile train knows and uses."""

    term: int
    """Highest term of the area."""
    boot: int
    """Incarnation of the receiver."""
    stamp_ns: int
    """Stamp of a recent report of the receiver, by its clock."""
    trains: Sequence[int]
    places_m: Sequence[float]
    """Places of interest on the line."""
    grants: Sequence[SignedGrant] = ()
    """Grants that true masters show."""


def forged(
    kind: type[T2tMessage], rng: random.Random, head: Mapping[str, Any], knows: Knowledge
) -> T2tMessage | None:
    """A message of this kind with random values.

    None: receivers would refuse it for its values alone.
    """
    hints = typing.get_type_hints(kind)
    fields: dict[str, Any] = dict(head)
    for each in dataclasses.fields(kind):
        if each.name not in HEAD and each.name not in fields:
            fields[each.name] = _value(each.name, hints[each.name], rng, knows)
    message = kind(**fields)
    return None if problem_of_t2t(message) else message


def _value(name: str, hint: Any, rng: random.Random, knows: Knowledge) -> Any:
    if typing.get_origin(hint) is tuple:
        entry = typing.get_args(hint)[0]
        return tuple([_entry(entry, rng, knows) for _ in range(rng.choice(LENGTHS))])
    if hint is bool:
        return rng.random() < 0.5
    if hint is bytes:
        return rng.randbytes(SIGNATURE_BYTES)
    if issubclass(hint, enum.IntEnum):
        return rng.choice(list(hint))
    if hint is float:
        return rng.choice(knows.places_m if rng.random() < 0.7 else PLACES_M)
    return rng.choice(_numbers(name, knows))


def _numbers(name: str, knows: Knowledge) -> Sequence[int]:
    if name.endswith("term"):
        near = [knows.term + step for step in (-1, 0, 1, 2, TERM_STEP_MAX, TERM_STEP_MAX + 1)]
        return [each for each in near if each >= 0] + [0, TERM_MAX]
    if name == "to_boot" or name == "boot":
        return (knows.boot, knows.boot, knows.boot, knows.boot + 1, 2**32 - 1)
    if name.endswith("_ns"):
        return (knows.stamp_ns, knows.stamp_ns, *STAMPS_NS)
    if name in ("train", "successor", "standby", "behind", "waits_for", "holder"):
        return (0, *knows.trains)
    return NUMBERS


def _entry(entry: Any, rng: random.Random, knows: Knowledge) -> Any:
    if entry is SpeedRestriction:
        start_m, end_m = sorted([rng.choice(knows.places_m), rng.choice(knows.places_m)])
        return SpeedRestriction(start_m, end_m, rng.choice((0.1, 10.0, 200.0)))
    if entry is SignedGrant and knows.grants and rng.random() < 0.7:
        return rng.choice(knows.grants)
    hints = typing.get_type_hints(entry)
    return entry(**{name: _value(name, hints[name], rng, knows) for name in entry._fields})


class Insider:
    """Sends forged messages on a simulated line, and restarts other nodes one at a time.

    `calm` takes the hostile train off the line, as people would, and expects the others to go on.
    """

    def __init__(self, world: LineWorld, seed: int) -> None:
        self.world, self.counts = world, dict[str, int]()
        self._rng = random.Random(seed ^ 0x5A5A)
        self._address = world.drawn.insider
        self._sequence = 1_000_000
        self._over = False
        self._booted_ns: dict[int, int] = {}

    def begin(self) -> None:
        self._later(BETWEEN_NS[1], self._forge)
        self._later(RESTARTS_NS, self._restart)

    def calm(self) -> None:
        self._over = True
        net, train = self.world.net, self.world.trains[self._address]
        net.kill(self._address, why="is switched off by people")
        take_off(self.world, train)
        net.at(net.now_ns + SEEN_NS, self._report_gone_trains)

    def _report_gone_trains(self, _: object) -> None:
        """As elected master it may have put any train onto the roster of any area."""
        for train in self.world.trains.values():
            seen_gone(self.world, train)

    def _later(self, wait_ns: int, call: Any) -> None:
        net = self.world.net
        net.at(net.now_ns + wait_ns, lambda _: None if self._over else call())

    def _restart(self) -> None:
        net = self.world.net
        victim = self._rng.choice([each for each in net.nodes if each != self._address])
        net.kill(victim)
        self._booted_ns[victim] = net.now_ns + DEAD_NS
        self._later(DEAD_NS, lambda: net.boot(victim))
        self._later(RESTARTS_NS, self._restart)

    def _forge(self) -> None:
        rng, net = self._rng, self.world.net
        self._later(rng.randint(*BETWEEN_NS), self._forge)
        target = rng.choice([each for each in net.nodes if each != self._address])
        node = net.nodes[target]
        if net.now_ns < self._booted_ns.get(target, 0) + YOUNG_NS:
            return
        kind = rng.choice(T2T_TYPES)
        message = forged(kind, rng, self._head(kind, target, node), self._knowledge(node))
        if message is None:
            return
        self.counts[kind.__name__] = self.counts.get(kind.__name__, 0) + 1
        net.deliver(target, message if net.codec is None else net.codec.seal(message))

    def _head(self, kind: type[T2tMessage], target: int, node: SimulatedNode) -> dict[str, Any]:
        self._sequence += 1
        rng = self._rng
        areas = [area.number for area in self.world.drawn.cast.line.areas]
        own = self.world.net.nodes[self._address]
        head: dict[str, Any] = {
            "source": self._address,
            "destination": rng.choice((target, BROADCAST)),
            "area": rng.choice(areas) if rng.random() < 0.95 else 255,
            "boot": own.disk.boot if isinstance(own.disk, TrainMemory) else 1,
            "sequence": self._sequence,
            "stamp_ns": node.clock.local_ns(self.world.net.now_ns),
        }
        if kind is TrainReport:
            reading = self.world.trains[self._address].reading()
            head |= {
                "localised": reading.localised,
                "front_min_m": reading.front_min_m,
                "front_max_m": reading.front_max_m,
                "rear_min_m": reading.rear_min_m,
                "protected_m": reading.rear_min_m,
                "axles": reading.axles,
            }
            head["latent_m"] = head["easy_m"] = reading.front_max_m + rng.choice((0.0, 500.0))
        return head

    def _knowledge(self, node: SimulatedNode) -> Knowledge:
        net, trains = self.world.net, self.world.trains
        disks = [each.disk for each in net.nodes.values() if isinstance(each.disk, TrainMemory)]
        terms = [area.seen_term for disk in disks for area in disk.areas]
        memory = node.disk
        line_end_m = self.world.drawn.cast.line.end_m
        places_m = [each.front_m for each in trains.values()]
        return Knowledge(
            max(terms, default=0),
            memory.boot if isinstance(memory, TrainMemory) else 1,
            node.clock.local_ns(net.now_ns),
            tuple(trains),
            [*places_m, *[each + 300.0 for each in places_m], line_end_m, line_end_m - 20.0],
            self._shown_grants(),
        )

    def _shown_grants(self) -> list[SignedGrant]:
        """Return the grants in the newest heartbeats of all masters."""
        found: list[SignedGrant] = []
        for node in self.world.net.nodes.values():
            machine = node.machine
            protocol = machine.protocol if isinstance(machine, TrainNodeController) else None
            if isinstance(protocol, TrainNode):
                for area in self.world.drawn.cast.line.areas:
                    desk = protocol.core.desk(area.number)
                    found += () if desk is None else desk.lease.proof()
        return found
