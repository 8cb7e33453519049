"""A small railway for tests of trains that command themselves: ticks, a simple network, simple
trains.

The rig holds the truth. Tests read true positions and usable authorities from it instead of asking
the trains.
"""

import heapq
import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from firmware_py.trackdb.areas import Area, AreaMap, ObjectKind, ObjectSite, TrackSection
from plant_emulator.wayside.arbiter import Arbiter, ArbiterGuards
from plant_emulator.wayside.line_object import LineObject
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, ObjectMemory
from plant_emulator.wayside.track import WaysideTrack
from vobc.train_to_train.guards import TrainGuards
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import (
    HeldAuthority,
    OwnTrain,
    Role,
    T2tConfig,
    TrainMemory,
    TrainState,
)
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import BROADCAST, Heartbeat, ObjectState, T2tMessage

MS = 1_000_000
TICK_MS = 5
LENGTH_M = 80.0
AXLES = 16
BRAKE_MPS2 = 0.8
EMERGENCY_MPS2 = 1.0
HARDEST_MPS2 = 10.0
ACCEL_MPS2 = 1.0
UNCERTAIN_M = 2.0
ARBITER = 65_001

Spoil = Callable[[T2tMessage, int], list[int]]
"""How the network treats a message for one receiver: one delay in ms for each copy that arrives."""


def plain(message: T2tMessage, receiver: int) -> list[int]:
    return [5]


@dataclass
class Train:
    address: int
    core: TrainCore
    front_m: float
    speed_mps: float = 0.0
    limit_mps: float = 20.0
    held: HeldAuthority | None = None
    latent_m: float = -math.inf
    memory: TrainMemory = field(default_factory=TrainMemory)
    alive: bool = True
    paused: bool = False
    localised: bool = True
    out_of_service: bool = False
    emergencies: int = 0
    rolls_back_m: float = 0.0
    state: TrainState = TrainState.LOST
    roles: dict[int, Role] = field(default_factory=dict)
    inbox: list[T2tMessage] = field(default_factory=list)
    trail: list[str] = field(default_factory=list)

    @property
    def rear_m(self) -> float:
        return self.front_m - LENGTH_M

    def own(self) -> OwnTrain:
        high_m = self.front_m + UNCERTAIN_M
        v = self.speed_mps
        return OwnTrain(
            localised=self.localised,
            front_min_m=self.front_m - UNCERTAIN_M,
            front_max_m=high_m,
            rear_min_m=self.rear_m - UNCERTAIN_M,
            rests_m=self.rear_m - UNCERTAIN_M + v * v / (2.0 * HARDEST_MPS2),
            speed_mps=v,
            standstill=v == 0.0,
            reach_m=high_m + v * 0.5 + v * v / (2.0 * EMERGENCY_MPS2),
            easy_m=high_m + v + v * v / (2.0 * BRAKE_MPS2),
            axles=AXLES,
            out_of_service=self.out_of_service,
        )


def line_of(
    *borders_m: float,
    section_m: float = 0.0,
    objects: Iterable[tuple[float, float]] = (),
    apply_m: float = 800.0,
) -> AreaMap:
    """Areas between the borders.

    All sections have one length; a length of 0 means none. Objects are numbered from 1.
    """
    areas = tuple([Area(n + 1, a, b) for n, (a, b) in enumerate(itertools.pairwise(borders_m))])
    sections: list[TrackSection] = []
    at_m = borders_m[0]
    while section_m and at_m < borders_m[-1]:
        end_m = min(at_m + section_m, borders_m[-1])
        sections.append(TrackSection(len(sections) + 1, at_m, end_m))
        at_m = end_m
    sites = tuple([ObjectSite(n + 1, ObjectKind.SWITCH, a, b) for n, (a, b) in enumerate(objects)])
    return AreaMap("test", areas, tuple(sections), sites, apply_m)


