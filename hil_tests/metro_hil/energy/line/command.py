"""`hil run green-cbtc`: Table 4 of [Lin], the ablation of its law, and pages of plots."""

import argparse
import json
import sys
from typing import Any, Final

import tomli_w
from rich.console import Console
from rich.table import Table

from firmware_py.clock.clock import WallClock
from firmware_py.storage.whole_file import write_whole
from metro_hil.energy.compiled import COMPILED
from metro_hil.energy.line import table_four
from metro_hil.energy.line.model import LineTrain, Supply, Timetable, shipped_supplies
from metro_hil.energy.line.simulate import LapResults, simulate
from metro_hil.energy.line.table_four import PRINTED, TableFour, TableFourRow, share_at_least
from metro_hil.engine.errors import UsageError
from metro_hil.model.run_folder import make_run_folder
from metro_hil.model.run_options import EXIT_INTERRUPTED, EXIT_OK
from metro_hil.model.terminal import console_for

NAME: Final = "green-cbtc"
PERCENT: Final = 100.0


def run(options: argparse.Namespace) -> int:
    """Run the campaign green-cbtc.

    Raises RunFolderError, and UsageError for options without a use.
    """
    for name in ("bench", "controller", "filter", "rerun"):
        if getattr(options, name, None) is not None:
            raise UsageError(f"--{name}: {NAME} has no cases, only seeds; use --seed or --limit")
    folder = make_run_folder(options.out, WallClock().epoch_ns(), NAME).path
    console = console_for(json=options.json)
    if not COMPILED:
        console.print("without numba (extra `compiled`) the run takes fifty times as long")
    seeds = table_four.SEEDS if options.seed is None else (options.seed,)
    seeds = seeds if options.limit is None else seeds[: options.limit]
    document: dict[str, Any] = {"seeds": list(seeds)}
    _show_arithmetic(console)
    for supply in shipped_supplies().values():
        try:
            with console.status(f"{supply.name} network") as status:
                table = table_four.table_four(
                    supply, seeds=seeds, budget=table_four.BUDGET, told=status.update
                )
        except KeyboardInterrupt:
            document["interrupted"] = True
            break
        _show(console, table)
        page = folder / f"green_{supply.name}.png"
        _draw(page, table)
        write_timetable(folder / f"timetable_{supply.name}.toml", supply, table.synchronised)
        console.print(f"plots: {page}", highlight=False, soft_wrap=True)
        document[supply.name] = as_document(table)
    write_whole(folder / "results.json", json.dumps(document, indent=2) + "\n")
    console.print(f"folder: {folder}", highlight=False, soft_wrap=True)
    if options.json:
        print(json.dumps(document))
    if "interrupted" in document:
        print("hil: interrupted; these are the results until then", file=sys.stderr)
        return EXIT_INTERRUPTED
    return EXIT_OK


def _show_arithmetic(console: Console) -> None:
    base = PRINTED[0].actual_kwh
    saved = base - PRINTED[2].actual_kwh
    most = base - PRINTED[3].actual_kwh
    console.print(
        f"The paper's saving of 9.94 % is {saved:.2f} of the smaller {PRINTED[2].actual_kwh:.2f} "
        f"kWh; relative to the traditional law it is {PERCENT * saved / base:.2f} %, and "
        f"{PERCENT * most / base:.2f} % with .5/.5, which keeps 95 % timing only. In a year of 15 "
        f"h a day {saved:.2f} kWh a lap are {saved * table_four.LAPS_A_YEAR:,.0f} kWh, as printed.",
        highlight=False,
    )


def _show(console: Console, table: TableFour) -> None:
    supply = table.supply
    console.rule(f"{supply.name} network")
    console.print(
        f"{supply.no_load_v:g} V, {supply.substations[0].source_ohm * 1e3:g} mΩ, "
        f"{supply.sections[0].ohm_per_km * 1e3:g} mΩ/km, "
        f"resistors from {supply.voltages.chops_from_v:g} V; "
        f"a lap of 21 min, dwell 20 to 40 s, {len(table.seeds)} seeds",
        highlight=False,
    )
    rows = [_named(table, column.law) for column in PRINTED]
    shown = Table("simulated / printed", *(column.law for column in PRINTED), title="Table 4")
    pairs = list(zip(rows, PRINTED, strict=True))
    timing = (f"{_on_time(row):.1%} / {paper.timing_ratio:.0%}" for row, paper in pairs)
    shown.add_row("timing rate", *timing)
    shown.add_row("precise parking", *(f"{_parking(row):.2%} / 99.99%" for row in rows))
    shown.add_row("worst stop", *(f"{_worst_stop(row)} cm" for row in rows))
    shown.add_row(
        "overall, kWh",
        *(
            f"{row.mean(lambda outcome: outcome.overall_kwh):.0f} / {paper.overall_kwh:.0f}"
            for row, paper in pairs
        ),
    )
    shown.add_row(
        "actual, kWh",
        *(
            f"{row.mean(lambda outcome: outcome.actual_kwh):.0f} / {paper.actual_kwh:.0f}"
            for row, paper in pairs
        ),
    )
    shown.add_row(
        "regeneration used",
        *(
            f"{row.mean(lambda outcome: outcome.use_ratio):.1%} / {paper.use_ratio:.1%}"
            for row, paper in pairs
        ),
    )
    shown.add_row("comfort: greatest jerk", *(f"{_jerk(row)} m/s³ / good" for row in rows))
    console.print(shown)
    _show_all(console, table)


