"""A simulated line that a directed scenario controls step by step instead of by random events."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from firmware_py.trackdb.areas import AreaMap
from metro_hil.simulation.generate import (
    FIRST_ARBITER,
    SECTION_PIECES,
    Draw,
    line_of_areas,
    with_signed_grants,
)
from metro_hil.simulation.line_world import LineWorld
from metro_hil.simulation.orders import TrainOrder
from metro_hil.simulation.protocol_nodes import SAFE, Guards, LineParticipants, TrainNode
from metro_hil.simulation.trace import Teller
from metro_hil.simulation.train_node import TrainNodeController
from metro_hil.simulation.world import Setting
from vobc.train_to_train.vocabulary import Role, T2tConfig, TrainMemory
from zenoh_config.t2t import AreaAuthority, OrderKind
from zenoh_config.timers import TIMERS_A, LineTimers

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000


class UnexpectedError(Exception):
    """A scenario had an unexpected outcome although no invariant was violated."""


@dataclass(frozen=True, slots=True)
class Plot:
    """Trains, line and timers with which a scenario starts."""

    fronts_m: Mapping[int, float]
    areas: int = 1
    arbiters: int = 1
    objects: bool = False
    stops_m: Sequence[float] = ()
    dwell_s: float = 20.0
    timers: LineTimers = TIMERS_A
    guards: Guards = SAFE
    line: AreaMap | None = None
    area_m: float = 2000.0
    pieces: int = SECTION_PIECES
    """Number of sections in each area."""
    seed: int = 1
    speed_max_mps: float = 60.0 / 3.6
    length_m: float = 80.0
    signed: bool = False
    """Whether arbiters sign their grants, as on a secured line."""


@dataclass(slots=True)
class HeldMessage:
    """A message that the scenario holds back."""

    source: int
    target: int
    message: Any


class ScriptedLine:
    """A simulated line with the actions and queries that scenarios use."""

    def __init__(self, plot: Plot, tell: Teller | None = None) -> None:
        line = plot.line or line_of_areas(
            plot.areas, objects=plot.objects, area_m=plot.area_m, pieces=plot.pieces
        )
        arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + plot.arbiters))
        config = T2tConfig(timers=plot.timers, arbiters=arbiters)
        cast = LineParticipants(line, config, tuple(plot.fronts_m), plot.guards)
        if plot.signed:
            cast = with_signed_grants(cast)
        setting = Setting(
            plot.fronts_m,
            plot.stops_m,
            plot.dwell_s,
            plot.length_m,
            drift_ppm=0,
            speed_max_mps=plot.speed_max_mps,
        )
        self.world = LineWorld(plot.seed, Draw(cast, setting), tell=tell)
        self.net = self.world.net
        self.arbiters = arbiters
        self.held: list[HeldMessage] = []
        self._rules: list[Callable[[int, int, Any], int | None]] = []

    # -- time --------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        return self.net.now_ns / NS_PER_S

    def run(self, seconds: float) -> None:
        self.net.run(self.net.now_ns + int(seconds * NS_PER_S))

    def until(self, what: str, holds: Callable[[], bool], *, within_s: float) -> float:
        """Run until the condition holds; return the duration in seconds. Raises UnexpectedError."""
        begun_ns, end_ns = self.net.now_ns, self.net.now_ns + int(within_s * NS_PER_S)
        while not holds():
            if self.net.now_ns >= end_ns:
                raise UnexpectedError(f"{what}: not within {within_s:g} s")
            self.net.run(self.net.now_ns + 5 * NS_PER_MS)
        return (self.net.now_ns - begun_ns) / NS_PER_S

    def expect(self, what: str, holds: bool) -> None:
        if not holds:
            raise UnexpectedError(f"expectation failed at {self.now_s:.3f} s: {what}")

    def settle(self, within_s: float = 20.0) -> None:
        """Start all nodes and run until every train has authority."""
        self.world.boot_all()
        self.until("all trains have authority", self.all_held, within_s=within_s)

    # -- queries -----------------------------------------------------------------------------------

    def protocol(self, train: int) -> TrainNode | None:
        """Return the protocol of the train; None while its process is dead."""
        machine = self.net.nodes[train].machine
        if isinstance(machine, TrainNodeController) and isinstance(machine.protocol, TrainNode):
            return machine.protocol
        return None

    def role(self, train: int, area: int = 1) -> Role:
        node = self.protocol(train)
        if node is None or node.last is None:
            return Role.OUTSIDE
        roles: dict[int, Role] = dict(node.last.roles)
        return roles.get(area, Role.OUTSIDE)

    def master(self, area: int = 1) -> int | None:
        """Return the running train that takes itself for master, by the highest term if several."""
        masters = [
            train
            for train in self.world.trains
            if self.role(train, area) is Role.MASTER and self.net.runs(train)
        ]
        return max(masters, key=lambda train: self.term(train, area), default=None)

    def standby(self, area: int = 1) -> int | None:
        found = [train for train in self.world.trains if self.role(train, area) is Role.STANDBY]
        return found[0] if found else None

    def term(self, train: int, area: int = 1) -> int:
        """Return the highest term that the train has stored."""
        memory = self.net.nodes[train].disk
        return memory.of_area(area).seen_term if isinstance(memory, TrainMemory) else 0

    def held_term(self, train: int, area: int = 1) -> int:
        """Return the term of the authority in the train's brake loop; 0 without any."""
        machine = self.net.nodes[train].machine
        grants = machine.grants if isinstance(machine, TrainNodeController) else ()
        return max([grant.term for grant in grants if grant.area == area], default=0)

    def end_m(self, train: int) -> float | None:
        """Return the end of the authority in force; None without any."""
        grants, _ = self.world.drivers[train].in_force(self.net.now_ns)
        return min([grant.end_m for grant in grants], default=None)

    def all_held(self) -> bool:
        return not self.world.without_authority()

    def without(self) -> list[int]:
        """Return the trains that have no authority in force."""
        return self.world.without_authority()

    def emergencies(self) -> int:
        return sum(train.emergencies for train in self.world.trains.values())

    # -- actions -----------------------------------------------------------------------------------

    def others(self, *addresses: int) -> list[int]:
        return [each for each in self.net.nodes if each not in addresses]

    def both_ways(self, one: Sequence[int], two: Sequence[int]) -> list[tuple[int, int]]:
        return [pair for a in one for b in two for pair in ((a, b), (b, a))]

    def cut_off(self, address: int, *, keeps: bool = False) -> list[tuple[int, int]]:
        """Cut the links of a node to all others; return the pairs, which `heal` takes."""
        pairs = self.both_ways([address], self.others(address))
        self.net.cut(pairs, keeps=keeps)
        return pairs

    def rule(self, rule: Callable[[int, int, Any], int | None]) -> None:
        """Add a rule for messages.

        It gets source, target and message, and returns None (lost) or the extra delay in ns.
        """
        self._rules.append(rule)
        self.net.meddle(self._meddle)

    def no_rules(self) -> None:
        self._rules.clear()
        self.net.meddle(None)

    def _meddle(self, source: int, target: int, message: Any) -> int | None:
        late_ns = 0
        for rule in self._rules:
            by_ns = rule(source, target, message)
            if by_ns is None:
                return None
            late_ns = max(late_ns, by_ns)
        return late_ns

    def lose(self, *kinds: type, source: int | None = None, target: int | None = None) -> None:
        """Lose all later messages of these kinds from this source to this target."""
        self.rule(
            lambda a, b, message: (
                None
                if isinstance(message, kinds) and source in (None, a) and target in (None, b)
                else 0
            )
        )

    def keep_back(self, wanted: Callable[[int, int, Any], bool]) -> None:
        """Hold back the messages that `wanted` selects until `let_go`."""

        def rule(source: int, target: int, message: Any) -> int | None:
            if not wanted(source, target, message):
                return 0
            self.held.append(HeldMessage(source, target, message))
            return None

        self.rule(rule)

    def let_go(self, source: int | None = None) -> int:
        """Deliver all held messages (of one source) now, in order; return their number."""
        held = [each for each in self.held if source in (None, each.source)]
        self.held = [each for each in self.held if source not in (None, each.source)]
        for each in held:
            self.net.deliver(each.target, each.message)
        return len(held)

    def keep_back_authorities(self, train: int) -> None:
        self.keep_back(
            lambda source, target, message: target == train and type(message) is AreaAuthority
        )

    def order(self, kind: OrderKind, train: int, area: int = 1) -> None:
        self.world.t2t.orders.append(TrainOrder(kind, area, train))

    def commanded(self, *, within_s: float) -> float:
        return self.until("a train commands", lambda: self.master() is not None, within_s=within_s)

    def until_without(self, trains: list[int], *, within_s: float) -> float:
        """Run until exactly these trains have no authority."""
        what = f"all but {trains} have authority"
        return self.until(what, lambda: self.without() == trains, within_s=within_s)

    def stands(self, train: int) -> float:
        """Run until the train stands; return how long that took."""
        motion = self.world.trains[train].motion
        return self.until(f"{train} stands", lambda: motion.speed_mps == 0.0, within_s=120.0)

    def roll_back(self, train: int, way_m: float) -> None:
        motion = self.world.trains[train].motion
        motion.back_m = way_m
