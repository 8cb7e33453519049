"""Starts the plant that a case names."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from can_dbc.nodes import Node
from firmware_py.buses.inproc import VirtualBus
from firmware_py.ports import CanPort
from firmware_py.settings import SettingsError
from metro_hil.external_controller import ControllerProgram, ControllerStartError, program_of
from metro_hil.foreign_plant.node_wire import NodeWire
from metro_hil.foreign_plant.nodes_file import read_nodes
from metro_hil.foreign_plant.plant import ForeignPlant, PlantDiedError, PlantStartError
from metro_hil.model.case import ControllerSpec, PlantSpec
from metro_hil.model.run_options import PLANTS
from plant_emulator.consist import Consist
from plant_emulator.world import STEP_NS, STEP_S, TrainScenario
from vobc.process.commission import plain

NODES: Final = "nodes"
"""Kind of a plant that is the shipped one with LS-BUS nodes beside it."""
PLANT_PORT: Final = "PLANT"
"""Name of the port at which a foreign plant receives the controller's frames."""
BENCH_PORTS: Final = (PLANT_PORT, "STRANGER", "BABBLER")


def read_plant(text: str) -> PlantSpec:
    """Parse the value of `--plant`. Raises PlantStartError."""
    if text in PLANTS:
        return PlantSpec()
    kind, _, rest = text.partition(":")
    if kind == "command" and rest:
        return PlantSpec(kind=kind, command=rest)
    if kind == "fmu" and rest:
        return PlantSpec(kind=kind, mapping=rest)
    if kind == NODES and rest:
        return PlantSpec(kind=kind, nodes=rest)
    raise PlantStartError(
        f"--plant {text}: `command:WORDS`, `fmu:MAPPING` or `nodes:FILE` is needed"
    )


def start_nodes(spec: PlantSpec, bus: VirtualBus, acting: Mapping[int, str]) -> NodeWire:
    """Start LS-BUS nodes on the bus of a train. Raises SettingsError or PlantStartError.

    Args:
        acting: see `DisturbedWire`.
    """
    nodes = read_nodes(Path(spec.nodes))
    for name in nodes.hellos:
        if name in Node.__members__ or name in BENCH_PORTS:
            raise SettingsError(
                f"{spec.nodes}: node name {name!r} is one of the bench; choose another"
            )
    processes = nodes.start(spec.lease_s)
    try:
        return NodeWire(bus, processes, nodes.errors, nodes.filters, acting)
    except PlantDiedError as error:
        for each in processes:
            each.close()
        raise PlantStartError(str(error)) from error


def start_plant(spec: PlantSpec, scenario: TrainScenario, port: CanPort) -> ForeignPlant:
    """Start the program of a plant that is not the shipped one. Raises PlantStartError.

    Args:
        port: receives the frames of the controller.
    """
    return ForeignPlant(_program_of(spec), table_of(scenario), port=port, lease_s=spec.lease_s)


def _program_of(spec: PlantSpec) -> ControllerProgram:
    if spec.kind == "fmu":
        words = (sys.executable, "-m", "metro_hil.foreign_plant.host", spec.mapping)
        return ControllerProgram(words, dict(os.environ))
    try:
        return program_of(ControllerSpec(kind=spec.kind, command=spec.command))
    except ControllerStartError as error:
        raise PlantStartError(f"plant{str(error).removeprefix('controller')}") from error


def table_of(scenario: TrainScenario) -> dict[str, Any]:
    """Content of hello."""
    train, front_m = scenario.train, scenario.start.stop_m
    consist = Consist(train, scenario.line, front_m=front_m, step_s=STEP_S)
    weight_kn = sum(car.weight_n for car in consist.cars) / 1000.0
    resistance = train.resistance
    return {
        "start_ns": 0,
        "step_ns": STEP_NS,
        "seed": scenario.seed,
        "front_m": front_m,
        "mission": {"start": scenario.start.name, "destination": scenario.destination.name},
        "train": {
            "mass_kg": consist.mass_kg,
            "inertia_kg": consist.inertia_kg,
            "length_m": train.length_m,
            "resistance_n": weight_kn * resistance.a_n_per_kn,
            "resistance_n_per_mps": weight_kn * resistance.b_n_per_kn_per_mps,
            "resistance_n_per_mps2": weight_kn * resistance.c_n_per_kn_per_mps2,
        },
        "consist": plain(train),
        "line": plain(scenario.line),
    }