def _show_all(console: Console, table: TableFour) -> None:
    shown = Table("law", "within 2 s", "worst", "actual kWh", "used", "actual, paired [95 %]")
    for row in table.rows:
        shown.add_row(
            row.name,
            f"{_on_time(row):.1%}",
            f"{max(outcome.worst_s for outcome in row.outcomes):.1f} s",
            f"{row.mean(lambda outcome: outcome.actual_kwh):.1f}",
            f"{row.mean(lambda outcome: outcome.use_ratio):.1%}",
            row.change.text,
        )
    console.print(shown)
    lost = sum(outcome.unconverged for row in table.rows for outcome in row.outcomes)
    closure = max(abs(outcome.closure_ratio) for row in table.rows for outcome in row.outcomes)
    stops = table.rows[0].runs
    console.print(
        f"actual: from the grid, with the trains' auxiliaries; overall: plus the used "
        f"regeneration. Ablation: the law uses {table.constant_v:g} V. The energy balance closes "
        f"within {PERCENT * closure:.4f} %; {lost} steps without a solution. {stops} stops a law "
        f"support ≥ {share_at_least(stops, stops):.2%} of parking (Clopper-Pearson).",
        highlight=False,
    )


def _named(table: TableFour, name: str) -> TableFourRow:
    return next(row for row in table.rows if row.name == name)


def _on_time(row: TableFourRow) -> float:
    return row.mean(lambda outcome: outcome.on_time_ratio)


def _parking(row: TableFourRow) -> float:
    return row.mean(lambda outcome: outcome.parked_ratio)


def _worst_stop(row: TableFourRow) -> str:
    return f"{100.0 * max(outcome.parking_m for outcome in row.outcomes):.1f}"


def _jerk(row: TableFourRow) -> str:
    return f"{max(outcome.jerk_mps3 for outcome in row.outcomes):.2f}"


def _draw(page: Any, table: TableFour) -> None:
    from metro_hil.energy.line import figures
    from metro_hil.energy.line.model import HOLD_AND_COAST, TRADITIONAL
    from metro_hil.energy.line.simulate import dwells_of

    train, dwells = LineTrain(), dwells_of(table.seeds[0], 3)
    records = []
    for timetable, law in ((Timetable(), TRADITIONAL), (table.synchronised, HOLD_AND_COAST)):
        outcome: LapResults = simulate(
            train, table.supply, timetable, law, dwells, laps=1, record_s=1.0
        )
        assert outcome.record is not None
        records.append(outcome.record)
    figures.draw(page, table, records[0], records[1])


def as_document(table: TableFour) -> dict[str, Any]:
    """Return the table for JSON."""
    return {
        "constant_v": table.constant_v,
        "rows": [
            {
                "law": row.name.strip(),
                "on_time_ratio": row.mean(lambda outcome: outcome.on_time_ratio),
                "overall_kwh": row.mean(lambda outcome: outcome.overall_kwh),
                "actual_kwh": row.mean(lambda outcome: outcome.actual_kwh),
                "use_ratio": row.mean(lambda outcome: outcome.use_ratio),
                "parked_ratio": _parking(row),
                "parking_m": max(outcome.parking_m for outcome in row.outcomes),
                "jerk_mps3": max(outcome.jerk_mps3 for outcome in row.outcomes),
                "change_ratio": row.change.mean_ratio,
                "change_half_ratio": row.change.half_ratio,
            }
            for row in table.rows
        ],
    }


def write_timetable(path: Any, supply: Supply, timetable: Timetable) -> None:
    """Write the timetable as TOML, like `vobc timetable`."""
    document = {
        "supply": supply.name,
        "phase_s": timetable.phase_s,
        "runs_s": list(timetable.runs_s),
        "hold_mps": [round(speed, 4) for speed in timetable.hold_mps],
        "coast_m": [round(at, 2) for at in timetable.coast_m],
    }
    write_whole(path, tomli_w.dumps(document))
