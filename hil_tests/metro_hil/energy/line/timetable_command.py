"""`vobc timetable`: finds turnback phase, run splits and regimes that save energy on a line."""

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Final

from rich.console import Console
from rich.table import Table

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from metro_hil.energy.line.command import write_timetable
from metro_hil.energy.line.model import (
    HOLD_AND_COAST,
    TRADITIONAL,
    LineTrain,
    Timetable,
    line_supply,
)
from metro_hil.energy.line.service_command import (
    divide_trip,
    free_file,
    save_on_line,
    save_on_network,
)
from metro_hil.energy.line.simulate import dwells_of, simulate
from metro_hil.energy.line.synchronise import TimetableSearch
from metro_hil.energy.line.table_four import paired
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from metro_hil.model.terminal import console_for

CHANGPING: Final = "changping"
STRONG: Final = "strong"
DESCRIPTION: Final = (
    "Find a timetable in which accelerating and braking trains meet, at unchanged trip times and "
    "headway, judged with dwells that the search did not use. For the seven trains of the "
    "Changping section, on points of mass: turnback phase, run splits, speeds to hold and points "
    "to coast from. With --traffic, for any line: running times, on designed runs and the whole "
    "supply. With --service, for trains that turn round: running times and layovers. With another "
    "line alone, divide the trip time among its hops so that the designed runs take the least "
    "energy."
)
JUDGING_SEEDS: Final = tuple(range(101, 107))


def parser() -> argparse.ArgumentParser:
    """Return the parser of `vobc timetable`."""
    top = CommandParser(prog="vobc timetable", description=DESCRIPTION)
    top.add_argument("--save-energy", action="store_true", required=True, help="aim of the search")
    top.add_argument(
        "--line", metavar="NAME|FILE", help="default: that of the traffic, or changping"
    )
    top.add_argument("--traffic", metavar="NAME|FILE", help="traffic file with line and train")
    top.add_argument(
        "--service", metavar="FILE", help="service file of trains that turn round on a network"
    )
    top.add_argument(
        "--train", metavar="NAME|FILE", help="train or consist; default: that of the traffic"
    )
    top.add_argument(
        "--reserve",
        type=_percent,
        metavar="PERCENT",
        help="trip time above the fastest; default: the planned running times, or 12",
    )
    top.add_argument(
        "--supply", metavar="NAME|FILE", help="default: that of the traffic, or strong"
    )
    top.add_argument(
        "--budget", type=_whole, default=150, metavar="N", help="number of tries; default: 150"
    )
    top.add_argument("--seed", type=_whole, default=1, metavar="N", help="default: 1")
    top.add_argument("--out", metavar="FILE", help="the timetable as TOML; default: none")
    top.add_argument("--json", action="store_true", help="one JSON object on standard output")
    return top


def main(argv: Sequence[str]) -> int:
    """Run the command; every error of the user becomes one line, never a traceback."""
    options = parser().parse_args(argv)
    try:
        if options.service is not None:
            return save_on_network(options)
        if options.traffic is not None:
            return save_on_line(options)
        if (options.line or CHANGPING) != CHANGPING:
            return divide_trip(options)
        return _find(options)
    except SettingsError as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE


def _find(options: argparse.Namespace) -> int:
    for name in ("train", "reserve"):
        if getattr(options, name) is not None:
            raise SettingsError(f"--{name}: only with another line, or with --traffic")
    out = free_file(options.out)
    console = console_for(json=options.json)
    train, supply, base = LineTrain(), line_supply(options.supply or STRONG), Timetable()
    search = TimetableSearch(train, supply, base, seed=options.seed, budget=options.budget)
    with console.status("searching") as status:
        found = search.run(
            lambda tried, kwh: status.update(f"tried {tried}, least {kwh:.1f} kWh a lap")
        )
    dwells = [dwells_of(seed, 3) for seed in JUDGING_SEEDS]
    before = [simulate(train, supply, base, TRADITIONAL, one) for one in dwells]
    after = [simulate(train, supply, found.timetable, HOLD_AND_COAST, one) for one in dwells]
    change = paired(before, after)
    on_time_ratio = min(outcome.on_time_ratio for outcome in after)
    _show(console, base, found.timetable)
    console.print(
        f"{change.text} of actual energy "
        f"against the traditional law; {on_time_ratio:.1%} of runs within 2 s; {found.tried} tries",
        highlight=False,
    )
    if out is not None:
        write_timetable(out, supply, found.timetable)
        console.print(f"timetable: {out}", highlight=False, soft_wrap=True)
    if options.json:
        document = {
            "phase_s": found.timetable.phase_s,
            "runs_s": found.timetable.runs_s,
            "hold_mps": found.timetable.hold_mps,
            "coast_m": found.timetable.coast_m,
            "change_ratio": change.mean_ratio,
            "change_half_ratio": change.half_ratio,
            "on_time_ratio": on_time_ratio,
        }
        print(json.dumps(document))
    return EXIT_OK


def _show(console: Console, base: Timetable, found: Timetable) -> None:
    table = Table("leg", "run before, s", "run, s", "hold, km/h", "coast from, m")
    for leg, run_s in enumerate(found.runs_s):
        table.add_row(
            str(leg + 1),
            f"{base.runs_s[leg]:g}",
            f"{run_s:.1f}",
            f"{found.hold_mps[leg] * 3.6:.1f}",
            f"{found.coast_m[leg]:.0f}",
        )
    console.print(table)
    console.print(
        f"trains leave the far terminal {found.phase_s:.1f} s after the near one; "
        f"before the search {base.phase_s:g} s",
        highlight=False,
    )


def _percent(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not 0.0 <= value <= 200.0:
        raise argparse.ArgumentTypeError(f"{text} is not within 0..200")
    return value


def _whole(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not 1 <= value < 10**6:
        raise argparse.ArgumentTypeError(f"{text} is not within 1..999999")
    return value
