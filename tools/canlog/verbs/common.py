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
"""Limit of stamps in 64 bits of nanoseconds."""
DAY_S: Final = 86_400
COUNT_MAX: Final = 10**12
"""Largest count that an option accepts; no log has more of anything."""


def seconds(text: str) -> float:
    """Parse seconds. Raises ArgumentTypeError for text that is no instant or duration of a log."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= SECONDS_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds of a log")
    return value


def count(text: str) -> int:
    """Parse a count of 0 or more. Raises ArgumentTypeError."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    if int(text) > COUNT_MAX:
        raise argparse.ArgumentTypeError(f"{text} is more than {COUNT_MAX}")
    return int(text)


def offset_s(text: str) -> int:
    """Parse seconds east of Greenwich. Raises ArgumentTypeError for a day or more."""
    try:
        value = int(text)
    except ValueError:
        value = DAY_S
    if abs(value) >= DAY_S:
        raise argparse.ArgumentTypeError(f"{text!r} is no offset within a day, in seconds")
    return value


LOG_HELP: Final = "a log, the folder of a run or part of its name; default: the last run"


def add_log(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """Add the log to read, how to read it, and the DBC files.

    Args:
        required: for a verb that writes beside the log or to a bus: if the user forgets the
            log, it must not take the last run.
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
    """Return the bus that the files define, and report their flaws on standard error.

    Without files it is this project's bus, or an empty one for a log of another bus.

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
    """Return the options for reading; every verb refuses a file without frames."""
    return ReadOptions(
        format=given.format,
        stamps=given.stamps,
        utc_offset_s=given.utc_offset_s,
        channels=tuple(given.channel),
        refuse_empty=True,
    )
