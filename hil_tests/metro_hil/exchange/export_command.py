"""`vobc export`: writes a line in a format that other tools read."""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import LineMap, load_line
from metro_hil.exchange.railml_export import railml_text
from metro_hil.exchange.ttobench_export import LOST, ttobench_text
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE

PROG: Final = "vobc export"
DESCRIPTION: Final = (
    "Write a line as infrastructure of railML 3.2 or as a track of TTOBench. `vobc import` reads "
    "both back: railML gives the same line again."
)
EPILOG: Final = "exit codes: 0 the file is written; 2 wrong usage, or the line cannot be read"
FORMATS: Final[Mapping[str, tuple[str, Callable[[LineMap], str], tuple[str, ...]]]] = {
    "railml": (".railml", railml_text, ()),
    "ttobench": (".json", ttobench_text, LOST),
}
"""Suffix of the file, its writer, and what the format has no place for."""


def parser() -> argparse.ArgumentParser:
    """The command line of `vobc export`."""
    top = CommandParser(prog=PROG, description=DESCRIPTION, epilog=EPILOG)
    top.add_argument("line", metavar="NAME|FILE", help="line, or FILE:ROUTE of a network")
    top.add_argument("--as", dest="form", choices=tuple(FORMATS), required=True, help="format")
    top.add_argument("--out", metavar="FILE", help="default: the line's name in this folder")
    top.add_argument("--force", action="store_true", help="replace a file that exists")
    return top


def main(argv: Sequence[str]) -> int:
    """Write the file, and print what the format has no place for."""
    options = parser().parse_args(argv)
    suffix, text, lost = FORMATS[options.form]
    try:
        line = load_line(options.line)
        path = Path(options.out or f"{line.name}{suffix}")
        if path.exists() and not options.force:
            raise SettingsError(f"{path}: exists; give --force to replace it")
    except SettingsError as error:
        print(f"{PROG}: {error}", file=sys.stderr)
        return EXIT_USAGE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text(line))
    print(f"wrote {path}")
    for each in lost:
        print(f"  left out: {each}")
    print(f"next: vobc import {path}")
    return EXIT_OK
