"""`hil laws`: the published figures of each control law, and whether they still hold."""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from metro_hil.model.case import Case, CaseResult
    from metro_hil.report.law_figures import Results
    from metro_hil.report.standing import Standing


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "laws",
        help="show how each control law came out",
        description="Print the figures of each control law, scenario by scenario, that the pages "
        "below docs/reference/laws show. With --run those of campaigns are taken over.",
    )
    parser.add_argument(
        "--run", metavar="FOLDER", dest="runs", action="append", default=[],
        help="of a campaign that was run; several are taken over one after another",
    )  # fmt: skip
    parser.add_argument(
        "--check",
        action="store_true",
        help="report which figures are older than the code; exit code 1 if any is",
    )
    parser.add_argument(
        "--measure", action="store_true", help="run the scenarios whose figures are stale again"
    )
    parser.add_argument(
        "--write", action="store_true", help="keep the figures, for the pages (`make docs`)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError for a folder that does not belong to a campaign."""
    from firmware_py.storage.whole_file import write_whole
    from metro_hil.engine.sources import sources_hash
    from metro_hil.report.law_figures import results_json
    from metro_hil.report.standing import stamped

    found = published()
    for name in options.runs:
        found = taken_over(found, name)
    stale: list[Standing] = []
    if options.check or options.measure:
        judged = check(found)
        found = stamped(found, judged, sources_hash())
        stale = [each for each in judged if each.reason]
    if options.measure:
        for name in sorted({each.scenario for each in stale}):
            found = taken_over(found, _measured(name))
        stale = []
    found = _titled(found)
    if options.write or options.measure:
        path = kept()
        write_whole(path, results_json(found))
        print(f"figures: {path}", file=sys.stderr)
    elif options.json:
        print(results_json(found), end="")
    elif not options.check:
        _print(found)
    return EXIT_FAILED if stale else EXIT_OK


def _print(found: "Results") -> None:
    """One table for each law, one row for each scenario."""
    from rich.table import Table

    console = console_for(highlight=False, markup=False)
    columns = (
        *("scenario", "stops", "missed", "mean", "worst", "bound", "in 10"),
        *("run s", "over %"),
    )
    for law, scenarios in found.items():
        table = Table(
            title=law, title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0)
        )
        for number, column in enumerate(columns):
            table.add_column(column, justify="right" if number else "left", overflow="fold")
        for name, each in scenarios.items():
            figures = each.figures
            table.add_row(
                name,
                str(figures.stops),
                str(figures.missed),
                _scaled(figures.mean_m, 100.0, 2),
                _scaled(figures.worst_m, 100.0, 2),
                _scaled(figures.bound_m, 100.0, 1),
                _scaled(figures.within_ratio, 100.0, 1),
                _scaled(figures.run_s, 1.0, 1),
                _scaled(figures.over_ratio, 100.0, 1),
            )
        console.print(table)
        console.print()
    console.print(
        "mean, worst, bound: errors of stops and their bound, cm; in 10: % within 10 cm",
        style="dim",
    )
    console.print("over: running time over the shortest possible", style="dim")
    console.print("`hil laws --json` has all figures, with their confidence intervals", style="dim")


def _scaled(value: float | None, factor: float, digits: int) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"


def kept() -> Path:
    """Path of the published figures."""
    from metro_hil.report.law_figures import RESULTS

    return Path(__file__).resolve().parents[2] / RESULTS


def published() -> "Results":
    from metro_hil.report.law_figures import read_results

    return read_results(kept().read_text(encoding="utf-8")) if kept().is_file() else {}


def taken_over(found: "Results", name: str) -> "Results":
    """Add the figures of a campaign that was run. Raises UsageError."""
    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.journal import once_each, read_journal, refuse_damage
    from metro_hil.engine.program import program_version
    from metro_hil.engine.sources import sources_hash
    from metro_hil.report.law_figures import merged_results, results_of

    folder = find_folder(name)
    journal = read_journal(folder.journal_path)
    refuse_damage(folder.journal_path, journal)
    by_id = once_each(journal.results)
    pairs = [(case, by_id.get(case.id)) for case in folder.cases()]
    manifest = folder.manifest()
    # Figures of another program count as current only after a check against this one.
    sources = sources_hash() if manifest.program == program_version() else ""
    return merged_results(found, results_of(manifest.name, pairs, sources=sources))


def check(found: "Results") -> "list[Standing]":
    """Print the state of each figure as soon as it is known."""
    from metro_hil.engine.sources import sources_hash
    from metro_hil.report.standing import standings

    judged = []
    for standing in standings(found, sources_hash(), plan=planned, run=run_cases):
        print(standing, file=sys.stderr if standing.reason else sys.stdout, flush=True)
        judged.append(standing)
    return judged


def planned(scenario: str) -> "Sequence[Case]":
    """All cases of a shipped scenario."""
    from metro_hil.campaign import plan_cases
    from metro_hil.campaign.scenarios import read_named

    return plan_cases(read_named(scenario))


def run_cases(cases: "Sequence[Case]") -> "list[CaseResult]":
    """Run cases in virtual time on all processors."""
    from metro_hil.run.dispatch import run_case

    if len(cases) == 1:
        return [run_case(cases[0])]
    with ProcessPoolExecutor(min(len(cases), os.cpu_count() or 1)) as pool:
        return list(pool.map(run_case, cases))


def _measured(scenario: str) -> str:
    """Run a whole scenario with its progress; return the name that finds its folder."""
    print(f"measuring {scenario}", flush=True)
    words = [sys.executable, "-m", "metro_hil.cli.hil", "run", scenario, "--no-report"]
    # A failed monitor is no reason to keep old figures: the new ones show the present state.
    subprocess.run(words, check=False)
    return scenario


def _titled(found: "Results") -> "Results":
    """Set title and campaign of each scenario to the shipped ones, however it was run."""
    import msgspec

    from metro_hil.campaign.scenarios import shipped_scenarios
    from metro_hil.report.law_figures import titled

    shipped = {each.name: each for each in shipped_scenarios()}
    known = titled(found, {name: each.title for name, each in shipped.items()})
    return {
        law: {
            name: msgspec.structs.replace(each, campaign=shipped[name].campaign)
            for name, each in own.items()
        }
        for law, own in known.items()
    }
