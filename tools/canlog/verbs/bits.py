"""`canlog bits`: shows which bits of each identifier change, for a bus without a DBC file."""

import argparse
import json
import os
import sys
from collections.abc import Iterator
from typing import Any, Final

from canlog.bit_activity import Activity, ActivityView
from canlog.database import Bus
from canlog.frames import KEY_EXTENDED
from canlog.reader import stream
from canlog.select import Selection, Selector, parse_keys
from canlog.table import Groups
from canlog.verbs.common import add_log, bus_asked, read_options

FORMS: Final = ("text", "json")
SHADES: Final = ".:-=+*#%@"
"""Characters from a bit that never changes to one that changes in every frame."""
HEAT: Final = ("2", "34", "34", "36", "36", "32", "33", "31", "1;31")
"""Terminal colours for the same levels."""


def options(parser: argparse.ArgumentParser) -> None:
    add_log(parser)
    parser.add_argument(
        "--id", action="append", default=[], metavar="HEX", help="as in `canlog show`"
    )
    parser.add_argument("--as", dest="form", choices=FORMS, default="text")


def run(given: argparse.Namespace) -> int:
    """Print the bit activity of each identifier. Raises LogError."""
    bus, source = bus_asked(given), stream(given.log, read_options(given))
    wanted = Selection(keys=tuple(parse_keys(text) for text in given.id))
    selector, view = Selector(wanted, bus), ActivityView()
    for frames in source:
        rows = selector.rows(frames, Groups(frames)) if given.id else None
        view.feed(frames if rows is None else frames[rows])
    found = [view.found[place] for place in sorted(view.found)]
    if given.form == "json":
        print(json.dumps([_told(each, bus) for each in found], indent=1))
    else:
        colour = sys.stdout.isatty() and "NO_COLOR" not in os.environ
        for each in found:
            print("\n".join(lines_of(each, bus, colour=colour)))
    for warning in source.warnings:
        print(f"canlog: warning: {warning}", file=sys.stderr)
    return 0


def _told(one: Activity, bus: Bus) -> dict[str, Any]:
    return {
        "channel": one.channel,
        "id": _id_text(one.key),
        "message": bus.on(one.channel).name_of(one.key),
        "frames": one.frames,
        "flips": one.flips.tolist(),
        "flip_ratio": one.flip_ratio.round(6).tolist(),
        "entropy_bits": one.entropy_bits.round(4).tolist(),
    }


def _id_text(key: int) -> str:
    return f"{key & ~KEY_EXTENDED:08X}" if key & KEY_EXTENDED else f"{key:03X}"


def lines_of(one: Activity, bus: Bus, *, colour: bool = False) -> Iterator[str]:
    """Yield a head line, the bits of all bytes, highest first, and the entropy of each byte."""
    name = bus.on(one.channel).name_of(one.key)
    known = "" if name == _id_text(one.key) else f"  {name}"
    moving = int((one.flips > 0).sum())
    yield (
        f"{one.channel}  {_id_text(one.key):>8}{known}  {one.frames} frames,"
        f" {moving} of {8 * one.width} bits change"
    )
    shades = ["".join(_shade(ratio, colour) for ratio in byte) for byte in one.flip_ratio.tolist()]
    yield f"  bits     {' '.join(shades)}".rstrip()
    yield f"  entropy  {' '.join(f'{value:8.2f}' for value in one.entropy_bits.tolist())}".rstrip()


def _shade(ratio: float, colour: bool) -> str:
    level = 0 if ratio == 0 else 1 + min(int(ratio * (len(SHADES) - 1)), len(SHADES) - 2)
    return f"\x1b[{HEAT[level]}m{SHADES[level]}\x1b[0m" if colour else SHADES[level]
