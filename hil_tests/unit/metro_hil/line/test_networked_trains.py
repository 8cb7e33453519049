"""Trains of a network as programs of their own, and their wayside, over a radio in virtual time.

The trains are the points of mass of `test_turning_masters`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeVar

import pytest

from firmware_py.clock.clock import LockstepClock
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.trackdb.circuit import load_network, load_path
from firmware_py.trackdb.paths import Path as Way
from firmware_py.trackdb.version import database_version
from hil_tests.unit.metro_hil.line.test_turning_masters import (
    CYCLE_NS,
    LENGTH_M,
    SHORT,
    SHORT_TRACKS,
    T2T,
    TURN_CYCLES,
    Puppet,
    written,
)
from metro_hil.line.turning.invariants import Between, Observed
from metro_hil.line.turning.masters import ARBITERS
from metro_hil.line.turning.networked import NetworkedMasters, NetworkSession
from plant_emulator.wayside.departed_trains import DepartedTrains
from plant_emulator.wayside.interlocking import Interlocking, Lie, SharedNetwork, SignalBox
from plant_emulator.wayside.line_wayside import Disks, LineWayside
from plant_emulator.wayside.network_places import TrainPlace, TrainPresence, key_of_answer
from plant_emulator.wayside.network_wayside import NetworkWayside, PathWayside
from plant_emulator.wayside.route_objects import divided
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, ObjectMemory
from vobc.train_to_train.vocabulary import Role

M = TypeVar("M", ArbiterMemory, ObjectMemory)
NS_PER_S: Final = 1_000_000_000
EARLIER_NS: Final = 7 * NS_PER_S
"""The wayside of the tests starts this long after the clock."""


@dataclass
class Memories:
    """What arbiters and objects of each path have stored, and how the switches lay."""

    arbiters: dict[str, dict[int, ArbiterMemory | None]] = field(default_factory=dict)
    objects: dict[str, dict[int, ObjectMemory | None]] = field(default_factory=dict)
    lies: dict[str, Lie] = field(default_factory=dict)


def wayside_of(file: str, start_ns: int, memories: Memories | None = None) -> NetworkWayside:
    """A wayside with the memories of one that ended."""
    network, ways, memories = load_network(file), [], memories or Memories()
    for path in (load_path(f"{file}:out"), load_path(f"{file}:back")):
        areas, database = divided(network, path), database_version(path.line)
        boot = start_ns // NS_PER_S + 1
        arbiters = memories.arbiters.setdefault(
            path.line.name, dict.fromkeys(ARBITERS, ArbiterMemory(boot))
        )
        objects = memories.objects.setdefault(
            path.line.name, {site.number: ObjectMemory(boot) for site in areas.objects}
        )
        disks = Disks(arbiters, objects, _stores_in(arbiters), _stores_in(objects))
        wayside = LineWayside(
            *(T2T.timers, areas, disks), boot=boot, start_ns=start_ns, database=database
        )
        departed = DepartedTrains(path.line.name, database=database)
        ways.append(PathWayside(path, areas, wayside, departed))
    return NetworkWayside(network, ways, start_ns=start_ns, lies=memories.lies)


def _stores_in(memory: dict[int, M | None]) -> Callable[[int, M], bool]:
    def store(number: int, value: M) -> bool:
        memory[number] = value
        return True

    return store


class NetworkPuppet(Puppet):
    """A point of mass with a session of its own. It knows only its own box."""

    def __init__(self, number: int, shuttle: "NetworkShuttle", due_ns: int) -> None:
        self.number, self.net, self.due_ns = number, shuttle, due_ns
        self.box = SignalBox(shuttle.network)
        answers = (key_of_answer("short", number),)
        port = shuttle.air.port(f"train {number}", answers)
        self.session = NetworkSession(port, "short", number, shuttle.clock)
        self.lines = NetworkedMasters(shuttle.network, shuttle.ways, T2T, self.session, boot=1)

    @property
    def way(self) -> Way:
        return self.net.ways[self.trips % 2]

    def begin(self, now_ns: int) -> None:
        way = self.way
        self.front_m, self.speed_mps = way.line.stations[0].stop_m, 0.0
        self.stood_cycles, self.began_ns = 0, now_ns
        self.radio, self.port = self.lines.join(way.line.name, self.number, now_ns)
        self.routes = Interlocking(
            *(self.net.network, way),
            to_m=self.stop_m,
            front_m=self.front_m,
            rear_m=self.front_m - LENGTH_M,
            shared=SharedNetwork(self.box, f"train {self.number}", now_ns),
        )

    def step(self, now_ns: int) -> None:
        session = self.session
        if self.routes is None:
            session.tell(self.place(TrainPresence.DUE if self.is_due else TrainPresence.AHEAD))
            session.take()
            if not (self.is_due and session.enters):
                return
            self.begin(session.now_ns)
        super().step(session.now_ns)
        session.tell(self.place(TrainPresence.PRESENT))

    def turn(self, now_ns: int) -> None:
        if abs(self.front_m - self.stop_m) > 1.0 or self.speed_mps:
            return
        self.stood_cycles += 1
        if self.stood_cycles == TURN_CYCLES:
            self.lines.leave(self.way.line.name, self.number)
            self.trips += 1
            self.begin(now_ns)

    @property
    def is_due(self) -> bool:
        return self.session.zero_ns is not None and self.session.now_ns >= self.due_ns

    def place(self, presence: TrainPresence) -> TrainPlace:
        first = self.way.line.stations[0].stop_m
        front_m = self.front_m if self.routes else first
        end_m = self.end_m()
        return TrainPlace(
            *(presence, self.trips, self.way.line.name, front_m, front_m - LENGTH_M),
            *(front_m if end_m is None else end_m, self.stop_m, (), 0.0),
        )


class NetworkShuttle:
    def __init__(self, file: str, dues_s: Sequence[float]) -> None:
        self.network = load_network(file)
        self.ways = tuple(load_path(f"{file}:{name}") for name in ("out", "back"))
        self.clock, self.air, self.between = LockstepClock(), InprocRadio(0.005), Between()
        self.clock.wait_until(EARLIER_NS)
        self.memories, self.file = Memories(), file
        self.wayside = wayside_of(file, EARLIER_NS, self.memories)
        self.port = self.air.port("wayside", self.wayside.subscriptions)
        self.trains = [
            NetworkPuppet(number, self, round(due_s * NS_PER_S))
            for number, due_s in enumerate(dues_s, start=1)
        ]

    def restart_wayside(self) -> None:
        """End the wayside, and start one with its memories."""
        self.memories.lies = self.wayside.lies
        self.wayside = wayside_of(self.file, self.clock.now_ns(), self.memories)

    def run(self, duration_s: float) -> None:
        end_ns = self.clock.now_ns() + round(duration_s * NS_PER_S)
        while self.clock.now_ns() < end_ns:
            now_ns = self.clock.now_ns() + CYCLE_NS
            self.clock.wait_until(now_ns)
            for train in self.trains:
                train.step(now_ns)
            for key, payload in self.wayside.step(now_ns, self.port.receive(now_ns)):
                self.port.send(now_ns, key, payload)
            present = {
                name: Observed(routes, self.trains[int(name[-1]) - 1].end_m(), (now_ns,))
                for name, routes in self.wayside.box.trains.items()
            }
            self.between.look(now_ns / NS_PER_S, present)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("network"), SHORT, SHORT_TRACKS)


def test_two_trains_change_ends_under_a_wayside_that_starts_again(file: str) -> None:
    shuttle = NetworkShuttle(file, (0.0, 26.0))
    first, second = shuttle.trains

    shuttle.run(7.5)
    lies = shuttle.wayside.lies
    assert first.front_m < 100.0 < (first.end_m() or 0.0)
    # The train has authority over a switch that the wayside moved for it.
    shuttle.restart_wayside()
    assert shuttle.wayside.lies == lies == {"W1": Lie.RIGHT, "W2": Lie.LEFT}
    shuttle.run(32.5)

    # The first one has changed ends, and goes to the switch; the second one follows its old path.
    assert (first.trips, second.trips) == (1, 0)
    assert first.front_m > first.way.line.stations[0].stop_m
    assert None not in (first.end_m(), second.end_m())
    assert first.lines.radio is not None
    assert Role.MASTER in first.lines.radio.roles.values()
    assert shuttle.between.violations == []
    assert shuttle.between.checked_count > 200
    assert first.brakes == second.brakes == 0
    assert shuttle.wayside.refused == 0


def test_a_train_enters_when_it_is_due_and_only_once(file: str) -> None:
    shuttle = NetworkShuttle(file, (1.0, 0.0))
    first, second = shuttle.trains

    shuttle.run(1.5)
    # Both are due, and the second one asked first.
    assert second.routes is not None
    assert first.routes is None
    assert [*shuttle.wayside.box.entering] == ["train 1"]
    # The program of a train on the network starts again.
    again = NetworkSession(shuttle.air.port("again", ()), "short", 2, shuttle.clock)
    again.listen(())
    for _ in range(4):
        again.tell(second.place(TrainPresence.DUE))
        shuttle.run(0.05)
    again.take()

    assert again.newest is not None
    assert again.newest.is_known
    assert not again.enters
    assert again.zero_ns == pytest.approx(EARLIER_NS, abs=0.02 * NS_PER_S)


def test_a_train_that_is_gone_leaves_its_place_to_another(file: str) -> None:
    shuttle = NetworkShuttle(file, (0.0,))
    (train,) = shuttle.trains
    shuttle.run(0.5)
    assert shuttle.wayside.box.trains

    train.session.tell(train.place(TrainPresence.GONE))
    shuttle.clock.wait_until(shuttle.clock.now_ns() + CYCLE_NS)
    now_ns = shuttle.clock.now_ns()
    shuttle.wayside.step(now_ns, shuttle.port.receive(now_ns))

    assert shuttle.wayside.places == {}
    assert shuttle.wayside.box.trains == {}


def test_messages_are_received_at_the_instant_at_which_they_arrived() -> None:
    clock, air = LockstepClock(), InprocRadio(0.005)
    wayside = air.port("wayside", ())
    session = NetworkSession(air.port("train 1", ()), "short", 1, clock)
    session.listen(("a",))
    session.zero_ns = 1_000_000
    wayside.send(10_000_000, "a", b"late")

    # The train has been delayed: it is at 12 ms while the clock shows 40 ms.
    clock.wait_until(40_000_000)
    assert list(session.receive(12_000_000)) == []
    (message,) = session.receive(14_000_000)

    assert (message.payload, message.stamp_ns) == (b"late", 14_000_000)


def test_switches_lie_as_before_a_restart_of_the_wayside(file: str, tmp_path: Path) -> None:
    wayside = wayside_of(file, 0)
    wayside.box.machines["W1"].place(Lie.RIGHT)

    again = NetworkWayside(load_network(file), [], start_ns=0, lies=wayside.lies)

    assert again.lies == {"W1": Lie.RIGHT, "W2": Lie.LEFT}


@pytest.mark.parametrize(
    "payload",
    [
        b"{}",
        b'[2,0,"short-out",10.0,20.0,10.0,50.0,[],0.0]',
        b'[2,0,"short-out",10.0,-20.0,1e999,50.0,[],0.0]',
        b'[2,0,"nowhere",10.0,-20.0,10.0,50.0,[],0.0]',
        b'[7,0,"short-out",10.0,-20.0,10.0,50.0,[],0.0]',
    ],
)
def test_what_is_no_place_is_refused_and_counted(file: str, payload: bytes) -> None:
    shuttle = NetworkShuttle(file, ())
    air = shuttle.air.port("other", ())

    air.send(shuttle.clock.now_ns(), "m/short/p/1", payload)
    shuttle.run(0.1)

    assert shuttle.wayside.refused == 1
    assert shuttle.wayside.places == {}
