"""The real protocol on the simulated nodes: trains, arbiters, objects and track."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from firmware_py.trackdb.areas import AreaMap
from metro_hil.simulation.checker import Rules
from metro_hil.simulation.coverage import CountedGuard, answers, counted, told_kinds
from metro_hil.simulation.node import NEVER, NodeMachine, NodeStep, QueuedMessage
from metro_hil.simulation.orders import OrderSource, TrainOrder
from metro_hil.simulation.routes import Routes
from metro_hil.simulation.track import TrueTrack
from metro_hil.simulation.train_node import Protocolled
from metro_hil.simulation.true_train import BrakeLoopGrant, OdometryReading
from plant_emulator.wayside.arbiter import Arbiter, ArbiterGuards, of_masters
from plant_emulator.wayside.line_object import LineObject, ObjectGuards
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, ObjectMemory, WaysideStepped
from plant_emulator.wayside.track import WaysideTrack
from vobc.train_to_train.guards import TrainGuards
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import (
    OwnTrain,
    Role,
    Stepped,
    T2tConfig,
    TrainMemory,
    TrainState,
)
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    NO_TRAIN,
    Heartbeat,
    ObjectClaim,
    ObjectState,
    ObjectStatus,
    T2tMessage,
    TrainReport,
)
from zenoh_config.t2t_supervision import RemovalAnswer, RemovalState
from zenoh_config.term_grants import GrantSigner

NS_PER_MS: Final = 1_000_000
FOLLOWING: Final = frozenset((Role.OUTSIDE, Role.APPLICANT, Role.MEMBER))
FOR_MASTERS: Final = frozenset((TrainReport, ObjectStatus))


@dataclass(frozen=True, slots=True)
class Guards:
    """Guards of the protocol, or changed ones that show that a check fails without them."""

    train: TrainGuards = field(default_factory=TrainGuards)
    arbiter: ArbiterGuards = field(default_factory=ArbiterGuards)
    thing: ObjectGuards = field(default_factory=ObjectGuards)
    forget: frozenset[str] = frozenset()
    """Nodes whose memory is empty after a restart except for the boot count: train, arbiter,
    object."""


SAFE: Final = Guards()


@dataclass(frozen=True, slots=True)
class LineParticipants:
    """Line, configuration, trains and guards of a run."""

    line: AreaMap
    config: T2tConfig
    trains: tuple[int, ...]
    guards: Guards = SAFE
    signers: Mapping[int, GrantSigner] | None = None
    """Signs the grants on a secured line, by the arbiter's address."""


WaysideDisk = tuple[int, tuple[tuple[int, ObjectMemory], ...]]
"""Incarnation, and the memory of each object."""


class MachineStart(Protocol):
    """What a state machine starts from."""

    address: int
    boots: int
    disk: Any
    tuned: Collection[int] | None
    """Areas whose broadcasts the node receives."""


