"""`plant run --trains N`: serves all trains of a line in real time, each on its own bus, and their
network.
"""

import argparse
import json
from collections.abc import Collection
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from can_dbc.nodes import Node
from firmware_py import rendezvous
from firmware_py.buses import BusKind, open_can, parse_spec
from firmware_py.buses.hub_control import hub_status, start_hub
from firmware_py.clock.clock import WallClock
from firmware_py.clock.executive import Executive, Task, run
from firmware_py.clock.realtime import collect_garbage, die_with_parent, enter_realtime
from firmware_py.interrupts import Interrupts
from firmware_py.ports import CanPort, RadioPort, SerialPort
from firmware_py.settings import SettingsError
from firmware_py.storage.recorder import LineLog
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import LineMap
from plant_emulator.cli.openers import open_tags, open_wayside, refuse_second_plant
from plant_emulator.cli.options import AUTO
from plant_emulator.cli.words import TrainNotices, say, summarise
from plant_emulator.power.box import J_PER_KWH
from plant_emulator.power.supplies import Supply
from plant_emulator.process import TRUTH_COLUMNS, PlantDevice
from plant_emulator.traffic.config import TrafficConfig, plan_traffic
from plant_emulator.traffic.coupling import INTERVAL_NS, Coupling
from plant_emulator.traffic.member import TrafficMember, leader_rear_m, scenarios_of
from plant_emulator.traffic.timetable import Start, lap_timetable, starts
from plant_emulator.wire import COMMAND_IDS
from plant_emulator.world import TrainScenario

NUMBER: Final = "#"
"""Placeholder for the train's number in the name of a bus."""
BUSES: Final = f"embedded:train{NUMBER}"
GARBAGE_MS: Final = 10_000.0
TELL_MS: Final = 10_000.0
NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
ALONE: Final = {
    "start": "--from",
    "end": "--to",
    "driver": "--driver",
    "desk_recording": "--desk-recording",
    "faults": "--faults",
    "truth_feed": "--truth-feed",
    "line_radio": "--line-radio",
}
"""Options that apply to a single train only."""


@dataclass(frozen=True, slots=True)
class _Plan:
    traffic: TrafficConfig
    line: LineMap
    supply: Supply
    starts: tuple[Start, ...]
    scenarios: tuple[TrainScenario, ...]
    buses: tuple[str, ...]


def serve_trains(options: argparse.Namespace) -> int:
    """Serve until asked to end and return the exit code.

    Raises SettingsError, BusError, RadioError, SerialError, OSError.
    """
    plan = _plan(options)
    if options.parent is not None:
        die_with_parent(options.parent)
    ending = Interrupts()
    with ending.caught(), ExitStack() as stack:
        clock = WallClock()
        line = _Line(plan, options, clock, stack)
        executives = [plant.executive for plant in line.plants]
        executives.append(Executive(line.tasks(), clock.now_ns()))
        if options.priority:
            enter_realtime(options.priority)
            garbage = Task("garbage", GARBAGE_MS, collect_garbage, offset_ms=GARBAGE_MS)
            executives.append(Executive([garbage], clock.now_ns()))
        end_ns = None
        if options.duration_s is not None:
            end_ns = clock.now_ns() + round(options.duration_s * NS_PER_S)
        run(
            executives,
            clock,
            lambda now_ns: ending.asked or (end_ns is not None and now_ns >= end_ns),
        )
        line.end(clock.now_ns())
    return ending.exit_code


def _plan(options: argparse.Namespace) -> _Plan:
    for name, option in ALONE.items():
        if getattr(options, name) is not None:
            raise SettingsError(f"{option}: is for one train; not with --trains")
    if options.tags != AUTO or options.radio != AUTO:
        raise SettingsError(
            "--tags, --radio: each of several trains has its own; not with --trains"
        )
    traffic, line, supply = plan_traffic(options.line, options.traffic, options.supply)
    placed = starts(traffic, line, options.trains)
    pattern = BUSES if options.bus == AUTO else options.bus
    if NUMBER not in pattern:
        raise SettingsError(
            f"--bus {pattern}: each train has a bus of its own; write {NUMBER} where its number "
            f"stands, such as socketcan:vcan{NUMBER}"
        )
    scenarios = scenarios_of(
        traffic,
        line,
        placed,
        consist=options.consist,
        seed=options.seed,
        load_ratio=options.load_ratio,
        odometer_error_ratio=options.odometer_error,
    )
    buses = tuple(pattern.replace(NUMBER, str(start.train)) for start in placed)
    return _Plan(traffic, line, supply, placed, scenarios, buses)


class _Wires(NamedTuple):
    """The ports of one train."""

    can: CanPort
    tags: SerialPort
    radio: RadioPort
    truth: LineLog | None


