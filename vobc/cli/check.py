"""`vobc check`: judges line, train and parameters together, without a run."""

import argparse
import sys
from collections.abc import Sequence
from typing import Final

from can_dbc.doors import ALL_CARS, cars_text
from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from firmware_py.trackdb import load_line
from vobc.arbitration import most_accel_mps2
from vobc.cli.host import EXIT_OK, EXIT_USAGE
from vobc.config import load_config
from vobc.plausible import cars_at, check_plausible, least_rollback_m

PROG: Final = "vobc check"
DESCRIPTION: Final = (
    "Judge line, train and parameters together, as every start of the controller and `hil check` "
    "do. All contradictions are reported, one line each."
)
EPILOG: Final = "exit codes: 0 they fit; 2 wrong usage, or they do not fit"


def parser() -> argparse.ArgumentParser:
    top = CommandParser(prog=PROG, description=DESCRIPTION, epilog=EPILOG)
    top.add_argument(
        "--line", default="florence", metavar="NAME|FILE", help="line map; default: florence"
    )
    top.add_argument(
        "--params",
        default="florence4",
        metavar="NAME|FILE",
        help="what the controller believes of its train; default: florence4",
    )
    return top


def main(argv: Sequence[str]) -> int:
    """Print what was judged, or every contradiction."""
    options = parser().parse_args(argv)
    try:
        config = load_config(options.params)
        line = load_line(options.line).for_train(config.train.length_m)
        check_plausible(config, line)
    except SettingsError as error:
        for text in str(error).split("\n"):
            print(f"{PROG}: {text}", file=sys.stderr)
        return EXIT_USAGE
    print(f"parameters {config.name} fit line {line.name}")
    climb_permille = line.steepest_climb_permille(line.start_m, line.end_m)
    print(
        f"  rollback: protection keeps it within {line.rollback_m:g} m; on the steepest climb, "
        f"{climb_permille:g} ‰, the brake needs {least_rollback_m(config, line):.2f} m of that"
    )
    empty_mps2 = most_accel_mps2(0.0, train=config.train, load_kg=0.0)
    if empty_mps2 > config.atp.runaway_mps2:
        print(
            f"  traction: its full force gives the empty train {empty_mps2:.2f} m/s², "
            f"atp.runaway_mps2 is {config.atp.runaway_mps2:g}; the vehicle must limit traction by "
            "the load, or declare more"
        )
    for station in line.stations:
        cars = cars_at(config, station)
        doors = "the whole train" if cars == ALL_CARS else cars_text(cars)
        print(f"  doors at {station.name}: {doors}")
    return EXIT_OK
