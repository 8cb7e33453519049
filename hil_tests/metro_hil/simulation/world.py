"""A simulated line: its trains, wayside nodes, network and checker."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

from metro_hil.simulation.checker import Checker, Rules
from metro_hil.simulation.clocks import NodeClock
from metro_hil.simulation.event_queue import Codec, SimulatedNetwork
from metro_hil.simulation.motion import SimulatedMotion
from metro_hil.simulation.node import NodeMachine, SimulatedNode
from metro_hil.simulation.trace import Teller
from metro_hil.simulation.train_node import (
    CONTROL_NS,
    Protocolled,
    SimulatedDriver,
    TrainNodeController,
)
from metro_hil.simulation.true_train import AXLES, Build, TrueTrain

NS_PER_S: Final = 1_000_000_000
LOCAL_START_NS_MAX: Final = 3600 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Setting:
    """Where trains start, where they stop and how they are built."""

    fronts_m: Mapping[int, float]
    """Position of each train's front at the start, by train."""
    stops_m: Sequence[float] = ()
    dwell_s: float = 20.0
    length_m: float = 80.0
    builds: Mapping[int, Build] = field(default_factory=dict)
    """Build of each train that differs from the default, by train."""
    drift_ppm: int = 100
    speed_max_mps: float = 60.0 / 3.6

    def build(self, train: int) -> Build:
        return self.builds.get(train, Build(self.length_m, AXLES))


class ProtocolUnderTest(Protocol):
    """The protocol under test, which starts its own nodes."""

    @property
    def rules(self) -> Rules: ...

    def train(self, node: SimulatedNode, now_ns: int) -> Protocolled: ...

    def installed(self, address: int) -> object:
        """Return what the disk of a new node holds."""

    def wayside(self) -> Mapping[int, tuple[str, Callable[[SimulatedNode, int], NodeMachine]]]:
        """Return name and start function of every node that is not a train, by address."""


class SimulatedLine:
    """The whole simulated line, built at true instant 0."""

    def __init__(
        self,
        seed: int,
        setting: Setting,
        crew: ProtocolUnderTest,
        *,
        codec: Codec | None = None,
        tell: Teller | None = None,
    ) -> None:
        self.setting, self.crew = setting, crew
        self.rng = random.Random(seed ^ 0xA11)
        self.net = SimulatedNetwork(seed, codec=codec, tell=tell)
        self.trains = {
            address: TrueTrain(
                address,
                SimulatedMotion(0, front_m, emergency_mps2=self.rng.uniform(1.0, 1.3)),
                length_m=setting.build(address).length_m,
                half_width_m=self.rng.uniform(0.5, 5.0),
                axles=setting.build(address).axles,
            )
            for address, front_m in setting.fronts_m.items()
        }
        self.checker = Checker(self.trains.values(), crew.rules)
        self.drivers: dict[int, SimulatedDriver] = {}
        for address, (name, start) in crew.wayside().items():
            self._add(address, name, start)
        for address in self.trains:
            self._add(address, f"train {address}", self._start_train)
            self._add_driver(address)

    def boot_all(self) -> None:
        for address in self.net.nodes:
            self.net.boot(address)

    def _start_train(self, node: SimulatedNode, now_ns: int) -> NodeMachine:
        driver = self.drivers[node.address]
        driver.restart()
        return TrainNodeController(self.crew.train(node, now_ns), driver, self.net, self.checker)

    def _add(
        self, address: int, name: str, start: Callable[[SimulatedNode, int], NodeMachine]
    ) -> None:
        drift = self.setting.drift_ppm
        clock = NodeClock(
            0, self.rng.randrange(LOCAL_START_NS_MAX), self.rng.randint(-drift, drift)
        )
        node = SimulatedNode(address, name, start, clock)
        node.disk = self.crew.installed(address)
        self.net.add(node)

    def _add_driver(self, address: int) -> None:
        train = self.trains[address]
        self.stops_next(train)
        driver = SimulatedDriver(
            train,
            self.net.nodes[address],
            self.net,
            self.checker,
            stops_m=self.setting.stops_m,
            dwell_ns=int(self.setting.dwell_s * NS_PER_S),
            speed_max_mps=self.setting.speed_max_mps,
        )
        self.drivers[address] = driver
        self.net.at(self.rng.randrange(CONTROL_NS), driver.cycle)

    def stops_next(self, train: TrueTrain) -> None:
        """Make the first stop ahead of the train's position its next one."""
        train.next_stop = sum(stop_m < train.front_m for stop_m in self.setting.stops_m)
        train.dwell_until_ns = 0

    def without_authority(self) -> list[int]:
        """Return the trains on the line whose brake loop holds no authority in force now."""
        return [
            address
            for address, driver in self.drivers.items()
            if self.trains[address].on_line
            and not self.trains[address].shunts
            and not driver.in_force(self.net.now_ns)[0]
        ]

    def unsettled(self, waiting: Sequence[int]) -> bool:
        """Tell whether something goes on now that these trains have to wait for."""
        return any(each.shunts for each in self.trains.values())
