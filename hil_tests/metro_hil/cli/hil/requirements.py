"""`hil requirements`: prints the page of requirements with their scenarios, tests and results."""

import argparse
import sys
from pathlib import Path

from metro_hil.model.run_options import EXIT_OK


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "requirements",
        help="show the page from requirement to scenario, test and result",
        description="Print docs/reference/requirements.md: each requirement with its scenarios, "
        "its tests and their results. With --run the results of campaigns are taken over.",
    )
    parser.add_argument(
        "--run", metavar="FOLDER", dest="runs", action="append", default=[],
        help="of a campaign that was run; several are taken over one after another",
    )  # fmt: skip
    parser.add_argument(
        "--write", action="store_true", help="keep the results beside the catalogue, for the page"
    )
    parser.add_argument("--out", metavar="FILE", help="write the page there, not to the terminal")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError for a folder that does not belong to a campaign."""
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
    page = requirements_page(shipped_requirements(), scenarios, found)
    if options.out:
        write_whole(options.out, page)
    else:
        print(page, end="")
    return EXIT_OK
