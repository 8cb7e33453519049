"""`vobc timetable`: finds turnback phase, run splits and regimes that save energy on a line."""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import tomli_w
from rich.console import Console
from rich.table import Table

from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError, is_path
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import load_line
from metro_hil.energy.line.command import write_timetable
from metro_hil.energy.line.model import (
    HOLD_AND_COAST,
    TRADITIONAL,
    LineTrain,
    Timetable,
    line_supply,
)
from metro_hil.energy.line.simulate import dwells_of, simulate
from metro_hil.energy.line.synchronise import TimetableSearch
from metro_hil.energy.line.table_four import paired
from metro_hil.energy.line.trip_times import HopCosts, divide, hop_costs
from metro_hil.energy.running_curve.train import load_train
from metro_hil.model.run_options import EXIT_OK, EXIT_USAGE
from plant_emulator.traffic.config import TrafficConfig, load_traffic

CHANGPING: Final = "changping"
J_PER_KWH: Final = 3.6e6
DESCRIPTION: Final = (
    "Find a timetable for the seven trains of the Changping section in which accelerating and "
    "braking trains meet: turnback phase, run splits, speeds to hold and points to coast from, at "
    "unchanged trip times, headway and punctuality. Judged with dwells that the search did not "
    "use. With another line, or with --traffic, divide the time of the trip among its hops so that "
    "the designed runs take the least energy."
)
RESERVE: Final = 12.0
"""Running time above the fastest one, in per cent, where a line gives no running times."""
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
        "--train", metavar="NAME|FILE", help="train or consist; default: that of the traffic"
    )
    top.add_argument(
        "--reserve",
        type=_percent,
        metavar="PERCENT",
        help="trip time above the fastest; default: the planned running times, or 12",
    )
    top.add_argument(
        "--supply", default="strong", metavar="NAME|FILE", help="strong (default), weak or a file"
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
        if options.traffic is not None or (options.line or CHANGPING) != CHANGPING:
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
    console = Console(stderr=options.json)
    train, supply, base = LineTrain(), line_supply(options.supply), Timetable()
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


def free_file(name: str | None) -> Path | None:
    """Return the file to write. Raises SettingsError if it cannot be written or exists."""
    out = None if name is None else Path(name)
    if out is not None and out.exists():
        raise SettingsError(f"--out {out}: exists already and is not overwritten")
    if out is not None and not out.parent.is_dir():
        raise SettingsError(f"--out {out}: there is no folder {out.parent}")
    return out


def divide_trip(options: argparse.Namespace) -> int:
    """Divide the time of a trip over any line among its hops. Raises SettingsError."""
    traffic = None if options.traffic is None else load_traffic(options.traffic)
    if traffic is not None and options.line is not None:
        traffic = replace(traffic, line=options.line)
    line = load_line(options.line) if traffic is None else traffic.load_line()
    name = options.train or (traffic and traffic.consist)
    if not name:
        raise SettingsError(f"--train: is missing; {line.name} needs a train or --traffic")
    train, out = load_train(name), free_file(options.out)
    lap = traffic.stations_a_lap if traffic is not None and traffic.circular else None
    stations = line.stations[:lap]
    console = Console(stderr=options.json)
    hops = []
    with console.status("computing runs") as status:
        for index in range(len(stations) - 1):
            status.update(f"runs to {stations[index + 1].name}")
            hops.append(hop_costs(line, train, index, 1.0))
    before_s = [station.run_s for station in stations[1:]]
    if options.reserve is not None or not all(before_s):
        ratio = 1.0 + (RESERVE if options.reserve is None else options.reserve) / 100.0
        before_s = [ratio * hop.fastest_s for hop in hops]
    runs_s = [round(run_s, 1) for run_s in divide(hops, sum(before_s))]
    _show_trip(console, hops, before_s, runs_s)
    if out is not None:
        write_runs(out, traffic, {hop.end: run_s for hop, run_s in zip(hops, runs_s, strict=True)})
        console.print(f"timetable: {out}", highlight=False, soft_wrap=True)
    if options.json:
        print(json.dumps({"line": line.name, "train": train.name, "runs_s": runs_s}))
    return EXIT_OK


def _show_trip(
    console: Console, hops: Sequence[HopCosts], before_s: Sequence[float], runs_s: Sequence[float]
) -> None:
    table = Table(
        "to", "fastest, s", "run before, s", "run, s", "energy before, kWh", "energy, kWh"
    )
    was_kwh = now_kwh = 0.0
    for hop, was_s, run_s in zip(hops, before_s, runs_s, strict=True):
        was, now = hop.energy_j(was_s) / J_PER_KWH, hop.energy_j(run_s) / J_PER_KWH
        was_kwh, now_kwh = was_kwh + was, now_kwh + now
        times = (hop.fastest_s, was_s, run_s)
        table.add_row(hop.end, *(f"{time_s:.1f}" for time_s in times), f"{was:.2f}", f"{now:.2f}")
    console.print(table)
    console.print(
        f"trip of {sum(runs_s):.1f} s: {now_kwh:.2f} kWh instead of {was_kwh:.2f} kWh, all "
        "regenerated energy used, without auxiliaries",
        highlight=False,
    )


def write_runs(out: Path, traffic: TrafficConfig | None, runs_s: dict[str, float]) -> None:
    """Write the traffic with these running times, or only these times without traffic."""
    document: dict[str, Any] = {}
    if traffic is not None:
        document = {key: value for key, value in asdict(traffic).items() if value not in (None, ())}
        for key in ("line", "consist", "supply", "params"):
            if is_path(document.get(key, "")):
                document[key] = os.path.relpath(document[key], out.parent)
    write_whole(out, tomli_w.dumps({**document, "runs_s": runs_s}))


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
