"""Options that several subcommands share."""

import argparse
import math
import sys
from pathlib import Path
from typing import Final

from canlog.database import Bus, load_bus, no_bus
from canlog.formats.registry import FORMATS
from canlog.options import DELTA, ZERO, ReadOptions
from canlog.own_logs import OWN, own_or_none, remember, remembered

SECONDS_MAX: Final = 9.0e9
"""Stamps of 64 bits reach so far."""
DAY_S: Final = 86_400
COUNT_MAX: Final = 10**12
"""Beyond, nothing is counted in a log."""


def seconds(text: str) -> float:
    """Of an option. Raises ArgumentTypeError for what is no instant or duration of a log."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= SECONDS_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds of a log")
    return value


def count(text: str) -> int:
    """Of an option; not negative. Raises ArgumentTypeError."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    if int(text) > COUNT_MAX:
        raise argparse.ArgumentTypeError(f"{text} is more than {COUNT_MAX}")
    return int(text)


def offset_s(text: str) -> int:
    """East of Greenwich. Raises ArgumentTypeError for more than a day."""
    try:
        value = int(text)
    except ValueError:
        value = DAY_S
    if abs(value) >= DAY_S:
        raise argparse.ArgumentTypeError(f"{text!r} is no offset within a day, in seconds")
    return value


LOG_HELP: Final = "a log, the folder of a run or part of its name; default: the last run"


def add_log(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """The log to read, how to read it, and the DBC files.

    Args:
        required: for a verb that writes beside the log or onto a bus: a forgotten word must not
            make it take the last run.
    """
    if required:
        parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP.partition(";")[0])
    else:
        parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help=LOG_HELP)
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dbc",
        action="append",
        metavar="[CHANNEL=]FILE",
        help="DBC, KCD, SYM or ARXML, of one channel or of all, instead of this project's; may be"
        f" repeated; {OWN} is this project's, also for a log of another bus",
    )
    parser.add_argument("--no-dbc", action="store_true", help="decode nothing")
    parser.add_argument(
        "--remember", action="store_true", help="use these files for all logs of the folder"
    )
    parser.add_argument(
        "--channel",
        action="append",
        default=[],
        metavar="NAME",
        help="only frames of this channel of the log; may be repeated",
    )
    parser.add_argument("--format", choices=[each.name for each in FORMATS])
    parser.add_argument(
        "--stamps", choices=(DELTA, ZERO), help="what `candump -t d` or `-t z` wrote"
    )
    parser.add_argument(
        "--utc-offset-s", type=offset_s, default=0, help="of formats with local time, east positive"
    )


def bus_asked(given: argparse.Namespace) -> Bus:
    """What the files know; every flaw of them goes to standard error.

    Without files it is this project's bus, but for a log of another one, which is shown undecoded.

    Raises:
        LogError: names the file that cannot be used.
    """
    if given.no_dbc:
        return no_bus()
    logs = [getattr(given, name, None) for name in ("log", "a", "b")]
    paths = [path for path in logs if path is not None]
    if given.dbc is None:
        return remembered(paths) or own_or_none(paths, read_options(given))
    bus = load_bus(None if given.dbc == [OWN] else given.dbc)
    if given.remember:
        remember(paths, given.dbc)
    for each in bus.warnings:
        print(f"canlog: warning: {each}", file=sys.stderr)
    return bus


def read_options(given: argparse.Namespace) -> ReadOptions:
    """No verb takes a file without a frame."""
    return ReadOptions(
        format=given.format,
        stamps=given.stamps,
        utc_offset_s=given.utc_offset_s,
        channels=tuple(given.channel),
        refuse_empty=True,
    )
