"""`vobc lines`, `vobc consists` and `vobc show`: the files of lines and trains that ship."""

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any, Final

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError, find, shipped_names, text_of
from firmware_py.trackdb import load_line
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE, SHIPPED_VERBS
from plant_emulator.train_config import PACKAGE as CONSISTS
from plant_emulator.train_config import load_train
from vobc.config import SHIPPED as PARAMS

LINES: Final = "firmware_py.trackdb"
DIVISIONS: Final = "firmware_py.trackdb.division"
PACKAGES: Final = {"line": LINES, "consist": CONSISTS, "params": PARAMS}
"""Package of the shipped files, by the word that `vobc show` takes."""


def main(argv: Sequence[str]) -> int:
    """Run one of the three verbs. `argv` begins with the verb."""
    options = parser().parse_args(argv)
    try:
        if options.verb == "show":
            print(text_of(find(options.name, PACKAGES[options.kind])), end="")
            return EXIT_OK
        lines = options.verb == "lines"
        rows = line_rows() if lines else consist_rows()
    except SettingsError as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    if options.json:
        print(json.dumps({options.verb: rows}, ensure_ascii=False))
    else:
        for row in rows:
            print(line_text(row) if lines else consist_text(row))
    return EXIT_OK


def parser() -> argparse.ArgumentParser:
    """The command line of the three verbs."""
    top = CommandParser(prog="vobc")
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    for verb, words in SHIPPED_VERBS.items():
        parsed = verbs.add_parser(verb, help=words, description=f"{words[0].upper()}{words[1:]}.")
        if verb == "show":
            parsed.add_argument("kind", choices=tuple(PACKAGES), help="kind of the file")
            parsed.add_argument(
                "name", metavar="NAME|FILE", help="name of a shipped file, or a path"
            )
        else:
            parsed.add_argument("--json", action="store_true", help="print one JSON object")
    return top


def line_rows() -> list[dict[str, Any]]:
    """One row for each shipped line."""
    divided = shipped_names(DIVISIONS)
    rows = []
    for name in shipped_names(LINES):
        line = load_line(name)
        rows.append(
            {
                "name": name,
                "stations": len(line.stations),
                "from": line.stations[0].name,
                "to": line.stations[-1].name,
                "length_m": line.end_m - line.start_m,
                "areas": name in divided,
                "description": line.description,
            }
        )
    return rows


def consist_rows() -> list[dict[str, Any]]:
    """One row for each shipped consist."""
    params = shipped_names(PARAMS)
    rows = []
    for name in shipped_names(CONSISTS):
        train = load_train(name)
        rows.append(
            {
                "name": name,
                "cars": len(train.cars),
                "length_m": round(train.length_m, 3),
                "mass_kg": train.mass_kg,
                "params": name in params,
                "description": train.description,
            }
        )
    return rows


def line_text(row: dict[str, Any]) -> str:
    """A row of `line_rows` as one line of text."""
    length_km = row["length_m"] / 1000.0
    divided = ", divided into areas" if row["areas"] else ""
    return (
        f"{row['name']:<20} {row['stations']:>2} stations, {length_km:6.2f} km{divided}: "
        f"{row['description']}"
    )


def consist_text(row: dict[str, Any]) -> str:
    """A row of `consist_rows` as one line of text."""
    params = ", with params" if row["params"] else ""
    return (
        f"{row['name']:<24} {row['cars']} cars, {row['length_m']:6.2f} m{params}: "
        f"{row['description']}"
    )
