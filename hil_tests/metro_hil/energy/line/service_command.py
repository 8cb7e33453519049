"""`vobc timetable` for any line: trip times divided among hops, and trains that meet."""

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w
from rich.console import Console
from rich.table import Table

from firmware_py.settings import SettingsError, is_path, tables_of, text_of
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import Station, load_line
from metro_hil.energy.line.meetings import find_meetings
from metro_hil.energy.line.service import DesignedService, ServiceLine, ServiceResults
from metro_hil.energy.line.table_four import paired
from metro_hil.energy.line.trip_times import HopCosts, costs_of, divide, hop_costs
from metro_hil.energy.line.turning_service import TurningService
from metro_hil.energy.running_curve.train import RunningTrain, load_train, of_consist
from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.terminal import console_for
from plant_emulator.power.box import J_PER_KWH
from plant_emulator.traffic.config import TrafficConfig, plan_traffic
from plant_emulator.train_config import load_train as load_consist

RESERVE: Final = 12.0
"""Running time above the fastest one, in per cent, where a line gives no running times."""
CHOOSING_SEEDS: Final = tuple(range(7101, 7107))
JUDGING_SEEDS: Final = tuple(range(101, 107))
JUDGING_STEP_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A timetable that may be chosen."""

    name: str
    times_s: Sequence[float]


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
    if options.train is None:
        raise SettingsError(f"--train: is missing; {options.line} needs a train or --traffic")
    line, train, out = load_line(options.line), load_train(options.train), free_file(options.out)
    console = console_for(json=options.json)
    hops = []
    with console.status("computing runs") as status:
        for index in range(len(line.stations) - 1):
            status.update(f"runs to {line.stations[index + 1].name}")
            hops.append(hop_costs(line, train, index, 1.0))
    before_s = planned_s(line.stations[1:], hops, options.reserve)
    runs_s = [round(run_s, 1) for run_s in divide(hops, sum(before_s))]
    show_trip(console, hops, before_s, runs_s)
    if out is not None:
        write_whole(out, tomli_w.dumps({"runs_s": by_station([hop.end for hop in hops], runs_s)}))
        console.print(f"timetable: {out}", highlight=False, soft_wrap=True)
    if options.json:
        print(json.dumps({"line": line.name, "train": train.name, "runs_s": runs_s}))
    return EXIT_OK


def save_on_line(options: argparse.Namespace) -> int:
    """Find running times with which the trains of a line take the least energy together.

    Raises SettingsError. Trip times, headway and dwells stay as they are.
    """
    traffic, line, supply = plan_traffic(options.line, options.traffic, options.supply)
    train = train_of(options.train, traffic.consist)
    service = ServiceLine(traffic, line, train, supply)

    def write(out: Path, times_s: Sequence[float]) -> None:
        named = replace(traffic, supply=options.supply or traffic.supply)
        write_runs(out, named, by_station(service.ends, times_s))

    return _save(options, service, (line.name, train.name), (), write)


def save_on_network(options: argparse.Namespace) -> int:
    """Find running times and layovers with which trains that turn round take the least energy.

    Raises SettingsError. Trip times, headway and dwells stay as they are.
    """
    for name in ("train", "supply"):
        if getattr(options, name) is None:
            raise SettingsError(f"--{name}: is missing; --service needs it")
    for name in ("line", "traffic"):
        if getattr(options, name) is not None:
            raise SettingsError(f"--{name}: not with --service, whose file decides it")
    train = load_train(options.train)
    service = TurningService(options.service, options.supply, train)

    def write(out: Path, times_s: Sequence[float]) -> None:
        write_trips(out, options.service, list(service.trips_with(times_s)))

    return _save(options, service, (service.network, train.name), service.layovers_s, write)


def _save(
    options: argparse.Namespace,
    service: DesignedService,
    names: tuple[str, str],
    layovers_s: Sequence[float],
    write: Callable[[Path, Sequence[float]], None],
) -> int:
    """Search, judge, print and write a timetable. Raises SettingsError."""
    out, console = free_file(options.out), console_for(json=options.json)
    with console.status("computing runs") as status:
        hops = hops_of(service)
        ends = [hop.end for hop in service.hops]
        planned = [*planned_s(ends, hops, options.reserve), *layovers_s]
        divided = divided_s(service, hops, planned)
        service.profiles(planned)
        found = find_meetings(
            service,
            divided,
            seed=options.seed,
            budget=options.budget,
            told=lambda tried, kwh: status.update(f"tried {tried}, least {kwh:.2f} kWh a train"),
        )
        candidates = (
            Candidate("as planned", planned),
            Candidate("divided by least energy", divided),
            Candidate("with meeting trains", found.times_s),
        )
        # Dwells that the search did not use choose, and others judge.
        chosen = min(candidates, key=lambda each: _mean_kwh(_judge(service, each, CHOOSING_SEEDS)))
        judged = [_judge(service, each, JUDGING_SEEDS) for each in candidates]
    count = len(hops)
    show_trip(console, hops, planned[:count], chosen.times_s[:count])
    if layovers_s:
        console.print(_layovers_text(layovers_s, chosen.times_s[count:]), highlight=False)
    rows = _show_candidates(console, candidates, judged, chosen, count)
    if out is not None:
        write(out, chosen.times_s)
        console.print(f"timetable: {out}", highlight=False, soft_wrap=True)
    if options.json:
        line, train = names
        document = {"line": line, "train": train, **_times_of(chosen, count), "chosen": chosen.name}
        print(json.dumps({**document, "timetables": rows}))
    return EXIT_OK


def _times_of(candidate: Candidate, hops: int) -> dict[str, Any]:
    """Running times, and layovers if there are any, for JSON."""
    layovers_s = list(candidate.times_s[hops:])
    runs_s = list(candidate.times_s[:hops])
    return {"runs_s": runs_s, **({"layovers_s": layovers_s} if layovers_s else {})}


def _layovers_text(before_s: Sequence[float], after_s: Sequence[float]) -> str:
    changes = [
        f"{after:g} s instead of {before:g} s before trip {trip}"
        for trip, (before, after) in enumerate(zip(before_s, after_s, strict=True), start=2)
    ]
    return f"layovers: {', '.join(changes)}"


def train_of(name: str | None, consist: str) -> RunningTrain:
    """The named train, or that of the traffic. A running train may have the name of a consist."""
    return of_consist(load_consist(consist)) if name is None else load_train(name)


def hops_of(service: DesignedService) -> list[HopCosts]:
    """The energy of each hop of a lap or round trip over its running time."""
    return [
        costs_of(hop.start.name, end, service.hop(index), 1.0).from_s(service.least_s(index))
        for index, (hop, end) in enumerate(zip(service.hops, service.ends, strict=True))
    ]


def planned_s(
    ends: Sequence[Station], hops: Sequence[HopCosts], reserve: float | None
) -> list[float]:
    """Running times to the given stations: those of the line, or the fastest and a reserve."""
    if reserve is None and all(station.run_s for station in ends):
        return [station.run_s for station in ends]
    ratio = 1.0 + (RESERVE if reserve is None else reserve) / 100.0
    return [round(ratio * hop.fastest_s, 1) for hop in hops]


def divided_s(
    service: DesignedService, hops: Sequence[HopCosts], planned: Sequence[float]
) -> list[float]:
    """Divide the time of each trip among its hops by least energy. Raises SettingsError."""
    runs_s = list(planned)
    for trip in service.trips(planned):
        total_s = sum(planned[hop] for hop in trip)
        for hop, run_s in zip(trip, divide([hops[hop] for hop in trip], total_s), strict=True):
            runs_s[hop] = round(run_s, 1)
    return runs_s


def _judge(
    service: DesignedService, candidate: Candidate, seeds: Sequence[int]
) -> list[ServiceResults]:
    return [service.simulate(candidate.times_s, seed=s, step_s=JUDGING_STEP_S) for s in seeds]


def _mean_kwh(results: Sequence[ServiceResults]) -> float:
    return float(np.mean([each.actual_kwh + each.unserved_kwh for each in results]))


def _show_candidates(
    console: Console,
    candidates: Sequence[Candidate],
    judged: Sequence[Sequence[ServiceResults]],
    chosen: Candidate,
    hops: int,
) -> list[dict[str, Any]]:
    """Print the comparison, and return it for JSON."""
    table = Table("timetable", "kWh a train", "against planned [95 %]", "burnt", "lowest V", "")
    rows = []
    for candidate, results in zip(candidates, judged, strict=True):
        change = paired(judged[0], results)
        burnt_kwh = float(np.mean([each.burnt_kwh for each in results]))
        lowest_v = min(each.lowest_v for each in results)
        kwh = float(np.mean([each.actual_kwh for each in results]))
        table.add_row(
            candidate.name,
            f"{kwh:.2f}",
            "" if candidate is candidates[0] else change.text,
            f"{burnt_kwh:.2f}",
            f"{lowest_v:.0f}",
            "chosen" if candidate is chosen else "",
        )
        rows.append(
            {
                "name": candidate.name,
                **_times_of(candidate, hops),
                "actual_kwh": kwh,
                "change_ratio": change.mean_ratio,
                "change_half_ratio": change.half_ratio,
                "lowest_v": lowest_v,
            }
        )
    console.print(table)
    console.print(
        f"from the grid with auxiliaries, {len(JUDGING_SEEDS)} sets of dwells that neither search "
        "nor choice used; on an open line all trains once, on a circuit each lap, and with "
        "--service each round trip",
        highlight=False,
    )
    return rows


def by_station(ends: Sequence[str], runs_s: Sequence[float]) -> dict[str, float]:
    """The running times by the station where each run ends."""
    return dict(zip(ends, runs_s, strict=True))


def write_trips(
    out: Path, service: str, trips: Sequence[tuple[Mapping[str, float], float]]
) -> None:
    """Write the service with these running times and layovers of its trips."""
    document = tables_of(text_of(Path(service)), service)
    if is_path(document["line"]):
        document["line"] = os.path.relpath(Path(service).parent / document["line"], out.parent)
    for table, (runs_s, layover_s) in zip(document["trips"], trips, strict=True):
        table |= {"run_s": dict(runs_s), "layover_s": layover_s}
    write_whole(out, tomli_w.dumps(document))


def show_trip(
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


def write_runs(out: Path, traffic: TrafficConfig, runs_s: dict[str, float]) -> None:
    """Write the traffic with these running times."""
    document = {key: value for key, value in asdict(traffic).items() if value not in (None, ())}
    for key in ("line", "consist", "supply", "params"):
        if is_path(document.get(key, "")):
            document[key] = os.path.relpath(document[key], out.parent)
    write_whole(out, tomli_w.dumps({**document, "runs_s": runs_s}))
