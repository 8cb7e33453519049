"""`hil requirements`: prints the requirements with their scenarios, tests and last results."""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from firmware_py.settings import nearest
from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.terminal import console_for

if TYPE_CHECKING:
    from metro_hil.model.requirements import Requirement


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "requirements",
        help="show each requirement with its scenarios, tests and last results",
        description="Print a table of the requirements, or one requirement with its scenarios and "
        "tests. With --run the results of campaigns are taken over.",
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="a requirement, such as INV-05")
    parser.add_argument(
        "--run", metavar="FOLDER", dest="runs", action="append", default=[],
        help="of a campaign that was run; several are taken over one after another",
    )  # fmt: skip
    parser.add_argument(
        "--write", action="store_true", help="keep the results beside the catalogue, for the page"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="write docs/reference/requirements.md to this file"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError for a folder that belongs to no campaign, or an unknown requirement."""
    from firmware_py.storage.whole_file import write_whole
    from metro_hil.campaign.scenarios import shipped_scenarios
    from metro_hil.engine.errors import UsageError
    from metro_hil.engine.folder import find_folder
    from metro_hil.engine.journal import read_journal, refuse_damage
    from metro_hil.model.requirements import shipped_requirements
    from metro_hil.report.requirement_page import (
        RESULTS,
        outcomes,
        outcomes_json,
        read_outcomes,
        requirement_rows,
        requirements_page,
    )

    kept = Path(__file__).resolve().parents[2] / RESULTS
    found = read_outcomes(kept.read_text(encoding="utf-8")) if kept.is_file() else {}
    for name in options.runs:
        folder = find_folder(name)
        if subset := folder.manifest().subset:
            raise UsageError(
                f"--run {name}: only {subset} of its campaign were run; run all of them"
            )
        journal = read_journal(folder.journal_path)
        refuse_damage(folder.journal_path, journal)
        found |= outcomes(folder.cases(), journal.results)
    scenarios = shipped_scenarios()
    known = {each.name for each in scenarios}
    found = {name: outcome for name, outcome in found.items() if name in known}
    if options.write:
        write_whole(kept, outcomes_json(found))
        print(f"results: {kept}", file=sys.stderr)
    catalogue = shipped_requirements()
    if options.out:
        write_whole(options.out, requirements_page(catalogue, scenarios, found))
        return EXIT_OK
    rows = requirement_rows(_chosen(catalogue, options.name), scenarios, found)
    if options.json:
        print(json.dumps({"requirements": rows}, ensure_ascii=False))
    elif options.name is not None:
        _print_one(rows[0])
    else:
        _print(rows)
    return EXIT_OK


def _chosen(catalogue: "Mapping[str, Requirement]", name: str | None) -> "dict[str, Requirement]":
    from metro_hil.engine.errors import UsageError

    if name is None:
        return dict(catalogue)
    if name.upper() not in catalogue:
        raise UsageError(f"requirement {name!r}: unknown; {nearest(name.upper(), list(catalogue))}")
    return {name.upper(): catalogue[name.upper()]}


def _print(rows: "Sequence[dict[str, Any]]") -> None:
    from rich.table import Table

    table = Table(box=None)
    table.add_column("requirement", no_wrap=True)
    table.add_column("scenarios", overflow="fold")
    table.add_column("tests", justify="right")
    table.add_column("what", overflow="fold", ratio=1)
    for row in rows:
        counts = Counter(each["result"] for each in row["scenarios"])
        words = ", ".join(f"{count} {result}" for result, count in counts.items())
        table.add_row(row["id"], words or "none", str(len(row["tests"])), row["text"])
    console = console_for(highlight=False, markup=False)
    console.print(table)
    console.print("`hil requirements NAME` names the scenarios and tests of one", style="dim")


def _print_one(row: "dict[str, Any]") -> None:
    source = f" ({row['source']})" if row["source"] else ""
    print(f"{row['id']}{source}: {row['text']}")
    for each in row["scenarios"]:
        print(f"  scenario {each['name']}: {each['result']}")
    for test in row["tests"]:
        print(f"  test {test}")