class TrainNode:
    """The core of a train with its stored memory."""

    __slots__ = (
        "_age_max_ns",
        "_covered",
        "_follows",
        "_held",
        "_keep",
        "_roles",
        "_routes",
        "_seat",
        "_state",
        "core",
        "grants",
        "last",
    )

    def __init__(
        self,
        core: TrainCore,
        memory: TrainMemory,
        routes: Routes,
        covered: Counter[str],
        age_max_ns: int,
        seat: MachineStart,
    ) -> None:
        self.core = core
        self._seat = seat
        seat.tuned = core.listens
        self._covered = covered
        self._age_max_ns = age_max_ns
        self._state: TrainState | None = None
        self._roles: tuple[tuple[int, Role], ...] = ()
        self._follows = False
        self._keep = memory
        self._routes = routes
        self._held: Any = None
        self.grants: tuple[BrakeLoopGrant, ...] = ()
        self.last: Any = None
        """Result of the latest step."""

    def step(self, now_ns: int, heard: Sequence[Any], reading: OdometryReading) -> NodeStep:
        own = OwnTrain(
            reading.localised,
            reading.front_min_m,
            reading.front_max_m,
            reading.rear_min_m,
            reading.rests_m,
            reading.speed_mps,
            reading.standstill,
            reading.reach_m,
            reading.easy_m,
            reading.axles,
            reading.out_of_service,
        )
        stepped = self.core.step(now_ns, tuple(heard), own)
        self.last = stepped
        if self.core.listens is not self._seat.tuned:
            self._seat.tuned = self.core.listens
        if stepped.state is not self._state or stepped.roles != self._roles:
            self._changes(stepped)
        if stepped.out:
            told_kinds(stepped.out, self._covered)
        if stepped.memory is not None:
            self._keep = stepped.memory
        held = stepped.authority
        if held is not None and now_ns - held.echo_ns > self._age_max_ns:
            # The ATP that this replaces ignores an expired authority.
            held = None
        if held is not self._held and held != self._held:
            self._held = held
            self.grants = () if held is None else (_grant(held, self._keep),)
        return NodeStep(self._routes.letters(stepped.out), self._keep, self.core.next_due_ns())

    def _changes(self, stepped: Stepped) -> None:
        covered = self._covered
        if stepped.state is not self._state:
            covered[f"state {stepped.state.value}"] += 1
            if self._state is not None:
                covered[f"from {self._state.value} to {stepped.state.value}"] += 1
        before, after = dict(self._roles), dict(stepped.roles)
        for area in before.keys() | after.keys():
            # A train reports no role in areas that it has nothing to do with.
            was, role = before.get(area, Role.OUTSIDE), after.get(area, Role.OUTSIDE)
            if was is not role:
                covered[f"role {role.value}"] += 1
                covered[f"from {was.value} to {role.value}"] += 1
        self._state, self._roles = stepped.state, stepped.roles
        self._follows = all(role in FOLLOWING for _, role in stepped.roles)

    def waits_for(self, message: Any) -> bool:
        """Tell whether a message wakes the train at once.

        A train that follows reads messages meant for masters only when it steps anyway.
        """
        return not self._follows or type(message) not in FOR_MASTERS


class Mute:
    """A train whose memory cannot be read; it takes no part until a person intervenes."""

    grants: tuple[BrakeLoopGrant, ...] = ()

    def step(self, now_ns: int, heard: Sequence[Any], reading: OdometryReading) -> NodeStep:
        return NodeStep((), None, NEVER)


def _grant(held: Any, memory: TrainMemory) -> BrakeLoopGrant:
    seen = memory.of_area(held.area)
    issuer = seen.owner if seen.seen_term == held.term else NO_TRAIN
    return BrakeLoopGrant(
        held.end_m, held.term, held.sequence, issuer, held.area, held.echo_ns, held.rear_m
    )


class ArbiterNode:
    """One arbiter."""

    def __init__(
        self,
        cast: LineParticipants,
        routes: Routes,
        node: MachineStart,
        now_ns: int,
        crew: "ProtocolNodes",
    ) -> None:
        self._address, self._crew = node.address, crew
        self._core = Arbiter(
            cast.config.timers,
            address=node.address,
            memory=ArbiterMemory(node.disk.boot)
            if node.disk is not None and "arbiter" in cast.guards.forget
            else node.disk,
            start_ns=now_ns,
            guards=cast.guards.arbiter,
            arbiters=len(cast.config.arbiters),
            signer=None if cast.signers is None else cast.signers[node.address],
        )
        self._keep: ArbiterMemory | None = node.disk
        self._routes = routes
        if crew.arbiters is not None:
            crew.arbiters[node.address] = self._core

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep:
        stepped = self._core.step(now_ns, tuple(heard))
        if stepped.memory is not None:
            self._keep = stepped.memory
        told_kinds(stepped.out, self._crew.said)
        letters = self._routes.letters(stepped.out)
        self._crew.answered(self._address, heard, letters)
        return NodeStep(letters, self._keep, NEVER)


