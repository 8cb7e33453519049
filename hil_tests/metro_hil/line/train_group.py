"""Several trains that command themselves, each with controller, plant and bus, in virtual time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

from can_dbc.nodes import Node
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock.clock import LockstepClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.ports import CanPort
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.storage.checked_store import CheckedStore
from firmware_py.storage.nvram import Nvram, NvramRecord
from firmware_py.tag_reader.inproc_line import inproc_line
from firmware_py.trackdb import load_line
from firmware_py.trackdb.areas import AreaMap
from firmware_py.trackdb.version import database_version
from plant_emulator.process import PlantDevice
from plant_emulator.wayside.line_wayside import Disks, LineWayside, WaysideTruth
from plant_emulator.wayside.railway import subscriptions
from plant_emulator.wayside.t2t_vocabulary import ArbiterMemory, ObjectMemory
from plant_emulator.world import NOTHING, plan_scenario
from vobc.config import VobcConfig, plan_mission
from vobc.process import VobcDevice
from vobc.process.line_command import LineCommand, commanded
from vobc.train_to_train.train import TrainCore
from vobc.train_to_train.vocabulary import Role, T2tConfig, TrainMemory
from vobc.wire import RECEIVED_IDS
from vobc.wire.line_radio import LineRadio
from zenoh_config import keys

BIT_RATE: Final = 250_000
WAYSIDE_MS: Final = 10.0
WAYSIDE: Final = "wayside"
TRACK: Final = "track"
AXLES: Final = 16
AXLE_INSET_M: Final = 2.0
NS_PER_S: Final = 1_000_000_000


class TrainRun(NamedTuple):
    """Start and end of a train's run, as names of stations."""

    start: str
    end: str
    stops: tuple[str, ...] | None = None
    """Stations at which the train stops, its end included; None: all stations on the way."""


class BenchTrain(NamedTuple):
    bus: InprocBus
    plant: PlantDevice
    vobc: VobcDevice
    command: LineCommand


