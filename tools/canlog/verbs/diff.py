"""`canlog diff A B`: compares two runs signal by signal, or two DBC files."""

import argparse
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final

from canlog.damage import LogError
from canlog.verbs.common import add_reading, bus_asked, count, read_options, seconds

SAME: Final = 0
DIFFERENT: Final = 1
DBC: Final = ".dbc"


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "a", type=Path, metavar="A", help="a log, a run or part of its name, or a DBC file"
    )
    parser.add_argument("b", type=Path, metavar="B")
    add_reading(parser)
    parser.add_argument(
        "--lsb", type=count, default=1, metavar="N", help="raw steps allowed; default: 1"
    )
    parser.add_argument(
        "--tolerance",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="for a signal, MESSAGE.signal or pattern, in its unit; may be repeated",
    )
    parser.add_argument(
        "--ignore", action="append", default=[], metavar="PATTERN", help="message or MESSAGE.signal"
    )
    parser.add_argument("--trailer", action="store_true", help="compare counters and CRCs, too")
    parser.add_argument(
        "--timing-ms", type=seconds, help="maximum distance of two frames of a pair"
    )
    parser.add_argument(
        "--align",
        default="start",
        metavar="HOW",
        help="start (of the run or log), absolute, or a message whose first frame is zero",
    )
    parser.add_argument("--context", type=count, default=5, help="frames around; default: 5")
    parser.add_argument(
        "--comments", action="store_true", help="compare comments of DBC files, too"
    )
    parser.add_argument("--json", action="store_true")


def run(given: argparse.Namespace) -> int:
    """Return 0 if nothing differs, 1 if something does. Raises LogError."""
    kinds = {path.suffix.lower() == DBC for path in (given.a, given.b)}
    if len(kinds) > 1:
        raise LogError("diff: compare two logs or two DBC files, not one of each")
    return _dbcs(given) if kinds == {True} else _logs(given)


def _dbcs(given: argparse.Namespace) -> int:
    from canlog.compare.dbcs import compare_buses
    from canlog.compare.told import change_lines, changes_json
    from canlog.database import load_bus

    changes = compare_buses(load_bus(given.a), load_bus(given.b), comments=given.comments)
    if given.json:
        print(json.dumps(changes_json(changes), indent=1))
    else:
        _print(change_lines(changes))
    return DIFFERENT if changes else SAME


def _logs(given: argparse.Namespace) -> int:
    from canlog.compare.logs import Allowed, compare
    from canlog.compare.told import difference_json, difference_lines, parse_tolerances
    from canlog.reader import read

    if given.lsb < 0 or given.context < 0:
        raise LogError("--lsb, --context: 0 or more")
    allowed = Allowed(
        lsb=given.lsb,
        physical=parse_tolerances(given.tolerance),
        ignored=tuple(given.ignore),
        trailer=given.trailer,
        timing_ms=given.timing_ms,
    )
    bus = bus_asked(given)
    options = replace(read_options(given), on_disk=True)
    a, b = (read(path, bus, options) for path in (given.a, given.b))
    found = compare(a, b, allowed, given.align)
    if not found.messages:
        raise LogError(f"--ignore {' '.join(given.ignore)}: leaves no message to compare")
    if given.json:
        print(json.dumps(difference_json(found, a, b, given.context), indent=1))
    else:
        _print(f"warning: {log.path}: {each}" for log in (a, b) for each in log.warnings)
        _print(difference_lines(found, a, b, given.context))
    return DIFFERENT if found.differs else SAME


def _print(lines: Iterable[str]) -> None:
    for line in lines:
        print(line)
