"""`canlog find`: ranks the bit fields of a bus that follow a given course."""

import argparse
import json
import math
import sys
from typing import Any, Final

from canlog.damage import LogError
from canlog.field_search import FieldMatch, bits_of, search
from canlog.reader import Log
from canlog.verbs.asked import log_options, read_asked
from canlog.verbs.common import count, seconds

FORMS: Final = ("text", "json")
LEAST: Final = 0.5
"""Default of the least correlation of a match."""
LEAST_MIN: Final = 0.1
"""Below it, noise is listed."""
NOTHING_FOUND: Final = 1


def options(parser: argparse.ArgumentParser) -> None:
    log_options(parser, span=False)
    parser.add_argument(
        "--like",
        required=True,
        metavar="COURSE",
        help="a sketch of seconds and values such as '0:0 10:50 20:0', a CSV file with seconds in"
        " its first column, or a signal as in `canlog plot`",
    )
    parser.add_argument("--column", metavar="NAME", help="of the CSV file; default: the second")
    parser.add_argument(
        "--shift", type=seconds, default=0.0, metavar="S", help="also try the course S s earlier"
        " to S s later",
    )  # fmt: skip
    parser.add_argument(
        "--least",
        type=correlation,
        default=LEAST,
        metavar="R",
        help="the least correlation of a match, in either direction; default: %(default)s",
    )
    parser.add_argument(
        "--limit", type=count, default=10, metavar="N", help="print at most N fields; default: 10"
    )
    parser.add_argument("--as", dest="form", choices=FORMS, default="text")


def correlation(text: str) -> float:
    """Parse a correlation. Raises ArgumentTypeError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not LEAST_MIN <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no correlation from {LEAST_MIN} to 1")
    return value


def run(given: argparse.Namespace) -> int:
    """Print the best fields; return 1 if none follows the course. Raises LogError."""
    from canlog.course import course_of

    if given.shift < 0:
        raise LogError(f"--shift {given.shift:g}: give the seconds in each direction, from 0 on")
    log = read_asked(given, on_disk=True)
    course = course_of(log, given.like, given.column)
    if course.at_ns[-1] < log.start_ns or course.at_ns[0] > log.end_ns:
        raise LogError(
            f"--like {course.name}: begins after {log.path} ends, or ends before it begins"
        )
    found = search(
        log,
        course,
        shift_s=given.shift,
        least=given.least,
        left_out=log.places_of(course.name),
    )[: given.limit]
    if given.form == "json":
        print(json.dumps([_told(each, log) for each in found], indent=1))
    else:
        for each in found:
            print(_line(each, log))
    for warning in log.warnings:
        print(f"canlog: warning: {warning}", file=sys.stderr)
    if not found:
        print(
            f"canlog: no bit field follows {course.name} with a correlation of {given.least:g} or"
            " more; --shift allows for another clock",
            file=sys.stderr,
        )
    return 0 if found else NOTHING_FOUND


def _told(one: FieldMatch, log: Log) -> dict[str, Any]:
    return {
        "correlation": round(one.correlation, 9),
        "channel": one.channel,
        "id": _id_text(one),
        "message": log.bus.on(one.channel).name_of(one.key),
        "signals": _signals(one, log),
        "start": one.start,
        "length": one.length,
        "big_endian": one.big_endian,
        "signed": one.signed,
        "scale": one.scale,
        "offset": one.offset,
        "shift_s": one.shift_s,
        "frames": one.frames,
    }


def _id_text(one: FieldMatch) -> str:
    return f"{one.identifier:0{8 if one.key != one.identifier else 3}X}"


def _signals(one: FieldMatch, log: Log) -> list[str]:
    """Return the signals of the DBC files that share a bit with the field."""
    spec = log.bus.on(one.channel).spec_at(one.key)
    if spec is None:
        return []
    return [
        f"{spec.name}.{each.name}"
        for each in spec.signals
        if bits_of(each.start, each.length, big_endian=each.big_endian) & one.bits()
    ]


def _line(one: FieldMatch, log: Log) -> str:
    """Return a line with the layout as a DBC file has it."""
    shift = f", {one.shift_s:+.3g} s" if one.shift_s else ""
    names = ", ".join(_signals(one, log))
    return (
        f"{one.correlation:+.6f}  {one.channel}  {_id_text(one):>8}  {one.layout:>9}"
        f" ({one.scale:.6g},{one.offset:.6g})  {one.frames} frames{shift}"
        f"{f'  {names}' if names else ''}"
    )
