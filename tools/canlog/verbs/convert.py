"""`canlog convert`: writes a log in another format, and lists what that format cannot hold."""

import argparse
import sys
from pathlib import Path

from canlog.convert import convert
from canlog.formats.registry import FORMATS
from canlog.verbs.common import add_log, bus_asked, read_options


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser, required=True)
    parser.add_argument("target", type=Path, metavar="TARGET", help="such as log.blf, log.log.gz")
    parser.add_argument("--to", choices=[each.name for each in FORMATS if each.writes])
    parser.add_argument("--force", action="store_true", help="replace an existing file")
    parser.add_argument(
        "--strict", action="store_true", help="exit with 1 when anything is damaged or lost"
    )


def run(given: argparse.Namespace) -> int:
    damaged, lost = convert(
        given.log,
        given.target,
        form=given.to,
        options=read_options(given),
        bus=bus_asked(given),
        overwrite=given.force,
    )
    for each in damaged:
        print(f"canlog: damaged: {each}", file=sys.stderr)
    for each in lost:
        print(f"canlog: lost: {each}", file=sys.stderr)
    return int(given.strict and bool(damaged or lost))
