"""`hil bus`: runs FMUs with CAN by FMI-LS-BUS as the nodes of a bus."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.cli.hil.working import number
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_INTERRUPTED,
    EXIT_OK,
)

if TYPE_CHECKING:
    from metro_hil.foreign_plant.nodes_file import BusNodes

NS_PER_S = 1_000_000_000
SHORT_S = 86_400.0


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "bus",
        help="run FMUs with CAN as the nodes of a bus",
        description="Run FMUs of FMI 3.0 with CAN by FMI-LS-BUS 1.0 as the nodes of a CAN bus in "
        "virtual time, with arbitration and error confinement. It prints what happened at each "
        "node. The same nodes give the same bytes.",
    )
    parser.add_argument(
        "nodes", nargs="+", metavar="FMU|FILE", help="FMUs, or one file of nodes (TOML)"
    )
    parser.add_argument(
        "--for",
        dest="duration_s",
        type=_seconds,
        default=1.0,
        metavar="S",
        help="virtual time, s; default: 1",
    )
    parser.add_argument("--log", metavar="FILE", help="write the frames as a candump log")
    parser.add_argument(
        "--bit-rate",
        type=number(1, 1_000_000),
        metavar="BIT/S",
        help="default: that which the nodes configure, or 250000",
    )
    parser.set_defaults(run=run)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds") from None
    if not 0.0 < value <= SHORT_S:
        raise argparse.ArgumentTypeError(f"{text} is not within 0..{SHORT_S:g}")
    return value


def run(options: argparse.Namespace) -> int:
    """Exit code 0 if the bus ran to the end. Raises SettingsError."""
    from firmware_py.interrupts import Interrupts
    from firmware_py.storage.errors import RecorderError
    from metro_hil.foreign_plant.node_bus import run_nodes
    from metro_hil.foreign_plant.plant import PlantDiedError

    nodes = _nodes(options.nodes)
    interrupts = Interrupts()
    try:
        with interrupts.caught():
            done = run_nodes(
                nodes,
                round(options.duration_s * NS_PER_S),
                None if options.log is None else Path(options.log),
                bit_rate=options.bit_rate,
                interrupted=lambda: interrupts.asked,
            )
    except (PlantDiedError, RecorderError) as error:
        print(f"hil: {error}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    print(f"{done.frames} frames at {done.bit_rate} bit/s, bus load {done.load_ratio:.1%}")
    print("node            sent  confirmed  received  TEC  REC  what else")
    for name, (counts, tec, rec) in done.nodes.items():
        row = f"{counts.transmitted:6} {counts.confirmed:10} {counts.received:9} {tec:4} {rec:4}"
        print(f"{name:13} {row}  {counts.others()}".rstrip())
    for event in done.events:
        print(f"{event.at_ns / NS_PER_S:.6f} s: {event.node} is {event.state.value}")
    if options.log is not None:
        print(f"written: {options.log}")
    return EXIT_INTERRUPTED if done.interrupted else EXIT_OK


def _nodes(words: Sequence[str]) -> "BusNodes":
    from firmware_py.settings import SettingsError
    from metro_hil.foreign_plant.nodes_file import NodeKeys, NodesFile, nodes_of, read_nodes

    files = [word for word in words if not word.endswith(".fmu")]
    if files and len(words) > 1:
        raise SettingsError(f"{files[0]}: a file of nodes stands alone; FMUs end in .fmu")
    if files:
        return read_nodes(Path(files[0]))
    stems = [Path(word).stem for word in words]
    keys = [
        NodeKeys(word, name=stem if stems.count(stem) == 1 else f"{stem}{index}")
        for index, (word, stem) in enumerate(zip(words, stems, strict=True), 1)
    ]
    return nodes_of(NodesFile(tuple(keys)), Path(), "")