class WaysideNode:
    """Interlocking and axle counters: all objects and the track in one process."""

    def __init__(
        self,
        cast: LineParticipants,
        routes: Routes,
        track: TrueTrack,
        node: MachineStart,
        now_ns: int,
        crew: "ProtocolNodes",
    ) -> None:
        timers = cast.config.timers
        disk: WaysideDisk = node.disk if node.disk is not None else (1000 * node.boots, ())
        kept = dict(disk[1])
        if "object" in cast.guards.forget:
            kept = {number: ObjectMemory(each.boot) for number, each in kept.items()}
        self._boot = disk[0] + 1
        self._routes, self._track, self._crew = routes, track, crew
        self._objects = {
            site.number: LineObject(
                timers,
                site,
                cast.line.area_at(site.start_m).number,
                memory=kept.get(site.number),
                start_ns=now_ns,
                guards=cast.guards.thing,
            )
            for site in cast.line.objects
        }
        self._memories = kept
        self._keep: WaysideDisk = (self._boot, tuple(kept.items()))
        self.status = WaysideTrack(timers, cast.line, boot=self._boot, start_ns=now_ns)
        self._beat_ns = timers.heartbeat_ms * NS_PER_MS
        self._desk = OrderSource(self._boot)

    def step(self, now_ns: int, heard: Sequence[Any]) -> NodeStep:
        if self._crew.arbiters is not None:
            majority = self._crew.cast.config.majority
            heard = of_masters(self._crew.arbiters.values(), heard, majority=majority)
        out, moved, due_ns = self._step_objects(now_ns, heard)
        # Lock an object before storing that it is locked; free it only after storing that.
        self._crew.move([each for each in moved if each[1]])
        freed = [each for each in moved if not each[1]]
        for message in heard:
            if type(message) is RemovalAnswer and message.train in self._crew.cast.trains:
                self._crew.removals[message.area, message.train] = message.state
            elif type(message) is Heartbeat:
                self._desk.masters[message.area] = message
        self.status.closed = self._crew.closed
        self.status.restrictions = self._crew.restrictions
        beats = tuple([m for m in heard if type(m) is Heartbeat])
        self._track.advance(self._crew.true_ns())
        if beats:
            track = self._track
            out += self.status.step(now_ns, beats, axles=track.axles(), disturbed=track.disturbed)
        out += self._desk.says(self._crew.orders, now_ns)
        self._crew.orders = [order for order in self._crew.orders if order.left > 0]
        told_kinds(out, self._crew.said)
        return NodeStep(
            self._routes.letters(out),
            self._keep,
            due_ns,
            (lambda: self._crew.move(freed)) if freed else None,
        )

    def _step_objects(
        self, now_ns: int, heard: Sequence[Any]
    ) -> tuple[list[T2tMessage], list[tuple[int, bool]], int]:
        """Step every object. The result is their messages, which of them locked or released, and
        when the next one is due.
        """
        out: list[T2tMessage] = []
        due_ns = now_ns + self._beat_ns
        moved: list[tuple[int, bool]] = []
        changed = False
        for number, thing in self._objects.items():
            true = self._track.objects[number]
            concerning = tuple([m for m in heard if _concerns(m, number, true.area)])
            stepped: WaysideStepped[ObjectMemory] = thing.step(
                now_ns,
                concerning,
                release_wanted=true.release_wanted,
                occupied=self._track.occupied(true),
            )
            if stepped.memory is not None:
                self._memories[number] = stepped.memory
                changed = True
            for message in stepped.out:
                if isinstance(message, ObjectStatus) and message.state is not ObjectState.FAILED:
                    moved.append((number, message.state is ObjectState.LOCKED))
            out += stepped.out
            due_ns = min(due_ns, thing.next_due_ns())
        if changed:
            self._keep = (self._boot, tuple(self._memories.items()))
        return out, moved, due_ns