class _Line:
    def __init__(
        self, plan: _Plan, options: argparse.Namespace, clock: WallClock, stack: ExitStack
    ) -> None:
        self._plan, self._stack, self._clock = plan, stack, clock
        self._out = None if options.out is None else Path(options.out)
        supply = plan.supply
        self._coupling = Coupling(plan.traffic, supply)
        self._began = False
        say(
            f"{len(plan.starts)} trains on {plan.line.name}, {supply.name} network, seed "
            f"{options.seed}; they leave once each has a controller:"
        )
        wires = [self._wires(index) for index in range(len(plan.starts))]
        params = plan.traffic.params or options.consist or plan.traffic.consist
        for bus, start in zip(plan.buses, plan.starts, strict=True):
            say(
                f"  vobc run --bus {bus} --line {plan.traffic.line} --from "
                f'"{start.station.name}" --params {params} --ato green'
            )
        start_ns = clock.now_ns()
        self.plants = [
            self._plant(scenario, each, start_ns)
            for scenario, each in zip(plan.scenarios, wires, strict=True)
        ]
        self.members = [self._member(index) for index in range(len(wires))]
        self._notices = [
            TrainNotices(plant, f"train {start.train}")
            for plant, start in zip(self.plants, plan.starts, strict=True)
        ]

    def _wires(self, index: int) -> _Wires:
        """Open the train's ports. An embedded bus that is not served yet is started."""
        plan, clock, stack = self._plan, self._clock, self._stack
        spec, train = plan.buses[index], plan.starts[index].train
        bus = parse_spec(spec)
        if bus.kind is BusKind.EMBEDDED and hub_status(bus.name) is None:
            stack.callback(start_hub(bus.name, bound=True).stop)
        refuse_second_plant(spec, clock, desk_elsewhere=False)
        can = open_can(spec, clock=clock, node="PLANT", accept_ids=COMMAND_IDS)
        stack.callback(can.close)
        truth = None
        if self._out is not None:
            folder = self._out / f"train{train}"
            folder.mkdir(parents=True, exist_ok=True)
            truth = LineLog(folder / "truth.csv", TRUTH_COLUMNS)
            stack.callback(truth.close)
        stack.callback(rendezvous.withdraw, bus.name)
        tags = open_tags(AUTO, spec, stack, quiet=True)
        radio = open_wayside(AUTO, plan.line, spec, clock, stack, quiet=True)
        return _Wires(can, tags, radio, truth)

    def _plant(self, scenario: TrainScenario, wires: _Wires, start_ns: int) -> PlantDevice:
        def shared_port(node: Node, ids: Collection[int]) -> CanPort:
            return wires.can

        return PlantDevice(
            scenario,
            open_port=shared_port,
            tags=wires.tags,
            radio=wires.radio,
            truth=wires.truth,
            start_ns=start_ns,
            epoch_offset_ns=self._clock.epoch_offset_ns,
        )

    def _member(self, index: int) -> TrafficMember:
        plan, length_m = self._plan, self._plan.scenarios[index].train.length_m
        return TrafficMember(
            self.plants[index],
            plan.traffic,
            lap_timetable(plan.traffic, plan.line),
            plan.starts[index],
            start_ns=None,
            leader_rear_m=leader_rear_m(plan.traffic, plan.starts, index, length_m),
        )

    def tasks(self) -> list[Task]:
        interval_ms = INTERVAL_NS / NS_PER_MS
        return [
            Task("network", interval_ms, self.couple, offset_ms=interval_ms),
            Task("words", TELL_MS, self.tell, offset_ms=TELL_MS),
        ]

    def couple(self, now_ns: int) -> None:
        """Collect all trains' loads, solve the network, and return the results to the trains."""
        if not self._began and all(plant.wire.commands for plant in self.plants):
            self._began = True
            say("every train has a controller: the timetable begins")
            for member in self.members:
                member.begin(now_ns)
        said = [member.says(now_ns) for member in self.members]
        for member, answer in zip(self.members, self._coupling.answers(said), strict=True):
            member.on_message(answer)
        for words in self._notices:
            words.tell()

    def tell(self, now_ns: int) -> None:
        """Print the state of the network periodically."""
        volts = [plant.world.power.voltage_v for plant in self.plants]
        given_kw = sum(self._coupling.substations_w) / 1e3
        moving = sum(plant.world.speed_mps != 0.0 for plant in self.plants)
        say(
            f"{self.plants[0].elapsed_s:.0f} s: {moving} of {len(volts)} trains move, "
            f"{min(volts):.0f} to {max(volts):.0f} V, substations give {given_kw:.0f} kW"
        )

    def end(self, now_ns: int) -> None:
        for plant in self.plants:
            plant.stop(now_ns)
        for words in self._notices:
            words.say_end()
        books, network = self._coupling.books, self._coupling.network
        say(
            f"from the grid {books.sources_j / J_PER_KWH:.2f} kWh, regenerated "
            f"{books.regenerated_j / J_PER_KWH:.2f}, burnt {books.resistor_j / J_PER_KWH:.2f}; "
            f"{network.unconverged} of {network.solved} instants without a solution"
        )
        if self._out is not None:
            text = json.dumps(self._summary(), indent=2)
            write_whole(self._out / "line.json", text + "\n")

    def _summary(self) -> dict[str, Any]:
        books, network = self._coupling.books, self._coupling.network
        return {
            "actual_kwh": books.sources_j / J_PER_KWH,
            "regenerated_kwh": books.regenerated_j / J_PER_KWH,
            "resistor_kwh": books.resistor_j / J_PER_KWH,
            "closure_ratio": books.closure_ratio,
            "unconverged": network.unconverged,
            "solved": network.solved,
            "trains": {
                f"train{member.train}": {
                    **summarise(plant, None),
                    "runs": [run._asdict() for run in member.dispatcher.runs],
                }
                for plant, member in zip(self.plants, self.members, strict=True)
            },
        }