class LineBench:
    """Trains 1, 2, ... on one line, the foremost first; each has its own bus and centre.

    Messages between trains and wayside about the line use `air`, which can lose, delay and cut.
    """

    def __init__(
        self,
        config: VobcConfig,
        areas: AreaMap,
        runs: Sequence[TrainRun],
        *,
        t2t: T2tConfig | None = None,
        seed: int = 1,
        line: str | None = None,
        real: Mapping[str, Any] = NOTHING,
        apart: bool = False,
    ) -> None:
        """Create the trains.

        Raises SettingsError if line and stations do not fit together.

        `apart`: each arbiter, and the track, is a program of its own, which can crash alone.

        `line` is a path; None: the line of the areas. `real` is as for `plan_scenario`.
        """
        self.clock = LockstepClock()
        self.air = InprocRadio(0.005)
        self.areas = areas
        self.trains: dict[int, BenchTrain] = {}
        self._t2t = t2t or T2tConfig()
        self._config = commanded(config, self._t2t.timers)
        self._seed = seed
        self._line, self._real = line or areas.name, real
        self._executives: list[Executive] = []
        stores = {address: CheckedStore(None, ArbiterMemory) for address in self._t2t.arbiters}
        self._stores = stores
        self._objects = {site.number: ObjectMemory() for site in areas.objects}
        self._wayside_starts = 0
        self._apart = apart
        self._programs: dict[str, LineWayside | None] = {}
        """Programs of the wayside by name; None while one is down."""
        self.release_wanted: set[int] = set()
        """Numbers of objects whose release is requested."""
        self._ports = {}
        for name in self._parts():
            wayside = self._programs[name] = self._new_wayside(name, 0)
            self._ports[name] = self.air.port(name, wayside.subscriptions)
        for number, way in enumerate(runs, start=1):
            self._add(number, way)
        self._executives.append(Executive([Task("wayside", WAYSIDE_MS, self._wayside)], 0))

    def _add(self, address: int, way: TrainRun) -> None:
        config = replace(self._config, address=address)
        line = load_line(self._line).for_train(config.train.length_m)
        scenario = plan_scenario(
            line=self._line,
            consist=config.name,
            start=way.start,
            end=way.end,
            seed=self._seed + address,
            real=self._real,
        )
        bus = InprocBus(f"train{address}", BIT_RATE, None)
        radio = InprocRadio()
        controller_end, reader_end = inproc_line()

        def open_node(node: Node, accept_ids: frozenset[int]) -> CanPort:
            return bus.port(node.name, accept_ids)

        plant = PlantDevice(
            scenario,
            open_port=open_node,
            tags=reader_end,
            radio=radio.port("centre", subscriptions(line.name)),
            truth=None,
            start_ns=0,
        )
        store = CheckedStore(None, TrainMemory)
        core = TrainCore(self._t2t, self.areas, address=address, memory=TrainMemory(), start_ns=0)
        line_radio = LineRadio(core, self.areas.name, store.put, database=database_version(line))
        port = self.air.port(f"train {address}", line_radio.subscriptions)
        command = LineCommand(line_radio, port, config, line, axles=AXLES)
        vobc = VobcDevice(
            config,
            line,
            plan_mission(line, way.start, way.end, way.stops),
            can=bus.port(Node.VOBC.name, RECEIVED_IDS),
            tags=controller_end,
            radio=radio.port("train", (keys.orders(line.name, address),)),
            nvram=Nvram(None, NvramRecord(boot_count=1)),
            cycle_log=None,
            start_ns=0,
            command=command,
        )
        self.trains[address] = BenchTrain(bus, plant, vobc, command)
        self._executives += [plant.executive, vobc.executive]

    def run(self, duration_s: float, look: Callable[[], None] | None = None) -> None:
        """Run for a while; `look` is called before every release."""
        end_ns = self.clock.now_ns() + round(duration_s * NS_PER_S)

        def over(now_ns: int) -> bool:
            if look is not None:
                look()
            return now_ns >= end_ns

        run(self._executives, self.clock, over)

    def kill(self, address: int) -> None:
        """Kill the controller of a train between two instructions; its plant goes on."""
        self._executives.remove(self.trains[address].vobc.executive)

    def stop(self, address: int) -> Executive:
        """Stop the controller of a train until `go_on`."""
        executive = self.trains[address].vobc.executive
        self._executives.remove(executive)
        return executive

    def go_on(self, executive: Executive) -> None:
        self._executives.append(executive)

    def crash_wayside(self, name: str = WAYSIDE) -> None:
        """Crash a program of the wayside; it loses everything that it did not store."""
        assert self._programs[name] is not None
        self._programs[name] = None

    def restart_wayside(self, name: str = WAYSIDE) -> None:
        self._programs[name] = self._new_wayside(name, self.clock.now_ns())

    def _parts(self) -> list[str]:
        arbiters = [f"arbiter {address}" for address in self._t2t.arbiters]
        return [*arbiters, TRACK] if self._apart else [WAYSIDE]

    def _new_wayside(self, name: str, now_ns: int) -> LineWayside:
        self._wayside_starts += 1
        own = {a for a in self._stores if not self._apart or name == f"arbiter {a}"}

        def store_object(number: int, memory: ObjectMemory) -> bool:
            self._objects[number] = memory
            return True

        disks = Disks(
            {a: self._stores[a].value or ArbiterMemory() for a in sorted(own)},
            dict(self._objects),
            lambda address, memory: self._stores[address].put(memory),
            store_object,
        )
        return LineWayside(
            *(self._t2t.timers, self.areas, disks),
            boot=self._wayside_starts,
            start_ns=now_ns,
            database=database_version(load_line(self._line)),
            arbiters=self._t2t.arbiters,
            serves_track=name in (WAYSIDE, TRACK),
        )

    @property
    def behind_rear_m(self) -> float:
        """Least distance from the end of an authority to the train ahead."""
        return self._t2t.rollback_m

    def masters(self, area: int) -> list[int]:
        return [
            address
            for address, train in self.trains.items()
            if train.command.radio.roles.get(area) is Role.MASTER
            and train.vobc.executive in self._executives
        ]

    def _wayside(self, now_ns: int) -> None:
        truth = self._truth()
        for name, port in self._ports.items():
            heard, program = port.receive(now_ns), self._programs[name]
            if program is not None:
                for key, payload in program.step(now_ns, heard, truth):
                    port.send(now_ns, key, payload)

    def _truth(self) -> WaysideTruth:
        axles: dict[int, int] = {}
        occupied = set()
        for train in self.trains.values():
            world = train.plant.world
            step_m = (world.length_m - 2.0 * AXLE_INSET_M) / (AXLES - 1)
            places_m = [world.front_m - AXLE_INSET_M - n * step_m for n in range(AXLES)]
            first_m, last_m = places_m[0], places_m[-1]
            # A line has hundreds of sections, and a train stands in few of them.
            below = [
                section
                for section in self.areas.sections
                if section.start_m <= first_m and last_m < section.end_m
            ]
            for at_m in places_m:
                for section in below:
                    if section.start_m <= at_m < section.end_m:
                        axles[section.number] = axles.get(section.number, 0) + 1
            rear_m = world.front_m - world.length_m
            for site in self.areas.objects:
                if rear_m < site.end_m and site.start_m < world.front_m:
                    occupied.add(site.number)
        return WaysideTruth(axles, occupied, self.release_wanted)
