"""Trains on a network that command themselves: one line of masters for each path of the service.

A train takes part in the line of the path that it runs on. When it goes on over another path, the
controller of that path starts as a train that enters: it reports, and joins the roster. Until axle
counters show that the train has left the path before, the masters there keep its place as that of
a silent train.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from firmware_py.ports import LinkCounters, RadioMessage, TunableRadioPort
from firmware_py.radio.inproc_radio import InprocRadio, InprocRadioPort
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path
from firmware_py.trackdb.version import database_version
from plant_emulator.wayside.departed_trains import DepartedTrains
from plant_emulator.wayside.interlocking import (
    NOT_SHARED,
    Interlocking,
    Shared,
    SignalBox,
    sections_of,
)
from plant_emulator.wayside.line_wayside import Disks, LineWayside
from plant_emulator.wayside.route_objects import AXLES, claimed, divided, shared_tracks, truth_of
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, ObjectMemory
from vobc.config import VobcConfig
from vobc.process.line_command import LineCommand, commanded
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import Role, T2tConfig, TrainMemory
from vobc.wire.line_radio import LineRadio
from zenoh_config.t2t import FIRST_ARBITER

DELAY_S: Final = 0.005
ARBITERS: Final = tuple(range(FIRST_ARBITER, FIRST_ARBITER + 3))
WAYSIDE: Final = "wayside"
DEPARTURES: Final = "departures"
CUT_NS: Final = 400_000_000
"""Time for which the radio of a master is cut. It is longer than a lease, and shorter than the life
of an authority until the service brake."""
WATCH_NS: Final = 2_000_000_000
"""Time after a strike in which the age of authorities is watched."""
NS_PER_S: Final = 1e9


@dataclass(frozen=True, slots=True)
class CommandChange:
    """Another train began to command an area."""

    at_s: float
    path: str
    area: int
    train: int


@dataclass(slots=True)
class StruckMaster:
    """A train that commanded when it was struck."""

    at_s: float
    train: int
    areas: tuple[tuple[str, int], ...]
    """Path and number of each area that it commanded where another train takes part."""
    takeovers_s: dict[tuple[str, int], float] = field(default_factory=dict)
    """Time by area until another train commanded it."""
    oldest_s: float = 0.0
    """Age of the oldest authority of another train in the 2 s after."""

    @property
    def is_followed(self) -> bool:
        """Whether another train commands each of the areas."""
        return bool(self.areas) and len(self.takeovers_s) == len(self.areas)


class Masters:
    """All paths of a service with their wayside."""

    def __init__(self, network: TrackNetwork, paths: Iterable[Path], box: SignalBox) -> None:
        self._box, self._t2t = box, T2tConfig(arbiters=ARBITERS)
        self.struck: StruckMaster | None = None
        self.changes: list[CommandChange] = []
        """Every train that began to command an area, the first ones included."""
        self._newest: dict[tuple[str, int], int] = {}
        known = {path.line.name: path for path in paths}
        box.shared = shared_tracks(known.values())
        self.paths = {name: MasterPath(network, path, box.shared) for name, path in known.items()}

    def config_of(self, config: VobcConfig, train: int) -> VobcConfig:
        return replace(commanded(config, self._t2t.timers), address=train)

    def enter(self, line: LineMap, config: VobcConfig, began_ns: int) -> LineCommand:
        """The part of a train in the line of the path that it enters."""
        radio, port = self.paths[line.name].enter(config.address, self._t2t, began_ns)
        return LineCommand(radio, port, config, line, axles=AXLES)

    def leave(self, path: str, train: int) -> None:
        """The train sends and receives nothing on this path any more."""
        self.paths[path].leave(train)

    def step(self, now_ns: int) -> None:
        """Run the wayside of all paths."""
        for name, path in self.paths.items():
            path.step(now_ns, self._box.trains)
            self._box.claimed[name] = path.claimed()
        for name, area, train in self.commanding():
            if self._newest.get((name, area)) != train:
                self._newest[name, area] = train
                self.changes.append(CommandChange(now_ns / NS_PER_S, name, area, train))
        if self.struck is not None:
            self._watch(self.struck, now_ns)

    def choose(self, now_ns: int) -> StruckMaster | None:
        """Choose the train to strike: the first one that commands an area with another train."""
        for train in dict.fromkeys(train for _, _, train in self.commanding()):
            areas = tuple(
                (name, area)
                for name, area, commands in self.commanding()
                if commands == train and self.paths[name].has_others(area, train)
            )
            if areas:
                self.struck = StruckMaster(now_ns / NS_PER_S, train, areas)
                return self.struck
        return None

    def cut(self, train: int) -> None:
        """Lose everything between a train and all others until `heal`."""
        for path in self.paths.values():
            path.cut(train)

    def heal(self) -> None:
        for path in self.paths.values():
            path.air.heal()

    def _watch(self, struck: StruckMaster, now_ns: int) -> None:
        after_s = now_ns / NS_PER_S - struck.at_s
        if not struck.is_followed:
            for name, area, train in self.commanding():
                key = name, area
                if train != struck.train and key in struck.areas:
                    struck.takeovers_s.setdefault(key, after_s)
        if after_s * NS_PER_S <= WATCH_NS:
            ages_ns = [
                age_ns
                for path in self.paths.values()
                for age_ns in path.ages_ns(now_ns, but=struck.train)
            ]
            struck.oldest_s = max(struck.oldest_s, max(ages_ns, default=0) / NS_PER_S)

    def commanding(self) -> list[tuple[str, int, int]]:
        """Path, area and number of each train that commands now."""
        return [
            (name, area, train)
            for name, path in self.paths.items()
            for train, radio in sorted(path.radios.items())
            for area, role in sorted(radio.roles.items())
            if role is Role.MASTER
        ]


class MasterPath:
    """One path: its areas, its radio, its wayside, and the trains on it."""

    def __init__(self, network: TrackNetwork, path: Path, shared: Shared = NOT_SHARED) -> None:
        """Args:
        shared: tracks that other paths run over, too.
        """
        self.areas = divided(network, path, shared)
        self.air = InprocRadio(DELAY_S)
        self.radios: dict[int, LineRadio] = {}
        """By train, its part in the line."""
        self._began_ns: dict[int, int] = {}
        self._path, self._routes = path, sections_of(network, path, shared)
        self._database = database_version(path.line)
        self._memories: dict[int, CheckedStore[TrainMemory]] = {}
        self._ports: dict[int, InprocRadioPort] = {}
        arbiters = {address: CheckedStore(None, ArbiterMemory) for address in ARBITERS}
        disks = Disks(
            dict.fromkeys(ARBITERS, ArbiterMemory()),
            {site.number: ObjectMemory() for site in self.areas.objects},
            lambda address, memory: arbiters[address].put(memory),
            lambda number, memory: True,
        )
        self._wayside = LineWayside(
            *(T2tConfig().timers, self.areas, disks), boot=1, start_ns=0, database=self._database
        )
        self._port = self.air.port(WAYSIDE, self._wayside.subscriptions)
        self.departed = DepartedTrains(self.areas.name, database=self._database)
        self._departures = self.air.port(DEPARTURES, self.departed.subscriptions)

    def enter(
        self, train: int, t2t: T2tConfig, began_ns: int
    ) -> tuple[LineRadio, TunableRadioPort]:
        """Let a train take part, whose own time begins at an instant of the network."""
        store = self._memories.setdefault(train, CheckedStore(None, TrainMemory))
        memory = store.value or TrainMemory()
        core = TrainCore(t2t, self.areas, address=train, memory=memory, start_ns=0)
        radio = LineRadio(core, self.areas.name, store.put, database=self._database)
        if train not in self._ports:
            self._ports[train] = self.air.port(name_of(train), ())
        port = ShiftedPort(self._ports[train], began_ns)
        port.listen(radio.subscriptions)
        self.departed.enters(train)
        self.radios[train], self._began_ns[train] = radio, began_ns
        return radio, port

    def has_others(self, area: int, train: int) -> bool:
        """Whether another train takes part in an area."""
        return any(area in radio.roles for other, radio in self.radios.items() if other != train)

    def ages_ns(self, now_ns: int, *, but: int) -> list[int]:
        """Age of the authority of each train but one."""
        return [
            now_ns - self._began_ns[train] - radio.authority.echo_ns
            for train, radio in self.radios.items()
            if train != but and radio.authority is not None
        ]

    def cut(self, train: int) -> None:
        for other in (
            WAYSIDE,
            DEPARTURES,
            *(name_of(each) for each in self._ports if each != train),
        ):
            self.air.cut(name_of(train), other)

    def leave(self, train: int) -> None:
        radio = self.radios.pop(train, None)
        if radio is not None:
            self.departed.leaves(train, radio.roles)
            self._ports[train].listen(())

    def step(self, now_ns: int, trains: Mapping[str, Interlocking]) -> None:
        truth = truth_of(self.areas, self._path, trains.values())
        for key, payload in self._wayside.step(now_ns, self._port.receive(now_ns), truth):
            self._port.send(now_ns, key, payload)

        def is_clear(train: int, area: int) -> bool:
            routes, within = trains.get(name_of(train)), self.areas.area(area)
            return routes is None or not any(
                low_m < within.end_m and within.start_m < high_m
                for low_m, high_m in routes.body.parts_on(self._path)
            )

        heard = self._departures.receive(now_ns)
        for key, payload in self.departed.step(now_ns, heard, is_clear):
            self._departures.send(now_ns, key, payload)

    def claimed(self) -> frozenset[str]:
        states = {number: each.memory.state for number, each in self._wayside.objects.items()}
        return claimed(self._routes, self.areas, states)


def name_of(train: int) -> str:
    return f"train {train}"


class ShiftedPort:
    """A port of the network's radio for a train whose clock began later."""

    def __init__(self, port: TunableRadioPort, began_ns: int) -> None:
        self._port, self._began_ns = port, began_ns

    @property
    def counters(self) -> LinkCounters:
        return self._port.counters

    def listen(self, subscriptions: Collection[str]) -> None:
        self._port.listen(subscriptions)

    def send(self, now_ns: int, key: str, payload: bytes) -> None:
        self._port.send(now_ns + self._began_ns, key, payload)

    def receive(self, now_ns: int) -> Sequence[RadioMessage]:
        heard = self._port.receive(now_ns + self._began_ns)
        return [each._replace(stamp_ns=each.stamp_ns - self._began_ns) for each in heard]

    def close(self) -> None:
        """Do nothing: the port stays for the next time on this path."""