class Rig:
    def __init__(
        self,
        line: AreaMap,
        *,
        config: T2tConfig | None = None,
        guards: TrainGuards | None = None,
        arbiter_guards: ArbiterGuards | None = None,
    ) -> None:
        self.line = line
        self.config = config or T2tConfig()
        self.guards = guards
        self.arbiter_guards = arbiter_guards
        self.now_ns = 0
        self.trains: dict[int, Train] = {}
        self.spoil: Spoil = plain
        self.log: list[tuple[int, T2tMessage]] = []
        self.memories: dict[int, ArbiterMemory | None] = {}
        self.arbiters: dict[int, Arbiter] = {}
        for address in self.config.arbiters:
            self.memories[address] = ArbiterMemory()
            self.start_arbiter(address)
        self.track = WaysideTrack(self.config.timers, line, boot=1, start_ns=0)
        self.objects = {
            site.number: LineObject(
                self.config.timers,
                site,
                line.area_at(site.start_m).number,
                memory=ObjectMemory(),
                start_ns=0,
            )
            for site in line.objects
        }
        self.wanted: set[int] = set()
        self.wayside_alive = True
        self.extra_axles: dict[int, int] = {}
        self._air: list[tuple[int, int, int, T2tMessage]] = []
        self._sent = 0
        self._starts_m = [each.start_m for each in line.sections]
        self._boxes: dict[int, list[T2tMessage]] = {}

    # Participants.

    def start_arbiter(self, address: int) -> None:
        self.arbiters[address] = Arbiter(
            self.config.timers,
            address=address,
            memory=self.memories[address],
            start_ns=self.now_ns,
            guards=self.arbiter_guards,
            arbiters=len(self.config.arbiters),
        )

    def stop_arbiter(self, address: int) -> None:
        del self.arbiters[address]

    def start_train(
        self, address: int, front_m: float, *, memory: TrainMemory | None = None, seed: int = 0
    ) -> Train:
        core = TrainCore(
            self.config,
            self.line,
            address=address,
            memory=memory or TrainMemory(),
            start_ns=self.now_ns,
            seed=seed,
            guards=self.guards,
        )
        train = self.trains[address] = Train(address, core, front_m)
        return train

    def kill(self, address: int) -> None:
        """Stop the controller of a train; the train brakes."""
        self.trains[address].alive = False

    def restart(self, address: int) -> None:
        old = self.trains[address]
        fresh = self.start_train(address, old.front_m, memory=old.memory)
        fresh.speed_mps = old.speed_mps
        fresh.latent_m = old.latent_m

    # Time.

    def run(self, ms: int, *, check: bool = True) -> None:
        for _ in range(ms // TICK_MS):
            self.now_ns += TICK_MS * MS
            for train in self.trains.values():
                self._move(train)
            self._tick()
            if check:
                self.check()

    def run_until(self, reached: Callable[[], bool], limit_ms: int = 60_000) -> int:
        """Run until the condition holds and return the duration in ms; raise AssertionError if
        it never does."""
        began_ns = self.now_ns
        while not reached():
            assert self.now_ns - began_ns < limit_ms * MS, "never"
            self.run(TICK_MS)
        return (self.now_ns - began_ns) // MS

    def _tick(self) -> None:
        while self._air and self._air[0][0] <= self.now_ns:
            _, _, receiver, message = heapq.heappop(self._air)
            if receiver in self.trains:
                self.trains[receiver].inbox.append(message)
            else:
                self._boxes.setdefault(receiver, []).append(message)
        for address, arbiter in self.arbiters.items():
            stepped = arbiter.step(self.now_ns, tuple(self._boxes.pop(address, [])))
            if stepped.memory is not None:
                self.memories[address] = stepped.memory
            self._send(stepped.out)
        self._wayside(tuple(self._boxes.pop(WAYSIDE, [])))
        for train in list(self.trains.values()):
            self._step(train)

    def _wayside(self, heard: tuple[T2tMessage, ...]) -> None:
        if not self.wayside_alive:
            return
        if any(isinstance(message, Heartbeat) for message in heard):
            self._send(self.track.step(self.now_ns, heard, axles=self._axles()))
        for number, each in self.objects.items():
            inside = any(
                t.front_m > each.site.start_m and t.rear_m < each.site.end_m
                for t in self.trains.values()
            )
            stepped = each.step(
                self.now_ns, heard, release_wanted=number in self.wanted, occupied=inside
            )
            self._send(stepped.out)

    def _axles(self) -> dict[int, int]:
        counted = dict(self.extra_axles)
        for train in self.trains.values():
            for n in range(AXLES):
                at_m = train.front_m - 2.0 - n * (LENGTH_M - 4.0) / (AXLES - 1)
                at = bisect_right(self._starts_m, at_m)
                if at:
                    counted[at] = counted.get(at, 0) + 1
        return counted

    def _step(self, train: Train) -> None:
        if not train.alive or train.paused:
            if not train.alive:
                train.inbox.clear()
            return
        heard, train.inbox = tuple(train.inbox), []
        if not heard and self.now_ns < train.core.next_due_ns():
            return
        stepped = train.core.step(self.now_ns, heard, train.own())
        if stepped.memory is not None:
            train.memory = stepped.memory
        train.held, train.state, train.roles = stepped.authority, stepped.state, dict(stepped.roles)
        self._send(stepped.out)

    def _send(self, out: Iterable[T2tMessage]) -> None:
        for message in out:
            self.log.append((self.now_ns, message))
            to = message.destination
            receivers = [*self.trains, WAYSIDE] if to == BROADCAST else [to]
            for receiver in receivers:
                if receiver == message.source:
                    continue
                for delay_ms in self.spoil(message, receiver):
                    self._sent += 1
                    due_ns = self.now_ns + delay_ms * MS
                    heapq.heappush(self._air, (due_ns, self._sent, receiver, message))

    def say(self, message: T2tMessage) -> None:
        """Send a message that no honest node of the rig sends."""
        self._send([message])

    # Trains run as fast as their authority allows, and brake in time.

    def _move(self, train: Train) -> None:
        dt_s = TICK_MS / 1000.0
        v = train.speed_mps
        held, age_max_ns = train.held, self.config.timers.authority_ms * MS
        age_ns = age_max_ns + 1 if held is None else self.now_ns - held.echo_ns
        if not train.alive or held is None or age_ns > age_max_ns:
            if v > 0.0 and train.alive and held is not None:
                train.emergencies += 1
            v -= EMERGENCY_MPS2 * dt_s
        elif age_ns > 0.6 * age_max_ns:
            v -= BRAKE_MPS2 * dt_s
        else:
            room_m = held.end_m - train.front_m - UNCERTAIN_M - 1.0 - v * 0.2
            if room_m <= v * v / (2.0 * BRAKE_MPS2):
                late = v * v / (2.0 * EMERGENCY_MPS2) > max(room_m, 0.0) and v > 0.5
                v -= (EMERGENCY_MPS2 if late else BRAKE_MPS2) * dt_s
            else:
                v = min(v + ACCEL_MPS2 * dt_s, train.limit_mps)
        train.speed_mps = max(0.0, v)
        train.front_m += train.speed_mps * dt_s

    # Truth.

    def check(self) -> None:
        """Check invariants 21 and 23: the track that a train may use is its own and locked."""
        for train in self.trains.values():
            held = train.held
            end_m = -math.inf if held is None else held.end_m
            stop_m = train.front_m + train.speed_mps**2 / (2.0 * EMERGENCY_MPS2)
            train.latent_m = max(train.front_m, end_m, min(train.latent_m, stop_m))
        order = sorted(self.trains.values(), key=lambda each: each.front_m)
        for behind, ahead in itertools.pairwise(order):
            assert behind.latent_m <= ahead.rear_m, (
                f"{self.now_ns / 1e9} s: train {behind.address} may come to {behind.latent_m} m, "
                f"the rear of train {ahead.address} is at {ahead.rear_m} m"
            )
        for each in self.objects.values():
            if each.memory.state is ObjectState.LOCKED:
                continue
            for train in self.trains.values():
                clear = (
                    train.latent_m <= each.site.start_m + 1e-9 or train.rear_m >= each.site.end_m
                )
                assert clear, f"train {train.address} may enter object {each.site.number}"

    def is_commanded(self) -> bool:
        return bool(self.masters())

    def masters(self, area: int = 1) -> list[int]:
        return [
            t.address
            for t in self.trains.values()
            if t.alive and t.roles.get(area) in (Role.MASTER, Role.FENCING)
        ]
