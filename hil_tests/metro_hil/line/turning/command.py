"""`vobc run --lockstep --service FILE --trains N`: trains that turn round on one network.

With `--masters` the trains command themselves.
"""

import json
import sys
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from statistics import mean
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from canlog.run_names import mark_latest
from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.storage.recorder import loss_text
from firmware_py.storage.whole_file import write_whole
from metro_hil.line.energy import (
    COLUMNS,
    TrainEnergy,
    cells_of,
    energy_of,
    keys_of_network,
    keys_of_service,
    keys_of_train,
    section_table,
    summary_of,
)
from metro_hil.line.turning.conductor import AFTER_KILL, Conductor
from metro_hil.line.turning.headway import Turnback, turnbacks
from metro_hil.line.turning.masters import Masters, StruckMaster
from metro_hil.line.turning.plan import FleetPlan, plan_fleet
from metro_hil.line.turning.train import TurningTrain
from metro_hil.metrics.hops import hop_table, means_of
from metro_hil.model.end_condition import ARRIVED, INTERRUPTED
from metro_hil.model.run_folder import make_run_folder, plain, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    RunOptions,
)

NS_PER_S: Final = 1e9
GRAPH: Final = "graph.png"


def run(options: RunOptions, console: Console) -> int:
    """Run all trains and write the results. Raises SettingsError, RunFolderError."""
    plan = plan_fleet(options)
    clock = WallClock()
    words = f"{plan.network.name}_{plan.trains}"
    folder = make_run_folder(options.out, clock.epoch_ns(), words)
    write_config(folder, {"options": options, "service": plan.service}, clock.epoch_ns())
    mark_latest(folder.path)

    def folder_of(number: int) -> Path | None:
        return folder.path / f"train{number}" if options.logs else None

    began_ns, interrupts = clock.now_ns(), Interrupts()
    conductor = Conductor(plan, folder_of)
    with interrupts.caught(), console.status("the first second") as status:
        record = conductor.run(
            told=lambda now_s: status.update(f"{now_s:.0f} s"),
            interrupted=lambda: interrupts.asked,
        )
    elapsed_s = max(1, clock.now_ns() - began_ns) / NS_PER_S
    trips = [trip for train in conductor.trains for trip in train.trips]
    turned = turnbacks(plan, trips)
    document = as_document(plan, conductor, turned)
    _show(console, plan, conductor, turned, document, record.duration_s / elapsed_s)
    if options.hops:
        console.print(hop_table(document["hops"]))
    write_whole(folder.results, json.dumps(document, indent=2) + "\n")
    from metro_hil.line.turning import figures

    figures.draw(folder.path / GRAPH, plan, record, turned, conductor.supply)
    console.print(f"train graph: {folder.path / GRAPH}", highlight=False, soft_wrap=True)
    console.print(f"run folder: {folder.path}", highlight=False, soft_wrap=True)
    if options.json:
        print(json.dumps(document))
    if lost := sum(train.lost_log_lines for train in conductor.trains):
        print(f"vobc: {folder.path}: {loss_text(lost)}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    if record.exit_reason == INTERRUPTED:
        return EXIT_INTERRUPTED
    struck = None if conductor.masters is None else conductor.masters.struck
    if plan.strike is not None and struck is None:
        print(
            f"vobc: at {plan.strike.at_s:g} s and later no train commanded an area with another "
            "train in it, so no master was struck; choose another second",
            file=sys.stderr,
        )
        return EXIT_ENVIRONMENT
    return EXIT_OK if _is_sound(conductor, struck) else EXIT_FAILED


def _is_sound(conductor: Conductor, struck: StruckMaster | None) -> bool:
    """Whether every train did what was planned, and nothing was violated."""
    braked = any(train.brakes for train in conductor.trains)
    ended = conductor.record.exit_reason in (ARRIVED, AFTER_KILL)
    followed = struck is None or struck.is_followed
    supply = conductor.supply
    solved = supply is None or not supply.coupling.network.unconverged
    return ended and followed and solved and not conductor.between.violations and not braked


def as_document(plan: FleetPlan, conductor: Conductor, turned: list[Turnback]) -> Mapping[str, Any]:
    """Return the results for JSON, equal for equal seeds on any machine."""
    record, between = conductor.record, conductor.between
    return {
        "network": plan.network.name,
        "trains": plan.trains,
        "headway_s": plan.service.headway_s,
        "seed": plan.seed,
        "exit_reason": record.exit_reason,
        "duration_s": record.duration_s,
        "least_gap_m": between.least_gap_m if isfinite(between.least_gap_m) else None,
        "checked_count": between.checked_count,
        "violations": [plain(each) for each in between.violations],
        "protection_brakes": [plain(each) for train in conductor.trains for each in train.brakes],
        "turnbacks": [{**plain(each), "limit_s": each.limit.total_s} for each in turned],
        "hops": means_of(
            [hop for train in conductor.trains for trip in train.trips for hop in trip.hops]
        ),
        "trips": [plain(trip) for train in conductor.trains for trip in train.trips],
        **({} if conductor.masters is None else {"masters": _of_masters(conductor.masters)}),
        **_of_supply(plan, conductor),
    }


def _of_supply(plan: FleetPlan, conductor: Conductor) -> dict[str, Any]:
    """Energy of all trains and of each; empty without a supply network."""
    if plan.supply is None or conductor.supply is None:
        return {}
    energies = _energies(conductor)
    full = conductor.supply.full_service
    return {
        "law": plan.config.ato.strategy,
        "supply": plan.supply.name,
        **keys_of_network(conductor.supply.coupling, list(energies.values())),
        "full_service": None if full is None else keys_of_service(full),
        "per_train": [
            {"train": number, **keys_of_train(energy)} for number, energy in energies.items()
        ],
    }


def _energies(conductor: Conductor) -> dict[int, TrainEnergy]:
    """Energy of each train that has entered, by its number."""
    return {
        train.number: energy_of(train.power)
        for train in conductor.trains
        if train.power is not None
    }


def _of_masters(masters: Masters) -> Mapping[str, Any]:
    struck = masters.struck
    result: dict[str, Any] = {"changes": [plain(each) for each in masters.changes]}
    if struck is not None:
        result["struck"] = {
            "at_s": struck.at_s,
            "train": struck.train,
            "oldest_authority_s": struck.oldest_s,
            "areas": [
                {"path": path, "area": area, "takeover_s": struck.takeovers_s.get((path, area))}
                for path, area in struck.areas
            ],
        }
    return result


def _masters_text(masters: Masters) -> str:
    """One line about who commanded."""
    text = f"masters: {len(masters.changes)} changes of command"
    struck = masters.struck
    if struck is None:
        return text
    times_s = list(struck.takeovers_s.values())
    followed = f"others commanded after {max(times_s):.2f} s" if times_s else "no other commanded"
    return (
        f"{text}; train {struck.train} struck at {struck.at_s:g} s, {followed} in "
        f"{len(times_s)} of {len(struck.areas)} areas; oldest authority {struck.oldest_s:.2f} s"
    )


def _show(
    console: Console,
    plan: FleetPlan,
    conductor: Conductor,
    turned: list[Turnback],
    document: Mapping[str, Any],
    factor: float,
) -> None:
    fed = COLUMNS if conductor.supply is not None else ()
    table = Table("train", "trips", "worst stop", "latest departure", "brakes by protection", *fed)
    for train in conductor.trains:
        energy = [] if train.power is None else cells_of(energy_of(train.power))
        table.add_row(*_row(train, timed=plan.service.headway_s > 0.0), *energy)
    console.print(table)
    if document.get("sections"):
        console.print(section_table(document["sections"]))
    if turned:
        console.print(_turnback_table(turned))
    record, between = conductor.record, conductor.between
    gap_m = between.least_gap_m
    gap = f"; least gap {gap_m:.0f} m" if isfinite(gap_m) else ""
    console.print(
        f"{record.exit_reason} after {record.duration_s:.0f} s{gap}; "
        f"{len(between.violations)} violations between trains; "
        f"{factor:.0f} times real time",
        highlight=False,
    )
    if conductor.masters is not None:
        console.print(_masters_text(conductor.masters), highlight=False)
    if document.get("supply"):
        console.print("; ".join(summary_of(document)), highlight=False)
    for each in between.violations:
        who = " and ".join(each.trains)
        console.print(f"at {each.at_s:.2f} s, {who}: {each.kind}", style="red", highlight=False)
    for train in conductor.trains:
        for brake in train.brakes:
            words = f"at {brake.at_s:.2f} s, {train.name}: {brake.kind} brake, {brake.cause}"
            console.print(words.replace("_", " "), style="red", highlight=False)


def _row(train: TurningTrain, *, timed: bool) -> list[str]:
    """Args:
    timed: whether the service has a headway, and so departures that are due.
    """
    done = sum(trip.ended_s is not None for trip in train.trips)
    errors_m = [
        abs(stop.error_m) for trip in train.trips for stop in trip.stops if stop.error_m is not None
    ]
    late_s = [
        trip.left_s - trip.due_s
        for trip in train.trips
        if timed and trip.left_s is not None and trip.due_s is not None
    ]
    return [
        str(train.number),
        f"{done} of {len(train.trips)}",
        f"{100.0 * max(errors_m):.1f} cm" if errors_m else "–",
        f"{max(late_s):+.1f} s" if late_s else "–",
        str(len(train.brakes)),
    ]


def _turnback_table(turned: list[Turnback]) -> Table:
    table = Table("turnback", "turns", "headway", "least possible", "analytic limit")
    for each in turned:
        headway = "–"
        if each.headways_s:
            low_s, high_s = min(each.headways_s), max(each.headways_s)
            headway = f"{mean(each.headways_s):.1f} s ({low_s:.1f} to {high_s:.1f})"
        table.add_row(
            each.limit.station,
            str(each.turns),
            headway,
            f"{each.least_s:.1f} s" if each.occupied_s else "–",
            f"{each.limit.total_s:.1f} s",
        )
    return table
