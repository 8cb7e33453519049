"""Options that several subcommands share."""

import argparse
from pathlib import Path

from metro_tools.canlog.formats.registry import FORMATS
from metro_tools.canlog.options import DELTA, ZERO, ReadOptions


def add_log(parser: argparse.ArgumentParser) -> None:
    """The log to read, how to read it, and the DBC files."""
    parser.add_argument("log", type=Path, metavar="LOG", help="a log, or the folder of a run")
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dbc", action="append", type=Path, help="instead of this project's; may be repeated"
    )
    parser.add_argument("--format", choices=[each.name for each in FORMATS])
    parser.add_argument(
        "--stamps", choices=(DELTA, ZERO), help="what `candump -t d` or `-t z` wrote"
    )
    parser.add_argument(
        "--utc-offset-s", type=int, default=0, help="of formats with local time, east positive"
    )


def read_options(given: argparse.Namespace) -> ReadOptions:
    return ReadOptions(format=given.format, stamps=given.stamps, utc_offset_s=given.utc_offset_s)
