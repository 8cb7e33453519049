"""`vobc export`: writes lines and trains in formats that other tools read."""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError, find, parse
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import LineMap, load_line
from firmware_py.trackdb.circuit import load_network, split_route
from firmware_py.trackdb.network_file import is_network
from metro_hil.exchange.railml_export import railml_text
from metro_hil.exchange.railml_network_export import ExportedNetwork, railml_network_text
from metro_hil.exchange.train_export import (
    LOST_BY_TTOBENCH,
    ExportedTrain,
    load_exported,
    railml_train_text,
    ttobench_train_text,
)
from metro_hil.exchange.ttobench_export import LOST, ttobench_text
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE

PROG: Final = "vobc export"
DESCRIPTION: Final = (
    "Write a line or a network as infrastructure of railML 3.2, a line as a track of TTOBench, or "
    "a consist as rolling stock of railML 3.2 or as a train of TTOBench. `vobc import` reads all "
    "of them back: "
    "railML gives the same line, network and consist again."
)
EPILOG: Final = "exit codes: 0 the file is written; 2 wrong usage, or the file cannot be read"
KMH_PER_MPS: Final = 3.6
SPEED_KMH: Final = 80.0
FORMATS: Final[Mapping[str, tuple[str, Callable[[LineMap], str], tuple[str, ...]]]] = {
    "railml": (".railml", railml_text, ()),
    "ttobench": (".json", ttobench_text, LOST),
}
"""Suffix of the file, the writer of lines, and what the format has no place for."""
TRAINS: Final[Mapping[str, tuple[Callable[[ExportedTrain], str], tuple[str, ...]]]] = {
    "railml": (railml_train_text, ()),
    "ttobench": (ttobench_train_text, LOST_BY_TTOBENCH),
}
"""The writer of trains, and what the format has no place for."""


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc export`."""
    top = CommandParser(prog=PROG, description=DESCRIPTION, epilog=EPILOG)
    top.add_argument(
        "line",
        nargs="?",
        metavar="NAME|FILE",
        help="line, network, or FILE:ROUTE for one route of it",
    )
    top.add_argument("--consist", metavar="NAME|FILE", help="write this train instead of a line")
    top.add_argument(
        "--max-speed",
        type=float,
        default=SPEED_KMH,
        metavar="KMH",
        help=f"greatest speed of the train, which a consist does not have; default: {SPEED_KMH:g}",
    )
    top.add_argument("--as", dest="form", choices=tuple(FORMATS), required=True, help="format")
    top.add_argument("--out", metavar="FILE", help="default: its name in this folder")
    top.add_argument("--force", action="store_true", help="replace a file that exists")
    return top


def main(argv: Sequence[str]) -> int:
    """Write the file, and print what the format has no place for."""
    options = parser().parse_args(argv)
    try:
        name, text, lost = _written(options)
        path = Path(options.out or f"{name}{FORMATS[options.form][0]}")
        if path.exists() and not options.force:
            raise SettingsError(f"{path}: exists; give --force to replace it")
    except SettingsError as error:
        print(f"{PROG}: {error}", file=sys.stderr)
        return EXIT_USAGE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text)
    print(f"wrote {path}")
    for each in lost:
        print(f"  left out: {each}")
    print(f"next: vobc import {path}")
    return EXIT_OK


def _network(name: str) -> ExportedNetwork | None:
    """The whole network of a file; None for a line, or for one route of a network."""
    base, route = split_route(name)
    table = parse(find(base, "firmware_py.trackdb"))
    if route is not None or not is_network(table):
        return None
    return ExportedNetwork(load_network(base), table)


def _written(options: argparse.Namespace) -> tuple[str, str, tuple[str, ...]]:
    """Name, text, and what the format has no place for. Raises SettingsError."""
    if (options.line is None) == (options.consist is None):
        raise SettingsError("name either a line, or a train with --consist")
    if options.line is not None:
        exported = _network(options.line)
        if exported is not None and options.form == "railml":
            return exported.network.name, railml_network_text(exported), ()
        line = load_line(options.line)
        _, write_line, lost = FORMATS[options.form]
        return line.name, write_line(line), lost
    if not 0.0 < options.max_speed <= 500.0:
        raise SettingsError(f"--max-speed {options.max_speed:g}: is not in 0..500 km/h")
    train = load_exported(options.consist, options.max_speed / KMH_PER_MPS)
    write_train, lost = TRAINS[options.form]
    return train.config.name, write_train(train), lost