def _concerns(message: T2tMessage, number: int, area: int) -> bool:
    if type(message) is ObjectClaim:
        return message.number == number
    return message.area == area and type(message) is not RemovalAnswer


class ProtocolNodes:
    """Starts all nodes of a line from their disks."""

    def __init__(self, cast: LineParticipants, seed: int) -> None:
        self.cast, self._seed = cast, seed
        self.said = Counter[str]()
        """Counts of what nodes sent and went through, by name, without guards."""
        self._counting: list[CountedGuard] = []
        self._guards = counted(cast.guards.train, self._counting)
        self.rules = Rules(
            age_max_ns=cast.config.timers.authority_ms * NS_PER_MS,
            roll_back_m=cast.config.rollback_m,
            jog_m=cast.config.jog_m,
        )
        self._routes = Routes(cast.trains)
        self.closed: tuple[Any, ...] = ()
        self.restrictions: tuple[Any, ...] = ()
        self.orders: list[TrainOrder] = []
        self.removals: dict[tuple[int, int], RemovalState] = {}
        """Last answer that supervision received, by area and train."""
        self.track: TrueTrack | None = None
        self.true_ns: Callable[[], int] = lambda: 0
        self.move: Callable[[list[tuple[int, bool]]], None] = lambda moved: None
        self.answered: Callable[[int, Sequence[Any], Sequence[QueuedMessage]], None] = (
            lambda area, read, answers: None
        )
        """Receives what an arbiter read and what it sends in answer."""
        self.arbiters: dict[int, Arbiter] | None = None
        """Latest incarnation of each arbiter, beside which objects and track run. None: they obey
        every term, as on a line without hostile trains they may."""

    @property
    def covered(self) -> Counter[str]:
        """Counts of what the run reached of the protocol, by name."""
        return self.said + answers(self._counting)

    def constants(self) -> dict[str, object]:
        """Return the parts that never change during the run, by name."""
        guards = self._guards
        return {
            "crew": self,
            "line": self.cast.line,
            "config": self.cast.config,
            "timers": self.cast.config.timers,
            "routes": self._routes,
            "said": self.said,
            "rules": self.rules,
            "guards": guards,
            "guards of members": guards.member,
            "guards of leases": guards.lease,
            "guards of masters": guards.master,
        }

    def train(self, node: MachineStart, now_ns: int) -> Protocolled:
        memory = node.disk
        if memory is None:
            return Mute()
        if "train" in self.cast.guards.forget:
            memory = TrainMemory(memory.boot)
        core = TrainCore(
            self.cast.config,
            self.cast.line,
            address=node.address,
            memory=memory,
            start_ns=now_ns,
            seed=self._seed ^ (node.address << 8) ^ node.boots,
            guards=self._guards,
        )
        return TrainNode(core, memory, self._routes, self.said, self.rules.age_max_ns, node)

    def installed(self, address: int) -> object:
        if address in self.cast.config.arbiters:
            return ArbiterMemory()
        if address == WAYSIDE:
            return 0, tuple((site.number, ObjectMemory()) for site in self.cast.line.objects)
        return TrainMemory()

    def wayside(self) -> Mapping[int, tuple[str, Callable[[MachineStart, int], NodeMachine]]]:
        def arbiter(node: MachineStart, now_ns: int) -> NodeMachine:
            return ArbiterNode(self.cast, self._routes, node, now_ns, self)

        def wayside(node: MachineStart, now_ns: int) -> NodeMachine:
            assert self.track is not None
            return WaysideNode(self.cast, self._routes, self.track, node, now_ns, self)

        arbiters = {
            address: (f"arbiter {address % 100}", arbiter) for address in self.cast.config.arbiters
        }
        return {**arbiters, WAYSIDE: ("wayside", wayside)}
